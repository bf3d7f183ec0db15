//! Random scenes drawn in several ways that must give the same image. Needs a GPU; a software adapter suffices.
//!
//! `RANDOM_SCENES=FIRST..END` draws those seeds instead of the usual ones; a failure names its seed.

use std::sync::Arc;

use crate::graphs::{Differences, Maker, Random, change, eye, named, picture, seeds};
use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::frames::count;
use kit::rig::{Rig, camera, new_rig, plain};
use terrane::cull::CullCamera;
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::scene::{
    Attachment, CameraNode, CameraTarget, CullAction, CullCallback, CullingMode, DistanceFog, Drawable, Environment,
    Geometry, HeightTile, Inherit, Mesh, Node, NodeKind, Page, PagedLod, PagingOptions, PictureSink, RangeMode,
    ReferenceFrame, Refine, RenderOrder, SunShadows, Texture, Topology, Water,
};
use terrane::state::{BinDetails, SortMode, StateSet, TextureFormat, TextureObject};

const SIDE: u32 = 96;

/// Returns the same graph with additional nodes that have no effect.
fn padded(node: &Node, random: &mut Random) -> Node {
    let mut copy = Node { children: node.children.iter().map(|child| padded(child, random)).collect(), ..node.clone() };
    match random.below(9) {
        0 => Node::group(vec![copy]),
        1 => Node::transform(DAffine3::IDENTITY, vec![copy]),
        2 => Node { children: vec![copy], ..Node::new(NodeKind::Switch(vec![true])) },
        3 => {
            let kind = NodeKind::Lod { center: DVec3::ZERO, ranges_m: vec![[0.0, f64::INFINITY]] };
            Node { children: vec![copy], ..Node::new(kind) }
        }
        4 => {
            copy.cull_callback = Some(CullCallback(Arc::new(|_| CullAction::Traverse)));
            copy
        }
        5 => Node::group(vec![Node::group(Vec::new()), copy, Node::geode(Vec::new())]),
        6 => {
            copy.culling_active = false;
            copy
        }
        _ => copy,
    }
}

/// Returns the same graph with state sets moved to the children of their nodes.
fn pushed_down(node: &Node) -> Node {
    let mut copy = Node { children: node.children.iter().map(pushed_down).collect(), ..node.clone() };
    let is_plain = matches!(copy.kind, NodeKind::Group | NodeKind::Transform(_) | NodeKind::Lod { .. });
    if is_plain && let Some(set) = copy.state_set.take() {
        let under = |child: Node| Node::group(vec![child]).with_state_set(set.clone());
        copy.children = copy.children.into_iter().map(under).collect();
    }
    copy
}

/// Returns the same graph with other drawables.
fn with_drawables(node: &Node, change: &dyn Fn(&mut Drawable)) -> Node {
    let children = node.children.iter().map(|child| with_drawables(child, change)).collect();
    let mut copy = Node { children, ..node.clone() };
    match &mut copy.kind {
        NodeKind::Geode(drawables) => drawables.iter_mut().for_each(change),
        NodeKind::Billboard(billboard) => billboard.drawables.iter_mut().for_each(|(_, drawable)| change(drawable)),
        _ => {}
    }
    copy
}

/// Makes small meshes large with triangles without area.
fn enlarge(drawable: &mut Drawable) {
    if let Geometry::Mesh(mesh) = &mut drawable.geometry
        && mesh.topology == Topology::Triangles
        && mesh.indices.len() < 60
    {
        let mesh = Arc::make_mut(mesh);
        mesh.indices = mesh.indices.iter().copied().chain(std::iter::repeat_n(0, 60)).collect();
    }
}

/// Replaces shared objects by copies.
fn own(drawable: &mut Drawable) {
    match &mut drawable.geometry {
        Geometry::Mesh(mesh) => *mesh = Arc::new(Mesh { indices: mesh.indices.to_vec().into(), ..Mesh::clone(mesh) }),
        Geometry::Height(tile) => *tile = Arc::new(HeightTile::clone(tile)),
        _ => {}
    }
    drawable.material.texture = drawable.material.texture.take().map(|image| Arc::new(Texture::clone(&image)));
}

