//! Cameras in the graph that have a stage of their own: put aside when they are met, culled once the stage is done that
//! they were met in. On the thread that culls.

use super::fade::Fade;
use super::shadows::ShadowLight;
use super::special::MOST_NESTED;
use super::stage::StageTarget;
use super::view::View;
use super::visitor::{Cull, CullVisitor, DepthRange, PageVisit};
use super::{CullCamera, RenderStage};
use crate::scene::{CameraShadows, Environment, Scene};

/// Where a camera of the graph hangs.
#[derive(Clone, Copy, Debug)]
pub(super) struct CameraPlace {
    /// The page, seen from the camera.
    pub visit: PageVisit,
    /// The camera's node in it.
    pub node: u32,
    /// State at the node, in the state graph, and its path.
    pub state: u32,
    pub path: u32,
    /// The scene's roots are shown too.
    pub shows_scene: bool,
}

/// A camera of the graph that has a stage of its own, culled once the stage it was met in is done.
#[derive(Debug)]
pub(super) struct DeferredCamera {
    pub met: CameraPlace,
    pub view: View,
    pub is_pre: bool,
    pub target: StageTarget,
}

/// A nested camera with shadows, which are culled once its stage is done.
#[derive(Clone, Copy, Debug)]
pub(super) struct NestedCamera {
    pub met: CameraPlace,
    /// One more than its view's index in the stage.
    pub place: u32,
    pub shadows: CameraShadows,
}

impl CullVisitor {
    /// Culls the cameras that were met from `first` on, and those met in their stages. What is drawn before comes
    /// out in `pre_render`, what is drawn after in `post_render`, each in the order of its numbers.
    pub(super) fn cull_deferred(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        environment: Option<&Environment>,
        stage: &mut RenderStage,
        first: usize,
        depth: u32,
    ) {
        while self.deferred.len() > first {
            let met = self.deferred.remove(first);
            let mut below = stage.spare.stages.pop().unwrap_or_default();
            let (view, target, is_pre) = (met.view, met.target.clone(), met.is_pre);
            let own = CullCamera {
                eye_from_world: view.eye_from_world,
                clip_from_eye: view.clip_from_eye,
                viewport_px: view.viewport_px,
                settings: view.settings,
                horizon: view.horizon,
                ..*camera
            };
            let View { clamp_projection, in_scene_camera, .. } = view;
            let view = View { clamp_projection, in_scene_camera, ..View::new(&own) };
            let others = self.deferred.len();
            self.traverse_stage(scene, &own, view, Some(&met.met), &mut below);
            self.sort(&mut below);
            let eye_in_world = own.eye_from_world.inverse().translation;
            let environment = target.environment.of_camera(environment, eye_in_world);
            let nested = std::mem::take(&mut self.nested);
            let light = environment.and_then(|e| Some(ShadowLight::new(&e, target.shadows.under(&e)?)));
            if let Some(light) = light.filter(|_| self.takes_shadows(&mut below)) {
                self.cull_stage_shadows(scene, &own, &light, Some(&met.met), &mut below);
            }
            self.cull_nested_shadows(scene, environment.as_ref(), nested, &mut below);
            below.target = target.within(&stage.target);
            below.inherit_positioned(stage);
            if depth < MOST_NESTED {
                self.cull_deferred(scene, &own, environment.as_ref(), &mut below, others, depth + 1);
            } else {
                self.deferred.truncate(others);
            }
            if below.target.keeps_projection {
                stage.widen(&below);
            }
            stage.requests.append(&mut below.requests);
            stage.counters.add(&below.counters);
            let list = if is_pre { &mut stage.pre_render } else { &mut stage.post_render };
            let place = list.partition_point(|s| s.target.order <= below.target.order);
            list.insert(place, below);
        }
        if stage.post_render.iter().any(|after| after.target.keeps_projection) {
            // Together they have other depths.
            let range = DepthRange { near: stage.near_m as f32, far: stage.far_m as f32 };
            let view = View { clamp_projection: stage.clamp_projection, range, ..View::new(camera) };
            stage.set_projection(view.clamped());
        }
    }
}

impl Cull<'_> {
    /// Scans what is below a camera that has this stage.
    pub(super) fn visit_camera(&mut self, met: &CameraPlace) {
        let scene = self.scene;
        let Some(page) = scene.page_at(met.visit.place) else { return };
        self.open_page(page, met.visit.state);
        if let Some(state) = self.chains.get_mut(met.path as usize) {
            *state = self.graph.find_or_insert_view(met.state, 0);
        }
        let fade = Fade::NONE;
        let visit = PageVisit { mask: self.view.planes.mask, view: 0, required: false, fade, ..met.visit };
        let context = self.page_context(page, visit);
        let transform = self.enclosing_transform(&context, met.node);
        let map = visit.eye_from_page * page.transforms().page_from_node(transform);
        let matrix = self.push_matrix(&map);
        let end = met.node + page.nodes()[met.node as usize].skip;
        self.scan_nodes(&context, met.node + 1, end, visit.mask, matrix);
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
    fn what_one_picture_does_not_see_a_camera_that_shows_the_scene_may() {
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
