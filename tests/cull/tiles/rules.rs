//! Rules that cull or keep a tile: the horizon, a camera's mask, small-feature culling. No GPU.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DMat4, DVec3};
use kit::cull_scenes::{content, look_at, page, square_box};
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::scene::{
    ComputeNearFar, CullAction, CullCallback, CullSettings, CullingMode, Node, NodeId, NodeKind, PagedLod,
    PagingOptions, RangeMode, Refine, Scene,
};
use terrane::state::StateSet;

/// A globe has 6 x 12 tiles of 30 degrees. From 1,000 km up, only tiles on this side of the horizon are visited.
#[test]
fn tiles_behind_the_horizon_are_culled() {
    use terrane::math::{Geodetic, Region, WGS84};
    let tiles = (0..72).map(|k| {
        let (i, j) = (f64::from(k % 12), f64::from(k / 12));
        let step = 30f64.to_radians();
        let (west, south) = (i * step - std::f64::consts::PI, j * step - 0.5 * std::f64::consts::PI);
        let region = Region {
            west,
            south,
            east: west + step,
            north: south + step,
            min_height_m: 0.0,
            max_height_m: 1000.0,
            ellipsoid: WGS84,
        };
        Node::new(NodeKind::PagedLod(Box::new(PagedLod {
            bounds: BoundingVolume::Region(region),
            range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
            refine: Refine::Replace,
            content: Some(format!("{k}").into()),
            content_transform: DAffine3::IDENTITY,
            reader_data: None,
            request_volume: None,
            paging: PagingOptions::default(),
        })))
    });
    let mut scene = Scene::new();
    scene.add_root(page(Node::group(tiles.collect()), 0));
    let eye = WGS84.ecef(&Geodetic { longitude: 0.26, latitude: 0.26, height_m: 1.0e6 });
    // The view is towards the earth's centre: half of the far side lies in the frustum.
    let straight = look_at(eye, DVec3::ZERO, DVec3::Z);
    let wanted = |camera: &CullCamera| {
        let mut stage = RenderStage::new();
        CullVisitor::new().cull(&scene, camera, &mut stage);
        let uris = stage.requests.iter().map(|r| scene.slot(r.slot).unwrap().uri.parse::<u32>().unwrap());
        uris.collect::<BTreeSet<u32>>()
    };
    let through = wanted(&straight);
    let solid = wanted(&CullCamera { horizon: Some(WGS84), ..straight });
    assert!(solid.is_subset(&through) && solid.len() < through.len(), "{solid:?} {through:?}");
    // The tile below the eye is visited, and none of the far hemisphere.
    assert!(solid.contains(&(3 * 12 + 6)), "{solid:?}");
    assert!(through.contains(&(2 * 12)) && !solid.contains(&(2 * 12)), "the antipode: {through:?} {solid:?}");
}

/// Returns a tile of a plane: a square around a point, with a content named after it.
fn flat_tile(center: DVec3, half_m: f64, geometric_error_m: f64) -> Node {
    Node::new(NodeKind::PagedLod(Box::new(PagedLod {
        bounds: BoundingVolume::Box(square_box(center, half_m)),
        range_mode: RangeMode::ScreenSpaceError { geometric_error_m },
        refine: Refine::Replace,
        content: Some(format!("{center}").into()),
        content_transform: DAffine3::from_translation(center),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    })))
}

/// Culls and attaches requested tiles until there are no requests.
fn settle(scene: &mut Scene, camera: &CullCamera) -> RenderStage {
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    for frame in 1..20 {
        visitor.cull(scene, &CullCamera { frame, ..*camera }, &mut stage);
        let wanted: Vec<NodeId> = stage.requests.iter().map(|r| r.slot).collect();
        if wanted.is_empty() {
            return stage;
        }
        for (i, slot) in wanted.into_iter().enumerate() {
            assert!(scene.attach(slot, content(50.0, i as u32)).is_ok());
        }
    }
    panic!("does not settle: {:?}", stage.requests);
}

#[test]
fn masked_child_does_not_delay_the_refinement_of_its_parent() {
    let mut parent = flat_tile(DVec3::ZERO, 100.0, 50.0);
    let mut hidden = flat_tile(DVec3::new(50.0, 0.0, 0.0), 50.0, 0.0);
    hidden.mask = 2;
    parent.children = vec![flat_tile(DVec3::new(-50.0, 0.0, 0.0), 50.0, 0.0), hidden];
    let mut scene = Scene::new();
    scene.add_root(page(parent, 0));
    let mut camera = look_at(DVec3::new(0.0, -10.0, 300.0), DVec3::ZERO, DVec3::Z);
    camera.settings.cull_mask = 1;
    let stage = settle(&mut scene, &camera);
    assert_eq!(stage.counters.tiles_drawn, 1);
    // 50 m to the left the child is visible, not the parent in the middle.
    let x = stage.eye_from_drawable.last().unwrap()[0][3];
    assert!((x + 50.0).abs() < 1.0, "{x}");
    camera.settings.cull_mask = 3;
    let both = settle(&mut scene, &camera);
    assert_eq!(both.counters.tiles_drawn, 2);
}

