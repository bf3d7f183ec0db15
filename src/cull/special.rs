//! The rarer node kinds during the node scan: other views, billboards, positioned state, occlusion queries.

use glam::{DAffine3, DMat3, DVec3};

use super::cameras::{CameraPlace, DeferredCamera, NestedCamera};
use super::stage::{
    ClipPlane, OcclusionQuery, PositionedLight, PositionedTexGen, StageTarget, StageView, moved, plane_moved,
    texgen_moved,
};
use super::view::View;
use super::visitor::{Cull, DepthRange, PageContext};
use super::{CullCamera, StageShadows};
use crate::scene::{
    BillboardMode, CameraEnvironment, CameraNode, CameraShadows, INACTIVE, NONE, OcclusionQueryNode, RareNode,
    ReferenceFrame, RenderOrder, UNBOUNDED, UNCULLED,
};

/// Cameras inside cameras are followed so deep.
pub(super) const MOST_NESTED: u32 = 8;

impl Cull<'_> {
    /// Visits a node of a rarer kind. False: its children are scanned like those of a group.
    pub(super) fn visit_special(&mut self, context: &PageContext, node: u32, mask: u8) -> bool {
        let page = context.page;
        let Some(special) = page.rare_nodes().get(page.payloads()[node as usize] as usize) else { return false };
        if self.view.casts {
            match special {
                RareNode::Camera { .. } | RareNode::Projection { .. } => return true,
                RareNode::OcclusionQuery(_) => return false,
                _ => {}
            }
        }
        match special {
            RareNode::Billboard { mode, positions, .. } => {
                self.billboard(context, node, *mode, positions, mask);
                false
            }
            RareNode::LightSource(source) => {
                let eye_from_node = self.eye_from_node(context, node, source.frame);
                let light = moved(&eye_from_node, &source.light);
                self.stage.lights.push(PositionedLight { light, view: self.view.index });
                false
            }
            RareNode::ClipNode(clip) => {
                let eye_from_node = self.eye_from_node(context, node, clip.frame);
                for (number, plane) in &clip.planes {
                    let plane = plane_moved(&eye_from_node, *plane);
                    self.stage.clip_planes.push(ClipPlane { number: *number, plane, view: self.view.index });
                }
                false
            }
            RareNode::TexGenNode(node_texgen) => {
                let eye_from_node = self.eye_from_node(context, node, ReferenceFrame::Relative);
                let texgen = texgen_moved(&eye_from_node, node_texgen.texgen);
                self.stage.texgens.push(PositionedTexGen { unit: node_texgen.unit, texgen, view: self.view.index });
                false
            }
            RareNode::ClearNode(clear) => {
                self.stage.clear_node = Some(clear.color);
                false
            }
            RareNode::Occluder => false,
            RareNode::OcclusionQuery(query) => {
                let is_hidden = self.occlusion_query(context, node, query);
                if is_hidden {
                    self.keep_required(context, node..node + page.nodes()[node as usize].skip);
                }
                is_hidden
            }
            RareNode::Camera { camera, path } => {
                self.camera_node(context, node, camera, *path, mask);
                true
            }
            RareNode::Projection { clip_from_eye, path } => {
                let own = View { clamp_projection: None, is_of_above: false, ..self.view };
                let view = View { clip_from_eye: *clip_from_eye, ..own };
                self.in_view(context, node, view, None, context.visit.eye_from_page, *path);
                true
            }
            RareNode::AbsoluteTransform => {
                let above = page.transforms().page_from_node(self.enclosing_transform(context, node));
                if let Some(eye_from_page) = finite(above.inverse()) {
                    let own = page.nodes()[node as usize].first_transform as usize;
                    self.in_frame(context, node, eye_from_page, Some(own));
                }
                true
            }
        }
    }

    fn eye_from_node(&self, context: &PageContext, node: u32, frame: ReferenceFrame) -> DAffine3 {
        match frame {
            ReferenceFrame::Absolute => DAffine3::IDENTITY,
            ReferenceFrame::Relative => {
                let enclosing = self.enclosing_transform(context, node);
                context.visit.eye_from_page * context.page.transforms().page_from_node(enclosing)
            }
        }
    }

    /// Scans the children of a node as if the page lay elsewhere. `own` is the node's transform, if it is one.
    fn in_frame(&mut self, context: &PageContext, node: u32, eye_from_page: DAffine3, own: Option<usize>) {
        let page = context.page;
        let mut visit = context.visit;
        visit.eye_from_page = eye_from_page;
        visit.mask = self.view.planes.mask;
        let below = self.page_context(page, visit);
        let tile_view = self.tile_view.take();
        self.linear_rows.0 = NONE;
        let transform = own.unwrap_or_else(|| self.enclosing_transform(context, node) as usize);
        let matrix = self.push_transforms(&below, transform..transform + 1);
        let end = node + page.nodes()[node as usize].skip;
        self.scan_nodes(&below, node + 1, end, visit.mask, matrix);
        self.linear_rows.0 = NONE;
        // The planes of occluders are those of the page again; the tiles' are made again.
        self.tile_view = tile_view.filter(|_| self.occluders.is_empty());
        self.frame_occluders(&context.visit.eye_from_page, page.origin());
    }

    /// Scans the children of a node under another view of the same stage: that of a nested camera or a Projection.
    fn in_view(
        &mut self,
        context: &PageContext,
        node: u32,
        mut view: View,
        camera_node: Option<&CameraNode>,
        eye_from_page: DAffine3,
        path: u32,
    ) {
        let clip_from_eye = view.clip_from_eye;
        let camera = CullCamera {
            eye_from_world: view.eye_from_world,
            clip_from_eye,
            viewport_px: view.viewport_px,
            settings: view.settings,
            horizon: view.horizon,
            ..*self.camera
        };
        let above = self.view.index;
        let shows_scene = camera_node.is_some_and(|node| node.shows_scene);
        self.stage.views.push(StageView {
            clip_from_eye,
            viewport_px: view.viewport_rect,
            camera,
            above,
            is_of_above: view.is_of_above,
            shows_scene,
            environment: camera_node.map_or(CameraEnvironment::Light, |node| node.environment.clone()),
            shadows: StageShadows::default(),
            range_m: [0.0; 2],
        });
        view.index = self.stage.views.len() as u32;
        view.derive();
        view.range = DepthRange::EMPTY;
        self.views.push(view);
        self.enter_view(view.index);
        // Known before anything below it is met.
        let state = self.chain_state(context.page, path);
        if shows_scene {
            self.queue_roots(state);
        }
        let mut below = *context;
        below.visit.view = view.index;
        self.in_frame(&below, node, eye_from_page, None);
        self.enter_view(above);
    }

    /// The current view has the projection of the stage.
    fn is_of_stage(&self) -> bool {
        let mut view = self.view.index;
        while let Some(found) = self.stage.views.get((view as usize).wrapping_sub(1)).filter(|view| view.is_of_above) {
            view = found.above;
        }
        view == 0
    }

    fn camera_node(&mut self, context: &PageContext, node: u32, camera: &CameraNode, path: u32, mask: u8) {
        let page = context.page;
        if camera.shows_scene && self.view.in_scene_camera {
            return;
        }
        let above = page.transforms().page_from_node(self.enclosing_transform(context, node));
        let Some(node_from_page) = finite(above.inverse()) else { return };
        let mut view = self.view;
        view.settings = camera.settings.inheriting(&self.view.settings, camera.inherit);
        view.clamp_projection = camera.clamp_projection;
        view.is_of_above = camera.projection.is_none() && camera.clamp_projection.is_none();
        let eye_from_node = match camera.frame {
            ReferenceFrame::Absolute => camera.view,
            ReferenceFrame::Relative => context.visit.eye_from_page * above * camera.view,
        };
        // What is below an absolute camera is in the world's frame.
        view.eye_from_world = match camera.frame {
            ReferenceFrame::Absolute => camera.view,
            ReferenceFrame::Relative => {
                let eye_from_above = context.visit.eye_from_page * above;
                eye_from_above * camera.view * eye_from_above.inverse() * self.view.eye_from_world
            }
        };
        let Some(eye_from_page) = finite(eye_from_node * node_from_page) else { return };
        view.in_scene_camera |= camera.shows_scene;
        if view.in_scene_camera {
            // What fades is known by the picture's own eye.
            view.settings.lod_fade_s = 0.0;
        }
        if camera.frame == ReferenceFrame::Absolute && !camera.shows_scene {
            view.horizon = None;
        }
        if let Some(clip_from_eye) = camera.projection {
            view.clip_from_eye = clip_from_eye;
        }
        if let Some(rect) = camera.viewport_px {
            (view.viewport_px, view.viewport_rect) = ([rect[2], rect[3]], Some(rect));
        }
        let order = match camera.order {
            RenderOrder::Nested => {
                let place = self.stage.views.len() as u32 + 1;
                self.in_view(context, node, view, Some(camera), eye_from_page, path);
                if camera.shadows != CameraShadows::None {
                    let (state, mut visit) = (self.chain_state(page, path), context.visit);
                    (visit.eye_from_page, visit.mask) = (eye_from_page, mask);
                    let met = CameraPlace { visit, node, state, path, shows_scene: camera.shows_scene };
                    self.nested.push(NestedCamera { met, place, shadows: camera.shadows });
                }
                return;
            }
            RenderOrder::PreRender(order) | RenderOrder::PostRender(order) => order,
        };
        let target_px = camera.target.as_ref().and_then(|target| target.size_px());
        for (_, sink) in camera.target.iter().flat_map(|target| target.read_backs()) {
            self.counters.answers_age = self.counters.answers_age.max(sink.age(self.camera.frame));
        }
        if let (None, Some(size_px)) = (camera.viewport_px, target_px) {
            view.viewport_px = size_px;
        }
        // Where it has no target of its own, it is where the view is that it was met in.
        let viewport_px = if target_px.is_some() { camera.viewport_px } else { view.viewport_rect };
        let is_after = matches!(camera.order, RenderOrder::PostRender(_)) && !camera.clear_depth;
        let keeps_projection = is_after && target_px.is_none() && view.is_of_above && self.is_of_stage();
        let mut visit = context.visit;
        (visit.eye_from_page, visit.mask) = (eye_from_page, mask);
        let state = self.chain_state(page, path);
        self.deferred.push(DeferredCamera {
            met: CameraPlace { visit, node, state, path, shows_scene: camera.shows_scene },
            view,
            is_pre: matches!(camera.order, RenderOrder::PreRender(_)),
            target: StageTarget {
                camera: camera.target.clone().filter(|_| target_px.is_some()),
                is_shared: false,
                keeps_projection,
                viewport_px,
                clear_color: camera.clear_color,
                clear_depth: camera.clear_depth,
                order,
                callbacks: camera.callbacks.clone(),
                environment: camera.environment.clone(),
                shadows: camera.shadows,
            },
        });
    }

    fn billboard(&mut self, context: &PageContext, node: u32, mode: BillboardMode, positions: &[DVec3], mask: u8) {
        let page = context.page;
        let first = page.nodes()[node as usize].first_drawable;
        let is_unculled = page.nodes()[node as usize].flags & UNCULLED != 0;
        let eye_from_node = self.eye_from_node(context, node, ReferenceFrame::Relative);
        let Some(node_from_eye) = finite(eye_from_node.inverse()) else { return };
        for (drawable, position) in (first..).zip(positions) {
            let depth = if is_unculled {
                self.depth_of_unculled(context, drawable)
            } else {
                let Some((depth, _)) = self.test_behind_occluders(context, drawable, mask) else { continue };
                depth
            };
            let map = mode.eye_from_drawable(&eye_from_node, node_from_eye.translation, *position);
            let matrix = self.push_matrix(&map);
            self.emit(context, drawable, depth, matrix);
        }
    }

    /// True when the children are skipped.
    fn occlusion_query(&mut self, context: &PageContext, node: u32, query: &OcclusionQueryNode) -> bool {
        let page = context.page;
        let sphere = page.spheres()[node as usize];
        // Answers are those of the picture itself: nobody draws what is only looked at.
        let only_looks = self.only_looks || self.camera.ahead_frames > 0;
        // Lights shine from where no box is seen, and cameras show what is not in it.
        let is_bounded = sphere.w < UNBOUNDED && sphere.w >= 0.0 && page.nodes()[node as usize].flags & INACTIVE == 0;
        if !is_bounded || self.view.in_scene_camera || only_looks {
            return false;
        }
        // What one eye does not see another may.
        let results = &query.results;
        if !results.are_of(self.fades.eye(), self.camera.frame) {
            return false;
        }
        let center = page.origin() + sphere.truncate().as_dvec3();
        let box_from_unit =
            DAffine3 { matrix3: DMat3::from_diagonal(DVec3::splat(f64::from(sphere.w))), translation: center };
        let eye_from_unit = context.visit.eye_from_page * box_from_unit;
        let eye = eye_from_unit.inverse().translation;
        // From inside (or nearly) the box's faces are not seen, which says nothing about what is in it.
        let is_outside = eye.abs().max_element() > 1.5;
        if !is_outside {
            results.answered(u64::MAX, query.visibility_threshold, self.camera.frame);
        } else if results.is_due(self.camera.frame, query.query_frames) {
            let matrix = self.push_matrix(&eye_from_unit);
            // What near or far cut off is not seen.
            let axis = self.view.depth_axis;
            let middle = axis.dot(eye_from_unit.translation);
            let reach = (eye_from_unit.matrix3.transpose() * axis).abs().element_sum();
            self.range.near = self.range.near.min((middle - reach) as f32);
            self.range.far = self.range.far.max((middle + reach) as f32);
            self.stage.queries.push(OcclusionQuery {
                results: results.clone(),
                visibility_threshold: query.visibility_threshold,
                frame: self.camera.frame,
                matrix,
                view: self.view.index,
            });
        }
        let (is_hidden, answers_age) = results.decide(self.camera.frame, query.failures_to_hide.max(1));
        self.counters.answers_age = self.counters.answers_age.max(answers_age);
        is_hidden
    }
}

