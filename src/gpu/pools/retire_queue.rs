//! [`RetireQueue`]: drawables that were released and whose slots are not free yet. Draw thread.

use std::collections::VecDeque;

use super::Pools;
use crate::scene::DrawSlot;

/// The maximum number of drawables whose slots are freed per frame, which takes some tenths of a millisecond. A large tile
/// set that is removed at once is spread over several frames.
const MAX_PER_FRAME: usize = 1024;

/// Released drawables, in the order of release.
pub(in crate::gpu) struct RetireQueue {
    slots: VecDeque<DrawSlot>,
    /// The number of drawables that may still be freed in this frame.
    left_in_frame: usize,
}

impl Default for RetireQueue {
    fn default() -> Self {
        Self { slots: VecDeque::new(), left_in_frame: MAX_PER_FRAME }
    }
}

impl RetireQueue {
    /// Adds drawables, and frees as many as the frame allows.
    pub(in crate::gpu) fn release(&mut self, slots: &[DrawSlot], pools: &mut Pools) {
        self.slots.extend(slots);
        self.free(self.left_in_frame, pools);
    }

    /// Begins the next frame's allowance.
    pub(in crate::gpu) fn start_frame(&mut self, pools: &mut Pools) {
        self.left_in_frame = MAX_PER_FRAME;
        self.free(MAX_PER_FRAME, pools);
    }

    /// Frees all released drawables, before uploads that need their slots.
    pub(in crate::gpu) fn free_all(&mut self, pools: &mut Pools) {
        self.free(usize::MAX, pools);
    }

    fn free(&mut self, max_count: usize, pools: &mut Pools) {
        let count = max_count.min(self.slots.len());
        self.slots.drain(..count).for_each(|slot| pools.release(slot));
        self.left_in_frame = self.left_in_frame.saturating_sub(count);
    }
}
