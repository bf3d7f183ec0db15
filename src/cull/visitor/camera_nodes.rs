//! Nodes with another view or another frame: cameras, projections and absolute transforms. Culling thread.
//!
//! A nested camera and a Projection are views of the same stage and are scanned at once. A camera that is drawn before or
//! after the stage is put into the [`CameraQueue`](super::camera_queue::CameraQueue).

use glam::{DAffine3, DMat4};

use super::camera_queue::{CameraVisit, DeferredCamera, NestedCamera};
use super::page_context::PageContext;
use super::page_queue::PageVisit;
use super::traversal::Traversal;
use crate::cull::fading::Fade;
use crate::cull::stage::{StageShadows, StageTarget, StageView};
use crate::cull::views::{DepthRange, View};
use crate::scene::{CameraEnvironment, CameraNode, CameraShadows, Inherit, ReferenceFrame, RenderOrder};

impl Traversal<'_> {
    /// Scans what is below a camera in the graph that has this stage, and the scene's roots where it shows them.
    pub(in crate::cull) fn visit_graph_camera(&mut self, camera: &CameraVisit) {
        if camera.shows_scene {
            let state = self.states.in_stage_view(camera.state);
            self.queue_roots(state);
        }
        let Some(page) = self.scene.page_at(camera.page.slot) else { return };
        self.start_page(page, camera.page.state);
        let state = self.states.in_stage_view(camera.state);
        self.states.set_path(camera.path, state);
        let mask = self.views.current().planes.mask;
        let visit = PageVisit { mask, view: 0, required: false, fade: Fade::NONE, ..camera.page };
        let context = self.page_context(page, visit);
        let transform = self.enclosing_transform(&context, camera.node);
        let matrix = self.push_matrix(&(visit.eye_from_page * page.transforms().page_from_node(transform)));
        let end = camera.node + page.nodes()[camera.node as usize].skip;
        self.scan_nodes(&context, camera.node + 1, end, mask, matrix);
    }

    /// Scans the children of a Projection in a view with its projection.
    pub(super) fn visit_projection(&mut self, context: &PageContext, node: u32, clip_from_eye: &DMat4, path: u32) {
        let mut view = View { clamp_projection: None, inherits_projection: false, ..*self.views.current() };
        view.camera.clip_from_eye = *clip_from_eye;
        self.scan_in_view(context, node, view, None, context.visit.eye_from_page, path);
    }

    /// Scans the children of a transform that is relative to the eye and not to the nodes above.
    pub(super) fn visit_absolute_transform(&mut self, context: &PageContext, node: u32) {
        let page = context.page;
        let page_from_above = page.transforms().page_from_node(self.enclosing_transform(context, node));
        if let Some(eye_from_page) = finite(page_from_above.inverse()) {
            let own = page.nodes()[node as usize].first_transform as usize;
            self.scan_in_frame(context, node, eye_from_page, Some(own));
        }
    }

    /// Scans the children of a node with another `eye_from_page`. `own` is the node's transform, if it is one.
    fn scan_in_frame(&mut self, context: &PageContext, node: u32, eye_from_page: DAffine3, own: Option<usize>) {
        let page = context.page;
        let mut visit = context.visit;
        visit.eye_from_page = eye_from_page;
        visit.mask = self.views.current().planes.mask;
        let below = self.page_context(page, visit);
        let tile_view = self.tile_view.take();
        self.matrices.forget();
        let transform = own.unwrap_or_else(|| self.enclosing_transform(context, node) as usize);
        let matrix = self.matrices.push(&below, transform, &mut self.stage.eye_from_drawable);
        let end = node + page.nodes()[node as usize].skip;
        self.scan_nodes(&below, node + 1, end, visit.mask, matrix);
        self.matrices.forget();
        // The scan moved the occluders into its own frames: they are moved back here, and for tiles when they are walked.
        self.tile_view = tile_view.filter(|_| !self.occlusion.is_active());
        self.occlusion.enter_page(&context.visit.eye_from_page, page.origin());
    }

    /// Scans the children of a node in another view of the same stage: that of a nested camera or a Projection.
    fn scan_in_view(
        &mut self,
        context: &PageContext,
        node: u32,
        mut view: View,
        camera_node: Option<&CameraNode>,
        eye_from_page: DAffine3,
        path: u32,
    ) {
        let above = self.views.current().index;
        let shows_scene = camera_node.is_some_and(|node| node.shows_scene);
        self.stage.views.push(StageView {
            clip_from_eye: view.camera.clip_from_eye,
            viewport_px: view.viewport_rect,
            camera: view.camera,
            above,
            inherits_projection: view.inherits_projection,
            shows_scene,
            environment: camera_node.map_or(CameraEnvironment::Light, |node| node.environment.clone()),
            shadows: StageShadows::default(),
            range_m: [0.0; 2],
        });
        view.index = self.stage.views.len() as u32;
        view.derive();
        view.depths = DepthRange::EMPTY;
        self.views.push(view);
        self.enter_view(view.index);
        // Found here, since the view is part of the states below.
        let state = self.states.path_state(context.page, path);
        if shows_scene {
            self.queue_roots(state);
        }
        let mut below = *context;
        below.visit.view = view.index;
        self.scan_in_frame(&below, node, eye_from_page, None);
        self.enter_view(above);
    }

    /// Returns true if the current view has the projection of the stage.
    fn has_stage_projection(&self) -> bool {
        let mut view = self.views.current().index;
        while let Some(found) =
            self.stage.views.get((view as usize).wrapping_sub(1)).filter(|view| view.inherits_projection)
        {
            view = found.above;
        }
        view == 0
    }

    /// Returns the view of a camera in the graph, with the eye's frame from that of the page. Returns `None` if a transform
    /// above it cannot be inverted.
    fn view_of_camera(&self, context: &PageContext, node: u32, camera: &CameraNode) -> Option<(View, DAffine3)> {
        let page_from_above = context.page.transforms().page_from_node(self.enclosing_transform(context, node));
        let above_from_page = finite(page_from_above.inverse())?;
        let mut view = *self.views.current();
        view.camera.settings = camera.settings.inheriting(&view.camera.settings, camera.inherit);
        let inherited = view.clamp_projection.filter(|_| camera.inherit.has(Inherit::CLAMP_PROJECTION));
        view.clamp_projection = camera.clamp_projection.or(inherited);
        view.inherits_projection = camera.projection.is_none() && camera.clamp_projection.is_none();
        let eye_from_above = context.visit.eye_from_page * page_from_above;
        // Nodes below an absolute camera lie in the world's frame.
        let eye_from_node = match camera.frame {
            ReferenceFrame::Absolute => camera.view,
            ReferenceFrame::Relative => eye_from_above * camera.view,
        };
        view.camera.eye_from_world = match camera.frame {
            ReferenceFrame::Absolute => camera.view,
            ReferenceFrame::Relative => eye_from_node * eye_from_above.inverse() * view.camera.eye_from_world,
        };
        let eye_from_page = finite(eye_from_node * above_from_page)?;
        view.in_scene_camera |= camera.shows_scene;
        if view.in_scene_camera {
            // The marks of fades belong to the eye of the stage.
            view.camera.settings.lod_fade_s = 0.0;
        }
        if camera.frame == ReferenceFrame::Absolute && !camera.shows_scene {
            view.camera.horizon = None;
        }
        if let Some(clip_from_eye) = camera.projection {
            view.camera.clip_from_eye = clip_from_eye;
        }
        if let Some(rect) = camera.viewport_px {
            (view.camera.viewport_px, view.viewport_rect) = ([rect[2], rect[3]], Some(rect));
        }
        Some((view, eye_from_page))
    }

    /// Visits a camera: scans a nested one at once, and queues one that has its own stage.
    pub(super) fn visit_camera_node(
        &mut self,
        context: &PageContext,
        node: u32,
        camera: &CameraNode,
        path: u32,
        mask: u8,
    ) {
        let page = context.page;
        if camera.shows_scene && self.views.current().in_scene_camera {
            return;
        }
        let Some((mut view, eye_from_page)) = self.view_of_camera(context, node, camera) else { return };
        let order = match camera.order {
            RenderOrder::Nested => {
                let stage_view = self.stage.views.len();
                self.scan_in_view(context, node, view, Some(camera), eye_from_page, path);
                if camera.shadows != CameraShadows::None {
                    let state = self.states.path_state(page, path);
                    let page = PageVisit { eye_from_page, mask, ..context.visit };
                    let visit = CameraVisit { page, node, state, path, shows_scene: camera.shows_scene };
                    self.cameras.add_nested(NestedCamera { visit, stage_view, shadows: camera.shadows });
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
            view.camera.viewport_px = size_px;
        }
        // A camera without a target is drawn into the viewport of the view around it.
        let viewport_px = if target_px.is_some() { camera.viewport_px } else { view.viewport_rect };
        let is_after = matches!(camera.order, RenderOrder::PostRender(_)) && !camera.clear_depth;
        let keeps_projection =
            is_after && target_px.is_none() && view.inherits_projection && self.has_stage_projection();
        let state = self.states.path_state(page, path);
        let page = PageVisit { eye_from_page, mask, ..context.visit };
        self.cameras.defer(DeferredCamera {
            visit: CameraVisit { page, node, state, path, shows_scene: camera.shows_scene },
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
                copy_to: camera.copy_to.clone(),
                callbacks: camera.callbacks.clone(),
                environment: camera.environment.clone(),
                shadows: camera.shadows,
            },
        });
    }
}

fn finite(map: DAffine3) -> Option<DAffine3> {
    map.is_finite().then_some(map)
}
