//! The report's JSON schema. It is stable: fields are only ever added. Plain values.
//!
//! Times are milliseconds unless the name says otherwise.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::fetch::CacheStats;

/// The report on a flight.
///
/// Its many fields are the keys of the JSON document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The name of the program, "terrane".
    pub tool: String,
    /// The version of the program.
    pub version: String,
    /// The name of the graphics adapter.
    pub adapter: String,
    /// The threading model.
    pub threading: String,
    /// Width and height of the image, pixels.
    pub size: [u32; 2],
    /// The number of frames rendered.
    pub frames: u32,
    /// The duration of frames on the main thread.
    pub frame_ms: FrameTimes,
    /// The duration of the phases of a frame.
    pub phase_ms: Phases,
    /// GPU time per frame; `null` when the adapter has no timestamps.
    pub gpu_ms: Option<Times>,
    /// The pager's tile counters.
    pub tiles: Tiles,
    /// Bytes transferred, and peaks of memory use.
    pub bytes: Bytes,
    /// The disk cache's counters; `null` without a disk cache.
    #[serde(default)]
    pub cache: Option<CacheStats>,
    /// Savings from sharing equal content; `null` when sharing is off.
    #[serde(default)]
    pub sharing: Option<Sharing>,
    /// The image pager's counters; `null` without image sequences.
    #[serde(default)]
    pub images: Option<Images>,
    /// Seconds from the first frame until every wanted tile is resident at the camera's first pose; `null` when the camera
    /// moved before that.
    pub converge_s: Option<f64>,
    /// Medians of draw counters per frame.
    pub draw: DrawMedians,
    /// The number of frames that took more than twice the median.
    pub hitches: u32,
    /// Background pixels where terrain must be, summed over all frames; `null` unless requested.
    pub holes: Option<u64>,
    /// Counters of the settled image; `null` unless requested.
    pub settled: Option<Settled>,
    /// The failures, each URI and reason once.
    pub errors: Vec<ReportError>,
    /// The properties that contents have and their readers leave out, counted by kind.
    #[serde(default)]
    pub ignored: BTreeMap<String, u64>,
}

/// The distribution of whole frames, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names are the documentation")]
pub struct FrameTimes {
    pub median: f64,
    pub p95: f64,
    pub p99: f64,
    pub max: f64,
}

/// The distribution of one phase, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names are the documentation")]
pub struct Times {
    pub median: f64,
    pub p99: f64,
    pub max: f64,
}

/// The phases of a frame. `update` contains `merge`; `draw` and `compile` may overlap the next frame's update.
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

/// The pager's tile counters.
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

/// Bytes transferred, and peaks of memory use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bytes {
    /// Bytes read from files and network together.
    pub read: u64,
    /// Bytes received from the network.
    pub http: u64,
    /// Bytes after decoding.
    pub decoded: u64,
    /// The peak of the GPU pools.
    pub gpu_peak: u64,
    /// The peak of the pages in CPU memory.
    pub cpu_peak: u64,
    /// The peak of what was on its way: read and not decoded, or decoded and not merged.
    #[serde(default)]
    pub loading_peak: u64,
    /// Loads that waited until bytes were free.
    #[serde(default)]
    pub loading_waits: u64,
    /// The time that they waited, all together, milliseconds.
    #[serde(default)]
    pub loading_wait_ms: u64,
    /// The peak resident memory of the process; 0 when the system does not report it.
    pub rss_peak: u64,
}

/// Equal content of different tiles: how often it was found, and the memory it saved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sharing {
    /// Images and textures that another tile already had.
    pub texture_hits: u64,
    /// Meshes and height tiles that another tile already had.
    pub geometry_hits: u64,
    /// State sets that another tile already had.
    pub state_set_hits: u64,
    /// Images that did not need decoding again.
    pub decodes_spared: u64,
    /// Bytes of payloads that were dropped at once or never created.
    pub payload_bytes_spared: u64,
    /// CPU memory saved in the merged tiles at the end, bytes.
    pub cpu_bytes_saved: u64,
    /// GPU memory saved in the merged tiles at the end, bytes.
    pub gpu_bytes_saved: u64,
    /// The peak of `gpu_bytes_saved`.
    pub gpu_bytes_saved_peak: u64,
    /// Entries in the table of shared content at the end.
    pub entries: u64,
    /// Entries removed after their last user was gone.
    pub pruned: u64,
}

/// The image pager's counters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Images {
    /// Images read and decoded.
    pub loaded: u64,
    /// Reads that failed.
    pub failed: u64,
    /// Reads cancelled because the image was no longer wanted.
    #[serde(default)]
    pub cancelled: u64,
    /// Images paged out.
    pub paged_out: u64,
    /// Images that started to be shown.
    pub shown: u64,
    /// Times that an earlier image stayed because the current one was not resident.
    pub late: u64,
    /// Bytes read.
    pub read: u64,
    /// The peak number of decoded images.
    pub images_peak: u64,
    /// The peak bytes of decoded images.
    pub bytes_peak: u64,
}

/// Medians per frame of the draw counters.
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

/// Counters of the settled image.
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
    /// The fraction of pixels that are not background, 0..=1.
    pub coverage: f64,
}

/// A failure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReportError {
    /// The URI that failed; `draw` for failures while drawing.
    pub uri: String,
    /// The reason.
    pub reason: String,
    /// The number of attempts that failed.
    pub count: u64,
}

impl Report {
    /// Returns the report as indented JSON with a final newline.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("a report contains only strings and finite numbers");
        text.push('\n');
        text
    }
}