/// Regression: such tiles were evicted as invisible, although their parent needs them. It was drawn again and requested
/// them.
#[test]
fn tiles_hidden_by_a_node_are_kept_while_siblings_load() {
    let tile = |x: f64| flat_tile(DVec3::new(x, 0.0, 0.0), 20.0, 0.0);
    let hiding: [fn(Vec<Node>) -> Node; 3] = [
        |children| Node { children, ..Node::new(NodeKind::Switch(vec![false])) },
        |children| {
            let kind = NodeKind::Lod { center: DVec3::ZERO, ranges_m: vec![[1e6, 1e7]] };
            Node { children, ..Node::new(kind) }
        },
        |children| {
            let skips = CullCallback(Arc::new(|_| CullAction::Skip));
            Node { children, cull_callback: Some(skips), ..Node::group(Vec::new()) }
        },
    ];
    for (kind, hide) in hiding.iter().enumerate() {
        let mut parent = flat_tile(DVec3::ZERO, 100.0, 50.0);
        parent.children = vec![flat_tile(DVec3::new(1.0, 0.0, 0.0), 100.0, 0.0)];
        let mut scene = Scene::new();
        scene.add_root(page(parent, 0));
        let camera = look_at(DVec3::new(0.0, -10.0, 300.0), DVec3::ZERO, DVec3::Z);
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        let mut hidden = None;
        for frame in 1..10 {
            visitor.cull(&scene, &CullCamera { frame, ..camera }, &mut stage);
            let wanted: Vec<NodeId> = stage.requests.iter().map(|r| r.slot).collect();
            for slot in wanted {
                let uri = scene.slot(slot).unwrap().uri.to_string();
                let is = |x: f64| uri == format!("{}", DVec3::new(x, 0.0, 0.0));
                let below = if is(1.0) {
                    page(Node::group(vec![tile(-40.0), hide(vec![tile(40.0)])]), 5)
                } else {
                    content(20.0, 9)
                };
                hidden = if is(40.0) { Some(slot) } else { hidden };
                assert!(scene.attach(slot, below).is_ok());
            }
        }
        assert!(stage.requests.is_empty(), "{kind}: {:?}", stage.requests);
        let hidden = hidden.unwrap_or_else(|| panic!("{kind}: never requested"));
        assert_eq!(scene.slot(hidden).unwrap().last_used_frame, 9, "{kind}");
    }
}

/// Tiles are refined in a view that is rotated by a quarter. Regression: its up axis had no pixels.
#[test]
fn rotated_view_shows_the_same_detail() {
    let mut parent = flat_tile(DVec3::ZERO, 100.0, 10.0);
    parent.children = vec![flat_tile(DVec3::ZERO, 100.0, 0.0)];
    let straight = look_at(DVec3::new(0.0, -10.0, 500.0), DVec3::ZERO, DVec3::Z);
    for turn in [0.0, 0.25, 0.5, 1.0].map(|turns| turns * std::f64::consts::PI) {
        let clip_from_eye = DMat4::from_rotation_z(turn) * straight.clip_from_eye;
        let camera = CullCamera { clip_from_eye, ..straight };
        assert!((camera.px_per_radian() - straight.px_per_radian()).abs() < 1e-6, "{turn}");
        let mut scene = Scene::new();
        scene.add_root(page(parent.clone(), 0));
        settle(&mut scene, &camera);
        assert_eq!(scene.page_count(), 3, "{turn}: the finer tile");
    }
}

/// With an infinite error limit, tiles without content are still refined: zero times infinity is not a number.
#[test]
fn unconditional_refinement_ignores_the_error_limit() {
    let settings = [(f64::INFINITY, 1.0), (1e300, 1.0), (16.0, f64::INFINITY), (16.0, 1.0)];
    for (max_sse_px, lod_scale) in settings {
        let mut root = flat_tile(DVec3::ZERO, 100.0, f64::MAX / 1e6);
        if let NodeKind::PagedLod(paged) = &mut root.kind {
            paged.content = None;
        }
        let mut below = flat_tile(DVec3::ZERO, 100.0, 10.0);
        below.children = vec![flat_tile(DVec3::ONE, 100.0, 0.0)];
        root.children = vec![below];
        let mut scene = Scene::new();
        scene.add_root(page(root, 0));
        let mut camera = look_at(DVec3::new(0.0, -10.0, 300.0), DVec3::ZERO, DVec3::Z);
        (camera.settings.max_sse_px, camera.settings.lod_scale) = (max_sse_px, lod_scale);
        let stage = settle(&mut scene, &camera);
        assert_eq!(stage.counters.tiles_drawn, 1, "{max_sse_px} {lod_scale}");
        let finest = max_sse_px * lod_scale < 100.0;
        assert_eq!(scene.page_count(), if finest { 3 } else { 2 }, "{max_sse_px} {lod_scale}");
    }
}

