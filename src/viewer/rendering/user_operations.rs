//! The application's operations: on contexts, cameras and compile threads, and for contexts that are opened. The queues are
//! handed out on the main thread; any thread adds to them and removes from them.
//!
//! | operations | run |
//! |---|---|
//! | realize | once for each context, when it is opened or its lost device was replaced; main thread |
//! | context | after the cameras of the context were drawn, before it is presented; thread that draws it |
//! | camera | after the camera was culled; thread that culls it |
//! | compile | in the upload step of a frame; compile thread, or without one the thread that draws |

use std::sync::Arc;

use super::stage::Rendering;
use crate::cull::CullVisitor;
use crate::gpu::GraphicsContext;
use crate::sync::{Operation, OperationQueue};

impl Rendering {
    /// Sets the operation for contexts that are opened from now on.
    pub(in crate::viewer) fn set_realize_operation(&mut self, operation: Option<Arc<dyn Operation<GraphicsContext>>>) {
        self.realize = operation;
    }

    /// Runs the realize operation for a context. No thread runs: the main thread owns the device.
    pub(super) fn realize_context(&mut self, context: u32) {
        let Some(operation) = self.realize.clone() else { return };
        if let Some(side) = self.device_of(context).and_then(|device| device.here()) {
            side.realize(context, &*operation);
        }
    }

    /// Returns the operations of a context.
    pub(in crate::viewer) fn context_operations(&self, context: u32) -> Option<&Arc<OperationQueue<GraphicsContext>>> {
        self.devices.iter().find_map(|device| device.context_operations(context))
    }

    /// Returns the operations of a camera.
    pub(in crate::viewer) fn camera_operations(&self, camera: u32) -> Option<&Arc<OperationQueue<CullVisitor>>> {
        self.cameras.iter().find(|c| c.number == camera).map(|c| &c.operations)
    }

    /// Returns the operations on the compile thread of a context's device.
    pub(in crate::viewer) fn compile_operations(&self, context: u32) -> Option<&Arc<OperationQueue<wgpu::Device>>> {
        let device = self.devices.iter().find(|device| device.size_px(context).is_some());
        device.map(|device| device.compile_operations())
    }

    /// Returns true while an operation of a context, a camera or a compile thread waits for a frame.
    pub(in crate::viewer) fn has_operations(&self) -> bool {
        self.devices.iter().any(|device| device.has_operations())
            || self.cameras.iter().any(|camera| !camera.operations.is_empty())
    }
}