/// Graphs with all kinds of state, for which the order of drawing counts.
#[test]
fn equivalent_scenes_draw_the_same_image() {
    let Some(mut rig) = new_rig([256, 256]) else { return };
    let rig = &mut rig;
    let (mut shown, mut scenes) = (0, 0);
    let mut last: Option<(Node, CullCamera, RgbaImage)> = None;
    let mut differences = Differences::default();
    for seed in seeds(0, 2) {
        let mut maker = Maker::new(seed, false);
        let node = maker.scene();
        let camera = camera([SIDE, SIDE], eye(&mut maker.random), DVec3::ZERO, DVec3::Z);
        let whole = picture(rig, &node, &camera, &plain());
        scenes += 1;
        shown += usize::from(count(&whole, kit::frames::MAGENTA) < 9000);
        let mut same = |what: &str, node: &Node, camera: &CullCamera, few: usize| {
            let other = picture(rig, node, camera, &plain());
            differences.compare(what, seed, [&whole, &other], few);
        };
        same("drawn twice", &node, &camera, 0);
        for culling in [CullingMode::CLUSTER, CullingMode::CLUSTER | CullingMode::SAMPLES | CullingMode::VIEW_FRUSTUM] {
            let mut other = camera;
            other.settings.culling = culling;
            same(&format!("{culling:?}"), &node, &other, 0);
        }
        for _ in 0..2 {
            same("with additional nodes", &padded(&node, &mut maker.random), &camera, 0);
        }
        same("state sets at the children", &pushed_down(&node), &camera, 0);
        same("large meshes", &with_drawables(&node, &enlarge), &camera, 30);
        same("nothing shared", &with_drawables(&node, &own), &camera, 0);
        let projection = Node { children: vec![node.clone()], ..Node::new(NodeKind::Projection(camera.clip_from_eye)) };
        same("below a Projection", &projection, &camera, 0);
        let nested = CameraNode::new(RenderOrder::Nested);
        same("below a nested camera", &Node::camera(nested, vec![node.clone()]), &camera, 0);
        let (shown, seen) = through_nested(&node, &camera);
        same("through a nested camera that shows the scene", &shown, &seen, 0);
        let absolute = NodeKind::AbsoluteTransform(camera.eye_from_world);
        let absolute = Node { children: vec![node.clone()], ..Node::new(absolute) };
        same("below an AbsoluteTransform", &absolute, &camera, 4);
        // At planetary coordinates, an f32 has steps of half a metre.
        let far = DAffine3::from_translation(DVec3::new(4.1e6, -1.2e6, 4.7e6));
        let seen = CullCamera { eye_from_world: camera.eye_from_world * far.inverse(), ..camera };
        // Nodes below an absolute camera are in world coordinates at any position in the graph.
        if !has_absolute_camera(&node) {
            same("far from the origin", &Node::transform(far, vec![node.clone()]), &seen, 30);
        }
        let other = to_texture(rig, &node, &camera);
        differences.compare("drawn into a texture", seed, [&whole, &other], 4);
        let other = several_roots(rig, &node, &camera, &plain());
        differences.compare("several roots", seed, [&whole, &other], 4);
        if let Some((node, camera, whole)) = last.replace((node, camera, whole)) {
            let again = picture(rig, &node, &camera, &plain());
            differences.compare("after another scene", seed, [&whole, &again], 0);
        }
    }
    differences.assert_none();
    assert!(2 * shown > scenes, "{shown} of {scenes} scenes show something");
}

/// The same with a sky, shadows and a sea.
#[test]
fn equivalent_scenes_have_the_same_light_and_air() {
    let Some(mut rig) = new_rig([256, 256]) else { return };
    let rig = &mut rig;
    let mut differences = Differences::default();
    for seed in seeds(2000, 1) {
        let mut maker = Maker::new(seed, false);
        let node = maker.scene();
        let camera = camera([SIDE, SIDE], eye(&mut maker.random), DVec3::ZERO, DVec3::Z);
        let environment = Environment {
            sun_direction: eye(&mut maker.random).normalize(),
            shadows: maker.random.percent(80).then(SunShadows::default),
            water: maker.random.percent(50).then(|| Water::at(-6.0)),
            fog: DistanceFog { enabled: maker.random.percent(50), density_per_m: 1e-3 },
            ..Environment::default()
        };
        let whole = picture(rig, &node, &camera, &environment);
        let mut same = |what: &str, node: &Node, camera: &CullCamera, few: usize| {
            let other = picture(rig, node, camera, &environment);
            differences.compare(what, seed, [&whole, &other], few);
        };
        same("drawn twice", &node, &camera, 0);
        let mut other = camera;
        other.settings.culling = CullingMode(other.settings.culling.0 & !CullingMode::SAMPLES.0);
        same("every leaf", &node, &other, 0);
        for _ in 0..2 {
            same("with additional nodes", &padded(&node, &mut maker.random), &camera, 0);
        }
        same("state sets at the children", &pushed_down(&node), &camera, 0);
        same("large meshes", &with_drawables(&node, &enlarge), &camera, 30);
        same("nothing shared", &with_drawables(&node, &own), &camera, 0);
        let other = several_roots(rig, &node, &camera, &environment);
        differences.compare("several roots", seed, [&whole, &other], 4);
    }
    differences.assert_none();
}

