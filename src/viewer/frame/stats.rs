//! [`FrameStats`]: times and counters of each frame. Written on the main thread; the figures of the draw thread arrive with
//! its answer, up to two frames later.

use std::collections::VecDeque;
use std::ops::RangeInclusive;
use std::time::Duration;

use crate::viewer::rendering::ThreadingModel;

/// Times in milliseconds and counters of one frame. More than 16 fields: one for each figure of the report.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameStats {
    /// The number of the frame; the first is 1.
    pub frame: u32,
    /// The whole frame on the main thread, including the wait for a free render stage, without reading images back.
    pub frame_ms: f64,
    /// Handlers and manipulator.
    pub event_ms: f64,
    /// Everything that has `&mut Scene`, the merge included.
    pub update_ms: f64,
    /// The pager's part of update: takes results, merges, expires, sorts requests.
    pub merge_ms: f64,
    /// Scene to render stage.
    pub cull_ms: f64,
    /// Render stage to submitted commands, on the thread that owns the context.
    pub draw_ms: f64,
    /// Uploads, on the thread that owns the context.
    pub compile_ms: f64,
    /// GPU time where the adapter has timestamps; on software adapters only while a timeline is recorded.
    pub gpu_ms: Option<f64>,
    /// Windows that had no image to draw into: hidden, late, or with a lost or outdated surface.
    pub skipped: u32,
    /// Leaves drawn.
    pub leaves: u32,
    /// Leaves that were skipped because they cover no sample.
    pub unsampled_leaves: u32,
    /// Draw calls recorded.
    pub draw_calls: u32,
    /// Leaves drawn into shadow maps.
    pub shadow_leaves: u32,
    /// Draw calls into shadow maps; they are part of `draw_calls`.
    pub shadow_draw_calls: u32,
    /// Pipelines that were created while the frame was drawn, which waited for them. 0 once a view has drawn its first frames,
    /// unless the scene graph changes or [`EnvironmentChanges::AtOnce`](crate::viewer::EnvironmentChanges) asks for it.
    pub pipelines_created: u32,
    /// Pipelines that another thread has created and that are in use since the frame before: those of contents that were
    /// loaded, and of changes of the environment.
    pub pipelines_created_by_thread: u32,
    /// State changes recorded.
    pub state_changes: u32,
    /// State changes that were redundant and skipped.
    pub state_changes_skipped: u32,
    /// Triangles drawn.
    pub triangles: u64,
    /// Points drawn.
    pub points: u64,
    /// Tiles whose content was drawn.
    pub tiles_drawn: u32,
    /// Tiles visited by cull.
    pub tiles_visited: u32,
    /// Nodes, drawables and tiles behind occluders.
    pub occluded: u32,
    /// Tiles wanted but not drawn at the wanted level.
    pub wanted_missing: u32,
    /// GPU bytes in use in the pools of all contexts, after the frame was drawn.
    pub gpu_bytes: u64,
    /// GPU bytes that the pools of all contexts have allocated, free slots of blocks included.
    pub gpu_bytes_allocated: u64,
    /// True once all draw threads have answered.
    pub drawn: bool,
}

/// The number of past frames from which the next frame time is estimated.
const BUSY_FRAMES: usize = 4;
/// More frames than are in flight, so that the figures of the draw thread find theirs.
const AWAITED_FRAMES: usize = 4;

/// The frames of a run, newest last; drops the oldest beyond a limit.
#[derive(Debug)]
pub struct StatsHistory {
    frames: VecDeque<FrameStats>,
    limit: usize,
    /// The number of frames, including dropped ones.
    count: u32,
    /// False keeps the frames that the pace of uploads needs, and shows none.
    is_on: bool,
}

impl StatsHistory {
    /// Creates a history of at most `limit` frames; memory for the first 4,096 is allocated at once.
    pub fn new(limit: usize) -> Self {
        Self { frames: VecDeque::with_capacity(limit.clamp(1, 4096)), limit: limit.max(1), count: 0, is_on: true }
    }

    /// Returns true while statistics are kept.
    pub fn is_on(&self) -> bool {
        self.is_on
    }

    /// Switches the history on or off; its frames are gone then. While it is off it is empty.
    pub(in crate::viewer) fn set_on(&mut self, is_on: bool) {
        if self.is_on != is_on {
            self.is_on = is_on;
            self.clear();
        }
    }

    /// Adds a frame.
    pub fn push(&mut self, stats: FrameStats) {
        let limit = if self.is_on { self.limit } else { AWAITED_FRAMES + BUSY_FRAMES };
        if self.frames.len() >= limit {
            self.frames.pop_front();
        }
        self.frames.push_back(stats);
        self.count += u32::from(self.is_on);
    }

    /// Returns the record of a frame, to add the draw thread's figures.
    pub fn frame_mut(&mut self, frame: u32) -> Option<&mut FrameStats> {
        self.frames.iter_mut().rev().find(|s| s.frame == frame)
    }

