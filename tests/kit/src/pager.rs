//! A scene that is culled and paged frame by frame without a GPU, with a context that uploads at once.

use std::time::{Duration, Instant};

use glam::{DAffine3, DMat3, DVec3};
use terrane::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use terrane::fetch::{Limits, root_uri};
use terrane::formats::ReadOptions;
use terrane::gpu::{CompileBudget, CompileOperation, Compiled};
use terrane::math::WGS84;
use terrane::pager::{CompileContext, DatabasePager, PagerConfig};
use terrane::scene::{BlockFormats, DrawSlot, Drawable, Geometry, Page, Scene, TexelFormat};

/// GPU bytes that the context reports for each page.
pub const PAGE_GPU_BYTES: u64 = 1000;

/// A context that uploads nothing: operations complete at once, and slots in use are counted.
#[derive(Default)]
pub struct Context {
    done: Vec<Compiled>,
    /// The number of slots that were handed out and not released.
    pub slots_out: u64,
    /// The number of operations that the pager has cancelled.
    pub cancelled: usize,
    /// Reports a byte per vertex of a page's meshes instead of [`PAGE_GPU_BYTES`].
    pub counts_vertices: bool,
    /// Withholds completed operations.
    pub holds: bool,
    /// Completes operations only in `run_compiles` with a time budget.
    pub waits: bool,
    waiting: Vec<Compiled>,
    /// The bytes that the context claims to have allocated beyond its slots in use.
    pub unused_bytes: u64,
    /// The budget that the pager has announced.
    pub max_bytes: Option<u64>,
    /// The compressed formats that the context claims to sample.
    pub block_formats: BlockFormats,
    /// The formats of the textures of base colours that were uploaded, in order.
    pub texture_formats: Vec<TexelFormat>,
}

impl CompileContext for Context {
    fn id(&self) -> u32 {
        0
    }

    fn block_formats(&self) -> BlockFormats {
        self.block_formats
    }

    fn set_max_bytes(&mut self, max_bytes: u64) {
        self.max_bytes = Some(max_bytes);
    }

    fn compile(&mut self, operation: CompileOperation) {
        let textures = operation.drawables.iter().filter_map(|drawable| drawable.material.texture.as_ref());
        self.texture_formats.extend(textures.map(|texture| texture.format));
        let slots = vec![DrawSlot(0); operation.drawables.len()];
        self.slots_out += slots.len() as u64;
        let ticket = operation.ticket;
        let vertices = |drawable: &Drawable| match &drawable.geometry {
            Geometry::Mesh(mesh) => mesh.vertices.len() as u64,
            _ => 0,
        };
        let bytes = match self.counts_vertices {
            true => operation.drawables.iter().map(vertices).sum(),
            false => PAGE_GPU_BYTES,
        };
        let to = if self.waits { &mut self.waiting } else { &mut self.done };
        let unused_bytes = self.unused_bytes;
        to.push(Compiled { ticket, slots, bytes, shared: Vec::new(), errors: Vec::new(), unused_bytes });
    }

    fn cancel(&mut self, tickets: &[u64]) {
        self.cancelled += tickets.len();
    }

    fn run_compiles(&mut self, budget: &CompileBudget) {
        if !budget.time.is_zero() {
            self.done.append(&mut self.waiting);
        }
    }

    fn take_compiled(&mut self) -> Vec<Compiled> {
        if self.holds { Vec::new() } else { std::mem::take(&mut self.done) }
    }

    fn release(&mut self, slots: Vec<DrawSlot>) {
        self.slots_out -= slots.len() as u64;
    }
}

/// A tile set that is culled and paged frame by frame.
pub struct Run {
    /// The scene with the tile set.
    pub scene: Scene,
    /// The pager under test.
    pub pager: DatabasePager,
    /// The only context.
    pub context: Context,
    /// The result of the last cull.
    pub stage: RenderStage,
    /// The number of the last frame.
    pub frame: u32,
    /// Seconds of reference time from one frame to the next: 1/60 at first.
    pub frame_s: f64,
    /// The reference time of the last frame in seconds.
    pub time_s: f64,
    /// The number of bytes read for the root tileset.
    pub root_bytes: u64,
    /// The largest screen-space error of a drawn tile, in pixels.
    pub max_sse_px: f64,
    /// The camera looks at the middle of the earth instead.
    pub is_globe: bool,
    /// The earth hides what is behind its horizon, if the camera looks at it.
    pub has_horizon: bool,
    visitor: CullVisitor,
}

