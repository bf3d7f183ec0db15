//! `terrane stress`: flights at random over a tile set that comes badly, and every invariant in each frame.
//!
//! ```text
//! seed -> plan (settings, faults, poses, events) -> flight -> checks in each frame
//!                                                          -> faults cease: it comes to rest
//!                                                          -> its picture is that of a new viewer
//!                                                          -> cleared: nothing is left
//!                                                          -> closed: in time
//! ```
//! A seed is a process: what panics, hangs or leaks takes no other seed with it. The plan is drawn before anything
//! begins, so that a seed's flight, events and settings are the same each time, and so is what the server does to the
//! first, second and third request for each file and each part of an archive, in whatever order they come. What depends
//! on how quick threads and network are is how many requests there are by some frame: what is stale, aborted or found no
//! room is not asked for, or once more. Two scenes with a pager each that ask for the same tile at the same moment are
//! told apart by who comes first.

mod archive;
mod check;
mod extras;
mod faults;
mod flight;
mod fresh;
mod happen;
mod plan;
mod random;
mod runner;
mod set;
mod watch;

use std::borrow::Cow;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args as ClapArgs;
use serde::{Deserialize, Serialize};
use terrane::fetch::{is_remote, shown};

use self::flight::Outcome;
use self::plan::{Plan, Way};
use crate::values::minutes;

#[derive(Clone, Debug, ClapArgs)]
pub struct StressArgs {
    /// Folder, tileset.json, archive, http(s) URL or s3://, gs://, az:// URI; without it small sets are made in a temporary folder
    pub source: Option<String>,
    /// How many seeds
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: u64,
    /// The first of them
    #[arg(long, default_value_t = 1)]
    pub first_seed: u64,
    /// Seeds for so many minutes, instead of a number of them
    #[arg(long, value_parser = minutes)]
    pub minutes: Option<f64>,
    /// This seed alone, in this process: the flight of a seed that failed, once more
    #[arg(long, conflicts_with_all = ["seeds", "first_seed", "minutes"])]
    pub seed: Option<u64>,
    /// Seeds at once [default: as many as there are cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub jobs: Option<u16>,
    /// Frames of each flight [default: 40 to 120, by seed]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..1_000_000))]
    pub frames: Option<u32>,
    /// Seeds of a hundred that are drawn by an adapter and looked at; the rest is drawn by a backend that does nothing
    #[arg(long, value_name = "PERCENT", default_value_t = 20, value_parser = clap::value_parser!(u64).range(..=100))]
    pub drawn: u64,
    /// Faults of the server for all seeds, as error=0.1,latency-ms=20, or none [default: by seed]; a SOURCE on a server
    /// has those of that server alone
    #[arg(long, value_name = "SPEC")]
    pub faults: Option<faults::FaultSpec>,
    /// A frame that takes so many seconds hangs
    #[arg(long, value_name = "SECONDS", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
    pub patience: u64,
    /// Write what each seed came to, as JSON
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// One line of JSON instead of text
    #[arg(long, hide = true)]
    pub as_json: bool,
}

impl StressArgs {
    /// What no single argument says is wrong.
    pub fn check(&self) -> Result<(), String> {
        match &self.source {
            Some(source) if self.faults.is_some() && is_remote(source) => {
                Err("--faults are those of a server of our own; SOURCE has its own".to_owned())
            }
            _ => Ok(()),
        }
    }

    /// What a seed does.
    fn plan(&self, seed: u64) -> Plan {
        let mut plan = Plan::new(seed, self.frames, self.drawn);
        if let Some(spec) = &self.faults {
            plan.faults = spec.0.clone();
        }
        plan
    }
}

/// What a seed came to.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct SeedReport {
    pub seed: u64,
    /// From disk, from the server that was named, or by what our own one speaks.
    pub way: String,
    /// Names the plan: the same plan, the same number.
    pub plan: String,
    pub drawing: String,
    #[serde(flatten)]
    pub outcome: Outcome,
    pub seconds: f64,
}

impl SeedReport {
    /// One line.
    fn line(&self) -> String {
        let verdict = if self.outcome.failures.is_empty() { "ok    " } else { "FAILED" };
        format!(
            "seed {:<5} {verdict} {:<8} {:<5} {:>4} frames, at rest after {:>4}, {:>3} pictures, {:>5} requests: {} merged, \
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

/// All of a run.
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

pub fn run(args: StressArgs) -> Result<()> {
    // Told before the flights, not after them.
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
    watch::start(Duration::from_secs(args.patience))?;
    let plan = args.plan(seed);
    let made = if args.source.is_none() { Some(set::Sets::make()?) } else { None };
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
    outcome.failures.extend(watch::take_said());
    let way = match plan.way {
        _ if is_remote(&source) => "server",
        Way::Disk => "disk",
        Way::Http => plan.wire.name(),
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
    tell(&report, None)?;
    write_report(args, &source, std::slice::from_ref(&report), start)?;
    ensure!(report.outcome.failures.is_empty(), "seed {seed} failed");
    Ok(())
}

/// Flies seeds in processes of their own.
fn many(args: &StressArgs) -> Result<()> {
    let start = Instant::now();
    let made = if args.source.is_none() { Some(set::Sets::make()?) } else { None };
    let mut reports: Vec<SeedReport> = Vec::new();
    runner::run(args, made.as_ref(), |report| {
        tell(&report, Some(&again(args, report.seed)))?;
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

/// The line that flies a seed again, as a shell takes it. Keys in a URL are not in it.
fn again(args: &StressArgs, seed: u64) -> String {
    let source = args.source.as_deref().map(|source| shown(source).into_owned());
    let words = runner::of_seed(args, source, seed);
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,+@%".contains(c);
    let quoted = words.into_iter().map(|word| match word.is_empty() || !word.chars().all(is_plain) {
        true => format!("'{}'", word.replace('\'', r"'\''")),
        false => word,
    });
    format!("terrane {}", quoted.collect::<Vec<_>>().join(" "))
}

/// A seed's line, what failed, and how it is flown again.
fn tell(report: &SeedReport, again: Option<&str>) -> Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", report.line()).context("stdout")?;
    for failure in &report.outcome.failures {
        writeln!(out, "    {failure}").context("stdout")?;
    }
    if let (Some(again), false) = (again, report.outcome.failures.is_empty()) {
        writeln!(out, "    again: {again}\n    plan {}", report.plan).context("stdout")?;
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
