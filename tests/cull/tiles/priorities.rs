//! The order of requests for tiles, exact ranges, failed tiles and invalid numbers.

use glam::{DAffine3, DVec3};
use kit::cull_scenes::{content, look_at, page, quadtree};
use terrane::cull::{CullVisitor, RenderStage};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::scene::{Node, NodeKind, PagedLod, PagingOptions, RangeMode, Refine, Scene, SlotState};

/// A tile set whose errors increase from the root to the leaves is still loaded from the root.
#[test]
fn coarse_tiles_are_requested_first_even_with_wrong_errors() {
    let error = |geometric_error_m| RangeMode::ScreenSpaceError { geometric_error_m };
    let leaf = tile_at(DVec3::ZERO, 1.0, error(0.0), "2");
    let root = tile_at(DVec3::ZERO, 3.0, error(10.0), "0")
        .with_child(tile_at(DVec3::ZERO, 2.0, error(1000.0), "1").with_child(leaf));
    let mut scene = Scene::new();
    let id = scene.add_root(page(root, 0));
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    visitor.cull(&scene, &look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z), &mut stage);
    let order: Vec<f32> =
        scene.slots_of_page(id).map(|slot| stage.requests.iter().find(|r| r.slot == slot).unwrap().priority).collect();
    assert!(order[0] > order[1] && order[1] > order[2], "{order:?}");
}

/// Among equally distant and coarse tiles, those near the view's center are requested first.
#[test]
fn tiles_near_the_view_center_are_requested_first() {
    let error = RangeMode::ScreenSpaceError { geometric_error_m: 10.0 };
    let aside: Vec<f64> = vec![0.0, 20.0, -35.0, 50.0];
    let position = |degrees: f64| 100.0 * DVec3::new(degrees.to_radians().sin(), degrees.to_radians().cos(), 0.0);
    let mut scene = Scene::new();
    let tiles: Vec<Node> =
        aside.iter().enumerate().map(|(i, d)| tile_at(position(*d), 1.0, error, &i.to_string())).collect();
    let id = scene.add_root(page(Node::group(tiles), 0));
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    let mut camera = look_at(DVec3::ZERO, DVec3::Y, DVec3::Z);
    camera.clip_from_eye =
        glam::dcamera::rh::proj::directx::perspective_infinite_reverse(120f64.to_radians(), 1.0, 0.1);
    visitor.cull(&scene, &camera, &mut stage);
    let priorities: Vec<f32> =
        scene.slots_of_page(id).map(|slot| stage.requests.iter().find(|r| r.slot == slot).unwrap().priority).collect();
    assert!(priorities.windows(2).all(|p| p[0] > p[1]), "{priorities:?}");
    assert!(priorities[3] > 0.25 * priorities[0] && priorities[3] < 0.5 * priorities[0], "{priorities:?}");
}

/// Regression: a tile around the eye with its middle behind the eye had the priority of an invisible tile.
#[test]
fn tiles_around_the_eye_have_the_priority_of_tiles_in_front() {
    let error = RangeMode::ScreenSpaceError { geometric_error_m: 10.0 };
    let priority = |center: DVec3, scale: f64| {
        let mut scene = Scene::new();
        let tile = tile_at(center / scale, 300.0 / scale, error, "0");
        let id = scene.add_root(page(Node::transform(DAffine3::from_scale(DVec3::splat(scale)), vec![tile]), 0));
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        visitor.cull(&scene, &look_at(DVec3::ZERO, DVec3::Y, DVec3::Z), &mut stage);
        let slot = scene.slots_of_page(id).next().unwrap();
        stage.requests.iter().find(|r| r.slot == slot).unwrap().priority
    };
    for scale in [1.0, 0.01, 100.0] {
        let [behind, before] = [-200.0, 200.0].map(|y| priority(DVec3::new(0.0, y, -100.0), scale));
        assert!(behind > 0.9 * before, "{scale}: {behind} {before}");
    }
}

