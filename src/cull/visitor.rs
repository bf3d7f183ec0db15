//! The cull traversal: a queue of pages, each scanned flat.

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec4};

use super::cameras::{CameraPlace, DeferredCamera, NestedCamera};
use super::fade::{Fade, FadeBand, LodFades};
use super::near_far::Candidate;
use super::occluders::{Collector, FrameOccluders, NO_OCCLUDERS, Occluders};
use super::planes::{Planes, depth_row};
use super::shadows::ShadowLight;
use super::sort::Sorter;
use super::stage::{CullCounters, RenderLeaf, RenderStage};
use super::state_graph::{ROOT, StateGraph};
use super::tiles::{MOST_PX, TileFrame, TileView};
use super::view::View;
use super::{CullCamera, Stereo};
use crate::scene::{
    CameraTarget, ClampProjection, ComputeNearFar, CullingMode, DrawHook, Environment, NONE, Page, Scene,
};
use crate::state::StateSet;

/// Why a page or tile is visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// To be drawn.
    Draw,
    /// Something above is drawn instead; what is wanted is requested and kept.
    Want,
    /// Outside the frustum, but its siblings can only replace the parent together with it.
    Keep,
}

/// Pages that wait for their visits: the contents of some tiles side by side, or a root of the scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    /// The tiles of the hanger's page up to `end`; of the world, the root's place in the scene's page table.
    pub first: u32,
    pub end: u32,
    /// Place of the frame that they hang in.
    pub hanger: u32,
    /// As in [`PageVisit`].
    pub state: u32,
    pub fade: Fade,
    pub mask: u8,
}

/// A frame in which pages hang, and why they are visited.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hanger {
    pub eye_from_frame: DAffine3,
    /// Place of the page with the tiles; `NONE` for the world.
    pub page: u32,
    /// Place of the view in the stage's.
    pub view: u32,
    /// As in [`PageVisit`]; plain content has no tiles that could be missing.
    pub purpose: Purpose,
    pub required: bool,
    pub shown_px: f32,
}

/// The visit of a page.
#[derive(Clone, Copy, Debug)]
pub(super) struct PageVisit {
    /// Place in the scene's page table.
    pub place: u32,
    pub eye_from_page: DAffine3,
    /// Planes that the page may cross.
    pub mask: u8,
    pub purpose: Purpose,
    /// The page's top tiles must be kept ready even where culled.
    pub required: bool,
    /// State under which the page hangs, in the state graph.
    pub state: u32,
    /// Place of the view in the stage's.
    pub view: u32,
    /// Error in pixels of what is shown while the page's top tiles are missing.
    pub shown_px: f32,
    pub fade: Fade,
}

/// The nearest and farthest depth met; NaN never enters.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthRange {
    pub near: f32,
    pub far: f32,
}

impl DepthRange {
    pub const EMPTY: Self = Self { near: f32::INFINITY, far: f32::NEG_INFINITY };
}

/// What is constant during the visit of a page.
#[derive(Clone, Copy)]
pub(super) struct PageContext<'a> {
    pub page: &'a Page,
    /// Linear part of `eye_from_page` as rows.
    pub eye_rows: [DVec3; 3],
    /// The eye in the page's frame; only known where the page has LOD nodes.
    pub eye: DVec3,
    pub planes: Planes,
    /// Depth of a point relative to the page's origin.
    pub depth: Vec4,
    pub slots: &'a [crate::scene::DrawSlot],
    /// More than the boxes of drawables may count.
    pub looks_closer: bool,
    /// Some drawables are culled by their normal cones.
    pub has_clusters: bool,
    /// Near and far are those of primitives.
    pub by_primitives: bool,
    pub visit: PageVisit,
}

