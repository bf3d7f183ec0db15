//! The rarer node kinds during the node scan: billboards, positioned state and occlusion queries. Culling thread.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

use super::page_context::PageContext;
use super::traversal::Traversal;
use crate::cull::stage::{
    ClipPlane, OcclusionQuery, PositionedLight, PositionedTexGen, move_light, move_plane, move_texgen,
};
use crate::math::Aabb;
use crate::scene::{
    AutoScale, BillboardMode, INACTIVE, LocalLights, OcclusionQueryNode, RareNode, ReferenceFrame, UNBOUNDED, UNCULLED,
};
use crate::state::Light;

/// The positions of drawables in their node's frame, and their bounds in their own.
type PlacedDrawables<'a> = (&'a [DVec3], &'a [Aabb]);

impl Traversal<'_> {
    /// Visits a node of a rarer kind. Returns true if its children must be scanned like those of a group.
    pub(super) fn visit_rare_node(&mut self, context: &PageContext, node: u32, mask: u8) -> bool {
        let page = context.page;
        let Some(special) = page.rare_nodes().get(page.payloads()[node as usize] as usize) else { return true };
        if self.views.current().casts {
            match special {
                RareNode::Camera { .. } | RareNode::Projection { .. } => return false,
                RareNode::OcclusionQuery(_) | RareNode::LocalLights { .. } => return true,
                _ => {}
            }
        }
        match special {
            RareNode::Billboard { mode, auto_scale, positions, bounds } => {
                let placed: PlacedDrawables<'_> = (positions, bounds);
                self.visit_billboard(context, node, (*mode, *auto_scale), placed, mask);
                true
            }
            RareNode::LightSource(source) => {
                let eye_from_node = self.eye_from_node(context, node, source.frame);
                let light = move_light(&eye_from_node, &source.light);
                self.stage.lights.push(PositionedLight { light, view: self.views.current().index });
                true
            }
            RareNode::LocalLights { lights, path } => {
                self.visit_local_lights(context, node, lights, *path);
                true
            }
            RareNode::ClipNode(clip) => {
                let eye_from_node = self.eye_from_node(context, node, clip.frame);
                for (number, plane) in &clip.planes {
                    let plane = move_plane(&eye_from_node, *plane);
                    self.stage.clip_planes.push(ClipPlane { number: *number, plane, view: self.views.current().index });
                }
                true
            }
            RareNode::TexGenNode(node_texgen) => {
                let eye_from_node = self.eye_from_node(context, node, ReferenceFrame::Relative);
                let texgen = move_texgen(&eye_from_node, node_texgen.texgen);
                self.stage.texgens.push(PositionedTexGen {
                    unit: node_texgen.unit,
                    texgen,
                    view: self.views.current().index,
                });
                true
            }
            RareNode::ClearNode(clear) => {
                self.stage.clear_node = Some(clear.color);
                true
            }
            RareNode::Occluder => true,
            RareNode::OcclusionQuery(query) => {
                let is_hidden = self.visit_occlusion_query(context, node, query);
                if is_hidden {
                    self.keep_required(context, node..node + page.nodes()[node as usize].skip);
                }
                !is_hidden
            }
            RareNode::Camera { camera, path } => {
                self.visit_camera_node(context, node, camera, *path, mask);
                false
            }
            RareNode::Projection { clip_from_eye, path } => {
                self.visit_projection(context, node, clip_from_eye, *path);
                false
            }
            RareNode::AbsoluteTransform => {
                self.visit_absolute_transform(context, node);
                false
            }
        }
    }

    /// Positions lights that shine on what is below their node.
    fn visit_local_lights(&mut self, context: &PageContext, node: u32, lights: &Arc<LocalLights>, path: u32) {
        let eye_from_node = self.eye_from_node(context, node, ReferenceFrame::Relative);
        let view = self.views.current().index;
        let above = self.states.lights_above(context.page, path);
        let numbered = lights.lights.iter().zip(0u8..).map(|(light, number)| PositionedLight {
            light: Light { number, ..move_light(&eye_from_node, light) },
            view,
        });
        let group = self.stage.push_light_group(above, numbered);
        self.states.enter_lights(context.page, path, lights, group);
    }

    /// Returns the matrix from a node's frame to the eye; the identity for an absolute one.
    fn eye_from_node(&self, context: &PageContext, node: u32, frame: ReferenceFrame) -> DAffine3 {
        match frame {
            ReferenceFrame::Absolute => DAffine3::IDENTITY,
            ReferenceFrame::Relative => {
                let enclosing = self.enclosing_transform(context, node);
                context.visit.eye_from_page * context.page.transforms().page_from_node(enclosing)
            }
        }
    }

    /// Emits the drawables of a billboard, each turned to the eye.
    fn visit_billboard(
        &mut self,
        context: &PageContext,
        node: u32,
        (mode, auto_scale): (BillboardMode, Option<AutoScale>),
        (positions, bounds): PlacedDrawables<'_>,
        mask: u8,
    ) {
        let page = context.page;
        let first = page.nodes()[node as usize].first_drawable;
        let is_unculled = page.nodes()[node as usize].flags & UNCULLED != 0;
        let eye_from_node = self.eye_from_node(context, node, ReferenceFrame::Relative);
        let node_from_eye = eye_from_node.inverse();
        if !node_from_eye.is_finite() {
            return;
        }
        let view = self.views.current();
        let (px_per_radian, is_parallel) = (view.camera.px_per_radian(), view.ranges.is_parallel());
        for (drawable, (position, bounds)) in (first..).zip(positions.iter().zip(bounds)) {
            let action = self.ask_drawable(context, drawable);
            if !action.visits() {
                continue;
            }
            let depths = self.views.depths();
            let mut depth = if is_unculled {
                self.depth_of_unculled(context, drawable)
            } else {
                let Some((depth, _)) = self.test_behind_occluders(context, drawable, mask) else { continue };
                depth
            };
            let mut map = mode.eye_from_drawable(&eye_from_node, node_from_eye.translation, *position);
            if let Some(auto_scale) = auto_scale {
                let scale = auto_scale.scale_at(&eye_from_node, *position, px_per_radian, is_parallel);
                map.matrix3 *= scale;
                // The drawable's box is that of the largest scale.
                self.views.set_depths(depths);
                depth = self.depth_of_scaled(&map, bounds);
            }
            let matrix = self.push_matrix(&map);
            self.emit_as(&action, context, drawable, depth, matrix);
        }
    }

    /// Returns the depth of a drawable at its scale from this eye, and widens near and far.
    fn depth_of_scaled(&mut self, eye_from_drawable: &DAffine3, bounds: &Aabb) -> f32 {
        let in_eye = bounds.transformed(eye_from_drawable);
        let (nearest, farthest) = (-in_eye.max.z as f32, -in_eye.min.z as f32);
        if farthest >= self.views.current().min_depth {
            self.views.widen(nearest, farthest);
        }
        0.5 * (nearest + farthest)
    }

    /// Asks for the visible samples of a node's bound when that is due. Returns true if the node is hidden by earlier
    /// answers.
    fn visit_occlusion_query(&mut self, context: &PageContext, node: u32, query: &OcclusionQueryNode) -> bool {
        let page = context.page;
        let sphere = page.spheres()[node as usize];
        // Queries belong to views that are drawn.
        let is_dry_run = self.options.is_dry_run || self.camera.ahead_frames > 0;
        // A subtree with lights or cameras has effects outside of its bound.
        let is_bounded = sphere.w < UNBOUNDED && sphere.w >= 0.0 && page.nodes()[node as usize].flags & INACTIVE == 0;
        if !is_bounded || self.views.current().in_scene_camera || is_dry_run {
            return false;
        }
        // Answers belong to one eye: a node that is hidden from one may be seen by the other.
        let results = &query.results;
        if !results.are_of(self.fades.eye(), self.camera.frame) {
            return false;
        }
        let center = page.origin() + sphere.truncate().as_dvec3();
        let box_from_unit =
            DAffine3 { matrix3: DMat3::from_diagonal(DVec3::splat(f64::from(sphere.w))), translation: center };
        let eye_from_unit = context.visit.eye_from_page * box_from_unit;
        let eye = eye_from_unit.inverse().translation;
        // From inside, or close to it, the box's faces may be culled or clipped: the node counts as visible.
        let is_outside = eye.abs().max_element() > 1.5;
        if !is_outside {
            results.answered(u64::MAX, query.visibility_threshold, self.camera.frame);
        } else if results.is_due(self.camera.frame, query.query_frames) {
            let matrix = self.push_matrix(&eye_from_unit);
            // Near and far must include the box, since clipped samples would not be counted.
            let axis = self.views.current().depth_axis;
            let middle = axis.dot(eye_from_unit.translation);
            let reach = (eye_from_unit.matrix3.transpose() * axis).abs().element_sum();
            self.views.widen((middle - reach) as f32, (middle + reach) as f32);
            self.stage.queries.push(OcclusionQuery {
                results: results.clone(),
                visibility_threshold: query.visibility_threshold,
                frame: self.camera.frame,
                matrix,
                view: self.views.current().index,
            });
        }
        let (is_hidden, answers_age) = results.decide(self.camera.frame, query.failures_to_hide.max(1));
        self.counters.answers_age = self.counters.answers_age.max(answers_age);
        is_hidden
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cull::{CullCamera, CullVisitor, RenderStage};
    use crate::math::Aabb;
    use crate::scene::{Drawable, LightSource, Material, Mesh, Node, NodeKind, Page, Scene};

    #[test]
    fn queries_never_hide_unbounded_nodes_lights_or_unculled_nodes() {
        let mesh = Mesh::cuboid(&Aabb { min: DVec3::new(-1.0, -1.0, -21.0), max: DVec3::new(1.0, 1.0, -19.0) });
        let geode = Node::geode(vec![Drawable::new(mesh.into(), Material::default())]);
        let queries = |below: Node| {
            let query = OcclusionQueryNode { query_frames: 1, ..OcclusionQueryNode::default() };
            let results = query.results.clone();
            let asked = Node::new(NodeKind::OcclusionQueryNode(Box::new(query))).with_child(below);
            let mut scene = Scene::new();
            scene.add_root(Page::from_node(asked).unwrap());
            let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
            for frame in 1..6 {
                visitor.cull(&scene, &CullCamera { frame, ..CullCamera::default() }, &mut stage);
                results.answered(0, 1, frame);
            }
            (stage.queries.len(), stage.leaf_count(), stage.lights.len())
        };
        assert_eq!(queries(geode.clone()), (1, 0, 0));
        let light = Node::new(NodeKind::LightSource(Box::new(LightSource {
            light: Light::default(),
            frame: ReferenceFrame::Relative,
        })));
        assert_eq!(queries(Node::group(vec![geode.clone(), light])), (0, 1, 1));
        assert_eq!(queries(Node { culling_active: false, ..geode }), (0, 1, 0));
    }

    /// Regression: a node was queried only once when the frame number did not change.
    #[test]
    fn node_is_queried_again_while_the_frame_number_stands_still() {
        let mesh = Mesh::cuboid(&Aabb { min: DVec3::new(-1.0, -1.0, -21.0), max: DVec3::new(1.0, 1.0, -19.0) });
        let query = OcclusionQueryNode { query_frames: 3, ..OcclusionQueryNode::default() };
        let results = query.results.clone();
        let mut asked = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
        asked.children.push(Node::geode(vec![Drawable::new(mesh.into(), Material::default())]));
        let mut scene = Scene::new();
        scene.add_root(Page::from_node(asked).unwrap());
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        let mut cull = || {
            visitor.cull(&scene, &CullCamera::default(), &mut stage);
            (stage.queries.len(), stage.leaf_count())
        };
        assert_eq!([cull(), cull()], [(1, 1), (0, 1)], "no answer yet");
        results.answered(0, 1, CullCamera::default().frame);
        assert_eq!([cull(), cull()], [(1, 1), (0, 1)]);
        results.answered(0, 1, CullCamera::default().frame);
        assert_eq!([cull(), cull()], [(1, 0), (0, 0)], "hidden");
        results.answered(9, 1, CullCamera::default().frame);
        assert_eq!([cull(), cull()], [(1, 1), (0, 1)], "and seen again");
    }

    #[test]
    fn near_and_far_include_the_boxes_of_queries() {
        let cube = |z: f64| {
            let center = DVec3::new(0.0, 0.0, z);
            let mesh = Mesh::cuboid(&Aabb { min: center - 1.0, max: center + 1.0 });
            Node::geode(vec![Drawable::new(mesh.into(), Material::default())])
        };
        let query = OcclusionQueryNode { query_frames: 1, failures_to_hide: 2, ..OcclusionQueryNode::default() };
        let results = query.results.clone();
        let mut asked = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
        asked.children.push(cube(-20.0));
        let mut scene = Scene::new();
        scene.add_root(Page::from_node(Node::group(vec![asked, cube(-1000.0)])).unwrap());
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        visitor.cull(&scene, &CullCamera { frame: 1, ..CullCamera::default() }, &mut stage);
        assert_eq!(stage.counters.answers_age, 1, "queried in the first frame");
        let mut age = |frame: u32, answered: Option<u32>| {
            answered.into_iter().for_each(|of_frame| results.answered(0, 1, of_frame));
            visitor.cull(&scene, &CullCamera { frame, ..CullCamera::default() }, &mut stage);
            stage.counters.answers_age
        };
        assert_eq!((age(2, Some(1)), age(3, Some(2))), (2, u32::MAX), "the second hidden answer hides it");
        assert_eq!((age(4, None), age(5, Some(4))), (2, 1));
        assert_eq!((stage.leaf_count(), stage.queries.len()), (1, 1));
        assert!(stage.near_m < 19.0 && stage.far_m > 1000.0, "{} to {}", stage.near_m, stage.far_m);
    }
}
