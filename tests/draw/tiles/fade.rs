//! Fades between levels of detail: in the middle of a fade each pixel shows one of the two levels, never both and never
//! the background behind them.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::frames::{MAGENTA, count};
use kit::rig::{Rig, camera, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::terrain::Terrain;
use terrane::cull::CullCamera;
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::scene::{
    AlphaMode, Attachment, CameraNode, CameraTarget, Material, Node, NodeKind, PageId, PagedLod, PagingOptions,
    RangeMode, Refine, RenderOrder, Scene,
};
use terrane::state::{Attribute, Program, StateSet, SurfaceMaterial, TextureFormat, TextureObject};

use super::{detach, large};

const SIZE: u32 = 64;
const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];
const GREEN: [f32; 4] = [0.0, 1.0, 0.0, 1.0];
const BLUE: [f32; 4] = [0.0, 0.0, 1.0, 1.0];

/// Returns a tile that is refined if the LOD scale is below a tenth of its range. The eye is 10 m away.
fn tile(range_m: f64, refine: Refine, children: Vec<Node>) -> Node {
    let lod = PagedLod {
        bounds: BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 3.0)),
        range_mode: RangeMode::Distance { center: DVec3::ZERO, range_m },
        refine,
        content: Some("tile".into()),
        content_transform: DAffine3::IDENTITY,
        reader_data: None,
        paging: PagingOptions::default(),
        request_volume: None,
    };
    Node { children, ..Node::new(NodeKind::PagedLod(Box::new(lod))) }
}

/// Uploads a content and attaches it to the nth slot of the root.
fn attach(rig: &mut Rig, scene: &mut Scene, slot: usize, content: Node) -> PageId {
    let slot = scene.slots_of_page(scene.roots()[0]).nth(slot).unwrap();
    super::attach(rig, scene, slot, content)
}

/// Draws at a time with a LOD scale: 1 shows the coarse level, less the finer.
fn seen(time_s: f64, lod_scale: f64) -> CullCamera {
    let mut camera = CullCamera { simulation_time_s: time_s, ..unit_camera(SIZE) };
    camera.settings.lod_scale = lod_scale;
    camera
}

fn assert_each_is_one_of(picture: &RgbaImage, old: &RgbaImage, new: &RgbaImage, what: &str) -> usize {
    let mut are_new = 0;
    for (x, y, pixel) in picture.enumerate_pixels() {
        let (old, new) = (old.get_pixel(x, y), new.get_pixel(x, y));
        assert!(pixel == old || pixel == new, "{what}: {pixel:?} at {x} {y} is neither {old:?} nor {new:?}");
        are_new += usize::from(pixel == new && new != old);
    }
    are_new
}

/// Fades to the new level and back. Returns the shares of new pixels in the frames of the first fade.
fn assert_fades(rig: &mut Rig, scene: &Scene, at: &dyn Fn(f64, f64) -> CullCamera, what: &str) -> Vec<usize> {
    let environment = plain();
    let without = |rig: &mut Rig, lod_scale: f64| {
        let mut camera = at(0.0, lod_scale);
        camera.settings.lod_fade_s = 0.0;
        rig.picture(scene, &camera, &environment)
    };
    let (old, new) = (without(rig, 1.0), without(rig, 0.5));
    let differing = old.pixels().zip(new.pixels()).filter(|(a, b)| a != b).count();
    assert!(differing > 500, "{what}: {differing}");
    assert_eq!(rig.picture(scene, &at(100.0, 1.0), &environment), old);
    assert_eq!(rig.picture(scene, &at(100.02, 1.0), &environment), old);
    let mut shares = Vec::new();
    for step in 1..=7 {
        let picture = rig.picture(scene, &at(100.02 + 0.04 * f64::from(step), 0.5), &environment);
        let are_new = assert_each_is_one_of(&picture, &old, &new, what);
        assert_eq!(rig.stage.counters.fading > 0, step < 7, "{what}: {step}");
        shares.push(are_new);
    }
    assert!(shares.is_sorted() && shares[0] > 0 && shares[5] < differing, "{what}: {shares:?} of {differing}");
    assert_eq!(*shares.last().unwrap(), differing, "{what}");
    assert_eq!(rig.picture(scene, &at(100.31, 0.5), &environment), new);
    assert!(rig.stage.parts.is_empty() && rig.stage.part_of_state.iter().all(|f| *f == 0));
    let picture = rig.picture(scene, &at(100.41, 1.0), &environment);
    let are_new = assert_each_is_one_of(&picture, &old, &new, what);
    assert!(are_new > 0 && are_new < differing, "{what}, back: {are_new} of {differing}");
    assert_eq!(rig.picture(scene, &at(101.0, 1.0), &environment), old, "{what}: a jump in time");
    // Without simulation time the level changes at once.
    assert_eq!(rig.picture(scene, &at(101.0, 0.5), &environment), new);
    assert_eq!(rig.picture(scene, &at(101.0, 1.0), &environment), old);
    shares
}