impl Run {
    /// Reads the root tileset of a folder or a URL.
    pub fn new(source: &str, config: PagerConfig) -> Self {
        let uri = root_uri(source).unwrap();
        let options = ReadOptions::for_root(&uri, config.limits);
        let mut pager = DatabasePager::new(config, options).unwrap();
        let root = pager.read_root(&uri).unwrap();
        Self::with(pager, root)
    }

    /// Starts from a page that the test has made. The contents are below a folder.
    pub fn of_page(root: Page, folder: &str, config: PagerConfig) -> Self {
        let options = ReadOptions::for_root(&root_uri(folder).unwrap(), Limits::default());
        Self::with(DatabasePager::new(config, options).unwrap(), root)
    }

    fn with(pager: DatabasePager, root: Page) -> Self {
        let mut scene = Scene::new();
        scene.add_root(root);
        let root_bytes = pager.stats().bytes_read;
        let (context, stage, visitor) = (Context::default(), RenderStage::new(), CullVisitor::new());
        let max_sse_px = CullCamera::default().settings.max_sse_px;
        Self {
            scene,
            pager,
            context,
            stage,
            frame: 0,
            frame_s: 1.0 / 60.0,
            time_s: 0.0,
            root_bytes,
            max_sse_px,
            is_globe: false,
            has_horizon: true,
            visitor,
        }
    }

    /// Culls and updates one frame of a camera that looks straight down from `eye`.
    pub fn frame(&mut self, eye: DVec3) {
        self.frame_with(eye, &[]);
    }

    /// Does the same as [`Self::frame`], with additional requests.
    pub fn frame_with(&mut self, eye: DVec3, others: &[PageRequest]) {
        self.cull(eye);
        self.update_with(others);
    }

    /// Updates the pager with the requests of the last cull and others.
    pub fn update_with(&mut self, others: &[PageRequest]) {
        let contexts: &mut [&mut dyn CompileContext] = &mut [&mut self.context];
        let requests = [&self.stage.requests, others].concat();
        self.pager.update_scene_graph(&mut self.scene, self.frame, self.time_s, &requests, contexts);
        self.check_counters();
    }

    /// Culls the next frame without an update of the pager.
    pub fn cull(&mut self, eye: DVec3) {
        self.frame += 1;
        self.time_s += self.frame_s;
        let eye_from_world = DAffine3::from_translation(-eye);
        let mut camera = CullCamera { eye_from_world, frame: self.frame, ..CullCamera::default() };
        if self.is_globe {
            let back = eye.normalize();
            let up = back.any_orthonormal_vector();
            let matrix3 = DMat3::from_cols(up.cross(back), up, back);
            camera.eye_from_world = DAffine3 { matrix3, translation: eye }.inverse();
            camera.horizon = self.has_horizon.then_some(WGS84);
        }
        camera.settings.max_sse_px = self.max_sse_px;
        self.visitor.cull(&self.scene, &camera, &mut self.stage);
    }

    /// Checks that each request has ended in exactly one way or is in flight, and that each failure is reported.
    pub fn check_counters(&self) {
        let s = self.pager.stats();
        let ended = s.merged + s.failed + s.cancelled + s.stale + s.declined + s.dropped;
        assert_eq!(s.requested + s.retried, ended + s.waiting + s.in_flight, "{s:?}");
        assert_eq!(s.merged, s.expired + s.resident, "{s:?}");
        let reported: u64 = self.pager.errors().iter().map(|e| e.count).sum();
        assert_eq!(reported, s.failed + s.drawables_failed, "{s:?}");
    }

    /// Runs frames until `done` returns true; panics with `what` after [`MAX_WAIT`](crate::MAX_WAIT).
    pub fn until(&mut self, eye: DVec3, what: &str, done: impl Fn(&Self) -> bool) {
        let end = Instant::now() + crate::MAX_WAIT;
        while !done(self) {
            assert!(Instant::now() < end, "{what}: {:?} {:?}", self.pager.stats(), self.pager.errors());
            self.frame(eye);
            std::thread::sleep(Duration::from_micros(200));
        }
    }

    /// Loads and merges all requested pages, for at most [`MAX_WAIT`](crate::MAX_WAIT).
    pub fn work_until_idle(&mut self) {
        let contexts: &mut [&mut dyn CompileContext] = &mut [&mut self.context];
        self.pager.work_until(&mut self.scene, contexts, Instant::now() + crate::MAX_WAIT);
    }

    /// Runs frames until nothing is requested or in flight, and one more.
    pub fn settle(&mut self, eye: DVec3) {
        self.frame(eye);
        self.until(eye, "does not settle", |r| r.pager.is_idle() && r.stage.requests.is_empty());
        self.frame(eye);
    }
}

/// Returns the point above the origin.
pub fn above(height_m: f64) -> DVec3 {
    DVec3::new(0.0, 0.0, height_m)
}
