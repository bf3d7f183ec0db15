//! The contexts of a [`CompositeViewer`]: the windows and textures that views are drawn in. Main thread.

use super::ViewerError;
use super::composite::CompositeViewer;
#[cfg(feature = "window")]
use super::config::Screen;
use super::ids::{ContextId, ViewId};
use crate::draw::ViewChange;
use crate::gpu::{ContextTraits, GraphicsContext};

/// Contexts: the windows and textures that views are drawn in.
impl CompositeViewer {
    /// Adds a context with its own device; at most [`ViewerConfig::max_contexts`](super::ViewerConfig::max_contexts). The
    /// application's pages are uploaded to it, and all paged contents are loaded again, for every context
    /// ([`Self::open_offscreen_on`] avoids both). Stops the threads; the next frame starts them again.
    pub fn open_context(&mut self, context: GraphicsContext) -> Result<ContextId, ViewerError> {
        self.frame.open_context(context, &mut self.scenes)
    }

    /// Adds a window as a context with its own device; see [`Self::open_context`]. Call it on the thread of the event
    /// loop, then add a view or a [`Slave`](super::Slave) in it.
    pub fn open_window(
        &mut self,
        target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        traits: &ContextTraits,
    ) -> Result<ContextId, ViewerError> {
        self.open_context(GraphicsContext::new_window(target, traits)?)
    }

    /// Adds an offscreen context on the device of another one. They share pools, textures and pipelines: nothing is
    /// uploaded or loaded again, and bytes count once. One thread draws all contexts of a device, one after the other, in
    /// every threading model. Only size, samples and vsync of the traits are used.
    pub fn open_offscreen_on(&mut self, other: ContextId, traits: &ContextTraits) -> Result<ContextId, ViewerError> {
        self.frame.open_context_on(other, traits, GraphicsContext::add_offscreen_target)
    }

    /// Adds a window on the device of another context; see [`Self::open_offscreen_on`]. Call it on the thread of the event
    /// loop. Fails when the device's adapter cannot present to the window.
    pub fn open_window_on(
        &mut self,
        other: ContextId,
        target: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
        traits: &ContextTraits,
    ) -> Result<ContextId, ViewerError> {
        self.frame.open_context_on(other, traits, |context, traits| context.add_window_target(target, traits))
    }

    /// Closes a context and removes the cameras in it; other contexts are unaffected. Returns false when there is no such
    /// context.
    pub fn close_context(&mut self, id: ContextId) -> Result<bool, ViewerError> {
        self.frame.close_context(id, &mut self.views, &mut self.scenes)
    }

    /// Returns the open contexts, by the screens of their windows and by position, x before y ([`ContextTraits::screen`]), then
    /// in the order opened.
    pub fn contexts(&self) -> impl Iterator<Item = ContextId> {
        self.frame.rendering.context_ids().map(ContextId)
    }

    /// Sets the size of a context in pixels, for example after its window was resized.
    pub fn resize_context(&mut self, context: ContextId, size_px: [u32; 2]) -> Result<(), ViewerError> {
        self.frame.resize(context, size_px)?;
        self.views.values_mut().for_each(|view| view.redraw_in(context));
        Ok(())
    }

    /// Draws a context after all others that share its device, from the next frame on, so that its operations find their images
    /// of the same frame.
    pub fn draw_last(&mut self, context: ContextId) -> Result<(), ViewerError> {
        self.frame.draw_last(context)
    }

    /// Moves the master camera of a view to another context; OSG's camera with another graphics context. Waits until all frames
    /// are drawn. Slaves stay where they are.
    pub fn move_view(&mut self, view: ViewId, context: ContextId) -> Result<(), ViewerError> {
        let of_view = self.views.get_mut(view).ok_or(ViewerError::NoView(view))?;
        self.frame.move_master(of_view, context)?;
        let bounds = self.scenes[of_view.scene()].bounds();
        of_view.prepare(&self.frame.rendering, bounds);
        of_view.request_redraw();
        Ok(())
    }

    /// Creates the pipelines that views need after a change of light 0 or of the stencil, before the frame that shows the change.
    /// Changes of the environment need no announcement where they wait for their pipelines
    /// ([`EnvironmentChanges`](super::EnvironmentChanges)). What is loaded later gets both kinds of pipelines. The devices'
    /// threads do this between two frames; the first draw with a pipeline may still be slow on software drivers. See
    /// [`Renderer::prewarm_change`](crate::draw::Renderer::prewarm_change) for what is not covered.
    pub fn prewarm_change(&mut self, change: &ViewChange) {
        self.frame.prewarm_change(change);
    }

    /// Sets [`ViewerConfig::frames_to_retain`](super::ViewerConfig::frames_to_retain), also for drawables that are kept already.
    pub fn set_frames_to_retain(&mut self, frames: u32) {
        self.frame.set_frames_to_retain(frames);
    }

    /// Frees the GPU memory of all removed drawables before the next frame, however long that takes; otherwise each frame frees
    /// what it has time for. OSG's `flushAllDeletedGLObjects`.
    pub fn flush_deleted_objects(&mut self) {
        self.frame.rendering.devices_mut().for_each(|device| device.flush_released());
    }

    /// Returns the screens of the display, as [`run_window`](super::run_window) and [`run_views`](super::run_views) found them
    /// when they opened windows last; empty in other event loops, which have [`Screen::all`](super::Screen::all).
    #[cfg(feature = "window")]
    pub fn screens(&self) -> &[Screen] {
        &self.frame.screens
    }

    /// Sets whether a context's window waits for the vertical blank; see [`ContextTraits::vsync`].
    pub fn set_vsync(&mut self, context: ContextId, vsync: bool) -> Result<(), ViewerError> {
        self.frame.set_vsync(context, vsync)
    }

    /// Returns the name of the first context's adapter.
    pub fn adapter_name(&self) -> &str {
        self.frame.rendering.adapter_name()
    }

    /// Returns true if the first context's adapter is a software driver, which draws far slower than a GPU.
    pub fn is_software_adapter(&self) -> bool {
        self.frame.rendering.is_software()
    }

    /// Loses the device of a context, as if the driver had lost it.
    #[cfg(feature = "testing")]
    pub fn lose_device(&mut self, context: ContextId) -> Result<(), ViewerError> {
        self.frame.lose_device(context)
    }

    /// Sets the next answers of a window's surface.
    #[cfg(feature = "testing")]
    pub fn pretend_surface(
        &mut self,
        context: ContextId,
        answers: &[crate::gpu::SurfaceAnswer],
    ) -> Result<(), ViewerError> {
        self.frame.pretend_surface(context, answers)
    }
}