/// Returns a node of a colour at a depth in metres.
type Kind<'a> = dyn Fn([f32; 4], f32) -> Node + 'a;

#[test]
fn tile_fades_into_its_children_pixel_by_pixel() {
    let Some(mut rig) = rig("tile_fades_into_its_children_pixel_by_pixel") else { return };
    let rig = &mut *rig;
    let unlit = |color| Material { base_color: color, unlit: true, double_sided: true, ..Material::default() };
    let fixed = || {
        let material = SurfaceMaterial { emission: [0.2; 3], ..SurfaceMaterial::default() };
        Arc::new(StateSet::default().with(Attribute::SurfaceMaterial(material)))
    };
    let with_alpha = |color, alpha| Material { alpha, ..unlit(color) };
    let kinds: [(&str, &Kind<'_>); 6] = [
        ("pulled", &|color, depth| Node::geode(vec![quad([0.0, 0.0, depth], [1.2, 1.2], color)])),
        ("large", &|color, depth| Node::geode(vec![large([0.0, 0.0, depth], 1.2, unlit(color))])),
        ("lit", &|color, depth| {
            Node::geode(vec![large([0.0, 0.0, depth], 1.2, Material { unlit: false, ..unlit(color) })])
        }),
        ("masked", &|color, depth| {
            Node::geode(vec![large([0.0, 0.0, depth], 1.2, with_alpha(color, AlphaMode::Mask(0.5)))])
        }),
        ("blended", &|color, depth| {
            Node::geode(vec![large([0.0, 0.0, depth], 1.2, with_alpha(color, AlphaMode::Blend))])
        }),
        ("fixed function", &|color, depth| {
            let lit = Material { unlit: false, ..unlit(color) };
            let meshes = vec![large([0.0, 0.0, depth], 1.2, lit), quad([0.0, 0.0, depth - 1.0], [2.0, 2.0], color)];
            Node::geode(meshes).with_state_set(fixed())
        }),
    ];
    for (what, content) in kinds {
        let mut scene = rig.scene(tile(6.0, Refine::Replace, vec![tile(0.0, Refine::Replace, Vec::new())]));
        // The finer level is behind the coarse one. If both were drawn, pixels would show it.
        let pages = [attach(rig, &mut scene, 0, content(RED, 0.0)), attach(rig, &mut scene, 1, content(GREEN, -0.3))];
        let shares = assert_fades(rig, &scene, &seen, what);
        // Four of twenty-five parts of the pixels change in each frame.
        for (step, share) in shares[..6].iter().enumerate() {
            let expected = 0.16 * (step + 1) as f64 * f64::from(SIZE * SIZE);
            assert!((*share as f64 - expected).abs() < 0.02 * f64::from(SIZE * SIZE), "{what}: {shares:?}");
        }
        for page in pages.into_iter().rev() {
            detach(rig, &mut scene, page);
        }
    }
}

#[test]
fn height_tiles_fade_as_well() {
    let Some(mut rig) = rig("height_tiles_fade_as_well") else { return };
    let rig = &mut *rig;
    let terrain =
        Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 900.0, root_error_m: 250.0, textured: true };
    let center = terrain.world(0.5, 0.5, 0.0);
    let bounds = BoundingVolume::Sphere(BoundingSphere::new(center, 40_000.0));
    let lod = |range_m| PagedLod {
        bounds,
        range_mode: RangeMode::Distance { center, range_m },
        refine: Refine::Replace,
        content: Some("heights".into()),
        content_transform: DAffine3::IDENTITY,
        reader_data: None,
        paging: PagingOptions::default(),
        request_volume: None,
    };
    let mut root = Node::new(NodeKind::PagedLod(Box::new(lod(20_000.0))));
    root.children = (0..4).map(|_| Node::new(NodeKind::PagedLod(Box::new(lod(0.0))))).collect();
    let mut scene = rig.scene(root);
    attach(rig, &mut scene, 0, terrain.tile(0, 0, 0));
    for i in 0..4 {
        attach(rig, &mut scene, 1 + i, terrain.tile(1, i as u32 % 2, i as u32 / 2));
    }
    let eye = terrain.world(0.5, 0.5, 30_000.0);
    for fixed_function in [false, true] {
        let at = |time_s: f64, lod_scale: f64| {
            let mut camera = CullCamera {
                simulation_time_s: time_s,
                ..camera([SIZE, SIZE], eye, center, terrain.up(0.5, 0.5).any_orthonormal_vector())
            };
            camera.settings.lod_scale = lod_scale;
            camera
        };
        let set = StateSet::default().with(Attribute::SurfaceMaterial(SurfaceMaterial::default()));
        rig.visitor.state_set = fixed_function.then(|| Arc::new(set));
        assert_fades(rig, &scene, &at, "heights");
    }
    rig.visitor.state_set = None;
}

