//! Buffers of frames without memory: one error is reported, the rest is drawn, and everything is drawn once there is
//! memory. Needs a GPU; a software adapter suffices.

use std::sync::Arc;

use glam::DVec3;
use kit::frames::{count, pixel};
use kit::rig::{Rig, camera, new_rig, plain, unit_camera};
use kit::shadows::{cuboid, ground, sunny, tower};
use kit::shapes::quad;
use kit::skip::skipped;
use terrane::cull::CullCamera;
use terrane::draw::DrawStats;
use terrane::scene::{
    Attachment, CameraNode, CameraTarget, Drawable, Environment, Geometry, Material, Mesh, Node, NodeKind,
    OcclusionQueryNode, PictureSink, Scene,
};
use terrane::state::{Attribute, StateSet, SurfaceMaterial, TextureFormat, TextureObject};

const SIDE: u32 = 64;
const RED: [u8; 3] = [255, 0, 0];

/// Returns a grid with `side` squares along each side.
fn squares(side: usize) -> Vec<Drawable> {
    let half = 1.0 / side as f32;
    let at = |place: usize| (2 * place + 1) as f32 * half - 1.0;
    let places = (0..side * side).map(|i| [at(i % side), at(i / side), 0.0]);
    places.map(|place| quad(place, [half; 2], [1.0, 0.0, 0.0, 1.0])).collect()
}

/// Returns the only error.
fn only_error(rig: &mut Rig) -> String {
    let errors = rig.renderer.take_errors();
    assert_eq!(errors.len(), 1, "{errors:?}");
    errors.into_iter().next().unwrap()
}

fn draw_thrice(rig: &mut Rig, scene: &Scene, camera: &CullCamera, environment: &Environment) -> DrawStats {
    (0..3).map(|_| rig.draw(scene, camera, environment)).last().unwrap()
}

#[test]
fn renderer_starts_without_memory_and_draws_once_there_is_some() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    let scene = rig.scene(Node::geode(squares(1)));
    let camera = unit_camera(SIDE);
    let mut said = Vec::new();
    for left_bytes in (0..8).map(|step| step * (16 << 10)) {
        rig.ctx.pretend_frame_memory(Some(left_bytes));
        let stats = rig.draw(&scene, &camera, &plain());
        let refused = (stats.stages_refused, stats.passes, stats.leaves) == (1, 0, 0);
        assert!(refused || stats.passes == 1, "{left_bytes}: {stats:?}");
        said.extend(rig.renderer.take_errors());
    }
    for what in ["leaves", "depth and samples of a target", "uniforms"] {
        let named = format!("out of graphics memory: {what} of ");
        assert_eq!(said.iter().filter(|error| error.starts_with(&named)).count(), 1, "{said:?}");
    }
    assert_eq!(said.len(), 3, "{said:?}");
    assert_eq!(count(&rig.picture(&scene, &camera, &plain()), RED), (SIDE * SIDE) as usize);
    rig.release(scene);
}

#[test]
fn leaves_without_memory_are_dropped() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    let (few, many) = (rig.scene(Node::geode(squares(2))), rig.scene(Node::geode(squares(20))));
    let camera = unit_camera(SIDE);
    rig.draw(&few, &camera, &plain());
    rig.ctx.pretend_frame_memory(Some(0));
    let stats = draw_thrice(&mut rig, &many, &camera, &plain());
    assert_eq!((stats.leaves, stats.leaves_dropped, stats.stages_refused), (256, 144, 0));
    assert!(only_error(&mut rig).starts_with("out of graphics memory: leaves of "));
    let drawn = count(&rig.read_back(), RED);
    assert!((2200..3000).contains(&drawn), "256 of 400 squares: {drawn} of 4096 pixels");
    rig.ctx.pretend_frame_memory(None);
    let stats = rig.draw(&many, &camera, &plain());
    assert_eq!((stats.leaves, stats.leaves_dropped), (400, 0));
    assert_eq!(count(&rig.read_back(), RED), (SIDE * SIDE) as usize);
    for scene in [few, many] {
        rig.release(scene);
    }
}

#[test]
fn frame_without_memory_for_its_uniforms_is_left_out() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    let plain_ones = rig.scene(Node::geode(squares(20)));
    let with_states = squares(20).into_iter().enumerate().map(|(i, square)| {
        let material = SurfaceMaterial { shininess: i as f32 * 0.25, ..SurfaceMaterial::default() };
        let set = StateSet::default().with(Attribute::SurfaceMaterial(material));
        Node::geode(vec![square]).with_state_set(Arc::new(set))
    });
    let query = OcclusionQueryNode { query_frames: 1, ..OcclusionQueryNode::default() };
    let mut asking = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
    asking.children = with_states.collect();
    let scene = rig.scene(asking);
    let camera = unit_camera(SIDE);
    // There is memory for leaves and queries.
    rig.draw(&plain_ones, &camera, &plain());
    rig.ctx.pretend_frame_memory(Some(80 << 10));
    let stats = draw_thrice(&mut rig, &scene, &camera, &plain());
    assert_eq!((stats.stages_refused, stats.passes, stats.leaves, stats.draw_calls), (1, 0, 0, 0));
    assert!(only_error(&mut rig).starts_with("out of graphics memory: uniforms of "));
    // Later frames are complete.
    assert_eq!(count(&rig.picture(&plain_ones, &camera, &plain()), RED), (SIDE * SIDE) as usize);
    rig.ctx.pretend_frame_memory(None);
    let stats = rig.draw(&scene, &camera, &plain());
    assert_eq!((stats.stages_refused, stats.passes, stats.leaves), (0, 1, 400));
    assert!(rig.renderer.take_errors().is_empty());
    for scene in [plain_ones, scene] {
        rig.release(scene);
    }
}

