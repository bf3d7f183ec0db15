//! Callbacks of render bins, and the drawing of a stage's bins one by one around them. Draw thread.

use std::ops::Range;
use std::sync::Arc;

use super::callbacks::info::RenderInfo;
use super::recorder::{DrawSources, PassRecorder};
use crate::cull::{RenderBin, RenderStage};
use crate::state::{DataVariance, OpaqueDrawData};

type OnBin = Box<dyn Fn(&RenderInfo<'_>, &mut BinDrawing<'_, '_, '_>) + Send + Sync>;

/// Draws a render bin instead of the renderer, or around it; OSG's `RenderBin::DrawCallback`. It belongs into the state
/// set that names the bin ([`StateSet::bin_callback`](crate::state::StateSet::bin_callback)).
///
/// It is called once for each stage in which the bin has leaves, at the bin's position in the pass. A bin with leaves that
/// write no depth is drawn after the sky. The callback also draws the bins nested in its bin.
pub struct BinCallback {
    /// Draws the bin.
    pub draw: OnBin,
    /// [`DataVariance::Dynamic`] if the update phase changes data that the callback reads.
    pub data_variance: DataVariance,
}

impl BinCallback {
    /// Creates a callback that reads no data that the update phase changes.
    pub fn new(draw: impl Fn(&RenderInfo<'_>, &mut BinDrawing<'_, '_, '_>) + Send + Sync + 'static) -> Self {
        Self { draw: Box::new(draw), data_variance: DataVariance::Static }
    }

    /// Packs the callback for a [`StateSet`](crate::state::StateSet).
    pub fn hook(self) -> OpaqueDrawData {
        OpaqueDrawData(Arc::new(self))
    }

    /// Returns true if some callback of a stage's bins reads data that the update phase changes.
    pub(crate) fn are_dynamic(stage: &RenderStage) -> bool {
        let mut hooks = stage.bins.iter().flat_map(|bin| bin.callbacks.iter().flatten());
        hooks.any(|hook| Self::of(hook).is_some_and(|c| c.data_variance == DataVariance::Dynamic))
    }

    fn of(hook: &OpaqueDrawData) -> Option<&Self> {
        hook.0.downcast_ref()
    }
}

/// A bin and the bins nested in it, which a [`BinCallback`] draws.
pub struct BinDrawing<'a, 'p, 'e> {
    recorder: &'a mut PassRecorder<'p, 'e>,
    sources: &'a DrawSources<'a>,
    info: &'a RenderInfo<'a>,
    bins: Bins<'a>,
    depth: usize,
}

impl<'e> BinDrawing<'_, '_, 'e> {
    /// Returns the bin's own leaves and those of the bins nested in it, in draw order.
    pub fn bins(&self) -> &[RenderBin] {
        self.bins.bins
    }

    /// Draws the bin as it would be drawn without the callback. It may be called any number of times.
    pub fn draw(&mut self) {
        draw_bins(self.recorder, self.sources, self.info, self.bins, self.depth);
    }

    /// Returns the render pass, for drawing and for changing its state. [`Self::draw`] sets the state that it needs
    /// again.
    pub fn pass(&mut self) -> &mut wgpu::RenderPass<'e> {
        self.recorder.forget();
        self.recorder.pass
    }
}

/// Bins in draw order, with the first run of each and the end of the last one's runs.
#[derive(Clone, Copy)]
pub(in crate::draw) struct Bins<'a> {
    pub(in crate::draw) bins: &'a [RenderBin],
    pub(in crate::draw) starts: &'a [u32],
}

impl<'a> Bins<'a> {
    fn part(self, part: Range<usize>) -> Self {
        let starts = self.starts.get(part.start..part.end + 1).unwrap_or_default();
        Self { bins: self.bins.get(part).unwrap_or_default(), starts }
    }

    /// Returns the number of bins at the front that are nested in the same bin at a depth.
    fn nested(self, depth: usize) -> usize {
        let bin_at = |bin: &RenderBin| bin.path.get(depth).copied();
        match self.bins.first().and_then(bin_at) {
            Some(first) => self.bins.iter().take_while(|bin| bin_at(bin) == Some(first)).count(),
            None => 1,
        }
    }

    /// Splits off the bins that end before a run. Bins nested in the same bin stay together.
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

/// Draws bins that share their first `depth` enclosing bins, or has their callbacks draw them.
pub(in crate::draw) fn draw_bins(
    recorder: &mut PassRecorder<'_, '_>,
    sources: &DrawSources<'_>,
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
            let mut drawing = BinDrawing { recorder: &mut *recorder, sources, info, bins: group, depth: depth + 1 };
            (callback.draw)(info, &mut drawing);
        } else if group.bins.iter().any(|bin| bin.callbacks.len() > depth + 1) {
            draw_bins(recorder, sources, info, group, depth + 1);
        } else if let [first, .., last] = group.starts {
            recorder.draw_runs(sources, *first as usize..*last as usize);
        }
    }
}
