//! Scenes of one page, the camera of their tests, and the slots that cull keeps of them.

use glam::DVec3;
use kit::cull_scenes::{drawable, look_at, page};
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{Node, Scene};

/// Returns a cube of 1 m.
pub fn cube(center: DVec3) -> Node {
    Node::geode(vec![drawable(Aabb { min: center - 0.5, max: center + 0.5 })])
}

/// Returns a camera that looks along +y from 10 m in front of the origin, with z up.
pub fn camera() -> CullCamera {
    look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z)
}

/// Returns a scene of one page.
pub fn scene(root: Node) -> Scene {
    let mut scene = Scene::new();
    scene.add_root(page(root, 0));
    scene
}

/// Culls a node as the only page of a scene.
pub fn cull(root: Node, camera: &CullCamera) -> RenderStage {
    cull_scene(&scene(root), camera)
}

/// Culls a scene three times and returns the last stage.
pub fn cull_scene(scene: &Scene, camera: &CullCamera) -> RenderStage {
    let mut stage = RenderStage::new();
    let mut visitor = CullVisitor::new();
    for _ in 0..3 {
        visitor.cull(scene, camera, &mut stage);
    }
    stage
}

/// Returns the draw slots of all leaves in ascending order.
pub fn slots(stage: &RenderStage) -> Vec<u32> {
    let mut slots: Vec<u32> = stage.bins.iter().flat_map(|b| b.leaves.iter().map(|l| l.slot.0)).collect();
    slots.sort_unstable();
    slots
}

/// Returns a leaf's origin in eye space.
pub fn origin_in_eye(stage: &RenderStage, slot: u32) -> DVec3 {
    let leaf = stage.bins.iter().flat_map(|b| &b.leaves).find(|l| l.slot.0 == slot).unwrap();
    let rows = stage.eye_from_drawable[leaf.matrix as usize];
    DVec3::new(f64::from(rows[0][3]), f64::from(rows[1][3]), f64::from(rows[2][3]))
}