#[test]
fn small_feature_culling_keeps_tiles() {
    let mut scene = Scene::new();
    scene.add_root(page(flat_tile(DVec3::ZERO, 1.0, 0.0), 0));
    let far = look_at(DVec3::new(0.0, -5000.0, 0.0), DVec3::ZERO, DVec3::Z);
    let culling = CullingMode::DEFAULT | CullingMode::SMALL_FEATURE;
    let settings = CullSettings { culling, ..CullSettings::default() };
    assert_eq!(settle(&mut scene, &CullCamera { settings, ..far }).counters.tiles_drawn, 1);
}

/// The image has 1,024 pixels for 200 m without perspective, so that an error of 3 m projects to 15.36 pixels.
#[test]
fn orthographic_errors_do_not_depend_on_distance() {
    let eye = DVec3::new(0.0, 0.0, 5000.0);
    for (error_m, height_m, drawn) in [(3.0, 5000.0, 1), (3.3, 5000.0, 4), (3.0, 60.0, 1), (3.3, 60.0, 4)] {
        let mut parent = flat_tile(DVec3::ZERO, 100.0, error_m);
        parent.children = [(-50.0, -50.0), (50.0, -50.0), (-50.0, 50.0), (50.0, 50.0)]
            .map(|(x, y)| flat_tile(DVec3::new(x, y, 0.0), 50.0, 0.0))
            .to_vec();
        let mut scene = Scene::new();
        scene.add_root(page(parent, 0));
        let mut camera = look_at(eye.with_z(height_m), DVec3::ZERO, DVec3::Y);
        camera.clip_from_eye = proj::orthographic(-100.0, 100.0, -100.0, 100.0, 1e5, 0.1);
        assert_eq!(settle(&mut scene, &camera).counters.tiles_drawn, drawn, "{error_m} {height_m}");
        assert!(camera.eye_point().is_parallel);
    }
}

/// Pages attached to tiles are visited after all nodes of the page itself.
#[test]
fn near_and_far_planes_of_a_nested_view_follow_its_tiles() {
    let narrow = proj::perspective(0.5, 1.0, 1e5, 0.1);
    let view = Node { children: vec![flat_tile(DVec3::ZERO, 100.0, 0.0)], ..Node::new(NodeKind::Projection(narrow)) };
    let mut scene = Scene::new();
    scene.add_root(page(Node::group(vec![view, flat_tile(DVec3::new(0.0, 0.0, -5000.0), 100.0, 0.0)]), 0));
    let mut camera = look_at(DVec3::new(0.0, 0.0, 1000.0), DVec3::ZERO, DVec3::Y);
    camera.settings.compute_near_far = ComputeNearFar::BoundingVolumes;
    let stage = settle(&mut scene, &camera);
    let [near_m, far_m] = stage.views[0].range_m;
    // The content is two metres thick.
    assert!((near_m - 999.0).abs() < 0.1 && (far_m - 1001.0).abs() < 0.1, "{near_m} {far_m}");
    let clip = stage.views[0].clip_from_eye;
    let depth = |distance_m: f64| {
        let clip = clip * glam::DVec4::new(0.0, 0.0, -distance_m, 1.0);
        clip.z / clip.w
    };
    assert!(depth(999.0) < 1.0 && depth(970.0) > 1.0 && depth(1001.0) > 0.0 && depth(1030.0) < 0.0);
    assert!(stage.near_m > 5000.0, "leaves of another view were included: {}", stage.near_m);
}

/// Returns three levels of tiles, each named by its number in depth-first order. State sets make some of them grey.
fn numbered_tiles(level: u32, center: DVec3, next: &mut u32, greys: &BTreeMap<u32, f32>) -> Node {
    let number = *next;
    *next += 1;
    let half_m = 400.0 / f64::from(1 << level);
    let mut tile = flat_tile(center, half_m, if level == 2 { 0.0 } else { half_m });
    if let NodeKind::PagedLod(lod) = &mut tile.kind {
        lod.content = Some(number.to_string().into());
        lod.reader_data = Some(format!("data {number}").into());
        lod.paging.priority_offset = number as f32;
        if number == 9 {
            lod.request_volume = Some(BoundingVolume::Sphere(BoundingSphere::new(DVec3::Z * 1e4, 100.0)));
        }
        if number == 16 {
            // The eye is never near enough for its children.
            lod.range_mode = RangeMode::Distance { center: DVec3::Z * -1e6, range_m: 1.0 };
        }
    }
    if let Some(grey) = greys.get(&number) {
        let set = StateSet { color: Some([*grey, *grey, *grey, 1.0]), ..StateSet::default() };
        tile = tile.with_state_set(Arc::new(set));
    }
    if level < 2 {
        for (x, y) in [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)] {
            let child = center + DVec3::new(x, y, 0.0) * half_m;
            tile = tile.with_child(numbered_tiles(level + 1, child, next, greys));
        }
    }
    tile
}

