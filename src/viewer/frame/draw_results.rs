//! [`DrawResults`]: the statistics, errors and memory peaks that drawn frames reported. Main thread.

use super::stats::{FrameStats, StatsHistory};
use crate::draw::DrawStats;

/// Results of all frames so far.
#[derive(Debug)]
pub(in crate::viewer) struct DrawResults {
    history: StatsHistory,
    /// Problems while drawing, each listed once.
    errors: Vec<String>,
    /// The largest number of bytes that the GPU pools held.
    gpu_bytes_peak: u64,
    /// Milliseconds of reading back in the frame being measured; they do not count as frame time.
    read_back_ms: f64,
}

/// Figures of one drawn frame in one context.
pub(super) struct ContextFigures {
    pub(super) drawn: DrawStats,
    pub(super) draw_ms: f64,
    pub(super) compile_ms: f64,
    pub(super) gpu_bytes: u64,
    pub(super) gpu_bytes_allocated: u64,
    /// All contexts have drawn the frame.
    pub(super) is_complete: bool,
}

impl DrawResults {
    pub(super) fn new(history_frames: usize) -> Self {
        Self { history: StatsHistory::new(history_frames), errors: Vec::new(), gpu_bytes_peak: 0, read_back_ms: 0.0 }
    }

    pub(in crate::viewer) fn history(&self) -> &StatsHistory {
        &self.history
    }

    /// Switches the statistics of frames on or off.
    pub(in crate::viewer) fn set_stats(&mut self, is_on: bool) {
        self.history.set_on(is_on);
    }

    pub(in crate::viewer) fn errors(&self) -> &[String] {
        &self.errors
    }

    pub(in crate::viewer) fn gpu_bytes_peak(&self) -> u64 {
        self.gpu_bytes_peak
    }

    pub(super) fn begin_frame(&mut self) {
        self.read_back_ms = 0.0;
    }

    /// Adds the main thread's part of a frame; [`Self::add_drawn`] completes it.
    pub(super) fn push(&mut self, stats: FrameStats) {
        self.history.push(stats);
    }

    /// Sets the duration of a frame, without the time that reading back took.
    pub(super) fn set_frame_ms(&mut self, frame: u32, whole_ms: f64) {
        let frame_ms = (whole_ms - self.read_back_ms).max(0.0);
        if let Some(stats) = self.history.frame_mut(frame) {
            stats.frame_ms = frame_ms;
        }
    }

    pub(super) fn add_read_back_ms(&mut self, ms: f64) {
        self.read_back_ms += ms;
    }

    pub(super) fn add_error(&mut self, error: String) {
        self.errors.push(error);
    }

    /// Takes what a drawn frame reports besides its figures.
    pub(super) fn add_report(&mut self, errors: Vec<String>, gpu_bytes_peak: u64) {
        self.errors.extend(errors);
        self.gpu_bytes_peak = self.gpu_bytes_peak.max(gpu_bytes_peak);
    }

    /// Adds the figures of a context to a frame: times are the longest of all contexts, counters their sum.
    pub(super) fn add_drawn(&mut self, frame: u32, figures: &ContextFigures) {
        let ContextFigures { drawn, draw_ms, compile_ms, gpu_bytes, gpu_bytes_allocated, is_complete } = figures;
        let Some(stats) = self.history.frame_mut(frame) else { return };
        stats.draw_ms = stats.draw_ms.max(*draw_ms);
        stats.compile_ms = stats.compile_ms.max(*compile_ms);
        stats.gpu_ms = drawn.gpu_ms.map(|ms| ms.max(stats.gpu_ms.unwrap_or(0.0))).or(stats.gpu_ms);
        stats.skipped += u32::from(drawn.skipped);
        stats.leaves += drawn.leaves;
        stats.unsampled_leaves += drawn.unsampled_leaves;
        stats.draw_calls += drawn.draw_calls;
        stats.shadow_leaves += drawn.shadow_leaves;
        stats.shadow_draw_calls += drawn.shadow_draw_calls;
        stats.pipelines_created += drawn.pipelines_created;
        stats.pipelines_created_by_thread += drawn.pipelines_created_by_thread;
        stats.state_changes += drawn.state_changes;
        stats.state_changes_skipped += drawn.state_changes_skipped;
        stats.triangles += drawn.triangles;
        stats.points += drawn.points;
        stats.gpu_bytes += gpu_bytes;
        stats.gpu_bytes_allocated += gpu_bytes_allocated;
        stats.drawn = *is_complete;
    }
}
