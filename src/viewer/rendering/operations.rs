//! The loops of the threads of cameras and contexts, as operations in their queues.
//!
//! ```text
//! CullDrawThreadPerContext                   context: await frame, start barrier, render, swap ready, swap, end barrier
//! DrawThreadPerContext                       context: await frame, render, swap ready, swap
//! CullThreadPerCameraDrawThreadPerContext    context: await frame, render, swap ready, swap
//!                                            camera:  start barrier, cull
//! ```
//! Between two frames a context's thread waits in "await frame", where it can upload, and not at the start barrier.

use std::sync::Arc;

use super::cores;
use super::cull_side::CullSide;
use super::draw_side::DrawSide;
use crate::sync::{Barrier, BlockCount, Operation};
use crate::trace;

/// A step in the loop of a context's thread.
pub(super) struct Step {
    pub(super) name: &'static str,
    pub(super) run: fn(&mut DrawSide),
    /// Released when the thread ends, since it is not completed then.
    pub(super) end_of_dynamic: Option<Arc<BlockCount>>,
}

impl Operation<DrawSide> for Step {
    fn name(&self) -> &str {
        self.name
    }

    fn keep(&self) -> bool {
        true
    }

    fn run(&self, side: &mut DrawSide) {
        let _span = trace::span(self.name);
        (self.run)(side);
    }

    fn release(&self) {
        if let Some(block) = &self.end_of_dynamic {
            block.release();
        }
    }
}

/// Pins a thread to a core, as its first operation.
pub(super) struct Pin(pub(super) core_affinity::CoreId);

impl<T> Operation<T> for Pin {
    fn name(&self) -> &str {
        "pin to core"
    }

    fn run(&self, _: &mut T) {
        cores::pin(self.0);
    }
}

/// A barrier in the loop of the contexts' threads.
pub(super) struct BarrierOperation {
    pub(super) name: &'static str,
    pub(super) barrier: Arc<Barrier>,
}

impl Operation<DrawSide> for BarrierOperation {
    fn name(&self) -> &str {
        self.name
    }

    fn keep(&self) -> bool {
        true
    }

    fn run(&self, side: &mut DrawSide) {
        // A thread that was woken without a frame would wait for the others forever.
        if side.meets_others {
            let _span = trace::span(self.name);
            self.barrier.block();
        }
    }

    fn release(&self) {
        self.barrier.release();
    }
}

/// The barrier at which the threads of cameras wait for the frame.
pub(super) struct StartOfCull(pub(super) Arc<Barrier>);

impl Operation<CullSide> for StartOfCull {
    fn name(&self) -> &str {
        "start barrier"
    }

    fn keep(&self) -> bool {
        true
    }

    fn run(&self, _: &mut CullSide) {
        let _span = trace::span("start barrier");
        self.0.block();
    }

    fn release(&self) {
        self.0.release();
    }
}

/// The cull in the loop of a camera's thread.
pub(super) struct Cull(pub(super) Option<Arc<BlockCount>>);

impl Operation<CullSide> for Cull {
    fn name(&self) -> &str {
        "cull"
    }

    fn keep(&self) -> bool {
        true
    }

    fn run(&self, side: &mut CullSide) {
        side.cull();
    }

    fn release(&self) {
        if let Some(block) = &self.0 {
            block.release();
        }
    }
}
