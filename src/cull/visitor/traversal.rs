//! [`Traversal`]: the state of the cull of one stage. Culling thread.
//!
//! The files beside this one and in `tiles` add the steps of a traversal, one for each kind of node.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::camera_queue::CameraQueue;
use super::matrices::{TransformMatrices, matrix_rows};
use super::near_far::PrimitiveCandidates;
use super::page_context::{OpenNode, PageContext, eye_in};
use super::page_queue::{AttachmentFrame, PageQueue, PageVisit, Purpose, QueuedPage};
use super::page_states::PageStates;
use crate::cull::CullCamera;
use crate::cull::fading::{Fade, LodFades};
use crate::cull::occluders::Occlusion;
use crate::cull::stage::{CullCounters, RenderLeaf, RenderStage};
use crate::cull::tiles::{MAX_ERROR_PX, OpenTile, TileView};
use crate::cull::views::ViewStack;
use crate::cull::views::{DepthRange, View};
use crate::cull::views::{Planes, depth_row};
use crate::scene::{ComputeNearFar, CullingMode, NONE, Page, Scene};
use crate::state::StateSet;

/// Memory that is reused by the culls of all stages and frames, so that a steady frame allocates nothing.
#[derive(Debug, Default)]
pub(in crate::cull) struct TraversalMemory {
    pub leaves: Vec<RenderLeaf>,
    pub queue: PageQueue,
    pub states: PageStates,
    pub cameras: CameraQueue,
    pub occlusion: Occlusion,
    primitives: PrimitiveCandidates,
    views: Vec<View>,
    stacks: OpenStacks,
}

/// The subtrees that are being scanned, innermost last.
#[derive(Debug, Default)]
pub(in crate::cull) struct OpenStacks {
    pub nodes: Vec<OpenNode>,
    pub tiles: Vec<OpenTile>,
}

/// Deviations from an ordinary cull.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::cull) struct TraversalOptions {
    /// Nodes of subtrees that are wholly inside the frustum are visited one by one.
    pub visits_all: bool,
    /// Only the pages of the scene's roots are visited.
    pub roots_only: bool,
    /// The result is not drawn, so that no occlusion queries are asked.
    pub is_dry_run: bool,
}

/// The cull of one stage under way: what is culled, and the parts that collect what is found.
///
/// More than 16 fields: a visit reads some parts while it writes into others, so that each is borrowed alone.
pub(in crate::cull) struct Traversal<'a> {
    pub scene: &'a Scene,
    pub camera: &'a CullCamera,
    pub options: TraversalOptions,
    pub stage: &'a mut RenderStage,
    /// Leaves in traversal order.
    pub leaves: &'a mut Vec<RenderLeaf>,
    pub counters: CullCounters,
    pub queue: &'a mut PageQueue,
    pub states: &'a mut PageStates,
    pub matrices: TransformMatrices,
    pub views: ViewStack<'a>,
    pub cameras: &'a mut CameraQueue,
    pub occlusion: &'a mut Occlusion,
    pub primitives: &'a mut PrimitiveCandidates,
    pub fades: &'a mut LodFades,
    pub stacks: &'a mut OpenStacks,
    /// The frame of the tile tree that was walked last in the current page.
    pub tile_view: Option<TileView>,
    /// The node of the current page that is visited in a pass of its cull callback, which is not asked again.
    pub in_pass: Option<u32>,
}

impl<'a> Traversal<'a> {
    /// Starts the cull of a stage. The occluders of the view must be in `memory` already.
    pub fn new(
        scene: &'a Scene,
        camera: &'a CullCamera,
        view: View,
        options: TraversalOptions,
        memory: &'a mut TraversalMemory,
        fades: &'a mut LodFades,
        stage: &'a mut RenderStage,
    ) -> Self {
        let TraversalMemory { leaves, queue, states, cameras, occlusion, primitives, views, stacks } = memory;
        stage.clear(camera);
        stage.clamp_projection = view.clamp_projection;
        leaves.clear();
        queue.clear();
        states.start_stage();
        cameras.start_stage();
        primitives.clear();
        Self {
            scene,
            camera,
            options,
            stage,
            leaves,
            counters: CullCounters::default(),
            queue,
            states,
            matrices: TransformMatrices::new(),
            views: ViewStack::new(views, view),
            cameras,
            occlusion,
            primitives,
            fades,
            stacks,
            tile_view: None,
            in_pass: None,
        }
    }

