//! [`CompileContext`]: the interface of a graphics context for a pager.

use std::sync::Arc;

use crate::gpu::{CompileBudget, CompileOperation, Compiled};
use crate::scene::{BlockFormats, DrawKind, DrawSlot};

/// The compile queue of one graphics context, as the pager sees it from the main thread.
pub trait CompileContext {
    /// Returns the id of the context; pages keep their draw slots by it.
    fn id(&self) -> u32;
    /// Returns the families of compressed texture formats that the context samples. Pages are decoded to formats that all
    /// contexts have.
    fn block_formats(&self) -> BlockFormats {
        BlockFormats::NONE
    }
    /// Announces the kinds of drawables of the next [`Self::compile`], so that their pipelines can be prewarmed.
    fn prewarm(&mut self, _kinds: &Arc<[DrawKind]>) {}
    /// Announces the GPU bytes that the pager's pages may take in the context, blocks and padding included.
    fn set_max_bytes(&mut self, _max_bytes: u64) {}
    /// Queues drawables for upload within the context's budget per frame.
    fn compile(&mut self, operation: CompileOperation);
    /// Cancels operations: those that have not begun may end with nothing uploaded. Each is still answered.
    fn cancel(&mut self, _tickets: &[u64]) {}
    /// Uploads within a budget, now or on the context's own thread, in the time between two frames. The context itself
    /// decides what it uploads within a frame.
    fn run_compiles(&mut self, budget: &CompileBudget);
    /// Returns what has been uploaded since the last call.
    fn take_compiled(&mut self) -> Vec<Compiled>;
    /// Returns slots to the context, after the last frame that may draw them was queued.
    fn release(&mut self, slots: Vec<DrawSlot>);
    /// Returns false once the context's thread has ended unexpectedly, or while it cannot upload: the pager does not wait
    /// for what was queued.
    fn is_alive(&self) -> bool {
        true
    }
}
