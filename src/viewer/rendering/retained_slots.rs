//! [`RetainedSlots`]: released drawables that are kept for some frames; OSG's delete handler. Draw thread.

use std::collections::VecDeque;

use crate::scene::DrawSlot;

/// The drawables that the application wants to be kept, each with the frame after which they were released.
#[derive(Debug, Default)]
pub(super) struct RetainedSlots {
    /// The number of frames for which drawables are kept after the last one that draws them.
    frames: u32,
    /// The frame that was begun last.
    frame: u32,
    slots: VecDeque<(u32, Vec<DrawSlot>)>,
}

impl RetainedSlots {
    /// Sets the number of frames, also for drawables that are kept already.
    pub(super) fn set_frames(&mut self, frames: u32) {
        self.frames = frames;
    }

    /// Takes released drawables; returns them if they are not to be kept.
    pub(super) fn retain(&mut self, slots: Vec<DrawSlot>) -> Option<Vec<DrawSlot>> {
        if self.frames == 0 {
            return Some(slots);
        }
        self.slots.push_back((self.frame, slots));
        None
    }

    /// Begins a frame.
    pub(super) fn begin_frame(&mut self, frame: u32) {
        self.frame = frame;
    }

    /// Takes drawables whose time is over.
    pub(super) fn take_due(&mut self) -> Option<Vec<DrawSlot>> {
        let (released, _) = self.slots.front()?;
        if self.frame.saturating_sub(*released) <= self.frames {
            return None;
        }
        self.take_any()
    }

    /// Takes drawables whose time need not be over.
    pub(super) fn take_any(&mut self) -> Option<Vec<DrawSlot>> {
        self.slots.pop_front().map(|(_, slots)| slots)
    }

    /// Forgets all, after their device was lost.
    pub(super) fn clear(&mut self) {
        self.slots.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawables_are_kept_for_the_given_frames() {
        let mut retained = RetainedSlots::default();
        assert_eq!(retained.retain(vec![DrawSlot(1)]), Some(vec![DrawSlot(1)]), "by default they are not kept");
        retained.set_frames(2);
        retained.begin_frame(5);
        assert_eq!(retained.retain(vec![DrawSlot(2)]), None);
        for frame in 6..=7 {
            retained.begin_frame(frame);
            assert_eq!(retained.take_due(), None, "{frame}");
        }
        assert_eq!(retained.retain(vec![DrawSlot(3)]), None);
        retained.begin_frame(8);
        assert_eq!([retained.take_due(), retained.take_due()], [Some(vec![DrawSlot(2)]), None]);
        retained.set_frames(0);
        assert_eq!(retained.take_due(), Some(vec![DrawSlot(3)]), "a smaller number holds for those that are kept");
        retained.set_frames(9);
        retained.retain(vec![DrawSlot(4)]);
        assert_eq!([retained.take_any(), retained.take_any()], [Some(vec![DrawSlot(4)]), None]);
    }
}