#[test]
fn children_of_a_lod_fade_and_programs_switch_in_the_middle() {
    let Some(mut rig) = rig("children_of_a_lod_fade_and_programs_switch_in_the_middle") else { return };
    let rig = &mut *rig;
    let lod = |state_set: Option<Arc<StateSet>>| {
        let geode = |color, depth| Node::geode(vec![large([0.0, 0.0, depth], 1.2, unlit_material(color))]);
        let mut lod = Node::new(NodeKind::Lod { center: DVec3::ZERO, ranges_m: vec![[0.0, 6.0], [6.0, 1e9]] });
        lod.children = vec![geode(GREEN, -0.3), geode(RED, 0.0)];
        // The neighbour is drawn whole during the fade.
        let beside = Node::geode(vec![quad([0.0, -0.9, 0.5], [1.2, 0.1], BLUE)]);
        let lod = match state_set {
            Some(set) => lod.with_state_set(set),
            None => lod,
        };
        Node::group(vec![lod, beside])
    };
    let scene = rig.scene(lod(None));
    assert_fades(rig, &scene, &seen, "Lod");
    rig.release(scene);

    let program = Program::new(
        "plain",
        "struct V { @builtin(position) position: vec4<f32>, @location(0) color: vec4<f32> }
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> V {
            let p = point_in_eye(leaves[instance], vertex.position);
            return V(frame.clip_from_eye * vec4<f32>(p, 1.0), leaves[instance].color);
        }
        @fragment fn fs_main(v: V) -> @location(0) vec4<f32> { return v.color; }",
    );
    let scene = rig.scene(lod(Some(Arc::new(StateSet::default().with(Attribute::Program(program))))));
    let environment = plain();
    let greens: Vec<usize> = (0..9)
        .map(|step| {
            let camera = seen(f64::from(step) * 0.05, if step < 2 { 1.0 } else { 0.5 });
            let picture = rig.picture(&scene, &camera, &environment);
            assert_eq!(count(&picture, MAGENTA), 0, "{step}");
            count(&picture, [0, 255, 0])
        })
        .collect();
    let all = greens[8];
    assert!(all > 3000, "{greens:?}");
    assert_eq!(greens, [0, 0, 0, 0, all, all, all, all, all]);
    rig.release(scene);
}

fn unlit_material(color: [f32; 4]) -> Material {
    Material { base_color: color, unlit: true, ..Material::default() }
}