/// At planetary coordinates the distance to a tile is exact to a millimetre.
#[test]
fn ranges_are_exact_far_from_the_origin() {
    let center = DVec3::new(4_517_590.0, 1_000_000.25, 4_487_348.0);
    let range_m = 100.0;
    let child = |i: u32| tile_at(center, 1.0, RangeMode::Distance { center, range_m: 0.0 }, &format!("c{i}"));
    let root = tile_at(center, 1.0, RangeMode::Distance { center, range_m }, "r").with_child(child(0));
    let mut scene = Scene::new();
    let id = scene.add_root(page(root, 0));
    for (i, slot) in scene.slots_of_page(id).collect::<Vec<_>>().into_iter().enumerate() {
        scene.attach(slot, content(1.0, i as u32)).unwrap();
    }
    let drawn_at = |distance_m: f64| {
        let up = center.normalize();
        let camera = look_at(center + up * distance_m, center, DVec3::Z);
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        visitor.cull(&scene, &camera, &mut stage);
        stage.bins[0].leaves[0].slot.0
    };
    assert_eq!(drawn_at(range_m - 0.002), 1);
    assert_eq!(drawn_at(range_m + 0.002), 0);
}

/// Returns a tile with a spherical bound.
fn tile_at(center: DVec3, radius_m: f64, range_mode: RangeMode, name: &str) -> Node {
    Node::new(NodeKind::PagedLod(Box::new(PagedLod {
        bounds: BoundingVolume::Sphere(BoundingSphere::new(center, radius_m)),
        range_mode,
        refine: Refine::Replace,
        content: Some(name.into()),
        content_transform: DAffine3::from_translation(center),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    })))
}

/// Invalid numbers in a tile set neither panic nor hide other tiles.
#[test]
fn tiles_with_invalid_numbers_do_not_affect_others() {
    let nan = BoundingSphere::new(DVec3::NAN, f64::NAN);
    let mut odd = tile_at(DVec3::ZERO, 1.0, RangeMode::ScreenSpaceError { geometric_error_m: f64::NAN }, "odd");
    if let NodeKind::PagedLod(lod) = &mut odd.kind {
        lod.bounds = BoundingVolume::Sphere(nan);
        lod.content_transform = DAffine3::from_scale(DVec3::INFINITY);
    }
    let huge = tile_at(DVec3::ZERO, 1e30, RangeMode::ScreenSpaceError { geometric_error_m: 1e300 }, "huge");
    let negative = tile_at(DVec3::ZERO, -5.0, RangeMode::ScreenSpaceError { geometric_error_m: -1.0 }, "negative");
    let good = tile_at(DVec3::ZERO, 1.0, RangeMode::ScreenSpaceError { geometric_error_m: 1.0 }, "good");
    let root = Node::group(vec![huge.with_child(odd), negative, good]);
    let mut scene = Scene::new();
    let id = scene.add_root(page(root, 0));
    let camera = look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z);
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    visitor.cull(&scene, &camera, &mut stage);
    assert_eq!(stage.requests.len(), 4);
    assert!(stage.requests.iter().all(|r| r.priority.is_finite() && r.error_px.is_finite()));
    for (i, slot) in scene.slots_of_page(id).collect::<Vec<_>>().into_iter().enumerate() {
        scene.attach(slot, content(1.0, i as u32)).unwrap();
    }
    visitor.cull(&scene, &camera, &mut stage);
    assert_eq!(stage.counters.leaves, 3);
    assert!(stage.near_m > 7.0 && stage.far_m < 13.0);
}

#[test]
fn failed_tile_keeps_its_parent_visible_in_its_place() {
    let mut scene = Scene::new();
    let root = scene.add_root(page(quadtree(2, 100.0, 50.0, Refine::Replace), 0));
    let slots: Vec<_> = scene.slots_of_page(root).collect();
    let camera = look_at(DVec3::new(0.0, 0.0, 50.0), DVec3::ZERO, DVec3::Y);
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    for (i, slot) in slots.iter().enumerate().take(4) {
        scene.attach(*slot, content(50.0, i as u32)).unwrap();
    }
    let mut drawn = |scene: &Scene| {
        visitor.cull(scene, &camera, &mut stage);
        (stage.bins.iter().flat_map(|b| &b.leaves).map(|l| l.slot.0).collect::<Vec<_>>(), stage.requests.len())
    };
    assert_eq!(drawn(&scene), (vec![0], 1));
    scene.set_failed(slots[4], true);
    assert_eq!(scene.slot(slots[4]).unwrap().state, SlotState::Failed);
    // The parent is drawn twice: in the tile's volume, and around it behind everything else.
    assert_eq!(drawn(&scene), (vec![1, 2, 3, 0, 0], 0));
    scene.set_failed(slots[4], false);
    assert_eq!(drawn(&scene), (vec![1, 2, 3, 0, 0], 1), "it is requested again, and the picture stays");
    scene.attach(slots[4], content(50.0, 4)).unwrap();
    assert_eq!(drawn(&scene), (vec![1, 2, 3, 4], 0));
}
