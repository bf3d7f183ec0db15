//! [`SlotAllocator`]: the free list of a block whose slots all have one size, and the size classes of slots. Draw
//! thread; plain values.

/// Hands out the slots `0..capacity`, the last freed first.
#[derive(Debug)]
pub(super) struct SlotAllocator {
    free: Vec<u32>,
    capacity: u32,
}

impl SlotAllocator {
    pub(super) fn new(capacity: u32) -> Self {
        // Reversed, so that the lowest slots are handed out first.
        Self { free: (0..capacity).rev().collect(), capacity }
    }

    pub(super) fn allocate(&mut self) -> Option<u32> {
        self.free.pop()
    }

    pub(super) fn release(&mut self, slot: u32) {
        debug_assert!(slot < self.capacity && !self.free.contains(&slot), "slot {slot} was released twice");
        self.free.push(slot);
    }

    /// Adds slots, up to a number.
    pub(super) fn grow(&mut self, capacity: u32) {
        self.free.extend((self.capacity..capacity).rev());
        self.capacity = self.capacity.max(capacity);
    }

    pub(super) fn capacity(&self) -> u32 {
        self.capacity
    }

    pub(super) fn is_empty(&self) -> bool {
        self.free.len() as u32 == self.capacity
    }
}

/// Rounds a length up to its size class. Each octave has eight classes, so that at most an eighth is wasted.
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
    fn slots_are_reused_last_freed_first() {
        let mut slots = SlotAllocator::new(3);
        assert_eq!([slots.allocate(), slots.allocate(), slots.allocate()], [Some(0), Some(1), Some(2)]);
        assert_eq!(slots.allocate(), None);
        slots.release(1);
        assert_eq!(slots.allocate(), Some(1));
        for s in 0..3 {
            slots.release(s);
        }
        assert!(slots.is_empty());
        slots.grow(5);
        assert_eq!([slots.allocate(), slots.allocate(), slots.capacity().into()], [Some(3), Some(4), Some(5)]);
        assert!(!slots.is_empty());
    }

    #[test]
    fn size_classes_waste_at_most_an_eighth() {
        for length in 64..100_000u32 {
            let class = size_class(length);
            assert!(class >= length && class as f64 <= 1.125 * length as f64 + 1.0, "{length} {class}");
            assert_eq!(size_class(class), class);
        }
    }
}