#[test]
fn nested_fades_leave_no_hole_and_end() {
    let Some(mut rig) = rig("nested_fades_leave_no_hole_and_end") else { return };
    let rig = &mut *rig;
    let grandchild = tile(0.0, Refine::Replace, Vec::new());
    let mut scene = rig.scene(tile(8.0, Refine::Replace, vec![tile(4.0, Refine::Replace, vec![grandchild])]));
    for (slot, (color, depth)) in [(RED, 0.0), (GREEN, -0.2), (BLUE, -0.4)].into_iter().enumerate() {
        attach(rig, &mut scene, slot, Node::geode(vec![quad([0.0, 0.0, depth], [1.2, 1.2], color)]));
    }
    let environment = plain();
    let picture = |rig: &mut Rig, time_s: f64, lod_scale: f64| {
        let picture = rig.picture(&scene, &seen(time_s, lod_scale), &environment);
        let colors = [[255, 0, 0], [0, 255, 0], [0, 0, 255]].map(|color| count(&picture, color));
        assert_eq!(colors.iter().sum::<usize>() as u32, SIZE * SIZE, "{time_s}: {colors:?}");
        colors
    };
    let all = (SIZE * SIZE) as usize;
    assert_eq!(picture(rig, 1.0, 1.0), [all, 0, 0]);
    assert_eq!(picture(rig, 1.02, 1.0), [all, 0, 0]);
    let half = picture(rig, 1.12, 0.6);
    assert!(half[0] > 1000 && half[1] > 1000 && half[2] == 0, "{half:?}");
    let three = picture(rig, 1.2, 0.3);
    assert!(three.iter().all(|c| *c > 200), "{three:?}");
    assert!(rig.stage.parts.len() == 3 && rig.stage.counters.fading == 2, "{:?}", rig.stage.parts);
    let back = picture(rig, 1.25, 1.0);
    assert!(back.iter().all(|c| *c > 0) && back[0] > three[0], "{back:?}");
    for step in 0..8 {
        picture(rig, 1.3 + 0.05 * f64::from(step), 0.3);
    }
    assert_eq!(picture(rig, 1.8, 0.3), [0, 0, all]);
    assert_eq!(rig.stage.counters.fading, 0);
}

#[test]
fn expiry_during_a_fade_ends_the_fade() {
    let Some(mut rig) = rig("expiry_during_a_fade_ends_the_fade") else { return };
    let rig = &mut *rig;
    let environment = plain();
    let content = |color, depth| Node::geode(vec![quad([0.0, 0.0, depth], [1.2, 1.2], color)]);
    let all = (SIZE * SIZE) as usize;
    let greens = |rig: &mut Rig, scene: &Scene, time_s: f64, lod_scale: f64| {
        let picture = rig.picture(scene, &seen(time_s, lod_scale), &environment);
        assert_eq!(count(&picture, [255, 0, 0]) + count(&picture, [0, 255, 0]), all, "{time_s}");
        count(&picture, [0, 255, 0])
    };
    for is_parent in [false, true] {
        let mut scene = rig.scene(tile(6.0, Refine::Replace, vec![tile(0.0, Refine::Replace, Vec::new())]));
        let parent = attach(rig, &mut scene, 0, content(RED, 0.0));
        let child = attach(rig, &mut scene, 1, content(GREEN, -0.3));
        greens(rig, &scene, 1.0, 1.0);
        greens(rig, &scene, 1.02, 1.0);
        let half = greens(rig, &scene, 1.12, 0.5);
        assert!(half > 1000 && half < all - 1000, "{half}");
        detach(rig, &mut scene, if is_parent { parent } else { child });
        // Another page uses its slots.
        let other = rig.compile(vec![quad([0.0, 0.0, 0.6], [1.2, 1.2], BLUE)]);
        assert_eq!(greens(rig, &scene, 1.14, 0.5), if is_parent { all } else { 0 });
        assert_eq!(rig.stage.counters.fading, 0);
        rig.ctx.release(&other.slots);
        // It is loaded again and drawn at once, because nothing was drawn there. The tree works as before.
        if is_parent {
            attach(rig, &mut scene, 0, content(RED, 0.0));
        } else {
            attach(rig, &mut scene, 1, content(GREEN, -0.3));
        }
        greens(rig, &scene, 1.16, 0.5);
        assert_eq!(greens(rig, &scene, 3.0, 0.5), all);
        assert_eq!(greens(rig, &scene, 4.0, 1.0), 0);
    }
}

#[test]
fn tiles_that_enter_the_view_do_not_fade() {
    let Some(mut rig) = rig("tiles_that_enter_the_view_do_not_fade") else { return };
    let rig = &mut *rig;
    let environment = plain();
    let mut scene = rig.scene(tile(6.0, Refine::Replace, vec![tile(0.0, Refine::Replace, Vec::new())]));
    for (slot, color) in [RED, GREEN].into_iter().enumerate() {
        attach(rig, &mut scene, slot, Node::geode(vec![quad([0.0; 3], [1.2, 1.2], color)]));
    }
    let all = (SIZE * SIZE) as usize;
    let picture = rig.picture(&scene, &seen(1.0, 1.0), &environment);
    assert_eq!(count(&picture, [255, 0, 0]), all);
    let away = CullCamera {
        simulation_time_s: 1.05,
        ..camera([SIZE, SIZE], DVec3::new(0.0, 0.0, 10.0), DVec3::new(0.0, 0.0, 20.0), DVec3::Y)
    };
    let picture = rig.picture(&scene, &away, &environment);
    assert_eq!(count(&picture, MAGENTA), all);
    let picture = rig.picture(&scene, &seen(1.1, 0.5), &environment);
    assert_eq!((count(&picture, [0, 255, 0]), rig.stage.counters.fading), (all, 0));
}

