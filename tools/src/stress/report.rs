//! The results of seeds, and the report of a run.

use std::borrow::Cow;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context as _, Result};
use serde::{Deserialize, Serialize};
use terrane::fetch::shown;

/// The result of a flight.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct Outcome {
    pub failures: Vec<String>,
    pub frames: u32,
    /// Frames from the end of the faults until everything is loaded.
    pub settling: u32,
    pub pictures: u64,
    /// The number of requests of all scenes. The next four counts are those of their outcomes.
    pub requested: u64,
    pub merged: u64,
    pub failed: u64,
    pub cancelled: u64,
    pub expired: u64,
    pub adapter: String,
    /// True if the last image was compared with that of a new viewer.
    pub compared: bool,
}

/// The result of a seed.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct SeedReport {
    pub seed: u64,
    /// "disk", "server" for a remote source, or the protocol of the local server.
    pub way: String,
    /// A hash of the plan.
    pub plan: String,
    pub drawing: String,
    #[serde(flatten)]
    pub outcome: Outcome,
    pub seconds: f64,
}

impl SeedReport {
    /// Returns the result as one line.
    pub fn line(&self) -> String {
        let verdict = if self.outcome.failures.is_empty() { "ok    " } else { "FAILED" };
        format!(
            "seed {:<5} {verdict} {:<8} {:<5} {:>4} frames, settled after {:>4}, {:>3} images, {:>5} requests: {} merged, \
             {} failed, {} cancelled, {} expired; {:.1} s",
            self.seed,
            self.way,
            self.drawing,
            self.outcome.frames,
            self.outcome.settling,
            self.outcome.pictures,
            self.outcome.requested,
            self.outcome.merged,
            self.outcome.failed,
            self.outcome.cancelled,
            self.outcome.expired,
            self.seconds
        )
    }
}

/// The report of a run.
#[derive(Serialize)]
struct Report<'a> {
    tool: &'static str,
    version: &'static str,
    source: Cow<'a, str>,
    seeds: &'a [SeedReport],
    failed: usize,
    frames: u64,
    seconds: f64,
}

/// Writes the report of a run that began at `start`.
pub fn write(file: &Path, source: &str, seeds: &[SeedReport], start: Instant) -> Result<()> {
    let report = Report {
        tool: "terrane stress",
        version: env!("CARGO_PKG_VERSION"),
        source: shown(source),
        seeds,
        failed: seeds.iter().filter(|r| !r.outcome.failures.is_empty()).count(),
        frames: seeds.iter().map(|r| u64::from(r.outcome.frames)).sum(),
        seconds: start.elapsed().as_secs_f64(),
    };
    let text = serde_json::to_string_pretty(&report)? + "\n";
    std::fs::write(file, text).with_context(|| file.display().to_string())
}