    /// Visits the queued pages, and those that they queue, until none is left.
    pub fn visit_queue(&mut self) {
        let mut pages_left = if self.options.roots_only { self.scene.roots().len() } else { usize::MAX };
        while pages_left > 0
            && let Some(pages) = self.queue.pop()
        {
            pages_left -= 1;
            self.visit_queued(&pages);
        }
    }

    /// Completes the stage: counters, near and far, projections.
    pub fn finish(mut self) {
        self.stage.state_sets.truncate(self.stage.view_of_state.len());
        self.counters.wanted_missing = self.stage.requests.len() as u32;
        self.counters.leaves = self.leaves.len() as u32;
        self.counters.dynamic_leaves = self.dynamic_leaves();
        self.stage.counters = self.counters;
        self.fit_views();
    }

    /// Returns the number of leaves below a dynamic state set.
    fn dynamic_leaves(&self) -> u32 {
        let states = &self.stage.state_sets;
        if !states.iter().any(|state| state.is_dynamic()) {
            return 0;
        }
        self.leaves.iter().filter(|leaf| states[leaf.state as usize].is_dynamic()).count() as u32
    }

    /// Returns true if subtrees wholly inside the frustum are taken as ranges, since nothing needs their nodes one by one.
    pub fn takes_ranges(&self) -> bool {
        !self.options.visits_all && self.occlusion.is_empty()
    }

    /// Makes another view of the stage the current one.
    pub fn enter_view(&mut self, view: u32) {
        self.views.enter(view);
        self.states.enter_view(view);
        self.occlusion.enter_view(view);
    }

    /// Fits near and far of each view to what was met in it.
    fn fit_views(&mut self) {
        let views = self.views.all_mut();
        self.primitives.widen_views(self.scene, views);
        for (index, view) in self.stage.views.iter().enumerate().rev() {
            if view.inherits_projection {
                let found = views[index + 1].depths;
                let above = &mut views[view.above as usize].depths;
                *above = DepthRange { near: above.near.min(found.near), far: above.far.max(found.far) };
            }
        }
        let [own, nested @ ..] = &*views else { return };
        [self.stage.near_m, self.stage.far_m] = own.depths_m();
        for (view, found) in self.stage.views.iter_mut().zip(nested) {
            (view.clip_from_eye, view.range_m) = (found.clamped(), found.depths_m());
        }
        self.stage.set_projection(own.clamped());
    }

    /// Returns the state graph node of the scene's roots, below the state set of the camera where it has one.
    pub fn root_state(&mut self, set: Option<&Arc<StateSet>>) -> u32 {
        self.states.root(set)
    }

    /// Queues the scene's roots for the current view, under a state.
    pub fn queue_roots(&mut self, state: u32) {
        let view = self.views.current();
        let mask = view.planes.mask;
        let attachment = self.queue.add_frame(AttachmentFrame {
            eye_from_frame: view.camera.eye_from_world,
            holder: NONE,
            above: 0,
            state,
            view: view.index,
            purpose: Purpose::Draw,
            required: false,
            shown_px: MAX_ERROR_PX,
        });
        for root in self.scene.roots() {
            let fade = Fade::NONE;
            self.queue.push(QueuedPage { first: root.slot, end: root.slot + 1, attachment, state, fade, mask });
        }
    }

    /// Drops what was cached for the page before.
    pub fn start_page(&mut self, page: &Page, state: u32) {
        self.tile_view = None;
        self.matrices.forget();
        self.states.start_page(page, state);
    }

