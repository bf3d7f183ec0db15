//! The main thread's side: the frame as `src/viewer/frame/` runs it, around the library's own rendering stage.

#[path = "../../src/viewer/rendering/mod.rs"]
mod rendering;

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use glam::DMat4;
use rendering::{CullTask, FRAMES_IN_FLIGHT, FrameJob, Lens, Rendering, Sight};
pub use terrane::viewer::Camera;

pub use rendering::ThreadingModel;

use crate::cull::CullCamera;
use crate::gpu::{ContextTraits, GpuError, GraphicsContext};
use crate::scene::Environment;
use crate::stand_ins::{Reads, Scene, Seen};
use crate::state::OpaqueDrawData;

pub mod ids {
    #[derive(Clone, Copy, Debug)]
    pub struct ContextId(pub u32);
}

#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    #[error(transparent)]
    Gpu(#[from] GpuError),
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    #[error("{0}")]
    Setting(String),
    #[error("no context {0:?}")]
    NoContext(ids::ContextId),
    #[error("the draw thread has stopped")]
    DrawThreadStopped,
}

/// A stand-in that paints nothing over an image.
pub mod overlay {
    use crate::gpu::{Device, Handle};

    pub struct OverlayPaint;

    pub struct OverlayPainter;

    impl OverlayPainter {
        pub fn of<'a>(
            painters: &'a mut Vec<Self>,
            _paint: &OverlayPaint,
            _device: &Device,
            _format: Handle,
        ) -> &'a mut Self {
            painters.push(Self);
            painters.last_mut().unwrap()
        }

        pub fn paint(
            &mut self,
            _device: &Device,
            _queue: Handle,
            _view: Option<&wgpu::TextureView>,
            _paint: &mut OverlayPaint,
        ) {
        }
    }
}

/// The devices, and the cameras of the contexts of each.
pub type Devices = &'static [&'static [usize]];

pub struct Viewer {
    rendering: Rendering,
    scene: Arc<Scene>,
    pub seen: Arc<Seen>,
    frame: u32,
}

impl Viewer {
    pub fn new(model: ThreadingModel, devices: Devices, seen: Seen) -> Self {
        let seen = Arc::new(seen);
        let mut rendering = Rendering::new(false, false);
        rendering.set_model(model).unwrap();
        for contexts in devices {
            let mut number = None;
            for cameras in *contexts {
                let context = match number {
                    None => rendering.add_context(GraphicsContext::new(&seen), 0),
                    Some(first) => {
                        let add = |device: &mut GraphicsContext, _: &ContextTraits| {
                            device.targets += 1;
                            Ok(())
                        };
                        rendering.add_context_on(first, &ContextTraits::default(), 0, add).unwrap()
                    }
                };
                number.get_or_insert(context);
                (0..*cameras).for_each(|_| _ = rendering.add_camera(context).unwrap());
            }
        }
        let scene = Arc::new(Scene { frame: 0, seen: seen.clone() });
        Self { rendering, scene, seen, frame: 0 }
    }

    /// No cull has access to the scene.
    pub fn is_alone(&mut self) -> bool {
        Arc::get_mut(&mut self.scene).is_some()
    }

    pub fn set_model(&mut self, model: ThreadingModel) {
        self.rendering.set_model(model).unwrap();
    }

    pub fn frame(&mut self) -> Result<(), ViewerError> {
        self.rendering.start_threads()?;
        self.frame += 1;
        let frame = self.frame;
        Arc::get_mut(&mut self.scene).expect("exclusive access to the scene").frame = frame;
        self.seen.changed.store(frame, Ordering::SeqCst);
        for place in 0..self.rendering.device_count() {
            while self.rendering.in_flight(place) >= FRAMES_IN_FLIGHT {
                self.absorb_next(place)?;
            }
        }
        let (scene, reads) = (&self.scene, self.seen.reads);
        let callbacks =
            (reads == Reads::InCallbacks).then(|| OpaqueDrawData(Arc::new(()) as Arc<dyn Any + Send + Sync>));
        self.rendering.frame(
            |_| FrameJob { frame, present: true, ..FrameJob::default() },
            |camera, last| {
                Some(CullTask {
                    scene: scene.clone(),
                    camera: CullCamera { frame, context: camera, ..CullCamera::default() },
                    lens: Lens { camera: Camera::default(), size_px: [1, 1], offset: DMat4::IDENTITY },
                    sight: Sight::Middle,
                    environment: Environment::default(),
                    state_set: None,
                    callbacks: callbacks.clone(),
                    clamp_projection: None,
                    viewport_px: None,
                    is_dynamic: reads == Reads::InTheFrame,
                    requests: last.requests,
                })
            },
        )?;
        for (camera, outcome) in self.rendering.outcomes() {
            assert_eq!(outcome.counters.leaves, frame, "the stage of camera {camera} in this frame");
        }
        for place in 0..self.rendering.device_count() {
            while let Some(done) = self.rendering.device_at(place).and_then(|device| device.try_done()) {
                done.stats?;
            }
        }
        Ok(())
    }

    fn absorb_next(&mut self, place: usize) -> Result<(), ViewerError> {
        let Some(device) = self.rendering.device_at(place) else { return Ok(()) };
        if let Some(done) = device.wait_done()? {
            done.stats?;
        }
        Ok(())
    }

    /// Waits for all frames in flight.
    pub fn finish(&mut self) -> Result<(), ViewerError> {
        for place in 0..self.rendering.device_count() {
            while self.rendering.in_flight(place) > 0 {
                self.absorb_next(place)?;
            }
        }
        Ok(())
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        self.seen.is_ending.store(true, Ordering::SeqCst);
    }
}
