//! The cull traversal: a queue of pages, each scanned flat.

use glam::{DAffine3, DVec3, Vec4};

use super::planes::{EyePlanes, Planes, depth_row};
use super::sort::Sorter;
use super::stage::{CullCounters, RenderLeaf, RenderStage};
use super::state_graph::{ROOT, StateGraph};
use super::tiles::{TileFrame, TileView};
use super::{CullCamera, CullingMode, SMALL_FEATURE_PX};
use crate::scene::{BLEND, NONE, Page, Scene};

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

/// A page that waits for its visit.
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
    /// State under which the page hangs.
    pub state: u32,
    /// Squared error in pixels of what is shown while the page's top tiles are missing.
    pub shown_px2: f32,
}

/// The nearest and farthest depth met; NaN never enters.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthRange {
    pub near: f32,
    pub far: f32,
}

/// What is constant during the visit of a page.
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
    pub visit: PageVisit,
}

/// Culls scenes; owns the memory that is reused from frame to frame. One per thread that culls.
#[derive(Debug, Default)]
pub struct CullVisitor {
    pub(super) queue: Vec<PageVisit>,
    pub(super) node_stack: Vec<super::nodes::Open>,
    pub(super) tile_stack: Vec<TileFrame>,
    /// State of each chain of the current page that has leaves, or `NONE`.
    pub(super) memo: Vec<u32>,
    /// State of each chain that others start from, or `NONE`.
    pub(super) chains: Vec<u32>,
    pub(super) graph: StateGraph,
    pub(super) leaves: Vec<RenderLeaf>,
    sorter: Sorter,
    visits_all: bool,
}

/// A cull under way.
pub(super) struct Cull<'a> {
    pub scene: &'a Scene,
    pub camera: &'a CullCamera,
    pub eye_planes: EyePlanes,
    pub stage: &'a mut RenderStage,
    pub queue: &'a mut Vec<PageVisit>,
    pub node_stack: &'a mut Vec<super::nodes::Open>,
    pub tile_stack: &'a mut Vec<TileFrame>,
    pub memo: &'a mut Vec<u32>,
    pub chains: &'a mut Vec<u32>,
    pub graph: &'a mut StateGraph,
    pub leaves: &'a mut Vec<RenderLeaf>,
    pub range: DepthRange,
    /// The last linear part of the current page that was multiplied, and the product as rows.
    pub linear_rows: (u32, [[f32; 4]; 3]),
    /// The last frame with tile trees of the current page.
    pub tile_view: Option<TileView>,
    pub counters: CullCounters,
    /// Pixels at 1 m of distance per metre, over the error limit and the LOD scale: error times it = range.
    pub range_per_error: f32,
    pub range_per_metre: f32,
    pub max_sse_px: f32,
    /// Subtrees wholly inside are taken as ranges.
    pub shortcut: bool,
    /// Radius over depth below which a bound is too small; 0 when off.
    pub small_feature: f32,
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

    /// Culls a scene for a camera: clears and refills the stage. Allocates nothing once the visitor and the stage
    /// have seen as much before.
    pub fn cull(&mut self, scene: &Scene, camera: &CullCamera, stage: &mut RenderStage) {
        self.traverse(scene, camera, stage);
        self.sort(stage);
    }

    /// The first half of [`Self::cull`]: everything but the bins. For benches that time the two apart.
    #[doc(hidden)]
    pub fn traverse(&mut self, scene: &Scene, camera: &CullCamera, stage: &mut RenderStage) {
        stage.camera = *camera;
        stage.eye_from_drawable.clear();
        stage.requests.clear();
        self.graph.clear(&mut stage.state_sets);
        self.leaves.clear();
        self.queue.clear();
        let limit = camera.max_sse_px * camera.lod_scale;
        let small = if camera.culling.contains(CullingMode::SMALL_FEATURE) {
            0.5 * SMALL_FEATURE_PX / camera.px_per_radian()
        } else {
            0.0
        };
        let mut cull = Cull {
            scene,
            camera,
            eye_planes: EyePlanes::new(camera),
            stage,
            queue: &mut self.queue,
            node_stack: &mut self.node_stack,
            tile_stack: &mut self.tile_stack,
            memo: &mut self.memo,
            chains: &mut self.chains,
            graph: &mut self.graph,
            leaves: &mut self.leaves,
            range: DepthRange { near: f32::INFINITY, far: f32::NEG_INFINITY },
            linear_rows: (NONE, [[0.0; 4]; 3]),
            tile_view: None,
            counters: CullCounters::default(),
            range_per_error: (camera.px_per_radian() / limit) as f32,
            range_per_metre: (1.0 / camera.lod_scale) as f32,
            max_sse_px: camera.max_sse_px as f32,
            shortcut: !self.visits_all && small == 0.0,
            small_feature: small as f32,
        };
        cull.run();
    }

    /// The second half of [`Self::cull`].
    #[doc(hidden)]
    pub fn sort(&mut self, stage: &mut RenderStage) {
        self.sorter.fill_bins(&mut self.leaves, self.graph.met(), stage);
    }
}

