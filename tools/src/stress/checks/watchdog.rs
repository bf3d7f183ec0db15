//! Detects problems outside of the frame loop: panics of any thread, errors in the log, and a hanging main thread.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Logged errors and panics. Written by any thread, taken by the main thread.
static ERRORS: Mutex<Vec<String>> = Mutex::new(Vec::new());
/// The current step of the main thread. Written by it, read by the watchdog.
static STEP: Mutex<Step> = Mutex::new(Step { since: None, what: String::new() });
/// The time between two checks of the watchdog.
const CHECK_INTERVAL: Duration = Duration::from_millis(500);

/// A step of the main thread, and its start.
struct Step {
    since: Option<Instant>,
    what: String,
}

impl Step {
    /// Returns true if the step has taken longer than `patience`.
    fn hangs(&self, now: Instant, patience: Duration) -> bool {
        self.since.is_some_and(|since| now.saturating_duration_since(since) > patience)
    }
}

/// The exit status of a process that hung.
pub const HUNG: i32 = 3;

/// Records an error, at most 100 of them.
fn record(text: String) {
    let mut errors = ERRORS.lock().unwrap_or_else(PoisonError::into_inner);
    if errors.len() < 100 {
        errors.push(text);
    }
}

/// A logger that records errors.
struct ErrorLog;

impl log::Log for ErrorLog {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        metadata.level() == log::Level::Error
    }

    fn log(&self, entry: &log::Record<'_>) {
        if self.enabled(entry.metadata()) {
            record(format!("{}: {}", entry.target(), entry.args()));
        }
    }

    fn flush(&self) {}
}

/// Installs the logger and the panic hook, and starts the watchdog thread. It ends the process with [`HUNG`] if a step takes
/// longer than `patience`.
pub fn start(patience: Duration) -> std::io::Result<()> {
    // Setting a second logger in one process fails, which only happens in tests.
    if log::set_logger(&ErrorLog).is_ok() {
        log::set_max_level(log::LevelFilter::Error);
    }
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        record(format!("thread {} panicked: {info}", std::thread::current().name().unwrap_or("?")));
        before(info);
    }));
    step(format_args!("start"));
    let watchdog = move || {
        loop {
            std::thread::sleep(CHECK_INTERVAL);
            let step = STEP.lock().unwrap_or_else(PoisonError::into_inner);
            if step.hangs(Instant::now(), patience) {
                eprintln!("no progress for {} s: {}", patience.as_secs(), step.what);
                std::process::exit(HUNG);
            }
        }
    };
    std::thread::Builder::new().name("watchdog".to_owned()).spawn(watchdog).map(drop)
}

/// Records the start of a step of the main thread.
pub fn step(what: std::fmt::Arguments<'_>) {
    let mut step = STEP.lock().unwrap_or_else(PoisonError::into_inner);
    step.since = Some(Instant::now());
    step.what.clear();
    let _ = std::fmt::Write::write_fmt(&mut step.what, what);
}

/// Returns the errors since the last call.
pub fn take_errors() -> Vec<String> {
    std::mem::take(&mut *ERRORS.lock().unwrap_or_else(PoisonError::into_inner))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_hangs_after_its_time_limit() {
        let (start, patience) = (Instant::now(), Duration::from_secs(60));
        let step = Step { since: Some(start), what: String::new() };
        assert!(!step.hangs(start + patience, patience) && step.hangs(start + Duration::from_secs(61), patience));
        assert!(!Step { since: None, what: String::new() }.hangs(start + 2 * patience, patience));
    }
}