    fn visit_queued(&mut self, pages: &QueuedPage) {
        let &QueuedPage { first, end, attachment, state, fade, mask } = pages;
        let &AttachmentFrame { eye_from_frame, holder, view, purpose, required, shown_px, .. } =
            self.queue.frame(attachment);
        if view != self.views.current().index {
            self.enter_view(view);
        }
        let takes_single_drawables = purpose == Purpose::Draw && self.takes_ranges() && self.only_frustum_culls();
        let holder = self.scene.page_at(holder);
        for index in first..end {
            let (slot, eye_from_page) = match holder {
                Some(holder) => {
                    let slot = holder.tiles().resident(index as usize);
                    (slot, eye_from_frame * holder.tiles().content_transform(index as usize))
                }
                None => (index, eye_from_frame),
            };
            let mask = if self.keeps_whole(slot) { 0 } else { mask };
            if takes_single_drawables && let Some(drawable) = self.scene.single_drawable_at(slot, self.camera.context) {
                self.take_single_drawable(drawable, &eye_from_page, state, mask);
                continue;
            }
            self.visit_page(PageVisit {
                slot,
                attachment,
                eye_from_page,
                mask,
                purpose,
                required,
                state,
                view,
                shown_px,
                fade,
            });
        }
    }

    /// Returns true for a page whose drawables are not tested against the frustum.
    fn keeps_whole(&self, slot: u32) -> bool {
        // The tiles in a page are always tested.
        !self.camera.culls_contents && self.scene.page_at(slot).is_some_and(|page| page.tiles().is_empty())
    }

    fn visit_page(&mut self, visit: PageVisit) {
        let (scene, slot) = (self.scene, visit.slot);
        let Some(page) = scene.page_at(slot) else { return };
        self.start_page(page, visit.state);
        if visit.purpose != Purpose::Draw {
            for root in 0..page.tiles().roots().len() {
                self.scan_tiles(page, &visit, root, visit.mask, visit.purpose);
            }
            return;
        }
        let context = self.page_context(page, visit);
        let matrix = if page.uses_page_frame() { self.push_matrix(&visit.eye_from_page) } else { 0 };
        let last = page.node_count() as u32;
        self.scan_nodes(&context, 0, last, visit.mask, matrix);
    }

    /// Returns true if the current view culls by nothing but the frustum, as far as pages of one drawable are concerned.
    fn only_frustum_culls(&self) -> bool {
        let view = self.views.current();
        let settings = &view.camera.settings;
        view.small_feature == 0.0 && settings.cull_mask != 0 && settings.compute_near_far != ComputeNearFar::Primitives
    }

    /// Computes the constants for the scan of a page, and moves the occluders into its frame.
    pub fn page_context<'p>(&mut self, page: &'p Page, visit: PageVisit) -> PageContext<'p> {
        self.occlusion.enter_page(&visit.eye_from_page, page.origin());
        let view = self.views.current();
        let settings = &view.camera.settings;
        let has_clusters = !page.normal_cones().is_empty() && settings.culling.contains(CullingMode::CLUSTER);
        let by_primitives = settings.compute_near_far == ComputeNearFar::Primitives;
        PageContext {
            page,
            eye_rows: [0, 1, 2].map(|row| visit.eye_from_page.matrix3.row(row)),
            eye: if page.needs_eye() { eye_in(&visit.eye_from_page) } else { DVec3::ZERO },
            planes: if visit.mask == 0 {
                Planes::UNUSED
            } else {
                view.planes.in_frame(&visit.eye_from_page, page.origin())
            },
            depth: depth_row(&visit.eye_from_page, page.origin(), view.depth_axis),
            slots: page.draw_slots_of(self.camera.context),
            looks_closer: has_clusters
                || by_primitives
                || self.occlusion.is_active()
                || !page.drawable_callbacks().is_empty(),
            has_clusters,
            by_primitives,
            visit,
        }
    }

    /// Appends a matrix to the stage and returns its index.
    pub fn push_matrix(&mut self, eye_from_node: &DAffine3) -> u32 {
        let index = self.stage.eye_from_drawable.len() as u32;
        self.stage.eye_from_drawable.push(matrix_rows(eye_from_node));
        index
    }
}