impl Cull<'_> {
    fn run(&mut self) {
        for root in self.scene.roots() {
            self.queue.push(PageVisit {
                place: root.slot,
                eye_from_page: self.camera.eye_from_world,
                mask: self.eye_planes.mask,
                purpose: Purpose::Draw,
                required: false,
                state: ROOT,
                shown_px2: f32::MAX,
            });
        }
        let mut next = 0;
        while let Some(visit) = self.queue.get(next).copied() {
            next += 1;
            self.visit_page(visit);
        }
        super::tiles::finish_requests(&mut self.stage.requests);
        self.counters.leaves = self.leaves.len() as u32;
        self.stage.counters = self.counters;
        let DepthRange { near, far } = self.range;
        let (near, far) = if near <= far { (near.max(0.0), far.max(0.0)) } else { (0.0, 0.0) };
        (self.stage.near_m, self.stage.far_m) = (f64::from(near), f64::from(far));
    }

    fn visit_page(&mut self, visit: PageVisit) {
        let scene = self.scene;
        let Some(page) = scene.page_at(visit.place) else { return };
        self.tile_view = None;
        self.memo.clear();
        self.memo.resize(page.paths.len(), NONE);
        self.chains.clear();
        self.chains.resize(page.paths.len(), NONE);
        if let Some(root) = self.chains.first_mut() {
            *root = visit.state;
        }
        if visit.purpose != Purpose::Draw {
            for root in 0..page.tiles.roots.len() {
                self.scan_tiles(page, &visit, root, visit.mask, visit.purpose);
            }
            return;
        }
        self.linear_rows.0 = NONE;
        let context = PageContext {
            page,
            eye_rows: [0, 1, 2].map(|row| visit.eye_from_page.matrix3.row(row)),
            eye: if page.lods.is_empty() { DVec3::ZERO } else { eye_in(&visit.eye_from_page) },
            planes: if visit.mask == 0 {
                Planes::UNUSED
            } else {
                self.eye_planes.in_frame(&visit.eye_from_page, page.origin)
            },
            depth: depth_row(&visit.eye_from_page, page.origin),
            slots: page.draw_slots_of(self.camera.context),
            visit,
        };
        let matrix = if page.uses_page_frame { self.push_matrix(&visit.eye_from_page) } else { 0 };
        let last = page.node_count() as u32;
        self.scan_nodes(&context, 0, last, visit.mask, matrix);
    }

    /// Stores a matrix and returns its index.
    pub(super) fn push_matrix(&mut self, eye_from_node: &DAffine3) -> u32 {
        let index = self.stage.eye_from_drawable.len() as u32;
        self.stage.eye_from_drawable.push(rows(eye_from_node));
        index
    }

    /// The state of the leaves of one of the page's chains.
    #[inline(always)]
    pub(super) fn state_of(&mut self, page: &Page, path: u32) -> u32 {
        match self.memo.get(path as usize) {
            Some(&state) if state != NONE => state,
            _ => self.meet_state(page, path),
        }
    }

    #[cold]
    fn meet_state(&mut self, page: &Page, path: u32) -> u32 {
        let state = self.chain_state(page, path);
        self.graph.meet(state);
        if let Some(known) = self.memo.get_mut(path as usize) {
            *known = state;
        }
        state
    }

    /// The state below one of the page's chains, whether or not it has leaves.
    pub(super) fn chain_state(&mut self, page: &Page, path: u32) -> u32 {
        // Up to the first chain that is known, one step down, again; chains are as deep as the graph at most.
        loop {
            let mut at = path;
            let mut above = None;
            let state = loop {
                match (self.chains.get(at as usize), page.paths.get(at as usize)) {
                    (Some(&state), _) if state != NONE => break state,
                    (_, Some(link)) => (above, at) = (Some(at), link.parent),
                    _ => break ROOT,
                }
            };
            let Some(next) = above else { return state };
            let set = page.paths[next as usize].set;
            let resolved = &mut self.stage.state_sets;
            let below = match page.state_sets.get(set as usize) {
                _ if set == BLEND => self.graph.find_or_insert_blend(state, resolved),
                Some(set) => self.graph.find_or_insert(state, set, resolved),
                None => state,
            };
            self.chains[next as usize] = below;
        }
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
