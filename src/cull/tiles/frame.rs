//! What holds for the children of a tile that is open.

use std::num::{NonZeroU32, NonZeroU64};

use crate::cull::fade::Fade;
use crate::cull::visitor::Purpose;

/// What holds for the tiles up to `end`.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct TileFrame {
    pub end: u32,
    pub mask: u8,
    pub purpose: Purpose,
    /// Culled tiles are kept (and asked for) too: the parent waits for all of them.
    pub required: bool,
    /// Error in pixels of what is shown while tiles here are missing.
    pub shown_px: f32,
    pub fade: Fade,
}

/// A [`TileFrame`] in two words: handed on in registers, and read back from the stack as it was written. A copy of
/// what was just written in smaller parts waits for all of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct PackedFrame(NonZeroU64, u64);

impl TileFrame {
    /// A copy, a field at a time: one of what was just written so waits for nothing.
    #[inline(always)]
    pub fn read(&self) -> Self {
        let Self { end, mask, purpose, required, shown_px, fade } = *self;
        Self { end, mask, purpose, required, shown_px, fade }
    }

    #[inline(always)]
    pub(super) fn pack(self) -> PackedFrame {
        // A frame with tiles does not end at 0.
        let end = NonZeroU32::new(self.end).unwrap_or(NonZeroU32::MIN);
        let first = NonZeroU64::from(end) | u64::from(self.shown_px.to_bits()) << 32;
        let bits = u32::from(self.mask) | (self.purpose as u32) << 8 | u32::from(self.required) << 16;
        PackedFrame(first, u64::from(self.fade.bits()) | u64::from(bits) << 32)
    }
}

impl PackedFrame {
    #[inline(always)]
    pub fn unpack(self) -> TileFrame {
        let (first, second) = (self.0.get(), self.1);
        TileFrame {
            end: first as u32,
            mask: (second >> 32) as u8,
            purpose: match (second >> 40) as u8 {
                0 => Purpose::Draw,
                1 => Purpose::Want,
                _ => Purpose::Keep,
            },
            required: second >> 48 != 0,
            shown_px: f32::from_bits((first >> 32) as u32),
            fade: Fade::from_bits(second as u32),
        }
    }
}