#[test]
fn draw_calls_without_memory_for_their_arguments_are_issued_one_by_one() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    if !rig.ctx.device().features().contains(wgpu::Features::INDIRECT_FIRST_INSTANCE) {
        return skipped("the adapter draws runs one by one");
    }
    let ball = |i: u32| {
        let place = DVec3::new(f64::from(i % 4), f64::from(i / 4), 0.0) * 0.5 - DVec3::new(0.75, 0.75, 0.0);
        let mesh = Mesh::sphere(place, 0.2, 12);
        Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material { unlit: true, ..Material::default() })
    };
    let scene = rig.scene(Node::geode((0..16).map(ball).collect()));
    let (camera, few) = (unit_camera(SIDE), rig.scene(Node::geode(squares(1))));
    rig.draw(&few, &camera, &plain());
    rig.ctx.pretend_frame_memory(Some(0));
    let stats = draw_thrice(&mut rig, &scene, &camera, &plain());
    let without = rig.read_back();
    assert_eq!((stats.draw_calls, stats.leaves), (16, 16));
    assert!(only_error(&mut rig).starts_with("out of graphics memory: arguments of draws of "));
    rig.ctx.pretend_frame_memory(None);
    let stats = rig.draw(&scene, &camera, &plain());
    assert_eq!((stats.draw_calls, stats.leaves), (1, 16));
    assert!(rig.read_back() == without && count(&without, [255; 3]) > 500);
    for scene in [few, scene] {
        rig.release(scene);
    }
}

#[test]
fn shadows_without_memory_for_their_maps_are_left_out() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    let tower = tower();
    let scene = rig.scene(Node::geode(vec![ground(100.0), cuboid(tower.min, tower.max)]));
    let camera = camera([SIDE; 2], DVec3::new(0.0, -90.0, 50.0), DVec3::ZERO, DVec3::Z);
    let with_shadows = sunny(DVec3::new(1.0, 0.0, 0.5));
    let without = Environment { shadows: None, ..with_shadows };
    let unshadowed = rig.picture(&scene, &camera, &without);
    rig.ctx.pretend_frame_memory(Some(0));
    let stats = draw_thrice(&mut rig, &scene, &camera, &with_shadows);
    assert_eq!((stats.shadow_leaves, stats.leaves), (0, 2));
    assert!(only_error(&mut rig).starts_with("out of graphics memory: shadow maps of "));
    assert!(rig.read_back() == unshadowed);
    rig.ctx.pretend_frame_memory(None);
    let shadowed = rig.picture(&scene, &camera, &with_shadows);
    assert!(shadowed != unshadowed && rig.renderer.take_errors().is_empty());
    // Without memory for larger maps, the existing ones stay in use.
    let mut larger = with_shadows;
    larger.shadows.as_mut().unwrap().resolution_px *= 2;
    rig.ctx.pretend_frame_memory(Some(0));
    assert!(rig.picture(&scene, &camera, &larger) == unshadowed);
    assert!(only_error(&mut rig).starts_with("out of graphics memory: shadow maps of "));
    assert!(rig.picture(&scene, &camera, &with_shadows) == shadowed);
    rig.release(scene);
}

#[test]
fn nodes_without_memory_for_their_query_are_drawn() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    let query = OcclusionQueryNode { query_frames: 1, failures_to_hide: 1, ..OcclusionQueryNode::default() };
    let mut asking = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
    asking.children = vec![Node::geode(squares(1))];
    let (scene, plain_one) = (rig.scene(asking), rig.scene(Node::geode(squares(1))));
    rig.draw(&plain_one, &unit_camera(SIDE), &plain());
    rig.ctx.pretend_frame_memory(Some(0));
    for frame in 1..20 {
        rig.draw(&scene, &CullCamera { frame, ..unit_camera(SIDE) }, &plain());
        assert_eq!(rig.stage.leaf_count(), 1);
    }
    assert!(only_error(&mut rig).starts_with("out of graphics memory: occlusion queries of "));
    assert_eq!(pixel(&rig.read_back(), 32, 32), RED);
    for scene in [scene, plain_one] {
        rig.release(scene);
    }
}

#[test]
fn image_without_memory_for_its_read_back_is_read_back_later() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    let camera = unit_camera(SIDE);
    let sink: Arc<PictureSink> = Arc::default();
    let texture = TextureObject::target("read", [SIDE; 2], TextureFormat::Rgba8Srgb);
    let [unread, read] = [None, Some(sink.clone())].map(|read_back| {
        let colors = vec![Attachment::new(texture.clone())];
        let target = CameraTarget { colors, read_back, samples: 1, ..CameraTarget::default() };
        let mut node = CameraNode::to_texture(texture.clone(), camera.eye_from_world, camera.clip_from_eye);
        node.target = Some(Arc::new(target));
        rig.scene(Node::camera(node, vec![Node::geode(squares(1))]))
    });
    rig.draw(&unread, &camera, &plain());
    rig.ctx.pretend_frame_memory(Some(0));
    let stats = draw_thrice(&mut rig, &read, &camera, &plain());
    assert_eq!((stats.stages_refused, stats.passes), (0, 2));
    assert!(only_error(&mut rig).starts_with("out of graphics memory: image to be read back of "));
    assert!(sink.take().is_none());
    rig.ctx.pretend_frame_memory(None);
    let came = (0..20).find_map(|_| {
        rig.draw(&read, &camera, &plain());
        sink.take()
    });
    assert_eq!(came.unwrap().texels[..3], RED);
    for scene in [unread, read] {
        rig.release(scene);
    }
}
