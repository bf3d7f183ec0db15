//! [`RetireQueue`]: drawables that were released and whose slots are not free yet. Draw thread.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::Pools;
use crate::scene::DrawSlot;

/// The time that freeing slots may take in a frame. A large tile set that is removed at once is spread over several frames;
/// OSG's budget for `flushDeletedGLObjects`.
const MAX_TIME: Duration = Duration::from_micros(300);
/// If no frame has begun for this long, none is delayed, and all slots are freed at once.
const IDLE_TIME: Duration = Duration::from_millis(100);
/// Slots freed between two looks at the clock: 100 ns each at most.
const SLOTS_PER_LOOK: usize = 32;

/// Released drawables, in the order of release.
pub(in crate::gpu) struct RetireQueue {
    slots: VecDeque<DrawSlot>,
    /// The rest of the frame's time.
    left_in_frame: Duration,
    frame_began: Instant,
}

impl Default for RetireQueue {
    fn default() -> Self {
        Self { slots: VecDeque::new(), left_in_frame: MAX_TIME, frame_began: Instant::now() }
    }
}

impl RetireQueue {
    /// Adds drawables, and frees as many as the frame has time for; all if no frames are drawn.
    pub(in crate::gpu) fn release(&mut self, slots: &[DrawSlot], pools: &mut Pools) {
        self.slots.extend(slots);
        if self.frame_began.elapsed() > IDLE_TIME {
            self.free_all(pools);
        } else {
            self.free_in_time(pools, Instant::now);
        }
    }

    /// Begins the next frame's time.
    pub(in crate::gpu) fn start_frame(&mut self, pools: &mut Pools) {
        (self.left_in_frame, self.frame_began) = (MAX_TIME, Instant::now());
        self.free_in_time(pools, Instant::now);
    }

    /// Frees all released drawables, before uploads that need their slots.
    pub(in crate::gpu) fn free_all(&mut self, pools: &mut Pools) {
        self.slots.drain(..).for_each(|slot| pools.release(slot));
    }

    /// Frees drawables until none or no time is left; at least some in each frame.
    fn free_in_time(&mut self, pools: &mut Pools, mut now: impl FnMut() -> Instant) {
        if self.slots.is_empty() || self.left_in_frame.is_zero() {
            return;
        }
        let start = now();
        while !self.slots.is_empty() {
            let count = SLOTS_PER_LOOK.min(self.slots.len());
            self.slots.drain(..count).for_each(|slot| pools.release(slot));
            let taken = now().saturating_duration_since(start);
            if taken >= self.left_in_frame {
                self.left_in_frame = Duration::ZERO;
                return;
            }
        }
        self.left_in_frame = self.left_in_frame.saturating_sub(now().saturating_duration_since(start));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    #[test]
    fn slots_are_freed_for_some_time_in_each_frame() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut pools = Pools::new(ctx.device(), 1);
        let mut queue = RetireQueue::default();
        queue.slots.extend((0..1000).map(DrawSlot));
        // Each look at the clock takes 100 microseconds: three batches fit into a frame.
        let mut time = Instant::now();
        let mut now = || {
            time += Duration::from_micros(100);
            time
        };
        queue.free_in_time(&mut pools, &mut now);
        assert_eq!(queue.slots.len(), 1000 - 3 * SLOTS_PER_LOOK);
        queue.free_in_time(&mut pools, &mut now);
        assert_eq!(queue.slots.len(), 1000 - 3 * SLOTS_PER_LOOK, "no time is left in this frame");
        queue.left_in_frame = MAX_TIME;
        queue.free_in_time(&mut pools, &mut now);
        assert_eq!(queue.slots.len(), 1000 - 6 * SLOTS_PER_LOOK);
        queue.free_all(&mut pools);
        assert!(queue.slots.is_empty());
    }
}
