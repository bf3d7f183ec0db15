//! What the pager's tests share: a context that compiles at once, and a scene that is culled and paged frame by frame.
//! No GPU.
#![allow(clippy::unwrap_used, reason = "test code")]
#![allow(dead_code, reason = "each test program uses a part of it")]

use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::gpu::{CompileBudget, CompileOperation, Compiled};
use terrane::io::{Limits, ReadOptions, root_uri};
use terrane::pager::{CompileContext, DatabasePager, PagerConfig};
use terrane::scene::{DrawSlot, Scene};

/// Bytes that the context says a page takes.
pub const PAGE_GPU_BYTES: u64 = 1000;

/// Compiles at once, and counts the slots that are out.
#[derive(Default)]
pub struct Context {
    done: Vec<Compiled>,
    pub slots_out: u64,
}

impl CompileContext for Context {
    fn id(&self) -> u32 {
        0
    }

    fn compile(&mut self, operation: CompileOperation) {
        let slots = vec![DrawSlot(0); operation.drawables.len()];
        self.slots_out += slots.len() as u64;
        let ticket = operation.ticket;
        self.done.push(Compiled { ticket, slots, bytes: PAGE_GPU_BYTES, shared: Vec::new(), errors: Vec::new() });
    }

    fn run_compiles(&mut self, _: &CompileBudget) {}

    fn take_compiled(&mut self) -> Vec<Compiled> {
        std::mem::take(&mut self.done)
    }

    fn release(&mut self, slots: Vec<DrawSlot>) {
        self.slots_out -= slots.len() as u64;
    }
}

/// A tile set under way.
pub struct Run {
    pub scene: Scene,
    pub pager: DatabasePager,
    pub context: Context,
    pub stage: RenderStage,
    pub frame: u32,
    /// Bytes of the root tileset.
    pub root_bytes: u64,
    /// How coarse tiles may look.
    pub max_sse_px: f64,
    visitor: CullVisitor,
}

impl Run {
    /// Reads the root of a folder or a URL.
    pub fn new(source: &str, config: PagerConfig) -> Self {
        let uri = root_uri(source).unwrap();
        let mut pager = DatabasePager::new(config, ReadOptions::for_root(&uri, Limits::default())).unwrap();
        let mut scene = Scene::new();
        scene.add_root(pager.read_root(&uri).unwrap());
        let root_bytes = pager.stats().bytes_read;
        let (context, stage, visitor) = (Context::default(), RenderStage::new(), CullVisitor::new());
        let max_sse_px = CullCamera::default().settings.max_sse_px;
        Self { scene, pager, context, stage, frame: 0, root_bytes, max_sse_px, visitor }
    }

    /// A frame that looks straight down.
    pub fn frame(&mut self, eye: DVec3) {
        self.frame += 1;
        let eye_from_world = DAffine3::from_translation(-eye);
        let mut camera = CullCamera { eye_from_world, frame: self.frame, ..CullCamera::default() };
        camera.settings.max_sse_px = self.max_sse_px;
        self.visitor.cull(&self.scene, &camera, &mut self.stage);
        let contexts: &mut [&mut dyn CompileContext] = &mut [&mut self.context];
        self.pager.update_scene_graph(&mut self.scene, self.frame, &self.stage.requests, contexts);
    }

    /// Frames until something holds, for a minute at most.
    pub fn until(&mut self, eye: DVec3, what: &str, done: impl Fn(&Self) -> bool) {
        let end = Instant::now() + Duration::from_secs(60);
        while !done(self) {
            assert!(Instant::now() < end, "{what}: {:?} {:?}", self.pager.stats(), self.pager.errors());
            self.frame(eye);
            std::thread::sleep(Duration::from_micros(200));
        }
    }

    /// Frames until nothing is wanted and nothing under way, and one more.
    pub fn settle(&mut self, eye: DVec3) {
        self.frame(eye);
        self.until(eye, "does not settle", |r| r.pager.is_idle() && r.stage.requests.is_empty());
        self.frame(eye);
    }
}

/// Above the origin.
pub fn above(height_m: f64) -> DVec3 {
    DVec3::new(0.0, 0.0, height_m)
}
