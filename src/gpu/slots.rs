//! Free lists for pools whose places all have one size, and what places are known by. Plain values; used on the draw
//! thread.

use crate::scene::ContentKey;

/// What a payload's place is found by again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Identity {
    /// Whatever has the same content: the payload may be gone.
    Content(ContentKey),
    /// The payload itself.
    Address(usize),
}

impl Identity {
    pub(super) fn new<T: ?Sized>(content: Option<&ContentKey>, payload: *const T) -> Self {
        content.map_or(Self::Address(payload as *const () as usize), |key| Self::Content(*key))
    }
}

/// Hands out the places `0..capacity`, last freed first.
#[derive(Debug)]
pub(super) struct SlotAllocator {
    free: Vec<u32>,
    capacity: u32,
}

impl SlotAllocator {
    pub(super) fn new(capacity: u32) -> Self {
        // Reversed, so that the first places are handed out first.
        Self { free: (0..capacity).rev().collect(), capacity }
    }

    pub(super) fn allocate(&mut self) -> Option<u32> {
        self.free.pop()
    }

    pub(super) fn release(&mut self, slot: u32) {
        debug_assert!(slot < self.capacity && !self.free.contains(&slot), "place {slot} released twice");
        self.free.push(slot);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.free.len() as u32 == self.capacity
    }
}

/// Number of places in the next block of a pool: 16 at first, doubling, so that a small scene does not pay for a
/// large block; never beyond `full` places or `target_bytes` a block, at least one place.
pub(super) fn block_capacity(blocks_so_far: usize, slot_bytes: u64, target_bytes: u64, full: u32) -> u32 {
    let by_bytes = (target_bytes / slot_bytes.max(1)).clamp(1, u64::from(full)) as u32;
    let grown = 16 << blocks_so_far.min(16);
    by_bytes.min(grown).max(1)
}

/// Rounds a length up to its size class: eight classes an octave, so at most an eighth is wasted.
pub(super) fn size_class(length: u32) -> u32 {
    let length = length.max(4);
    let octave = 31 - length.leading_zeros();
    let step = 1u32 << octave.saturating_sub(3);
    length.div_ceil(step).saturating_mul(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_reused_last_freed_first() {
        let mut slots = SlotAllocator::new(3);
        assert_eq!([slots.allocate(), slots.allocate(), slots.allocate()], [Some(0), Some(1), Some(2)]);
        assert_eq!(slots.allocate(), None);
        slots.release(1);
        assert_eq!(slots.allocate(), Some(1));
        for s in 0..3 {
            slots.release(s);
        }
        assert!(slots.is_empty());
    }

    #[test]
    fn size_classes_waste_at_most_an_eighth() {
        for length in 64..100_000u32 {
            let class = size_class(length);
            assert!(class >= length && class as f64 <= 1.125 * length as f64 + 1.0, "{length} {class}");
            assert_eq!(size_class(class), class);
        }
    }

    #[test]
    fn blocks_grow_within_their_bytes() {
        assert_eq!([0, 1, 2, 3, 99].map(|n| block_capacity(n, 1000, 1 << 30, 128)), [16, 32, 64, 128, 128]);
        assert_eq!(block_capacity(3, 1 << 20, 8 << 20, 64), 8);
        assert_eq!(block_capacity(0, 1 << 40, 8 << 20, 64), 1);
    }
}
