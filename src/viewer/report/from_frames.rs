//! Fills a [`Report`] from the statistics of its frames.

use std::collections::BTreeMap;

use super::schema::{Bytes, DrawMedians, FrameTimes, Phases, Report, Tiles, Times};
use crate::viewer::frame::{FrameStats, Samples};

impl Times {
    fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let s = Samples::new(values);
        Self { median: rounded(s.median()), p99: rounded(s.percentile(0.99)), max: rounded(s.max()) }
    }
}

/// Rounds milliseconds to nanoseconds; more digits are noise and make reports harder to compare.
fn rounded(ms: f64) -> f64 {
    (ms * 1e6).round() / 1e6
}

impl Report {
    /// Creates a report on frames; the caller fills in the counters that are not per frame.
    pub fn from_frames<'a>(frames: impl Iterator<Item = &'a FrameStats> + Clone) -> Self {
        let whole = Samples::new(frames.clone().map(|f| f.frame_ms));
        let drawn = frames.clone().filter(|f| f.drawn);
        let median = |value: fn(&FrameStats) -> f64| Samples::new(drawn.clone().map(value)).median() as u64;
        let gpu = Samples::new(drawn.clone().filter_map(|f| f.gpu_ms));
        Self {
            tool: "terrane".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            adapter: String::new(),
            threading: String::new(),
            size: [0, 0],
            frames: whole.len() as u32,
            frame_ms: FrameTimes {
                median: rounded(whole.median()),
                p95: rounded(whole.percentile(0.95)),
                p99: rounded(whole.percentile(0.99)),
                max: rounded(whole.max()),
            },
            phase_ms: Phases {
                event: Times::of(frames.clone().map(|f| f.event_ms)),
                update: Times::of(frames.clone().map(|f| f.update_ms)),
                merge: Times::of(frames.clone().map(|f| f.merge_ms)),
                cull: Times::of(frames.map(|f| f.cull_ms)),
                draw: Times::of(drawn.clone().map(|f| f.draw_ms)),
                compile: Times::of(drawn.clone().map(|f| f.compile_ms)),
            },
            gpu_ms: (!gpu.is_empty()).then(|| Times {
                median: rounded(gpu.median()),
                p99: rounded(gpu.percentile(0.99)),
                max: rounded(gpu.max()),
            }),
            tiles: Tiles::default(),
            bytes: Bytes { rss_peak: rss_peak_bytes(), ..Bytes::default() },
            cache: None,
            sharing: None,
            images: None,
            converge_s: None,
            draw: DrawMedians {
                leaves: median(|f| f64::from(f.leaves)),
                draw_calls: median(|f| f64::from(f.draw_calls)),
                state_changes: median(|f| f64::from(f.state_changes)),
                triangles: median(|f| f.triangles as f64),
                unsampled_leaves: median(|f| f64::from(f.unsampled_leaves)),
                shadow_leaves: median(|f| f64::from(f.shadow_leaves)),
                shadow_draw_calls: median(|f| f64::from(f.shadow_draw_calls)),
            },
            hitches: whole.above(2.0 * whole.median()) as u32,
            holes: None,
            settled: None,
            errors: Vec::new(),
            ignored: BTreeMap::new(),
        }
    }
}

/// Returns the peak resident memory of this process, bytes; 0 when the system does not report it.
fn rss_peak_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    line.and_then(|l| l.trim().strip_suffix("kB")).and_then(|kb| kb.trim().parse::<u64>().ok()).unwrap_or(0) * 1024
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hitches_are_frames_longer_than_twice_the_median() {
        let frames: Vec<_> = [1.0, 1.0, 1.0, 2.0, 2.1]
            .map(|frame_ms| FrameStats { frame_ms, drawn: true, leaves: 7, ..FrameStats::default() })
            .into();
        let report = Report::from_frames(frames.iter());
        assert_eq!((report.hitches, report.frames, report.draw.leaves), (1, 5, 7));
        assert_eq!(report.gpu_ms, None);
    }
}