fn has_absolute_camera(node: &Node) -> bool {
    let is_one = |camera: &CameraNode| camera.frame == ReferenceFrame::Absolute;
    matches!(&node.kind, NodeKind::Camera(camera) if is_one(camera)) || node.children.iter().any(has_absolute_camera)
}

/// Returns the scene beside a nested camera that shows it, for a camera that sees only its image.
fn through_nested(node: &Node, camera: &CullCamera) -> (Node, CullCamera) {
    let (alone, scene) = (1, 2);
    let mut nested = CameraNode { shows_scene: true, ..CameraNode::new(RenderOrder::Nested) };
    (nested.settings, nested.inherit) = (camera.settings, Inherit(Inherit::ALL.0 & !Inherit::CULL_MASK.0));
    nested.settings.cull_mask = scene;
    let nested = Node { mask: alone, ..Node::camera(nested, Vec::new()) };
    let node = Node { mask: scene, children: vec![node.clone()], ..Node::group(Vec::new()) };
    let mut seen = *camera;
    seen.settings.cull_mask = alone;
    (Node::group(vec![node, nested]), seen)
}

/// Returns the image of a camera above the whole scene, read back from its texture.
fn to_texture(rig: &mut Rig, node: &Node, camera: &CullCamera) -> RgbaImage {
    let sink = Arc::new(PictureSink::default());
    let texture = TextureObject::target("whole", [SIDE, SIDE], TextureFormat::Rgba8Srgb);
    let target = CameraTarget {
        colors: vec![Attachment::new(texture)],
        samples: 1,
        read_back: Some(sink.clone()),
        ..CameraTarget::default()
    };
    let mut above = CameraNode::new(RenderOrder::PreRender(-5));
    (above.target, above.clear_color) = (Some(Arc::new(target)), Some([1.0, 0.0, 1.0, 1.0]));
    let scene = rig.scene(Node::camera(above, vec![node.clone()]));
    let picture = (1..200).find_map(|frame| {
        rig.draw(&scene, &CullCamera { frame, ..*camera }, &plain());
        sink.take()
    });
    rig.release(scene);
    RgbaImage::from_raw(SIDE, SIDE, picture.unwrap().texels).unwrap()
}

/// Returns the children of the root as separate pages, each with the root's state set.
fn several_roots(rig: &mut Rig, node: &Node, camera: &CullCamera, environment: &Environment) -> RgbaImage {
    let mut scene = rig.scene(Node::group(Vec::new()));
    for child in &node.children {
        let root = Node { children: vec![child.clone()], ..node.clone() };
        let mut page = Page::from_node(root).unwrap();
        let compiled = rig.compile(page.take_drawables());
        page.set_draw_slots(0, compiled.slots);
        scene.add_root(page);
    }
    let picture = rig.picture(&scene, camera, environment);
    rig.release(scene);
    picture
}

/// Returns the same graph with some nodes in separate pages, attached to tiles.
fn below_tiles(rig: &mut Rig, node: &Node, camera: &CullCamera, random: &mut Random) -> RgbaImage {
    let mut cut = Vec::new();
    let mut scene = rig.scene(with_tiles(node, random, &mut cut));
    let mut pages = vec![scene.roots()[0]];
    // A part comes after the graph that it was cut from.
    for (number, content) in cut.into_iter().enumerate().rev() {
        let name = tile_name(number);
        let slot = pages.iter().find_map(|page| scene.nodes_named(*page, &name).next()).unwrap();
        let mut page = Page::from_node(content).unwrap();
        let compiled = rig.compile(page.take_drawables());
        page.set_draw_slots(0, compiled.slots);
        pages.push(scene.attach(slot, page).unwrap());
    }
    let picture = rig.picture(&scene, camera, &plain());
    for page in pages.into_iter().skip(1).rev() {
        for (_, slots) in scene.detach(page).unwrap().take_draw_slots() {
            rig.ctx.release(&slots);
        }
    }
    rig.release(scene);
    picture
}

