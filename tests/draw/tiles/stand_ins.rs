//! Tiles whose load failed: the content above is drawn within their volumes alone, and their siblings are drawn.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use image::RgbaImage;
use kit::frames::MAGENTA;
use kit::rig::{Rig, camera, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::terrain::Terrain;
use terrane::math::{BoundingSphere, BoundingVolume, OrientedBox};
use terrane::scene::{
    AlphaMode, Material, Node, NodeId, NodeKind, PageId, PagedLod, PagingOptions, RangeMode, Refine, Scene,
};
use terrane::state::{Attribute, StateSet, SurfaceMaterial};

use super::{attach, detach, large};

const SIZE: u32 = 64;
const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];
const GREEN: [f32; 4] = [0.0, 1.0, 0.0, 1.0];

fn tile(bounds: BoundingVolume, range_m: f64, content: bool) -> Node {
    Node::new(NodeKind::PagedLod(Box::new(PagedLod {
        range_mode: RangeMode::Distance { center: bounds.bounding_sphere().center, range_m },
        bounds,
        refine: Refine::Replace,
        content: content.then(|| "tile".into()),
        content_transform: DAffine3::IDENTITY,
        reader_data: None,
        paging: PagingOptions::default(),
        request_volume: None,
    })))
}

/// Returns a box around a quadrant of the square from -1.2 to 1.2: right is odd, top is 2 and 3.
fn quadrant(index: usize) -> (DVec3, BoundingVolume) {
    let center = DVec3::new([-0.6, 0.6][index % 2], [-0.6, 0.6][index / 2], 0.0);
    (center, BoundingVolume::Box(OrientedBox { center, half_axes: DMat3::from_diagonal(DVec3::new(0.6, 0.6, 0.5)) }))
}

/// Returns a square that is its own parent's quadrants as tiles.
fn root() -> Node {
    let all = OrientedBox { center: DVec3::ZERO, half_axes: DMat3::from_diagonal(DVec3::new(1.2, 1.2, 0.5)) };
    let mut root = tile(BoundingVolume::Box(all), 1e9, true);
    root.children = (0..4).map(|i| tile(quadrant(i).1, 0.0, true)).collect();
    root
}

fn slots(scene: &Scene, page: PageId) -> Vec<NodeId> {
    scene.slots_of_page(page).collect()
}

/// Asserts that each pixel is that of `inside` where `is_inside` says so and otherwise that of `outside`; pixels next to
/// the border may be either.
fn assert_composed(
    picture: &RgbaImage,
    [inside, outside]: [&RgbaImage; 2],
    is_inside: impl Fn(u32, u32) -> Option<bool>,
    what: &str,
) {
    let mut counts = [0; 2];
    for (x, y, pixel) in picture.enumerate_pixels() {
        let (within, beyond) = (inside.get_pixel(x, y), outside.get_pixel(x, y));
        match is_inside(x, y) {
            Some(true) => assert_eq!(pixel, within, "{what}: inside, at {x} {y}"),
            Some(false) => assert_eq!(pixel, beyond, "{what}: outside, at {x} {y}"),
            None => assert!(pixel == within || pixel == beyond, "{what}: {pixel:?} at {x} {y}"),
        }
        counts[usize::from(pixel == within)] += usize::from(within != beyond);
    }
    assert!(counts.iter().all(|count| *count > 200), "{what}: {counts:?}");
}

/// Returns whether a pixel shows the upper right quadrant; `None` within a pixel of the border.
fn is_upper_right(x: u32, y: u32) -> Option<bool> {
    let middle = SIZE / 2;
    let near = |v: u32| v.abs_diff(middle) <= 1;
    let is_in = x >= middle && y < middle;
    if (near(x) && y <= middle + 1) || (near(y) && x + 1 >= middle) { None } else { Some(is_in) }
}

type Content<'a> = dyn Fn([f32; 4], DVec3, f32) -> Node + 'a;

