//! `terrane stress`: random flights over a tile set from a faulty server, with a check of invariants in each frame.
//!
//! ```text
//! seed -> plan (settings, faults, poses, events) -> flight -> checks in each frame
//!                                                          -> faults end: everything is loaded
//!                                                          -> the image equals that of a new viewer
//!                                                          -> pages are cleared: nothing is left
//!                                                          -> the viewer is closed within 10 s
//! ```
//! Each seed runs in a separate process, so that a panic, a hang or a leak does not affect other seeds.
//!
//! The plan is drawn before the flight begins. A seed has the same flight, events and settings each time, and the server
//! has the same fault for the n-th request for each file and each part of an archive, in any order of requests. The
//! number of requests by some frame still depends on the timing of threads and network, because stale, aborted and
//! declined requests are dropped or repeated. If two pagers request the same tile at the same moment, the order of arrival
//! decides which one meets a fault.

mod archive_writer;
mod events;
mod extra_roots;
mod fault_spec;
mod flight;
mod invariants;
mod plan;
mod processes;
mod random;
mod reference;
mod servers;
mod tile_sets;
mod watchdog;

use std::borrow::Cow;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args as ClapArgs;
use serde::{Deserialize, Serialize};
use terrane::fetch::{is_remote, shown};

use self::flight::Outcome;
use self::plan::{Plan, Transport};
use crate::values::minutes;

#[derive(Clone, Debug, ClapArgs)]
pub struct StressArgs {
    /// Folder, tileset.json, archive, http(s) URL or s3://, gs://, az:// URI; without it small sets are generated in a temporary folder
    pub source: Option<String>,
    /// Number of seeds
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: u64,
    /// First seed
    #[arg(long, default_value_t = 1)]
    pub first_seed: u64,
    /// Run seeds for this many minutes instead of a number of seeds
    #[arg(long, value_parser = minutes)]
    pub minutes: Option<f64>,
    /// Run only this seed, in this process, to repeat a failure
    #[arg(long, conflicts_with_all = ["seeds", "first_seed", "minutes"])]
    pub seed: Option<u64>,
    /// Number of seeds at the same time [default: one per core]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub jobs: Option<u16>,
    /// Number of frames of each flight [default: 40 to 120, by seed]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..1_000_000))]
    pub frames: Option<u32>,
    /// Percentage of seeds that are drawn by an adapter and whose images are checked; the others use wgpu's noop backend
    #[arg(long, value_name = "PERCENT", default_value_t = 20, value_parser = clap::value_parser!(u64).range(..=100))]
    pub drawn: u64,
    /// Faults of the server for all seeds, such as error=0.1,latency-ms=20, or none [default: by seed]; not with a SOURCE
    /// on a server
    #[arg(long, value_name = "SPEC")]
    pub faults: Option<fault_spec::FaultSpec>,
    /// Seconds after which a frame counts as hanging
    #[arg(long, value_name = "SECONDS", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
    pub patience: u64,
    /// Write the results of all seeds as JSON
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Print one line of JSON instead of text
    #[arg(long, hide = true)]
    pub as_json: bool,
}

impl StressArgs {
    /// Checks combinations of arguments.
    pub fn check(&self) -> Result<(), String> {
        match &self.source {
            Some(source) if self.faults.is_some() && is_remote(source) => {
                Err("--faults apply to the local server only, and SOURCE is on another server".to_owned())
            }
            _ => Ok(()),
        }
    }

