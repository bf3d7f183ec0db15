//! Seeds in processes of their own, several at once.

use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};

use super::flight::Outcome;
use super::set::Sets;
use super::{SeedReport, StressArgs, watch};

/// Lines of what a process said that died.
const LAST_LINES: usize = 12;

/// Calls `done` for each seed as it ends.
pub fn run(args: &StressArgs, made: Option<&Sets>, mut done: impl FnMut(SeedReport) -> Result<()>) -> Result<()> {
    let program = std::env::current_exe().context("the program's own file")?;
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
                    let place = next.fetch_add(1, Ordering::Relaxed);
                    let is_over = match end {
                        Some(end) => Instant::now() >= end,
                        None => place >= args.seeds,
                    };
                    if is_over || stop.load(Ordering::Relaxed) {
                        return;
                    }
                    let seed = args.first_seed.wrapping_add(place);
                    let mut command = Command::new(program);
                    let source = args.source.clone().or_else(|| made.map(|sets| sets.of(seed)));
                    command.args(of_seed(args, source, seed)).arg("--as-json").stdin(Stdio::null());
                    let output = command.output().context("a seed's process");
                    if sender.send(output.map(|output| report(args, seed, &output))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        for report in &reports {
            let told = report.and_then(&mut done);
            if told.is_err() {
                stop.store(true, Ordering::Relaxed);
                // Whoever still sends is not kept waiting.
                drop(reports);
                return told;
            }
        }
        Ok(())
    })
}

/// The arguments that fly a seed over a source in a process of its own.
pub fn of_seed(args: &StressArgs, source: Option<String>, seed: u64) -> Vec<String> {
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
    line
}

/// What a process said, or how it died.
fn report(args: &StressArgs, seed: u64, output: &Output) -> SeedReport {
    let said = String::from_utf8_lossy(&output.stdout);
    let read = said.lines().last().and_then(|line| serde_json::from_str::<SeedReport>(line).ok());
    let is_well = output.status.success();
    if let (Some(report), true) = (read, is_well) {
        return report;
    }
    let errors = String::from_utf8_lossy(&output.stderr);
    let lines: Vec<&str> = errors.lines().filter(|line| !line.trim().is_empty()).collect();
    let how = if output.status.code() == Some(watch::HUNG) { "hangs" } else { "died" };
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
