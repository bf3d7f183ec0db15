//! What a viewer draws into: contexts and cameras that are opened, closed, resized and lost. Main thread; all frames are
//! drawn before anything changes.

use image::RgbaImage;

use super::ViewerError;
use super::base::ViewerBase;
use super::paged_scene::PagedScene;
use super::rendering::Closed;
use super::view::{ContextId, Place, Slave, SlaveId, View};
use super::viewport::Viewport;
use crate::gpu::{ContextTraits, GpuError, GraphicsContext, SurfaceAnswer};

impl ViewerBase {
    fn check_room(&self) -> Result<(), ViewerError> {
        let limit = self.max_contexts;
        if self.rendering.context_ids().count() >= limit {
            return Err(ViewerError::TooManyContexts { limit });
        }
        Ok(())
    }

    /// Takes a context while others may be drawn in; all frames are drawn before, and the next one starts the threads.
    pub(super) fn open_context(
        &mut self,
        mut context: GraphicsContext,
        scenes: &mut [PagedScene],
    ) -> Result<ContextId, ViewerError> {
        let has_stencil = context.device().features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8);
        if self.min_stencil_bits > if has_stencil { 8 } else { 0 } {
            let (bits, adapter) = (self.min_stencil_bits, context.adapter_name());
            return Err(ViewerError::Setting(format!("{adapter} has no {bits} bits of stencil")));
        }
        self.check_room()?;
        if let Some(folder) = &self.pipeline_cache
            && let Err(error) = context.keep_pipelines(folder)
        {
            log::warn!("{error}");
        }
        self.absorb_all()?;
        let number = self.rendering.add_context(context, self.stamp.frame);
        self.device_opened(scenes, number)?;
        Ok(ContextId(number))
    }

    /// Opens a context on the device of another one: what is uploaded there is here too. All frames are drawn before.
    pub(super) fn open_context_on(
        &mut self,
        other: ContextId,
        traits: &ContextTraits,
        add: impl FnOnce(&mut GraphicsContext, &ContextTraits) -> Result<(), GpuError>,
    ) -> Result<ContextId, ViewerError> {
        self.check_room()?;
        self.absorb_all()?;
        self.rendering.add_context_on(other.0, traits, self.stamp.frame, add).map(ContextId)
    }

    /// Drops a context with the cameras in it; all frames are drawn before. False when there is none.
    pub(super) fn close_context(
        &mut self,
        id: ContextId,
        views: &mut [View],
        scenes: &mut [PagedScene],
    ) -> Result<bool, ViewerError> {
        match self.absorb_all() {
            // One that has died draws no more, and is to be closed all the same.
            Ok(()) | Err(ViewerError::DrawThreadStopped) => {}
            Err(error) => return Err(error),
        }
        let closed = self.rendering.remove_context(id.0);
        if closed == Closed::Nothing {
            return Ok(false);
        }
        self.forget_pictures(id.0);
        for view in views {
            view.context_closed(id.0);
        }
        if let Closed::Device(device) = closed {
            // Another one that is lost shows again.
            self.lost = None;
            self.device_closed(scenes, device);
        }
        Ok(true)
    }

    /// A camera in a context; all frames are drawn before.
    pub(super) fn add_camera(&mut self, context: ContextId, viewport: Viewport) -> Result<Place, ViewerError> {
        self.absorb_all()?;
        let context_px = self.rendering.size_px(context.0).ok_or(ViewerError::NoContext(context))?;
        let (camera, device) = self.rendering.add_camera(context.0).ok_or(ViewerError::NoContext(context))?;
        Ok(Place { camera, context: context.0, device, viewport, context_px })
    }

    pub(super) fn remove_camera(&mut self, camera: u32) -> Result<(), ViewerError> {
        self.absorb_all()?;
        self.rendering.remove_camera(camera);
        Ok(())
    }

    pub(super) fn add_slave(&mut self, view: &mut View, slave: Slave) -> Result<SlaveId, ViewerError> {
        let place = self.add_camera(slave.context, slave.viewport)?;
        Ok(view.push_slave(place, slave))
    }

    pub(super) fn remove_slave(&mut self, view: &mut View, id: SlaveId) -> Result<bool, ViewerError> {
        if !view.take_slave(id) {
            return Ok(false);
        }
        self.remove_camera(id.0)?;
        Ok(true)
    }

    /// The last frame's picture in a context, offscreen.
    pub(super) fn read_back(&mut self, context: ContextId) -> Result<RgbaImage, ViewerError> {
        self.absorb_all()?;
        if let Some(GpuError::DeviceLost { reason }) = &self.lost {
            return Err(GpuError::DeviceLost { reason: reason.clone() }.into());
        }
        self.rendering.device_of(context.0).ok_or(ViewerError::NoContext(context))?.read_back(context.0)
    }

    pub(super) fn set_vsync(&mut self, context: ContextId, vsync: bool) -> Result<(), ViewerError> {
        self.rendering.device_of(context.0).ok_or(ViewerError::NoContext(context))?.set_vsync(context.0, vsync)
    }

    pub(super) fn lose_device(&mut self, context: ContextId) -> Result<(), ViewerError> {
        self.rendering.device_of(context.0).ok_or(ViewerError::NoContext(context))?.lose_device()
    }

    pub(super) fn pretend_surface(&mut self, context: ContextId, answers: &[SurfaceAnswer]) -> Result<(), ViewerError> {
        let handle = self.rendering.device_of(context.0).ok_or(ViewerError::NoContext(context))?;
        handle.pretend_surface(context.0, answers)
    }

    pub(super) fn resize(&mut self, context: ContextId, size_px: [u32; 2]) -> Result<(), ViewerError> {
        let handle = self.rendering.device_of(context.0).ok_or(ViewerError::NoContext(context))?;
        handle.resize(context.0, size_px.map(|side| side.max(1)))
    }
}
