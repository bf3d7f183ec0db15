//! The bins of a stage where the application draws some of them itself. Draw thread.

use crate::cull::RenderBin;
use crate::draw::callbacks::{BinCallback, RenderInfo};
use crate::draw::state::{Sources, State};

/// A bin, and those nested in it, that a [`BinCallback`] is to draw.
pub struct BinDrawing<'a, 'p, 'e> {
    state: &'a mut State<'p, 'e>,
    from: &'a Sources<'a>,
    info: &'a RenderInfo<'a>,
    bins: Bins<'a>,
    depth: usize,
}

impl<'e> BinDrawing<'_, '_, 'e> {
    /// Its own leaves and those of the bins nested in it, in draw order.
    pub fn bins(&self) -> &[RenderBin] {
        self.bins.bins
    }

    /// Draws it as it would be drawn without the callback; any number of times, also not at all.
    pub fn draw(&mut self) {
        draw_bins(self.state, self.from, self.info, self.bins, self.depth);
    }

    /// The pass, to draw and to change its state; what [`Self::draw`] needs it sets again.
    pub fn pass(&mut self) -> &mut wgpu::RenderPass<'e> {
        self.state.forget();
        self.state.pass
    }
}

/// Bins in draw order, with where the runs of each begin, and where the last one's end.
#[derive(Clone, Copy)]
pub(in crate::draw) struct Bins<'a> {
    pub(in crate::draw) bins: &'a [RenderBin],
    pub(in crate::draw) starts: &'a [u32],
}

impl<'a> Bins<'a> {
    fn part(self, part: std::ops::Range<usize>) -> Self {
        let starts = self.starts.get(part.start..part.end + 1).unwrap_or_default();
        Self { bins: self.bins.get(part).unwrap_or_default(), starts }
    }

    /// How many of the first bins are inside the same one at a depth.
    fn nested(self, depth: usize) -> usize {
        let bin_at = |bin: &RenderBin| bin.path.get(depth).copied();
        match self.bins.first().and_then(bin_at) {
            Some(first) => self.bins.iter().take_while(|bin| bin_at(bin) == Some(first)).count(),
            None => 1,
        }
    }

    /// Apart: those that end before a run, and the others. Bins inside the same one stay together.
    pub(in crate::draw) fn split_before(self, run: usize) -> (Self, Self) {
        let mut at = 0;
        while at < self.bins.len() {
            let next = at + self.part(at..self.bins.len()).nested(0);
            if self.starts.get(next).is_none_or(|end| *end as usize > run) {
                break;
            }
            at = next;
        }
        (self.part(0..at), self.part(at..self.bins.len()))
    }
}

/// Draws bins that are inside the same `depth` bins, or has them drawn.
pub(in crate::draw) fn draw_bins(
    state: &mut State<'_, '_>,
    from: &Sources<'_>,
    info: &RenderInfo<'_>,
    mut bins: Bins<'_>,
    depth: usize,
) {
    while !bins.bins.is_empty() {
        let count = bins.nested(depth);
        let group = bins.part(0..count);
        bins = bins.part(count..bins.bins.len());
        let hook = group.bins.iter().find_map(|bin| bin.callbacks.get(depth)?.as_ref());
        if let Some(callback) = hook.and_then(BinCallback::of) {
            let mut drawing = BinDrawing { state: &mut *state, from, info, bins: group, depth: depth + 1 };
            (callback.draw)(info, &mut drawing);
        } else if group.bins.iter().any(|bin| bin.callbacks.len() > depth + 1) {
            draw_bins(state, from, info, group, depth + 1);
        } else if let [first, .., last] = group.starts {
            state.draw_runs(from, *first as usize..*last as usize);
        }
    }
}
