//! The report of a flight: one JSON document with a stable schema. Made after the last frame, on the main thread.
//!
//! Fields are only ever added. Times are milliseconds unless the name says otherwise.

use serde::{Deserialize, Serialize};

use super::stats::{FrameStats, Samples};
use super::{Viewer, ViewerError};
use crate::io::CacheStats;
use crate::pager::{ErrorRecord, ImagePagerStats, PagerStats};

/// The whole report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// "terrane".
    pub tool: String,
    /// Version of the tool.
    pub version: String,
    /// Name of the adapter that drew.
    pub adapter: String,
    /// Threading model.
    pub threading: String,
    /// Width and height of the picture in pixels.
    pub size: [u32; 2],
    /// Frames rendered.
    pub frames: u32,
    /// Whole frame on the main thread.
    pub frame_ms: FrameTimes,
    /// Phases of the frame.
    pub phase_ms: Phases,
    /// GPU time; `null` where the adapter has no timestamps.
    pub gpu_ms: Option<Times>,
    /// What the pager did with tiles.
    pub tiles: Tiles,
    /// Bytes moved and held.
    pub bytes: Bytes,
    /// What the cache on disk did; `null` without one.
    #[serde(default)]
    pub cache: Option<CacheStats>,
    /// What equal contents shared; `null` where nothing is shared.
    #[serde(default)]
    pub sharing: Option<Sharing>,
    /// What the image pager did; `null` without image sequences.
    #[serde(default)]
    pub images: Option<Images>,
    /// Seconds from the first frame to nothing wanted and nothing pending at the first camera; `null` when the
    /// camera left before.
    pub converge_s: Option<f64>,
    /// Medians per frame.
    pub draw: DrawMedians,
    /// Frames longer than twice the median.
    pub hitches: u32,
    /// Background pixels below the horizon, summed over all frames; `null` unless asked for.
    pub holes: Option<u64>,
    /// The settled picture; `null` unless asked for.
    pub settled: Option<Settled>,
    /// What failed, each URI and reason once.
    pub errors: Vec<ReportError>,
}

/// Distribution of whole frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names are the documentation")]
pub struct FrameTimes {
    pub median: f64,
    pub p95: f64,
    pub p99: f64,
    pub max: f64,
}

/// Distribution of one phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names are the documentation")]
pub struct Times {
    pub median: f64,
    pub p99: f64,
    pub max: f64,
}

/// Phases of the frame; `update` contains `merge`; `draw` and `compile` may overlap the next frame's update.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names are the documentation")]
pub struct Phases {
    pub event: Times,
    pub update: Times,
    pub merge: Times,
    pub cull: Times,
    pub draw: Times,
    pub compile: Times,
}

/// Counters of the pager.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names are the documentation")]
pub struct Tiles {
    pub requested: u64,
    pub loaded: u64,
    pub merged: u64,
    pub expired: u64,
    pub failed: u64,
    pub cancelled: u64,
    pub stale: u64,
}

/// Bytes moved and the peaks of what was held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bytes {
    /// From files and network together.
    pub read: u64,
    /// From the network.
    pub http: u64,
    /// After decoding.
    pub decoded: u64,
    /// Most that the pools held at once.
    pub gpu_peak: u64,
    /// Most that pages held at once.
    pub cpu_peak: u64,
    /// Most that the system gave the process; 0 where the system does not say.
    pub rss_peak: u64,
}

/// Equal contents of tiles: how often they were found, and what it saved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sharing {
    /// Images and textures that another tile had already.
    pub texture_hits: u64,
    /// Meshes and height tiles that another tile had already.
    pub geometry_hits: u64,
    /// State sets that another tile had already.
    pub state_set_hits: u64,
    /// Images that were not decoded again.
    pub decodes_spared: u64,
    /// Payloads that were dropped at once or never made.
    pub payload_bytes_spared: u64,
    /// What merged tiles would hold besides on the CPU at the end.
    pub cpu_bytes_saved: u64,
    /// What merged tiles would hold besides on the GPU at the end.
    pub gpu_bytes_saved: u64,
    /// Most that `gpu_bytes_saved` was.
    pub gpu_bytes_saved_peak: u64,
    /// Shared contents at the end.
    pub entries: u64,
    /// Contents that were forgotten because nobody shared them any more.
    pub pruned: u64,
}

impl Sharing {
    fn of(pager: &PagerStats) -> Self {
        let s = &pager.sharing;
        Self {
            texture_hits: s.texture_hits,
            geometry_hits: s.geometry_hits,
            state_set_hits: s.state_set_hits,
            decodes_spared: s.decodes_spared,
            payload_bytes_spared: s.payload_bytes_spared,
            cpu_bytes_saved: pager.shared_cpu_bytes_saved,
            gpu_bytes_saved: pager.shared_gpu_bytes_saved,
            gpu_bytes_saved_peak: pager.shared_gpu_bytes_saved_peak,
            entries: s.entries,
            pruned: s.pruned,
        }
    }
}