/// Culls scenes; owns the memory that is reused from frame to frame. One per thread that culls.
#[derive(Debug, Default)]
pub struct CullVisitor {
    pub(super) queue: Vec<Waiting>,
    pub(super) hangers: Vec<Hanger>,
    pub(super) node_stack: Vec<super::nodes::Open>,
    pub(super) tile_stack: Vec<TileFrame>,
    /// Place in the stage of each chain of the current page that has leaves, or `NONE`.
    pub(super) memo: Vec<u32>,
    /// State of each chain that others start from, in the state graph, or `NONE`.
    pub(super) chains: Vec<u32>,
    pub(super) graph: StateGraph,
    pub(super) leaves: Vec<RenderLeaf>,
    views: Vec<View>,
    candidates: Vec<Candidate>,
    pub(super) deferred: Vec<DeferredCamera>,
    pub(super) nested: Vec<NestedCamera>,
    occluders: Occluders,
    page_occluders: FrameOccluders,
    tile_occluders: FrameOccluders,
    pub(super) sorter: Sorter,
    /// Of the eyes.
    fades: [LodFades; 2],
    /// The eye that is culled for.
    eye: usize,
    visits_all: bool,
    /// Only the pages that hang at the scene's root are visited.
    walks_only: bool,
    /// What it finds is not drawn in the frame it is of.
    only_looks: bool,
    /// x, y, width and height of the picture in its target; `None`: all of it.
    pub viewport_px: Option<[u32; 4]>,
    /// Of the eye that is culled for, where it has a picture of its own.
    eye_target: Option<Arc<CameraTarget>>,
    /// Changes near and far of the outermost stage when its settings have them computed.
    pub clamp_projection: Option<ClampProjection>,
    /// What is called while the outermost stage is drawn.
    pub callbacks: Option<DrawHook>,
    /// State above all roots; OSG's state set of a camera.
    pub state_set: Option<Arc<StateSet>>,
    /// Light and air of the picture: where the sun is, and which shadows it throws. Without one there are shadows only
    /// where cameras in the graph have an environment of their own.
    pub environment: Option<Environment>,
    /// Cameras in the graph that may still have shadows in this cull.
    pub(super) shadowed_cameras: u32,
}

/// A cull under way.
pub(super) struct Cull<'a> {
    pub scene: &'a Scene,
    pub camera: &'a CullCamera,
    pub stage: &'a mut RenderStage,
    pub queue: &'a mut Vec<Waiting>,
    pub hangers: &'a mut Vec<Hanger>,
    pub node_stack: &'a mut Vec<super::nodes::Open>,
    pub tile_stack: &'a mut Vec<TileFrame>,
    pub memo: &'a mut Vec<u32>,
    pub chains: &'a mut Vec<u32>,
    pub graph: &'a mut StateGraph,
    /// State of the roots, in the state graph.
    pub root_state: u32,
    pub leaves: &'a mut Vec<RenderLeaf>,
    /// The stage's views; the current one is a copy.
    pub views: &'a mut Vec<View>,
    pub view: View,
    /// Drawables whose primitives are to be looked at.
    pub candidates: &'a mut Vec<Candidate>,
    pub deferred: &'a mut Vec<DeferredCamera>,
    pub nested: &'a mut Vec<NestedCamera>,
    /// Of the stage's own view.
    pub stage_occluders: &'a Occluders,
    /// Of the current view.
    pub occluders: &'a Occluders,
    pub page_occluders: &'a mut FrameOccluders,
    pub tile_occluders: &'a mut FrameOccluders,
    pub fades: &'a mut LodFades,
    /// Of a Lod of the current page that fades around what is visited.
    pub band: FadeBand,
    pub range: DepthRange,
    /// The last linear part of the current page that was multiplied, and the product as rows.
    pub linear_rows: (u32, [Vec4; 3]),
    /// The last frame with tile trees of the current page.
    pub tile_view: Option<TileView>,
    pub counters: CullCounters,
    /// Subtrees are taken as ranges where they are wholly inside, unless small features or occluders are looked for.
    pub takes_ranges: bool,
    /// What is found is not drawn.
    pub only_looks: bool,
    /// Pages of the queue that are visited.
    pub most_pages: usize,
}

impl CullVisitor {
    /// A visitor without memory; the first culls make it.
    pub fn new() -> Self {
        Self::default()
    }

    /// A visitor that visits the nodes of subtrees that are wholly inside too, so that its counters can be compared
    /// with another engine's.
    #[doc(hidden)]
    pub fn visiting_all() -> Self {
        Self { visits_all: true, ..Self::default() }
    }

    /// A visitor for looking at what a frame would want: it asks no occlusion queries, nobody would answer them, and
    /// draws what they might hide.
    pub(crate) fn looking() -> Self {
        Self { only_looks: true, ..Self::default() }
    }

