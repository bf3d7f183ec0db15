//! Culls the cameras in the graph that have their own stages, after the stage that they were met in. Culling thread.

use super::camera_queue::DeferredCamera;
use super::cull_visitor::CullVisitor;
use crate::cull::CullCamera;
use crate::cull::shadows::ShadowLight;
use crate::cull::stage::RenderStage;
use crate::cull::views::{DepthRange, View};
use crate::scene::{Environment, Scene};

/// Depth to which cameras below cameras are culled; deeper ones are dropped.
const MAX_CAMERA_DEPTH: u32 = 8;

impl CullVisitor {
    /// Culls the deferred cameras from index `first` on, and those met in their stages. Stages drawn before are added to
    /// `pre_render` and stages drawn after to `post_render`, each in the order of their numbers.
    pub(super) fn cull_deferred(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        environment: Option<&Environment>,
        stage: &mut RenderStage,
        first: usize,
        depth: u32,
    ) {
        while let Some(deferred) = self.memory.cameras.take_deferred(first) {
            let DeferredCamera { visit, view, is_pre, target } = deferred;
            let mut below = stage.spare.stages.pop().unwrap_or_default();
            let own = view.camera;
            let View { clamp_projection, in_scene_camera, .. } = view;
            let view = View { clamp_projection, in_scene_camera, ..View::new(&own) };
            let others = self.memory.cameras.deferred_count();
            self.traverse_stage(scene, &own, view, Some(&visit), &mut below);
            self.sort(&mut below);
            let eye_in_world = own.eye_from_world.inverse().translation;
            let environment = target.environment.of_camera(environment, eye_in_world);
            let nested = self.memory.cameras.take_nested();
            let light = environment.and_then(|e| Some(ShadowLight::new(&e, target.shadows.under(&e)?)));
            if let Some(light) = light.filter(|_| self.take_shadow_budget(&mut below)) {
                self.cull_stage_shadows(scene, &own, &light, Some(&visit), &mut below);
            }
            self.cull_nested_shadows(scene, environment.as_ref(), nested, &mut below);
            below.target = target.within(&stage.target);
            below.inherit_positioned(stage);
            if depth < MAX_CAMERA_DEPTH {
                self.cull_deferred(scene, &own, environment.as_ref(), &mut below, others, depth + 1);
            } else {
                self.memory.cameras.truncate_deferred(others);
            }
            if below.target.keeps_projection {
                stage.widen(&below);
            }
            stage.requests.append(&mut below.requests);
            stage.counters.add(&below.counters);
            let list = if is_pre { &mut stage.pre_render } else { &mut stage.post_render };
            let index = list.partition_point(|s| s.target.order <= below.target.order);
            list.insert(index, below);
        }
        if stage.post_render.iter().any(|after| after.target.keeps_projection) {
            // Stages that share the projection widened near and far.
            let depths = DepthRange { near: stage.near_m as f32, far: stage.far_m as f32 };
            let view = View { clamp_projection: stage.clamp_projection, depths, ..View::new(camera) };
            stage.set_projection(view.clamped());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::math::Aabb;
    use crate::scene::{
        CameraNode, Drawable, Material, Mesh, Node, NodeKind, OcclusionQueryNode, OcclusionResults, Page, RenderOrder,
    };

    #[test]
    fn answers_of_the_main_view_do_not_hide_nodes_from_a_camera_that_shows_the_scene() {
        let around = Aabb { min: DVec3::splat(-1.0), max: DVec3::ONE };
        let cube = Node::geode(vec![Drawable::new(Mesh::cuboid(&around).into(), Material::default())]);
        let results = Arc::new(OcclusionResults::default());
        let query = OcclusionQueryNode { results: results.clone(), query_frames: 1, ..OcclusionQueryNode::default() };
        let mut hidden = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
        hidden.children.push(cube);
        let node = CameraNode { shows_scene: true, ..CameraNode::new(RenderOrder::PostRender(0)) };
        let mut scene = Scene::new();
        scene.add_root(Page::from_node(Node::group(vec![hidden, Node::camera(node, vec![])])).unwrap());
        let eye_from_world = DAffine3::from_translation(DVec3::new(0.0, 0.0, -10.0));
        let mut camera = CullCamera { eye_from_world, ..CullCamera::default() };
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        let mut met = || {
            camera.frame += 1;
            visitor.cull(&scene, &camera, &mut stage);
            let [mirror] = &stage.post_render[..] else { panic!("one camera") };
            assert_eq!((stage.queries.len(), mirror.queries.len()), (1, 0));
            (stage.leaf_count(), mirror.leaf_count())
        };
        assert_eq!(met(), (1, 1));
        (0..2).for_each(|_| results.answered(0, 1, 1));
        assert_eq!(met(), (0, 1));
    }
}
