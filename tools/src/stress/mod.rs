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
//!
//! With `--blocking` the timing has no effect on which request meets a fault, as long as the budgets have room: a failure that
//! a fault of the network caused happens again in the same frame.

mod args;
mod checks;
mod events;
mod extra_roots;
mod fault_spec;
mod flight;
mod plan;
mod processes;
mod random;
mod report;
mod sources;

use std::io::Write as _;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use terrane::fetch::{is_remote, shown};

pub use self::args::StressArgs;
use self::checks::watchdog;
use self::plan::Transport;
use self::report::{Outcome, SeedReport};
use self::sources::tile_sets::TileSets;

/// Runs `terrane stress`.
pub fn run(args: StressArgs) -> Result<()> {
    // A file that cannot be written is reported before the flights, not after them.
    if let Some(file) = &args.report {
        std::fs::File::create(file).with_context(|| file.display().to_string())?;
    }
    if let Some(source) = args.source.as_deref().filter(|source| !is_remote(source)) {
        std::fs::metadata(source).with_context(|| source.to_owned())?;
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
    let made = if args.source.is_none() { Some(TileSets::generate()?) } else { None };
    let source = match (&args.source, &made) {
        (Some(source), _) => source.clone(),
        (None, Some(sets)) => sets.of(seed),
        (None, None) => bail!("no source"),
    };
    let flown = flight::fly(&plan, &source, args.strict);
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
    if let Some(file) = &args.report {
        report::write(file, &source, std::slice::from_ref(&report), start)?;
    }
    ensure!(report.outcome.failures.is_empty(), "seed {seed} failed");
    Ok(())
}

/// Flies seeds in separate processes.
fn many(args: &StressArgs) -> Result<()> {
    let start = Instant::now();
    let made = if args.source.is_none() { Some(TileSets::generate()?) } else { None };
    let mut reports: Vec<SeedReport> = Vec::new();
    processes::run(args, made.as_ref(), |report| {
        print(&report, Some(&repeat_command(args, report.seed)))?;
        reports.push(report);
        Ok(())
    })?;
    reports.sort_by_key(|r| r.seed);
    let source = args.source.as_deref().unwrap_or("generated");
    if let Some(file) = &args.report {
        report::write(file, source, &reports, start)?;
    }
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