#[test]
fn added_content_fades_in_over_the_parent() {
    let Some(mut rig) = rig("added_content_fades_in_over_the_parent") else { return };
    let rig = &mut *rig;
    let environment = plain();
    let mut scene = rig.scene(tile(6.0, Refine::Add, vec![tile(0.0, Refine::Add, Vec::new())]));
    let content = |color, depth| Node::geode(vec![quad([0.0, 0.0, depth], [1.2, 1.2], color)]);
    attach(rig, &mut scene, 0, content(RED, 0.0));
    let all = (SIZE * SIZE) as usize;
    let greens = |rig: &mut Rig, scene: &Scene, time_s: f64, lod_scale: f64| {
        let picture = rig.picture(scene, &seen(time_s, lod_scale), &environment);
        assert_eq!(count(&picture, [255, 0, 0]) + count(&picture, [0, 255, 0]), all, "{time_s}");
        (count(&picture, [0, 255, 0]), rig.stage.counters.fading)
    };
    for time in [1.0, 1.02, 1.2, 1.4] {
        assert_eq!(greens(rig, &scene, time, 0.5).0, 0);
    }
    // It was wanted for a long time and is loaded now.
    let child = attach(rig, &mut scene, 1, content(GREEN, 0.3));
    let (first, fading) = greens(rig, &scene, 1.45, 0.5);
    assert!(first > 500 && first < 1200 && fading == 1, "{first} {fading}");
    let (second, _) = greens(rig, &scene, 1.55, 0.5);
    assert!(second > first && second < all);
    assert_eq!(greens(rig, &scene, 1.7, 0.5), (all, 0));
    // No request is made while it fades out.
    let (gone, fading) = greens(rig, &scene, 1.8, 1.0);
    assert!(gone > 1000 && gone < all - 1000 && fading == 1);
    detach(rig, &mut scene, child);
    assert_eq!(greens(rig, &scene, 1.85, 1.0).0, 0);
    assert!(rig.stage.requests.is_empty(), "{:?}", rig.stage.requests);
}

#[test]
fn cameras_in_the_graph_fade_independently() {
    let Some(mut rig) = rig("cameras_in_the_graph_fade_independently") else { return };
    let rig = &mut *rig;
    let lod = || {
        let geode = |color, depth| Node::geode(vec![large([0.0, 0.0, depth], 1.2, unlit_material(color))]);
        let mut lod = Node::new(NodeKind::Lod { center: DVec3::ZERO, ranges_m: vec![[0.0, 6.0], [6.0, 1e9]] });
        lod.children = vec![geode(GREEN, -0.3), geode(RED, 0.0)];
        lod
    };
    let texture = TextureObject::target("below", [SIZE, SIZE], TextureFormat::Rgba8Srgb);
    let target = CameraTarget { colors: vec![Attachment::new(texture)], ..CameraTarget::default() };
    let mut node = CameraNode::new(RenderOrder::PreRender(0));
    (node.target, node.clear_color) = (Some(Arc::new(target)), Some([0.0, 0.0, 0.0, 1.0]));
    let scene = rig.scene(Node::group(vec![lod(), Node::camera(node, vec![lod()])]));
    let environment = plain();
    let mut greens = Vec::new();
    for (time_s, lod_scale) in [(1.0, 1.0), (1.02, 1.0), (1.12, 0.5), (1.17, 0.5), (1.4, 0.5)] {
        let picture = rig.picture(&scene, &seen(time_s, lod_scale), &environment);
        let below = &rig.stage.pre_render[0];
        assert_eq!(below.parts, rig.stage.parts, "{time_s}");
        greens.push((count(&picture, [0, 255, 0]), rig.stage.parts.len(), rig.stage.counters.fading));
    }
    let all = (SIZE * SIZE) as usize;
    assert_eq!((greens[1], greens[4]), ((0, 0, 0), (all, 0, 0)));
    assert!(greens[2].0 > 1000 && greens[3].0 > greens[2].0 && greens[3].0 < all, "{greens:?}");
    assert_eq!((greens[2].1, greens[2].2), (2, 2), "one level fades in each stage");
    rig.release(scene);
}