#[test]
fn content_above_a_failed_tile_is_drawn_in_its_volume_alone() {
    let Some(mut rig) = rig("content_above_a_failed_tile_is_drawn_in_its_volume_alone") else { return };
    let rig = &mut *rig;
    let unlit = |color| Material { base_color: color, unlit: true, double_sided: true, ..Material::default() };
    let with_alpha = |color, alpha| Material { alpha, ..unlit(color) };
    let fixed = SurfaceMaterial { emission: [0.2; 3], ..SurfaceMaterial::default() };
    let fixed = Arc::new(StateSet::default().with(Attribute::SurfaceMaterial(fixed)));
    let kinds: [(&str, &Content<'_>); 6] = [
        ("pulled", &|color, center, half| Node::geode(vec![quad(center.as_vec3().to_array(), [half, half], color)])),
        ("large", &|color, center, half| Node::geode(vec![large(center.as_vec3().to_array(), half, unlit(color))])),
        ("lit", &|color, center, half| {
            Node::geode(vec![large(center.as_vec3().to_array(), half, Material { unlit: false, ..unlit(color) })])
        }),
        ("masked", &|color, center, half| {
            Node::geode(vec![large(center.as_vec3().to_array(), half, with_alpha(color, AlphaMode::Mask(0.5)))])
        }),
        ("blended", &|color, center, half| {
            Node::geode(vec![large(center.as_vec3().to_array(), half, with_alpha(color, AlphaMode::Blend))])
        }),
        ("fixed function", &|color, center, half| {
            let meshes = vec![large(center.as_vec3().to_array(), half, Material { unlit: false, ..unlit(color) })];
            Node::geode(meshes).with_state_set(fixed.clone())
        }),
    ];
    for (what, content) in kinds {
        let mut scene = rig.scene(root());
        let all = slots(&scene, scene.roots()[0]);
        let picture = |rig: &mut Rig, scene: &Scene| rig.picture(scene, &unit_camera(SIZE), &plain());
        let above = attach(rig, &mut scene, all[0], content(RED, DVec3::ZERO, 1.2));
        let coarse = picture(rig, &scene);
        // The finer level is behind the coarse one: where both were drawn, pixels would not show it.
        let finer = |rig: &mut Rig, scene: &mut Scene, i: usize| {
            attach(rig, scene, all[1 + i], content(GREEN, quadrant(i).0 - 0.3 * DVec3::Z, 0.6))
        };
        let mut pages: Vec<PageId> = (0..3).map(|i| finer(rig, &mut scene, i)).collect();
        assert_eq!(picture(rig, &scene), coarse, "{what}: the children wait for the fourth");
        scene.set_failed(all[4], true);
        let with_failure = picture(rig, &scene);
        scene.set_failed(all[4], false);
        assert_eq!(picture(rig, &scene), with_failure, "{what}: it is being tried again");
        scene.forget_failure(all[4]);
        assert_eq!(picture(rig, &scene), coarse, "{what}: the failure is forgotten");
        scene.set_failed(all[4], true);
        pages.push(finer(rig, &mut scene, 3));
        let fine = picture(rig, &scene);
        assert!(rig.stage.parts.is_empty());
        assert_composed(&with_failure, [&coarse, &fine], is_upper_right, what);
        // If nothing but failures is there, the content above is drawn as it is.
        for (i, page) in pages.into_iter().enumerate() {
            detach(rig, &mut scene, page);
            scene.set_failed(all[1 + i], true);
        }
        assert_eq!(picture(rig, &scene), coarse, "{what}: all have failed");
        assert!(rig.stage.parts.is_empty());
        detach(rig, &mut scene, above);
        rig.release(scene);
    }
}

/// The failed tile may be in another tileset than the content above it, at any depth below it.
#[test]
fn content_of_a_page_above_stands_in() {
    let Some(mut rig) = rig("content_of_a_page_above_stands_in") else { return };
    let rig = &mut *rig;
    let geode = |color, center: DVec3, half| Node::geode(vec![quad(center.as_vec3().to_array(), [half, half], color)]);
    let mut scene = rig.scene(root());
    let all = slots(&scene, scene.roots()[0]);
    let picture = |rig: &mut Rig, scene: &Scene| rig.picture(scene, &unit_camera(SIZE), &plain());
    let mut pages = vec![attach(rig, &mut scene, all[0], geode(RED, DVec3::ZERO, 1.2))];
    let coarse = picture(rig, &scene);
    for i in 0..3 {
        pages.push(attach(rig, &mut scene, all[1 + i], geode(GREEN, quadrant(i).0, 0.6)));
    }
    // Two tilesets, one in the other, and a tile without content.
    let mut external = |rig: &mut Rig, scene: &mut Scene, slot| {
        let mut empty = tile(quadrant(3).1, 1e9, false);
        empty.children = vec![tile(quadrant(3).1, 0.0, true)];
        let page = attach(rig, scene, slot, empty);
        pages.push(page);
        slots(scene, page)[0]
    };
    let outer = external(rig, &mut scene, all[4]);
    let inner = external(rig, &mut scene, outer);
    assert_eq!(picture(rig, &scene), coarse);
    scene.set_failed(inner, true);
    let with_failure = picture(rig, &scene);
    pages.push(attach(rig, &mut scene, inner, geode(GREEN, quadrant(3).0, 0.6)));
    let fine = picture(rig, &scene);
    assert_composed(&with_failure, [&coarse, &fine], is_upper_right, "tilesets");
    for page in pages.into_iter().rev() {
        detach(rig, &mut scene, page);
    }
    rig.release(scene);
}

/// A sphere cuts as a box does. Around the volume the content above is seen only where nothing else is drawn.
#[test]
fn a_sphere_cuts_and_the_rest_is_behind_everything() {
    let Some(mut rig) = rig("a_sphere_cuts_and_the_rest_is_behind_everything") else { return };
    let rig = &mut *rig;
    let geode = |color, half: f32| Node::geode(vec![quad([0.0; 3], [half, half], color)]);
    let sphere = |radius_m| BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, radius_m));
    let mut parent = tile(sphere(2.0), 1e9, true);
    parent.children = vec![tile(sphere(0.5), 0.0, true), tile(sphere(2.0), 0.0, true)];
    let mut scene = rig.scene(parent);
    let all = slots(&scene, scene.roots()[0]);
    attach(rig, &mut scene, all[0], geode(RED, 1.2));
    // The sibling is far behind, on the left only.
    attach(rig, &mut scene, all[2], Node::geode(vec![quad([-2.0, 0.0, -0.9], [2.0, 2.0], GREEN)]));
    scene.set_failed(all[1], true);
    let picture = rig.picture(&scene, &unit_camera(SIZE), &plain());
    for (x, y, pixel) in picture.enumerate_pixels() {
        let at = |v: u32| (f64::from(v) + 0.5) / f64::from(SIZE / 2) - 1.0;
        let distance = at(x).hypot(at(y));
        let is_red = pixel.0 == [255, 0, 0, 255];
        // The margin is a hundredth of the radius, the backdrop as wide as the radius; a pixel is 0.03 wide.
        let radius_m = if at(x) < 0.0 { 0.505 } else { 1.005 };
        assert!(distance > radius_m - 0.015 || is_red, "{x} {y}: {pixel:?}");
        assert!(distance < radius_m + 0.025 || !is_red, "{x} {y}: {pixel:?}");
    }
}

