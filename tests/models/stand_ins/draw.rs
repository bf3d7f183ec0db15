//! A renderer that takes some turns for each image.

use std::sync::atomic::Ordering;

use image::RgbaImage;
use shuttle::thread;
pub use terrane::draw::{DrawStats, FrameClock, ViewChange};
use terrane::scene::{DrawKind, Environment, Texture};
use terrane::state::{DataVariance, OpaqueDrawData, TextureObject};

use super::cull::RenderStage;
use super::gpu::{GpuError, GraphicsContext};
use super::{Panics, Reads};
use crate::schedules::thread::panic_on_purpose;

/// The number of turns of other threads while an image is drawn.
const TURNS: usize = 3;
/// The same if a thread panics: enough to release its data and to be noticed.
const TURNS_BESIDE_A_PANIC: usize = 100;

pub struct CameraCallbacks;

impl CameraCallbacks {
    /// The hooks of a model are all dynamic.
    pub fn variance_of(hook: &Option<OpaqueDrawData>) -> DataVariance {
        hook.as_ref().map_or(DataVariance::Static, |_| DataVariance::Dynamic)
    }
}

pub struct BinCallback;

impl BinCallback {
    pub fn are_dynamic(_stage: &RenderStage) -> bool {
        false
    }
}

pub struct CameraView<'a> {
    pub stage: &'a RenderStage,
    pub environment: &'a Environment,
}

pub struct StageKinds;

pub struct Renderer {
    /// The context and the frame.
    pub timed: (u32, u32),
    pub clock: FrameClock,
    pub hides_unready: bool,
}

impl Renderer {
    pub fn new(_context: &mut GraphicsContext) -> Self {
        Self { timed: (0, 0), clock: FrameClock::default(), hides_unready: false }
    }

    pub fn draw_views<'a>(
        &mut self,
        context: &mut GraphicsContext,
        views: impl IntoIterator<Item = CameraView<'a>>,
    ) -> Result<DrawStats, GpuError> {
        let ((_, frame), seen) = (self.timed, &context.seen);
        for CameraView { stage, .. } in views {
            assert_eq!(stage.camera.frame, frame, "the stage of this frame");
            let camera = stage.camera.context;
            seen.draws(camera, frame);
            let is_beside_a_panic = matches!(seen.panics, Panics::InDraw { camera: of, .. } if of != camera);
            for _ in 0..if is_beside_a_panic { TURNS_BESIDE_A_PANIC } else { TURNS } {
                thread::yield_now();
                if seen.reads != Reads::Nothing {
                    assert_eq!(seen.changed.load(Ordering::SeqCst), frame, "data that update has changed meanwhile");
                }
            }
            if seen.panics == (Panics::InDraw { camera, frame }) {
                panic_on_purpose();
            }
            seen.has_drawn(camera, frame);
        }
        context.frame = frame;
        Ok(DrawStats::default())
    }

    pub fn stage_kinds(&mut self, _context: &GraphicsContext) -> StageKinds {
        StageKinds
    }

    pub fn prewarm(&mut self, _context: &mut GraphicsContext, _kinds: &[DrawKind]) -> u32 {
        0
    }

    pub fn order_prewarm(&mut self, _context: &mut GraphicsContext, _kinds: &[DrawKind], _stages: &StageKinds) -> u32 {
        0
    }

    pub fn pipelines_in_creation(&self) -> u32 {
        0
    }

    pub fn rehearse_next(&mut self, _stage: RenderStage, _environment: Environment) {}

    pub fn take_rehearsed(&mut self) -> Option<u32> {
        None
    }

    pub fn prewarm_for(&mut self, _context: &mut GraphicsContext, _kinds: &[DrawKind], _stages: &StageKinds) -> u32 {
        0
    }

    pub fn create_pipelines(
        &mut self,
        _context: &mut GraphicsContext,
        _kinds: &[DrawKind],
        _stages: &StageKinds,
    ) -> u32 {
        0
    }

    pub fn announce_textures(&mut self, _context: &mut GraphicsContext, _kinds: &[DrawKind]) {}

    pub fn prewarm_change(&mut self, _context: &mut GraphicsContext, _change: &ViewChange) {}

    pub fn show_image(
        &mut self,
        _context: &GraphicsContext,
        _texture: &TextureObject,
        _image: &Texture,
    ) -> Result<(), String> {
        Ok(())
    }

    pub fn read_back(&mut self, _context: &mut GraphicsContext) -> Result<RgbaImage, GpuError> {
        Ok(RgbaImage::new(1, 1))
    }

    pub fn report_once(&mut self, problem: String) {
        panic!("{problem}");
    }

    pub fn take_errors(&mut self) -> Vec<String> {
        Vec::new()
    }
}