    /// Returns the plan of a seed.
    fn plan(&self, seed: u64) -> Plan {
        let mut plan = Plan::new(seed, self.frames, self.drawn);
        if let Some(spec) = &self.faults {
            plan.faults = spec.0.clone();
        }
        plan
    }
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
    fn line(&self) -> String {
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

/// Runs `terrane stress`.
pub fn run(args: StressArgs) -> Result<()> {
    // A file that cannot be written is reported before the flights, not after them.
    if let Some(file) = &args.report {
        std::fs::File::create(file).with_context(|| file.display().to_string())?;
    }
    match args.seed {
        Some(seed) => one(&args, seed),
        None => many(&args),
    }
}

/// Flies a seed in this process.
fn one(args: &StressArgs, seed: u64) -> Result<()> {
    let start = Instant::now();
    watchdog::start(Duration::from_secs(args.patience))?;
    let plan = args.plan(seed);
    let made = if args.source.is_none() { Some(tile_sets::TileSets::generate()?) } else { None };
    let source = match (&args.source, &made) {
        (Some(source), _) => source.clone(),
        (None, Some(sets)) => sets.of(seed),
        (None, None) => bail!("no source"),
    };
    let flown = flight::fly(&plan, &source);
    let mut outcome = match flown {
        Ok(outcome) => outcome,
        Err(error) => Outcome { failures: vec![format!("{error:#}")], ..Outcome::default() },
    };
    outcome.failures.extend(watchdog::take_errors());
    let way = match plan.transport {
        _ if is_remote(&source) => "server",
        Transport::Disk => "disk",
        Transport::Server => plan.protocol.name(),
    };
    let report = SeedReport {
        seed,
        way: way.to_owned(),
        plan: format!("{:016x}", plan.digest()),
        drawing: format!("{:?}", plan.drawing).to_lowercase(),
        outcome,
        seconds: start.elapsed().as_secs_f64(),
    };
    if args.as_json {
        writeln!(std::io::stdout(), "{}", serde_json::to_string(&report)?).context("stdout")?;
        return Ok(());
    }
    print(&report, None)?;
    write_report(args, &source, std::slice::from_ref(&report), start)?;
    ensure!(report.outcome.failures.is_empty(), "seed {seed} failed");
    Ok(())
}

/// Flies seeds in separate processes.
fn many(args: &StressArgs) -> Result<()> {
    let start = Instant::now();
    let made = if args.source.is_none() { Some(tile_sets::TileSets::generate()?) } else { None };
    let mut reports: Vec<SeedReport> = Vec::new();
    processes::run(args, made.as_ref(), |report| {
        print(&report, Some(&repeat_command(args, report.seed)))?;
        reports.push(report);
        Ok(())
    })?;
    reports.sort_by_key(|r| r.seed);
    let source = args.source.as_deref().unwrap_or("generated");
    write_report(args, source, &reports, start)?;
    let failed = reports.iter().filter(|r| !r.outcome.failures.is_empty()).count();
    let frames: u64 = reports.iter().map(|r| u64::from(r.outcome.frames)).sum();
    let requests: u64 = reports.iter().map(|r| r.outcome.requested).sum();
    let lost: u64 = reports.iter().map(|r| r.outcome.failed).sum();
    let (seeds, seconds) = (reports.len(), start.elapsed().as_secs_f64());
    let summary = format!(
        "{seeds} seeds, {failed} failed; {frames} frames, {requests} requests of which {lost} failed, in {seconds:.0} s"
    );
    writeln!(std::io::stdout(), "{summary}").context("stdout")?;
    ensure!(failed == 0, "{failed} of {seeds} seeds failed");
    Ok(())
}

/// Returns the shell command that flies a seed again. Keys in a URL are left out.
fn repeat_command(args: &StressArgs, seed: u64) -> String {
    let source = args.source.as_deref().map(|source| shown(source).into_owned());
    let words = processes::arguments(args, source, seed);
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,+@%".contains(c);
    let quoted = words.into_iter().map(|word| match word.is_empty() || !word.chars().all(is_plain) {
        true => format!("'{}'", word.replace('\'', r"'\''")),
        false => word,
    });
    format!("terrane {}", quoted.collect::<Vec<_>>().join(" "))
}

/// Prints the result of a seed with its failures, and the command that repeats it if given.
fn print(report: &SeedReport, repeat: Option<&str>) -> Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", report.line()).context("stdout")?;
    for failure in &report.outcome.failures {
        writeln!(out, "    {failure}").context("stdout")?;
    }
    if let (Some(repeat), false) = (repeat, report.outcome.failures.is_empty()) {
        writeln!(out, "    repeat: {repeat}\n    plan {}", report.plan).context("stdout")?;
    }
    Ok(())
}

fn write_report(args: &StressArgs, source: &str, seeds: &[SeedReport], start: Instant) -> Result<()> {
    let Some(file) = &args.report else { return Ok(()) };
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