/// Heights under both models of shading: no hole, the other three quarters as without the failure.
#[test]
fn height_tiles_stand_in_without_a_hole() {
    let Some(mut rig) = rig("height_tiles_stand_in_without_a_hole") else { return };
    let rig = &mut *rig;
    let terrain =
        Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 900.0, root_error_m: 250.0, textured: true };
    let volume = |u: f64, v: f64, half: f64| {
        let at = |du: f64, dv: f64| terrain.world(u + du, v + dv, 0.0);
        BoundingVolume::Box(OrientedBox {
            center: at(0.0, 0.0),
            half_axes: DMat3::from_cols(
                0.5 * (at(half, 0.0) - at(-half, 0.0)),
                0.5 * (at(0.0, half) - at(0.0, -half)),
                3_000.0 * terrain.up(u, v),
            ),
        })
    };
    let mut parent = tile(volume(0.5, 0.5, 0.5), 1e9, true);
    let quarter = |i: usize| (0.25 + 0.5 * (i % 2) as f64, 0.25 + 0.5 * (i / 2) as f64);
    parent.children = (0..4).map(|i| tile(volume(quarter(i).0, quarter(i).1, 0.25), 0.0, true)).collect();
    let mut scene = rig.scene(parent);
    let all = slots(&scene, scene.roots()[0]);
    attach(rig, &mut scene, all[0], terrain.tile(0, 0, 0));
    let (eye, center) = (terrain.world(0.5, 0.5, 30_000.0), terrain.world(0.5, 0.5, 0.0));
    let camera = camera([SIZE, SIZE], eye, center, terrain.up(0.5, 0.5).any_orthonormal_vector());
    let set = Arc::new(StateSet::default().with(Attribute::SurfaceMaterial(SurfaceMaterial::default())));
    let pictures = |rig: &mut Rig, scene: &Scene| {
        [None, Some(set.clone())].map(|set| {
            rig.visitor.state_set = set;
            rig.picture(scene, &camera, &plain())
        })
    };
    let is_hole = |pixel: &image::Rgba<u8>| pixel.0[..3] == MAGENTA;
    let coarse = pictures(rig, &scene);
    for i in 0..3 {
        attach(rig, &mut scene, all[1 + i], terrain.tile(1, i as u32 % 2, i as u32 / 2));
    }
    scene.set_failed(all[4], true);
    let with_failure = pictures(rig, &scene);
    attach(rig, &mut scene, all[4], terrain.tile(1, 1, 1));
    let fine = pictures(rig, &scene);
    rig.visitor.state_set = None;
    for (what, i) in [("lit", 0), ("fixed function", 1)] {
        let (mut as_fine, mut as_coarse) = (0, 0);
        for (x, y, pixel) in with_failure[i].enumerate_pixels() {
            let (coarse, fine) = (coarse[i].get_pixel(x, y), fine[i].get_pixel(x, y));
            assert!(!is_hole(pixel) || is_hole(fine) || is_hole(coarse), "{what}: a hole at {x} {y}");
            if coarse != fine {
                (as_fine, as_coarse) = (as_fine + usize::from(pixel == fine), as_coarse + usize::from(pixel == coarse));
            }
        }
        // A quarter of what differs, within the margin.
        let share = as_coarse as f64 / (as_fine + as_coarse) as f64;
        assert!((0.15..0.4).contains(&share), "{what}: {as_coarse} coarse, {as_fine} fine");
    }
}