    /// A visitor that leaves out what tiles draw, so that the walk of a tile tree can be timed by itself.
    #[doc(hidden)]
    pub fn walking_tiles() -> Self {
        Self { walks_only: true, ..Self::default() }
    }

    /// Culls a scene for a camera: clears and refills the stage, and makes the stages of the cameras met. Allocates
    /// nothing once the visitor and the stage have seen as much before.
    pub fn cull(&mut self, scene: &Scene, camera: &CullCamera, stage: &mut RenderStage) {
        let _span = crate::timeline::span("cull");
        self.traverse(scene, camera, stage);
        self.sort(stage);
        let environment = self.environment;
        self.shadowed_cameras = camera.settings.shadowed_cameras;
        let nested = std::mem::take(&mut self.nested);
        if let Some((environment, shadows)) = environment.and_then(|e| Some((e, e.shadows?))) {
            self.cull_stage_shadows(scene, camera, &ShadowLight::new(&environment, shadows), None, stage);
        }
        self.cull_nested_shadows(scene, environment.as_ref(), nested, stage);
        if !self.deferred.is_empty() {
            self.cull_deferred(scene, camera, environment.as_ref(), stage, 0, 0);
        }
    }

    /// Culls a scene for the two eyes of a camera, each into a stage of its own with a target.
    pub fn cull_stereo(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        stereo: &Stereo,
        targets: &[Arc<CameraTarget>; 2],
        stage: &mut RenderStage,
    ) {
        stage.clear(camera);
        stage.bins.clear();
        stage.state_sets.clear();
        stage.target.viewport_px = self.viewport_px;
        stage.stereo = Some(stereo.mode);
        stage.stereo_gap_px = stereo.separation_px;
        stage.counters = CullCounters::default();
        (stage.near_m, stage.far_m) = (f64::INFINITY, 0.0);
        for (place, (eye, target)) in stereo.eyes(camera).iter().zip(targets).enumerate() {
            let mut of_eye = stage.spare.stages.pop().unwrap_or_default();
            (self.eye, self.eye_target) = (place, Some(target.clone()));
            self.cull(scene, eye, &mut of_eye);
            (self.eye, self.eye_target) = (0, None);
            stage.requests.append(&mut of_eye.requests);
            stage.counters.add(&of_eye.counters);
            stage.near_m = stage.near_m.min(of_eye.near_m);
            stage.far_m = stage.far_m.max(of_eye.far_m);
            stage.pre_render.push(of_eye);
        }
    }

    /// The first half of [`Self::cull`]: everything but the bins, and the cameras in the graph. For benches that time
    /// the two apart.
    #[doc(hidden)]
    pub fn traverse(&mut self, scene: &Scene, camera: &CullCamera, stage: &mut RenderStage) {
        let _span = crate::timeline::span("traverse");
        self.graph.start_frame();
        self.fades[self.eye].start(camera.simulation_time_s);
        self.deferred.clear();
        let view = View { clamp_projection: self.clamp_projection, ..View::new(camera) };
        self.traverse_stage(scene, camera, view, None, stage);
        stage.target.callbacks = self.callbacks.clone();
        stage.target.camera = self.eye_target.clone();
        stage.target.viewport_px = self.viewport_px.filter(|_| self.eye_target.is_none());
    }

    /// The second half of [`Self::cull`].
    #[doc(hidden)]
    pub fn sort(&mut self, stage: &mut RenderStage) {
        let _span = crate::timeline::span("sort");
        self.sorter.fill_bins(&mut self.leaves, stage);
    }