    /// Returns the frames, newest last.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &FrameStats> + ExactSizeIterator + Clone {
        self.frames.range(if self.is_on { 0 } else { self.frames.len() }..)
    }

    /// Returns the number of frames since the last clear, including dropped ones.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Returns the newest frame.
    pub fn last(&self) -> Option<&FrameStats> {
        self.iter().next_back()
    }

    /// Returns the newest frame that is drawn.
    pub fn last_drawn(&self) -> Option<&FrameStats> {
        self.iter().rev().find(|s| s.drawn)
    }

    /// Returns the shortest and the longest time for which one of the last frames kept the drawing thread or the adapter busy,
    /// without uploads. Both are zero before the first frame.
    pub(in crate::viewer) fn busy(&self, model: ThreadingModel) -> RangeInclusive<Duration> {
        let before_draw = |s: &FrameStats| match model {
            ThreadingModel::SingleThreaded => s.event_ms + s.update_ms + s.cull_ms,
            ThreadingModel::CullDrawThreadPerContext => s.cull_ms,
            _ => 0.0,
        };
        let drawn = self.frames.iter().rev().filter(|s| s.drawn).take(BUSY_FRAMES);
        let busy_ms = drawn.map(|s| (before_draw(s) + s.draw_ms).max(s.gpu_ms.unwrap_or(0.0)));
        let duration = |ms: f64| Duration::try_from_secs_f64(1e-3 * ms).unwrap_or_default();
        let shortest = duration(busy_ms.clone().reduce(f64::min).unwrap_or(0.0));
        shortest..=duration(busy_ms.fold(0.0, f64::max)).max(shortest)
    }

    /// Removes all frames, for example after a warm-up.
    pub fn clear(&mut self) {
        self.count = 0;
        self.frames.clear();
    }
}

/// Sorted samples, for percentiles.
#[derive(Clone, Debug, Default)]
pub struct Samples(Vec<f64>);

impl Samples {
    /// Sorts the values; those that are not finite are left out.
    pub fn new(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        Self(values)
    }

    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns true when there are no samples.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the nearest-rank percentile for a `share` in 0..=1; 0 without samples.
    pub fn percentile(&self, share: f64) -> f64 {
        let rank = (share.clamp(0.0, 1.0) * self.0.len() as f64).ceil() as usize;
        self.0.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
    }

    /// Returns the 50th percentile.
    pub fn median(&self) -> f64 {
        self.percentile(0.5)
    }

    /// Returns the largest sample; 0 without samples.
    pub fn max(&self) -> f64 {
        self.0.last().copied().unwrap_or(0.0)
    }

    /// Returns the number of samples above a limit.
    pub fn above(&self, limit: f64) -> usize {
        self.0.len() - self.0.partition_point(|v| *v <= limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn busy_time_is_the_longest_of_the_last_frames() {
        let mut history = StatsHistory::new(100);
        let rounded = |busy: &Duration| (1e3 * busy.as_secs_f64()).round();
        let ms = |history: &StatsHistory, model| rounded(history.busy(model).end());
        assert_eq!(ms(&history, ThreadingModel::SingleThreaded), 0.0, "no frame yet");
        let frame = |draw_ms: f64, drawn| FrameStats {
            event_ms: 1.0,
            update_ms: 2.0,
            cull_ms: 4.0,
            draw_ms,
            compile_ms: 1000.0,
            drawn,
            ..FrameStats::default()
        };
        for (draw_ms, drawn) in [(90.0, true), (10.0, true), (20.0, true), (10.0, true), (10.0, true), (0.0, false)] {
            history.push(frame(draw_ms, drawn));
        }
        let models = ThreadingModel::ALL;
        assert_eq!(models.map(|model| ms(&history, model)), [27.0, 24.0, 20.0, 20.0]);
        assert_eq!(models.map(|model| rounded(history.busy(model).start())), [17.0, 14.0, 10.0, 10.0], "the shortest");
        history.push(FrameStats { gpu_ms: Some(25.0), ..frame(10.0, true) });
        assert_eq!(models.map(|model| ms(&history, model)), [27.0, 25.0, 25.0, 25.0]);
        history.push(frame(f64::NAN, true));
        assert_eq!(ms(&history, ThreadingModel::DrawThreadPerContext), 25.0);
    }

    #[test]
    fn history_that_is_off_shows_nothing_but_times_uploads() {
        let mut history = StatsHistory::new(100);
        let frame = |frame| FrameStats { frame, draw_ms: 5.0, drawn: true, ..FrameStats::default() };
        history.push(frame(1));
        history.set_on(false);
        (2..40).for_each(|number| history.push(frame(number)));
        assert_eq!((history.iter().len(), history.count(), history.last(), history.last_drawn()), (0, 0, None, None));
        assert!(history.frames.len() < 10 && history.frame_mut(39).is_some());
        assert!(history.busy(ThreadingModel::DrawThreadPerContext).end().as_millis() == 5);
        history.set_on(true);
        history.push(frame(40));
        assert_eq!((history.iter().len(), history.count(), history.last().map(|s| s.frame)), (1, 1, Some(40)));
    }

    #[test]
    fn percentiles_are_nearest_rank() {
        let s = Samples::new((1..=100).rev().map(f64::from).chain([f64::NAN]));
        assert_eq!((s.median(), s.percentile(0.95), s.percentile(0.99), s.max()), (50.0, 95.0, 99.0, 100.0));
        assert_eq!(s.above(90.0), 10);
        assert_eq!(Samples::default().median(), 0.0);
    }

    #[test]
    fn history_drops_the_oldest() {
        let mut history = StatsHistory::new(3);
        for frame in 1..=5 {
            history.push(FrameStats { frame, ..FrameStats::default() });
        }
        assert_eq!(history.iter().map(|s| s.frame).collect::<Vec<_>>(), [3, 4, 5]);
        assert!(history.frame_mut(2).is_none());
        assert!(history.frame_mut(4).is_some());
    }
}