/// Counters of the image pager.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Images {
    /// Read and decoded.
    pub loaded: u64,
    /// Reads that failed.
    pub failed: u64,
    /// Reads that were given up: nobody wanted the image any more.
    #[serde(default)]
    pub cancelled: u64,
    /// Paged out.
    pub paged_out: u64,
    /// Began to be shown.
    pub shown: u64,
    /// Times that an earlier image stayed, because the one of the moment was not there.
    pub late: u64,
    /// Bytes read.
    pub read: u64,
    /// Most decoded images at once.
    pub images_peak: u64,
    /// Most bytes of decoded images at once.
    pub bytes_peak: u64,
}

impl Images {
    fn of(s: &ImagePagerStats) -> Self {
        Self {
            loaded: s.loaded,
            failed: s.failed,
            cancelled: s.cancelled,
            paged_out: s.paged_out,
            shown: s.shown,
            late: s.late,
            read: s.bytes_read,
            images_peak: s.images_peak,
            bytes_peak: s.bytes_peak,
        }
    }
}

/// Medians of what a frame drew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names are the documentation")]
pub struct DrawMedians {
    pub leaves: u64,
    pub draw_calls: u64,
    pub state_changes: u64,
    pub triangles: u64,
    #[serde(default)]
    pub unsampled_leaves: u64,
    #[serde(default)]
    pub shadow_leaves: u64,
    #[serde(default)]
    pub shadow_draw_calls: u64,
}

/// The settled picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settled {
    /// Tiles drawn.
    pub tiles: u64,
    /// Contents drawn.
    pub contents: u64,
    /// Triangles drawn.
    pub triangles: u64,
    /// Points drawn.
    pub points: u64,
    /// Share of pixels that are not background, 0..=1.
    pub coverage: f64,
}

/// One thing that failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReportError {
    /// What could not be had; `draw` for what could not be drawn as it should.
    pub uri: String,
    /// Why.
    pub reason: String,
    /// How often it was tried.
    pub count: u64,
}

impl Times {
    fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let s = Samples::new(values);
        Self { median: rounded(s.median()), p99: rounded(s.percentile(0.99)), max: rounded(s.max()) }
    }
}

/// A thousandth of a microsecond is noise; shorter numbers make reports easier to compare.
fn rounded(ms: f64) -> f64 {
    (ms * 1e6).round() / 1e6
}

impl Report {
    /// A report on some frames; counters that are not per frame are filled in by the caller.
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
        }
    }

    /// The report as indented JSON with a newline at the end.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("a report holds strings and finite numbers only");
        text.push('\n');
        text
    }
}

impl Viewer {
    /// The report on all frames so far; waits for those still being drawn.
    pub fn report(&mut self) -> Result<Report, ViewerError> {
        self.base.absorb_all()?;
        let mut report = Report::from_frames(self.base.history.iter());
        report.frames = self.base.history.count();
        report.adapter = self.adapter_name().to_owned();
        report.threading = self.threading_model().to_string();
        report.size = self.size_px();
        report.converge_s = self.converge_s;
        report.bytes.gpu_peak = self.base.gpu_bytes_peak;
        if let Some(pager) = self.pager() {
            let s = pager.stats();
            report.tiles = Tiles {
                requested: s.requested,
                loaded: s.loaded,
                merged: s.merged,
                expired: s.expired,
                failed: s.failed,
                cancelled: s.cancelled,
                stale: s.stale,
            };
            report.bytes = Bytes {
                read: s.bytes_read,
                http: s.bytes_http,
                decoded: s.bytes_decoded,
                cpu_peak: s.cpu_bytes_peak,
                ..report.bytes
            };
            report.cache = pager.cache_stats();
            report.sharing = pager.sharing().map(|_| Sharing::of(s));
            report.errors = pager
                .errors()
                .into_iter()
                .map(|e| ReportError { uri: e.uri.to_string(), reason: e.reason.to_string(), count: e.count })
                .collect();
        }
        if let Some(images) = self.image_pager() {
            report.images = Some(Images::of(images.stats()));
            let record =
                |e: ErrorRecord| ReportError { uri: e.uri.to_string(), reason: e.reason.to_string(), count: e.count };
            report.errors.extend(images.errors().into_iter().map(record));
        }
        let of_draw = |reason: &String| ReportError { uri: "draw".into(), reason: reason.clone(), count: 1 };
        report.errors.extend(self.base.draw_errors.iter().map(of_draw));
        Ok(report)
    }
}

/// Most bytes of memory that the system has given this process; 0 where the system does not say.
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