    pub(super) fn traverse_stage(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        view: View,
        met: Option<&CameraPlace>,
        stage: &mut RenderStage,
    ) {
        stage.clear(camera);
        stage.clamp_projection = view.clamp_projection;
        self.graph.start_stage();
        self.leaves.clear();
        self.queue.clear();
        self.hangers.clear();
        self.views.clear();
        self.views.push(view);
        self.candidates.clear();
        self.nested.clear();
        self.occluders.clear();
        if view.settings.culling.contains(CullingMode::SHADOW_OCCLUSION) {
            let fades = &self.fades[self.eye];
            let below = met.filter(|met| !met.shows_scene);
            self.occluders.collect(&Collector { scene, view: &view, camera: below, fades, frame: camera.frame });
        }
        let root_state = self.state_set.as_ref().map_or(ROOT, |set| self.graph.find_or_insert(ROOT, set));
        let mut cull = Cull {
            scene,
            camera,
            stage,
            queue: &mut self.queue,
            hangers: &mut self.hangers,
            node_stack: &mut self.node_stack,
            tile_stack: &mut self.tile_stack,
            memo: &mut self.memo,
            chains: &mut self.chains,
            graph: &mut self.graph,
            root_state,
            leaves: &mut self.leaves,
            views: &mut self.views,
            view,
            candidates: &mut self.candidates,
            deferred: &mut self.deferred,
            nested: &mut self.nested,
            stage_occluders: &self.occluders,
            occluders: &self.occluders,
            page_occluders: &mut self.page_occluders,
            tile_occluders: &mut self.tile_occluders,
            fades: &mut self.fades[self.eye],
            band: FadeBand::FULL,
            range: DepthRange::EMPTY,
            linear_rows: (NONE, [Vec4::ZERO; 3]),
            tile_view: None,
            counters: CullCounters::default(),
            takes_ranges: !self.visits_all && self.occluders.is_empty(),
            only_looks: self.only_looks,
            most_pages: if self.walks_only { scene.roots().len() } else { usize::MAX },
        };
        cull.run(met);
    }
}

impl<'a> Cull<'a> {
    fn run(&mut self, met: Option<&CameraPlace>) {
        match met {
            None => self.queue_roots(self.root_state),
            Some(met) => {
                if met.shows_scene {
                    let state = self.graph.find_or_insert_view(met.state, 0);
                    self.queue_roots(state);
                }
                self.visit_camera(met);
            }
        }
        let mut next = 0;
        while let Some(waiting) = self.queue.get(next).copied().filter(|_| next < self.most_pages) {
            next += 1;
            self.visit_waiting(&waiting);
        }
        self.stage.state_sets.truncate(self.stage.view_of_state.len());
        self.counters.wanted_missing = self.stage.requests.len() as u32;
        self.counters.leaves = self.leaves.len() as u32;
        self.stage.counters = self.counters;
        self.fit_views();
    }

    /// Goes over to another view of the stage, with what was found in it so far; the one before.
    pub(super) fn enter_view(&mut self, view: u32) -> u32 {
        let before = self.view.index;
        self.views[before as usize].range = self.range;
        self.view = self.views[view as usize];
        self.range = self.view.range;
        // Those of other views are not looked for.
        self.occluders = if view == 0 { self.stage_occluders } else { &NO_OCCLUDERS };
        before
    }

    /// Near and far of each view, from all that was met in it.
    fn fit_views(&mut self) {
        self.views[self.view.index as usize].range = self.range;
        self.look_at_primitives();
        for (index, view) in self.stage.views.iter().enumerate().rev() {
            if view.is_of_above {
                let found = self.views[index + 1].range;
                let above = &mut self.views[view.above as usize].range;
                *above = DepthRange { near: above.near.min(found.near), far: above.far.max(found.far) };
            }
        }
        let [own, nested @ ..] = &self.views[..] else { return };
        [self.stage.near_m, self.stage.far_m] = own.depths_m();
        for (view, found) in self.stage.views.iter_mut().zip(nested) {
            (view.clip_from_eye, view.range_m) = (found.clamped(), found.depths_m());
        }
        self.stage.set_projection(own.clamped());
    }

    /// The scene's roots are to be visited in the current view, under a state.
    pub(super) fn queue_roots(&mut self, state: u32) {
        let hanger = self.hangers.len() as u32;
        self.hangers.push(Hanger {
            eye_from_frame: self.view.eye_from_world,
            page: NONE,
            view: self.view.index,
            purpose: Purpose::Draw,
            required: false,
            shown_px: MOST_PX,
        });
        let mask = self.view.planes.mask;
        for root in self.scene.roots() {
            let fade = Fade::NONE;
            self.queue.push(Waiting { first: root.slot, end: root.slot + 1, hanger, state, fade, mask });
        }
    }

    /// Forgets what was known of the page before.
    pub(super) fn open_page(&mut self, page: &Page, state: u32) {
        self.tile_view = None;
        self.band = FadeBand::FULL;
        self.memo.clear();
        self.memo.resize(page.state_paths().len(), NONE);
        self.chains.clear();
        self.chains.resize(page.state_paths().len(), NONE);
        if let Some(root) = self.chains.first_mut() {
            *root = state;
        }
        self.linear_rows.0 = NONE;
    }