fn finite(map: DAffine3) -> Option<DAffine3> {
    map.is_finite().then_some(map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cull::{CullVisitor, RenderStage};
    use crate::math::Aabb;
    use crate::scene::{Drawable, LightSource, Material, Mesh, Node, NodeKind, Page, Scene};
    use crate::state::Light;

    #[test]
    fn what_no_bound_culls_no_query_hides() {
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

    /// It was asked for once.
    #[test]
    fn where_frames_stand_still_a_node_is_asked_for_again() {
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
    fn a_hidden_node_is_asked_for_where_near_and_far_do_not_cut_it_off() {
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
        assert_eq!(stage.counters.answers_age, 1, "asked in the first frame");
        let mut age = |frame: u32, answered: Option<u32>| {
            answered.into_iter().for_each(|of_frame| results.answered(0, 1, of_frame));
            visitor.cull(&scene, &CullCamera { frame, ..CullCamera::default() }, &mut stage);
            stage.counters.answers_age
        };
        assert_eq!((age(2, Some(1)), age(3, Some(2))), (2, u32::MAX), "one more would hide it, and it did");
        assert_eq!((age(4, None), age(5, Some(4))), (2, 1));
        assert_eq!((stage.leaf_count(), stage.queries.len()), (1, 1));
        assert!(stage.near_m < 19.0 && stage.far_m > 1000.0, "{} to {}", stage.near_m, stage.far_m);
    }
}
