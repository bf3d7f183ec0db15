//! Opens, resizes and closes the contexts that a viewer draws into, and the cameras in them. Main thread; all frames in flight
//! are drawn before anything changes, and the next frame starts the threads again.

use image::RgbaImage;

use super::frame_loop::FrameLoop;
use crate::draw::ViewChange;
use crate::gpu::{ContextTraits, GpuError, GraphicsContext};
use crate::viewer::ViewerError;
use crate::viewer::ids::{ContextId, SlaveId};
use crate::viewer::paging::SceneList;
use crate::viewer::rendering::{Closed, DeviceHandle};
use crate::viewer::view::viewport::ViewArea;
use crate::viewer::view::{CameraSlot, Slave, View, ViewList};

impl FrameLoop {
    fn check_context_limit(&self) -> Result<(), ViewerError> {
        let limit = self.config.max_contexts;
        if self.rendering.context_ids().count() >= limit {
            return Err(ViewerError::TooManyContexts { limit });
        }
        Ok(())
    }

    fn device_of(&mut self, context: ContextId) -> Result<&mut DeviceHandle, ViewerError> {
        self.rendering.device_of(context.0).ok_or(ViewerError::NoContext(context))
    }

    /// Takes a context with its own device.
    pub(in crate::viewer) fn open_context(
        &mut self,
        mut context: GraphicsContext,
        scenes: &mut SceneList,
    ) -> Result<ContextId, ViewerError> {
        let has_stencil = context.device().features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8);
        if self.config.min_stencil_bits > if has_stencil { 8 } else { 0 } {
            let (bits, adapter) = (self.config.min_stencil_bits, context.adapter_name());
            return Err(ViewerError::Setting(format!("{adapter} has no {bits} bits of stencil")));
        }
        self.check_context_limit()?;
        let is_window = context.has_window_last();
        if let Some(folder) = &self.config.pipeline_cache
            && let Err(error) = context.keep_pipelines(folder)
        {
            log::warn!("{error}");
        }
        self.finish()?;
        let number = self.rendering.add_context(context, self.stamp().frame);
        if let Some(device) = self.rendering.device_of(number) {
            device.retain_released(self.config.frames_to_retain);
        }
        if let Err(error) = self.rendering.check_model() {
            self.rendering.remove_context(number);
            return Err(error);
        }
        self.pagers.device_opened(scenes, number, &mut self.rendering)?;
        if is_window {
            self.rehearsals.window_opened(ContextId(number));
        }
        Ok(ContextId(number))
    }

    /// Opens a context on the device of another one; it shares everything uploaded there. `add` creates the target.
    pub(in crate::viewer) fn open_context_on(
        &mut self,
        other: ContextId,
        traits: &ContextTraits,
        add: impl FnOnce(&mut GraphicsContext, &ContextTraits) -> Result<(), GpuError>,
    ) -> Result<ContextId, ViewerError> {
        self.check_context_limit()?;
        self.finish()?;
        let mut is_window = false;
        let add = |context: &mut GraphicsContext, traits: &ContextTraits| {
            add(context, traits)?;
            is_window = context.has_window_last();
            Ok(())
        };
        let id = self.rendering.add_context_on(other.0, traits, self.stamp().frame, add).map(ContextId)?;
        if is_window {
            self.rehearsals.window_opened(id);
        }
        Ok(id)
    }

    /// Closes a context with the cameras in it; returns false when there is no such context.
    pub(in crate::viewer) fn close_context(
        &mut self,
        id: ContextId,
        views: &mut ViewList,
        scenes: &mut SceneList,
    ) -> Result<bool, ViewerError> {
        match self.finish() {
            // A context whose thread has died can still be closed.
            Ok(()) | Err(ViewerError::DrawThreadStopped) => {}
            Err(error) => return Err(error),
        }
        let closed = self.rendering.remove_context(id.0);
        if closed == Closed::Nothing {
            return Ok(false);
        }
        self.pictures.forget_context(id.0);
        self.rehearsals.context_closed(id);
        views.values_mut().for_each(|view| view.context_closed(id.0));
        if let Closed::Device(device) = closed {
            // If another device is lost too, its next frame reports that.
            self.device_loss.clear();
            self.pagers.device_closed(scenes, device, &mut self.rendering);
        }
        Ok(true)
    }

    /// Adds a camera in a context, drawn after the cameras that it has.
    pub(in crate::viewer) fn add_camera(
        &mut self,
        context: ContextId,
        viewport: ViewArea,
    ) -> Result<CameraSlot, ViewerError> {
        self.finish()?;
        let context_px = self.rendering.size_px(context.0).ok_or(ViewerError::NoContext(context))?;
        let (camera, device) = self.rendering.add_camera(context.0).ok_or(ViewerError::NoContext(context))?;
        Ok(CameraSlot { camera, context: context.0, device, viewport, context_px })
    }

    /// Moves the master camera of a view to another context.
    pub(in crate::viewer) fn move_master(&mut self, view: &mut View, context: ContextId) -> Result<(), ViewerError> {
        let viewport = view.master.map_or(ViewArea::Whole, |slot| slot.viewport);
        let slot = self.add_camera(context, viewport)?;
        view.shown.forget_rehearsal();
        if let Some(before) = view.master.replace(slot) {
            self.rendering.remove_camera(before.camera);
        }
        Ok(())
    }

    /// Keeps released drawables for some frames, on all devices.
    pub(in crate::viewer) fn set_frames_to_retain(&mut self, frames: u32) {
        self.config.frames_to_retain = frames;
        self.rendering.devices_mut().for_each(|device| device.retain_released(frames));
    }

    /// Creates the pipelines for a change of views on all devices.
    pub(in crate::viewer) fn prewarm_change(&mut self, change: &ViewChange) {
        self.rendering.devices_mut().for_each(|device| device.prewarm_change(change));
    }

    /// Draws a context after the others of its device.
    pub(in crate::viewer) fn draw_last(&mut self, context: ContextId) -> Result<(), ViewerError> {
        self.finish()?;
        self.device_of(context)?.draw_last(context.0);
        Ok(())
    }

    pub(in crate::viewer) fn add_slave(&mut self, view: &mut View, slave: Slave) -> Result<SlaveId, ViewerError> {
        let slot = self.add_camera(slave.context, slave.viewport)?;
        Ok(view.push_slave(slot, slave))
    }

    /// Removes a slave; returns false when the view has no such slave.
    pub(in crate::viewer) fn remove_slave(&mut self, view: &mut View, id: SlaveId) -> Result<bool, ViewerError> {
        if !view.take_slave(id) {
            return Ok(false);
        }
        self.finish()?;
        self.rendering.remove_camera(id.0);
        Ok(true)
    }

    /// Removes the cameras of a view that is about to be removed.
    pub(in crate::viewer) fn remove_cameras_of(&mut self, view: &View) -> Result<(), ViewerError> {
        self.finish()?;
        view.cameras().for_each(|camera| self.rendering.remove_camera(camera));
        Ok(())
    }

    /// Reads back the last frame of an offscreen context.
    pub(in crate::viewer) fn read_back(&mut self, context: ContextId) -> Result<RgbaImage, ViewerError> {
        self.finish()?;
        if let Some(GpuError::DeviceLost { reason }) = self.device_loss.pending() {
            return Err(GpuError::DeviceLost { reason: reason.clone() }.into());
        }
        self.device_of(context)?.read_back(context.0)
    }

    /// Returns a view of the texture that an offscreen context draws into.
    pub(in crate::viewer) fn color_view(
        &mut self,
        context: ContextId,
    ) -> Result<Option<wgpu::TextureView>, ViewerError> {
        self.finish()?;
        self.device_of(context)?.color_view(context.0)
    }

    pub(in crate::viewer) fn set_vsync(&mut self, context: ContextId, vsync: bool) -> Result<(), ViewerError> {
        self.device_of(context)?.set_vsync(context.0, vsync)
    }

    /// Sets the size of a context's target.
    pub(in crate::viewer) fn resize(&mut self, context: ContextId, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.device_of(context)?.resize(context.0, size_px.map(|side| side.max(1)))
    }

    /// Loses the device of a context, as if the driver had lost it.
    #[cfg(feature = "testing")]
    pub(in crate::viewer) fn lose_device(&mut self, context: ContextId) -> Result<(), ViewerError> {
        self.device_of(context)?.lose_device()
    }

    /// Sets the next answers of a window's surface.
    #[cfg(feature = "testing")]
    pub(in crate::viewer) fn pretend_surface(
        &mut self,
        context: ContextId,
        answers: &[crate::gpu::SurfaceAnswer],
    ) -> Result<(), ViewerError> {
        self.device_of(context)?.pretend_surface(context.0, answers)
    }
}
