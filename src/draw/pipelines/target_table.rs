//! The kinds of targets that pipelines are created for, numbered by use. Draw thread.

use super::key::MAX_TARGETS;
use crate::gpu::TargetFormats;

/// Kinds that are kept even if they are not drawn into.
const KEPT: usize = 64;
/// Kinds that were drawn into in the last frames are kept, unless there is no other index left.
const UNUSED_FRAMES: u32 = 300;

/// The formats of targets, each with the frame in which it was last asked for.
#[derive(Debug, Default)]
pub(super) struct TargetTable(Vec<(TargetFormats, u32)>);

/// The index of a kind of target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TargetIndex {
    Known(u16),
    /// The index was that of another kind, whose pipelines are not drawn with any more.
    Replaced(u16),
}

impl TargetTable {
    /// Returns the index of a target's formats in a frame; `None` if too many different ones are in use.
    pub fn index_of(&mut self, formats: &TargetFormats, frame: u32) -> Option<TargetIndex> {
        if let Some(at) = self.0.iter().position(|(known, _)| known == formats) {
            self.0[at].1 = frame;
            return Some(TargetIndex::Known(at as u16));
        }
        let age = |used: u32| frame.wrapping_sub(used);
        let least_age = if self.0.len() < MAX_TARGETS { UNUSED_FRAMES } else { 1 };
        let oldest = self.0.iter().enumerate().max_by_key(|(_, (_, used))| age(*used));
        let replaced = oldest.filter(|(_, (_, used))| self.0.len() >= KEPT && age(*used) > least_age);
        if let Some((at, _)) = replaced {
            self.0[at] = (*formats, frame);
            return Some(TargetIndex::Replaced(at as u16));
        }
        if self.0.len() >= MAX_TARGETS {
            return None;
        }
        self.0.push((*formats, frame));
        Some(TargetIndex::Known(self.0.len() as u16 - 1))
    }

    pub fn formats(&self, index: u16) -> Option<&TargetFormats> {
        self.0.get(usize::from(index)).map(|(formats, _)| formats)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{DEPTH_FORMAT, MAX_COLOR_ATTACHMENTS};

    /// Regression: a 65th kind of target was refused for good.
    #[test]
    fn indices_of_unused_kinds_are_reused_beyond_a_number() {
        // Formats that differ in their samples alone.
        let kind = |samples: usize| TargetFormats {
            colors: [None; MAX_COLOR_ATTACHMENTS],
            depth: DEPTH_FORMAT,
            samples: samples as u32,
            keeps_alpha: false,
        };
        let mut table = TargetTable::default();
        let mut index_of = |samples, frame| table.index_of(&kind(samples), frame);
        for samples in 0..200 {
            assert_eq!(index_of(samples, 0), Some(TargetIndex::Known(samples as u16)), "all are in use");
        }
        for samples in 0..199 {
            assert_eq!(index_of(samples, 400), Some(TargetIndex::Known(samples as u16)));
        }
        assert_eq!(index_of(500, 400), Some(TargetIndex::Replaced(199)), "the only one not used for long");
        assert_eq!(index_of(501, 400), Some(TargetIndex::Known(200)));
        for samples in 502..502 + MAX_TARGETS - 201 {
            assert!(matches!(index_of(samples, 401), Some(TargetIndex::Known(_))));
        }
        assert_eq!(index_of(9_999, 401), None, "the others are those of this frame and the last");
        assert!(matches!(index_of(9_999, 402), Some(TargetIndex::Replaced(_))));
        assert_eq!(table.formats(199), Some(&kind(500)));
    }
}