fn tile_name(number: usize) -> String {
    format!("tile {number}")
}

/// Returns the graph with tiles instead of some nodes, and those nodes, each after the one that it was cut from.
fn with_tiles(node: &Node, random: &mut Random, cut: &mut Vec<Node>) -> Node {
    let children = node.children.iter().map(|child| with_tiles(child, random, cut)).collect();
    let copy = Node { children, ..node.clone() };
    if !random.percent(20) {
        return copy;
    }
    let place = random.place(5.0);
    cut.push(Node::transform(place.inverse(), vec![copy]));
    let lod = PagedLod {
        bounds: BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 500.0)),
        range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
        refine: Refine::Replace,
        content: Some("tile".into()),
        content_transform: place,
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    };
    Node::new(NodeKind::PagedLod(Box::new(lod))).named(&tile_name(cut.len() - 1))
}

/// Graphs in which the nearest leaf is visible in any order of drawing.
#[test]
fn opaque_leaves_may_be_drawn_in_any_order() {
    let Some(mut rig) = new_rig([256, 256]) else { return };
    let rig = &mut rig;
    let mut differences = Differences::default();
    for seed in seeds(1000, 1) {
        let mut maker = Maker::new(seed, true);
        let node = maker.scene();
        let camera = camera([SIDE, SIDE], eye(&mut maker.random), DVec3::ZERO, DVec3::Z);
        let whole = picture(rig, &node, &camera, &plain());
        let mut same = |what: &str, node: &Node, camera: &CullCamera, few: usize| {
            let other = picture(rig, node, camera, &plain());
            differences.compare(what, seed, [&whole, &other], few);
        };
        same("children in reverse order", &reversed(&node), &camera, 8);
        same("separate state sets", &with_sets(&node, &|set| set.clone()), &camera, 8);
        for sort in [SortMode::BackToFront, SortMode::FrontToBack, SortMode::TraversalOrder] {
            let sorted =
                with_sets(&node, &|set| StateSet { bin: set.bin.map(|bin| BinDetails { sort, ..bin }), ..set.clone() });
            same(&format!("{sort:?}"), &sorted, &camera, 8);
        }
        let mut fitted = camera;
        fitted.settings.compute_near_far = terrane::scene::ComputeNearFar::BoundingVolumes;
        same("near and far fitted", &node, &fitted, 12);
        let other = below_tiles(rig, &node, &camera, &mut maker.random);
        differences.compare("in pages below tiles", seed, [&whole, &other], 12);
    }
    differences.assert_none();
}

fn reversed(node: &Node) -> Node {
    let mut copy = node.clone();
    match &mut copy.kind {
        NodeKind::Switch(shown) => {
            shown.resize(copy.children.len(), false);
            shown.reverse();
        }
        NodeKind::Lod { ranges_m, .. } => {
            ranges_m.truncate(copy.children.len());
            ranges_m.reverse();
        }
        _ => {}
    }
    copy.children = copy.children.iter().rev().map(reversed).collect();
    copy
}

fn with_sets(node: &Node, change: &dyn Fn(&StateSet) -> StateSet) -> Node {
    Node {
        children: node.children.iter().map(|child| with_sets(child, change)).collect(),
        state_set: node.state_set.as_ref().map(|set| Arc::new(change(set))),
        ..node.clone()
    }
}

/// A changed scene equals one that was built like that.
#[test]
fn changed_scenes_equal_scenes_built_that_way() {
    let Some(mut rig) = new_rig([256, 256]) else { return };
    let rig = &mut rig;
    let mut differences = Differences::default();
    for seed in seeds(3000, 1) {
        let mut maker = Maker::new(seed, false);
        let mut node = maker.scene();
        named(&mut node, &mut 0);
        let camera = camera([SIDE, SIDE], eye(&mut maker.random), DVec3::ZERO, DVec3::Z);
        let mut scene = rig.scene(node.clone());
        for frame in 2..8 {
            for _ in 0..1 + maker.random.below(12) {
                change(&mut scene, &mut node, &mut maker, false);
            }
            let changed = rig.picture(&scene, &CullCamera { frame, ..camera }, &plain());
            let made = picture(rig, &node, &camera, &plain());
            differences.compare(&format!("changed {}", frame - 1), seed, [&changed, &made], 0);
        }
        rig.release(scene);
    }
    differences.assert_none();
}