#[test]
fn nodes_attached_to_a_tile_are_drawn_with_it() {
    let greys = BTreeMap::from([(3, 0.5), (11, 0.25), (13, 0.5)]);
    let mut scene = Scene::new();
    let roots = Node::group(vec![
        numbered_tiles(0, DVec3::ZERO, &mut 0, &BTreeMap::new()),
        numbered_tiles(0, DVec3::ZERO, &mut 0, &greys),
    ]);
    let root = scene.add_root(page(roots, 0));
    let slots: Vec<NodeId> = scene.slots_of_page(root).collect();
    assert_eq!(slots.len(), 42);
    for (i, slot) in slots.iter().enumerate() {
        let number = i % 21;
        let info = scene.slot(*slot).unwrap();
        assert_eq!(**info.uri, *number.to_string());
        assert_eq!(info.reader_data.and_then(|data| data.text()), Some(&*format!("data {number}")));
        assert_eq!(info.paging.priority_offset, number as f32);
        assert_eq!(info.depth, if number == 0 { 0 } else { 1 + u32::from(number % 5 != 1) });
        scene.attach(*slot, content(50.0, i as u32)).unwrap();
    }
    let camera = look_at(DVec3::new(0.0, -10.0, 700.0), DVec3::ZERO, DVec3::Z);
    let stage = settle(&mut scene, &camera);
    // Tile 9 has a request volume without this eye, so that tile 6 stands in for it and its siblings. The centre of
    // tile 16 is too far away for its refinement.
    let drawn: BTreeMap<u32, f32> =
        stage.bins.iter().flat_map(|bin| &bin.leaves).fold(BTreeMap::new(), |mut all, leaf| {
            all.insert(leaf.slot.0, stage.state_sets[leaf.state as usize].color[0]);
            all
        });
    let expected = (0..42).filter_map(|i| {
        let number = i % 21;
        let is_drawn = matches!(number, 2..=6 | 12..=16);
        let grey = match number {
            _ if i < 21 => 1.0,
            3 => 0.5,
            11 | 12 | 14 | 15 => 0.25,
            13 => 0.125,
            _ => 1.0,
        };
        is_drawn.then_some((i, grey))
    });
    assert_eq!(drawn, expected.collect());
}

/// Clients for 3D Tiles count a tile as selected if its bounding volume is in view, wherever its content is.
#[test]
fn contents_outside_of_the_view_are_selected_with_their_tile() {
    let camera = look_at(DVec3::new(0.0, 0.0, 1000.0), DVec3::ZERO, DVec3::Y);
    // Contents are 50 m wide. The first tile has its content at its centre, beside the view; the second is beside the view as
    // a whole.
    let mut wide = flat_tile(DVec3::new(2000.0, 0.0, 0.0), 2000.0, 0.0);
    if let NodeKind::PagedLod(tile) = &mut wide.kind {
        tile.content_transform = DAffine3::from_translation(DVec3::new(2000.0, 0.0, 0.0));
    }
    let outside = flat_tile(DVec3::new(-9000.0, 0.0, 0.0), 100.0, 0.0);
    let inside = flat_tile(DVec3::new(10.0, 0.0, 0.0), 100.0, 0.0);
    // A content behind the eye.
    let mut behind = flat_tile(DVec3::new(20.0, 0.0, 0.0), 100.0, 0.0);
    if let NodeKind::PagedLod(tile) = &mut behind.kind {
        tile.content_transform = DAffine3::from_translation(DVec3::new(0.0, 0.0, 9000.0));
    }
    let mut scene = Scene::new();
    scene.add_root(page(Node::group(vec![wide, outside, inside, behind]), 0));
    let stage = settle(&mut scene, &camera);
    assert_eq!(stage.counters.leaves, 1);
    let selecting = CullCamera { culls_contents: false, ..camera };
    let mut stage = RenderStage::new();
    CullVisitor::new().cull(&scene, &selecting, &mut stage);
    assert_eq!((stage.counters.leaves, stage.requests.len()), (3, 0));
}
