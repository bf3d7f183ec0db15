//! What the threads of cameras and contexts do again and again, as operations in their queues.
//!
//! ```text
//! CullDrawThreadPerContext                   context: await frame, start barrier, render, swap ready, swap, end barrier
//! DrawThreadPerContext                       context: await frame, render, swap ready, swap
//! CullThreadPerCameraDrawThreadPerContext    context: await frame, render, swap ready, swap
//!                                            camera:  start barrier, cull
//! ```
//! A context's thread waits for its frame where it can upload meanwhile, so that between two frames it is not the start
//! barrier that it waits at.

use std::sync::Arc;

use super::cull_side::CullSide;
use super::draw_side::DrawSide;
use crate::sync::{Barrier, BlockCount, Operation};
use crate::timeline;

/// A step of a context's thread.
pub(super) struct Step {
    pub(super) name: &'static str,
    pub(super) run: fn(&mut DrawSide),
    /// Opened when the thread ends, as nobody completes it then.
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
        let _span = timeline::span(self.name);
        (self.run)(side);
    }

    fn release(&self) {
        if let Some(block) = &self.end_of_dynamic {
            block.release();
        }
    }
}

/// Keeps a thread on a core, once, as its first operation.
pub(super) struct Pin(pub(super) core_affinity::CoreId);

impl<T> Operation<T> for Pin {
    fn name(&self) -> &str {
        "pin to core"
    }

    fn run(&self, _: &mut T) {
        if !core_affinity::set_for_current(self.0) {
            log::warn!("the system does not keep a thread on core {}", self.0.id);
        }
    }
}

/// The cores for the threads of a model in turn, leaving the first to the main thread; none where there is but one.
pub(super) fn pins() -> impl Iterator<Item = core_affinity::CoreId> {
    let cores = core_affinity::get_core_ids().unwrap_or_default();
    let spare: Vec<_> = cores.into_iter().skip(1).collect();
    (0..).map_while(move |i: usize| spare.get(i % spare.len().max(1)).copied())
}

/// A barrier that threads meet at.
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
        // Woken without a frame there is nobody to meet.
        if side.meets_others {
            let _span = timeline::span(self.name);
            self.barrier.block();
        }
    }

    fn release(&self) {
        self.barrier.release();
    }
}

/// Where the threads of cameras wait for the frame.
pub(super) struct StartOfCull(pub(super) Arc<Barrier>);

impl Operation<CullSide> for StartOfCull {
    fn name(&self) -> &str {
        "start barrier"
    }

    fn keep(&self) -> bool {
        true
    }

    fn run(&self, _: &mut CullSide) {
        let _span = timeline::span("start barrier");
        self.0.block();
    }

    fn release(&self) {
        self.0.release();
    }
}

/// One cull of a camera's thread.
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
