//! Runs seeds in separate processes, several at the same time.

use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};

use super::args::StressArgs;
use super::checks::watchdog;
use super::report::{Outcome, SeedReport};
use super::sources::tile_sets::TileSets;

/// The number of lines of standard error that are reported of a process that died.
const LAST_LINES: usize = 12;

/// Runs all seeds and calls `done` with each result on this thread. An error of `done` ends the run.
pub fn run(args: &StressArgs, sets: Option<&TileSets>, mut done: impl FnMut(SeedReport) -> Result<()>) -> Result<()> {
    let program = std::env::current_exe().context("path of this program")?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = args.jobs.map_or(cores, usize::from);
    let end = args.minutes.map(|minutes| Instant::now() + Duration::from_secs_f64(60.0 * minutes));
    let (next, stop) = (AtomicU64::new(0), AtomicBool::new(false));
    let (sender, reports) = crossbeam_channel::bounded::<Result<SeedReport>>(jobs);
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            let (sender, next, stop, program) = (sender.clone(), &next, &stop, &program);
            scope.spawn(move || {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    let is_last = match end {
                        Some(end) => Instant::now() >= end,
                        None => number >= args.seeds,
                    };
                    if is_last || stop.load(Ordering::Relaxed) {
                        return;
                    }
                    let seed = args.first_seed.wrapping_add(number);
                    let mut command = Command::new(program);
                    let source = args.source.clone().or_else(|| sets.map(|sets| sets.of(seed)));
                    command.args(arguments(args, source, seed)).arg("--as-json").stdin(Stdio::null());
                    let output = command.output().context("start of a process for a seed");
                    if sender.send(output.map(|output| report(args, seed, &output))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        for report in &reports {
            let result = report.and_then(&mut done);
            if result.is_err() {
                stop.store(true, Ordering::Relaxed);
                // Threads that still send get an error instead of waiting.
                drop(reports);
                return result;
            }
        }
        Ok(())
    })
}

/// Returns the arguments to fly a seed over a source in a separate process.
pub fn arguments(args: &StressArgs, source: Option<String>, seed: u64) -> Vec<String> {
    let mut line = vec!["stress".to_owned()];
    line.extend(source);
    let mut add = |name: &str, value: String| line.extend([name.to_owned(), value]);
    add("--seed", seed.to_string());
    add("--drawn", args.drawn.to_string());
    add("--patience", args.patience.to_string());
    if let Some(frames) = args.frames {
        add("--frames", frames.to_string());
    }
    if let Some(spec) = &args.faults {
        add("--faults", spec.to_string());
    }
    line.extend(args.blocking.then(|| "--blocking".to_owned()));
    line.extend(args.strict.then(|| "--strict".to_owned()));
    line
}

/// Returns the report that a process printed, or one that describes how it died.
fn report(args: &StressArgs, seed: u64, output: &Output) -> SeedReport {
    let stdout = String::from_utf8_lossy(&output.stdout);
    let read = stdout.lines().last().and_then(|line| serde_json::from_str::<SeedReport>(line).ok());
    if let (Some(report), true) = (read, output.status.success()) {
        return report;
    }
    let errors = String::from_utf8_lossy(&output.stderr);
    let lines: Vec<&str> = errors.lines().filter(|line| !line.trim().is_empty()).collect();
    let how = if output.status.code() == Some(watchdog::HUNG) { "hung" } else { "died" };
    let last = lines[lines.len().saturating_sub(LAST_LINES)..].join("\n    ");
    let failures = vec![format!("the process {how} ({}): {last}", output.status)];
    SeedReport {
        seed,
        way: "?".to_owned(),
        plan: format!("{:016x}", args.plan(seed).digest()),
        drawing: "?".to_owned(),
        outcome: Outcome { failures, ..Outcome::default() },
        seconds: 0.0,
    }
}