    fn visit_waiting(&mut self, waiting: &Waiting) {
        let &Waiting { first, end, hanger, state, fade, mask } = waiting;
        let Hanger { eye_from_frame, page: holder, view, purpose, required, shown_px } = self.hangers[hanger as usize];
        if view != self.view.index {
            self.enter_view(view);
        }
        let takes_lone = purpose == Purpose::Draw && self.takes_ranges && self.takes_whole_nodes();
        let holder = self.scene.page_at(holder);
        for at in first..end {
            let (place, eye_from_page) = match holder {
                Some(holder) => {
                    let place = holder.tiles().resident(at as usize);
                    (place, eye_from_frame * holder.tiles().content_transform(at as usize))
                }
                None => (at, eye_from_frame),
            };
            if takes_lone && let Some(lone) = self.scene.single_drawable_at(place, self.camera.context) {
                self.take_lone(lone, &eye_from_page, state, mask);
                continue;
            }
            self.visit_page(PageVisit { place, eye_from_page, mask, purpose, required, state, view, shown_px, fade });
        }
    }

    fn visit_page(&mut self, visit: PageVisit) {
        let (scene, place) = (self.scene, visit.place);
        let Some(page) = scene.page_at(place) else { return };
        self.open_page(page, visit.state);
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

    /// Nothing but the frustum hides a plain node.
    fn takes_whole_nodes(&self) -> bool {
        let settings = &self.view.settings;
        self.view.small_feature == 0.0
            && settings.cull_mask != 0
            && settings.compute_near_far != ComputeNearFar::Primitives
    }

    /// What a page's scan needs to know.
    pub(super) fn page_context<'p>(&mut self, page: &'p Page, visit: PageVisit) -> PageContext<'p> {
        self.frame_occluders(&visit.eye_from_page, page.origin());
        let settings = &self.view.settings;
        let has_clusters = !page.normal_cones().is_empty() && settings.culling.contains(CullingMode::CLUSTER);
        let by_primitives = settings.compute_near_far == ComputeNearFar::Primitives;
        PageContext {
            page,
            eye_rows: [0, 1, 2].map(|row| visit.eye_from_page.matrix3.row(row)),
            eye: if page.needs_eye() { eye_in(&visit.eye_from_page) } else { DVec3::ZERO },
            planes: if visit.mask == 0 {
                Planes::UNUSED
            } else {
                self.view.planes.in_frame(&visit.eye_from_page, page.origin())
            },
            depth: depth_row(&visit.eye_from_page, page.origin(), self.view.depth_axis),
            slots: page.draw_slots_of(self.camera.context),
            looks_closer: has_clusters || by_primitives || !self.occluders.is_empty(),
            has_clusters,
            by_primitives,
            visit,
        }
    }

    /// Moves the occluders into the frame of a page.
    pub(super) fn frame_occluders(&mut self, eye_from_page: &DAffine3, origin: DVec3) {
        if !self.occluders.is_empty() {
            self.occluders.in_frame(eye_from_page, origin, self.page_occluders);
        }
    }

    /// Stores a matrix and returns its index.
    pub(super) fn push_matrix(&mut self, eye_from_node: &DAffine3) -> u32 {
        let index = self.stage.eye_from_drawable.len() as u32;
        self.stage.eye_from_drawable.push(rows(eye_from_node));
        index
    }
}

/// Rows of an affine map as f32.
pub(super) fn rows(map: &DAffine3) -> [[f32; 4]; 3] {
    let (m, t) = (&map.matrix3, map.translation);
    let row = |x: f64, y: f64, z: f64, w: f64| [x as f32, y as f32, z as f32, w as f32];
    [
        row(m.x_axis.x, m.y_axis.x, m.z_axis.x, t.x),
        row(m.x_axis.y, m.y_axis.y, m.z_axis.y, t.y),
        row(m.x_axis.z, m.y_axis.z, m.z_axis.z, t.z),
    ]
}

/// The eye in the frame of `eye_from_frame`.
pub(super) fn eye_in(eye_from_frame: &DAffine3) -> DVec3 {
    let eye = eye_from_frame.inverse().translation;
    if eye.is_finite() { eye } else { DVec3::ZERO }
}
