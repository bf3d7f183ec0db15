//! Operations of the application: in update, and on the threads of contexts, cameras and uploads; OSG's operation queues.
//! Queues are handed out on the main thread. Any thread adds operations to them, and removes them by name.

use std::sync::Arc;

use super::ViewerError;
use super::composite::CompositeViewer;
use super::ids::{ContextId, SlaveId, ViewId};
use super::viewer::Viewer;
use crate::cull::CullVisitor;
use crate::gpu::GraphicsContext;
use crate::sync::{Operation, OperationQueue};

/// Operations and the step that opens a viewer without a frame.
///
/// An operation that is kept ([`Operation::keep`]) runs once in each frame, until it is removed from its queue by its name;
/// the others run once. [`Self::check_need_to_do_frame`] asks for a frame while operations wait. An operation delays its
/// frame: it must not wait for other threads of the viewer, nor call the viewer's `frame`.
impl CompositeViewer {
    /// Opens everything that frames need, without drawing one: starts the threads of the model, and fits the views to the
    /// sizes of their contexts. Otherwise the first frame does so. Fails without a context.
    pub fn realize(&mut self) -> Result<(), ViewerError> {
        if self.contexts().next().is_none() {
            return Err(ViewerError::Setting(
                "no context is open to be realized; open a window or a texture".to_owned(),
            ));
        }
        self.start_threading()?;
        self.prepare_views();
        Ok(())
    }

    /// Returns true from [`Self::realize`] or the first frame on, until threads are stopped, for example to open a context.
    pub fn is_realized(&self) -> bool {
        self.frame.rendering.is_running()
    }

    /// Sets [`ViewerConfig::realize_operation`](super::ViewerConfig::realize_operation) for contexts that are opened from now
    /// on.
    pub fn set_realize_operation(&mut self, operation: Option<Arc<dyn Operation<GraphicsContext>>>) {
        self.frame.rendering.set_realize_operation(operation);
    }

    /// Returns the operations that run in update, after the update callbacks and before cameras move. Main thread.
    pub fn update_operations(&self) -> &Arc<OperationQueue<Self>> {
        &self.update_operations
    }

    /// Runs the update operations of a frame.
    pub(super) fn run_update_operations(&mut self) {
        let operations = Arc::clone(&self.update_operations);
        operations.run_operations(self);
    }

    /// Returns true while an operation waits for a frame.
    pub(super) fn has_operations(&self) -> bool {
        !self.update_operations.is_empty() || self.frame.rendering.has_operations()
    }

    /// Returns the operations of a context. They run on the thread that draws it, after its cameras are drawn and before it
    /// is presented. That thread alone may use the context's queue. They must not resize or present it.
    pub fn context_operations(&self, context: ContextId) -> Result<&Arc<OperationQueue<GraphicsContext>>, ViewerError> {
        self.frame.rendering.context_operations(context.0).ok_or(ViewerError::NoContext(context))
    }

    /// Returns the operations of a view's master camera, or of a slave. They run on the thread that culls the camera, after
    /// it was culled. `None` when the view has no such camera.
    pub fn camera_operations(
        &self,
        view: ViewId,
        slave: Option<SlaveId>,
    ) -> Result<Option<&Arc<OperationQueue<CullVisitor>>>, ViewerError> {
        let camera = self.camera_number(view, slave)?;
        Ok(camera.and_then(|camera| self.frame.rendering.camera_operations(camera)))
    }

    /// Returns the operations of the compile thread of a context's device, for textures and pipelines of the application.
    /// Without [`ViewerConfig::compile_contexts`](super::ViewerConfig::compile_contexts) they run on the thread that draws,
    /// in the upload step of a frame.
    pub fn compile_operations(&self, context: ContextId) -> Result<&Arc<OperationQueue<wgpu::Device>>, ViewerError> {
        self.frame.rendering.compile_operations(context.0).ok_or(ViewerError::NoContext(context))
    }
}

/// Operations; see the methods of [`CompositeViewer`] with the same names.
impl Viewer {
    /// Opens everything that frames need, without drawing one.
    pub fn realize(&mut self) -> Result<(), ViewerError> {
        self.composite_mut().realize()
    }

    /// Returns true from [`Self::realize`] or the first frame on.
    pub fn is_realized(&self) -> bool {
        self.composite().is_realized()
    }

    /// Returns the operations that run in update.
    pub fn update_operations(&self) -> &Arc<OperationQueue<CompositeViewer>> {
        self.composite().update_operations()
    }
}
