//! What goes wrong outside the frame: panics of any thread, errors in the log, and coming to a stop.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Errors that were logged, and panics. Written by any thread, taken by the main one.
static SAID: Mutex<Vec<String>> = Mutex::new(Vec::new());
/// Where the main thread is. Written by it, read by the watch.
static AT: Mutex<At> = Mutex::new(At { since: None, what: String::new() });
/// Between two looks of the watch.
const LOOK: Duration = Duration::from_millis(500);

/// What the main thread is at, and since when.
struct At {
    since: Option<Instant>,
    what: String,
}

impl At {
    /// It has been there for longer than that.
    fn hangs(&self, now: Instant, patience: Duration) -> bool {
        self.since.is_some_and(|since| now.saturating_duration_since(since) > patience)
    }
}

/// The exit status where nothing moved any more.
pub const HUNG: i32 = 3;

fn say(text: String) {
    let mut said = SAID.lock().unwrap_or_else(PoisonError::into_inner);
    if said.len() < 100 {
        said.push(text);
    }
}

struct Log;

impl log::Log for Log {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        metadata.level() == log::Level::Error
    }

    fn log(&self, record: &log::Record<'_>) {
        if self.enabled(record.metadata()) {
            say(format!("{}: {}", record.target(), record.args()));
        }
    }

    fn flush(&self) {}
}

/// Begins to listen; a process that takes no step for `patience` ends with [`HUNG`].
pub fn start(patience: Duration) -> std::io::Result<()> {
    // A second logger in one process is no reason not to run.
    if log::set_logger(&Log).is_ok() {
        log::set_max_level(log::LevelFilter::Error);
    }
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        say(format!("thread {} panicked: {info}", std::thread::current().name().unwrap_or("?")));
        before(info);
    }));
    step(format_args!("start"));
    let watch = move || {
        loop {
            std::thread::sleep(LOOK);
            let at = AT.lock().unwrap_or_else(PoisonError::into_inner);
            if at.hangs(Instant::now(), patience) {
                eprintln!("no step for {} s: {}", patience.as_secs(), at.what);
                std::process::exit(HUNG);
            }
        }
    };
    std::thread::Builder::new().name("watch".to_owned()).spawn(watch).map(drop)
}

/// The main thread goes on, with this.
pub fn step(what: std::fmt::Arguments<'_>) {
    let mut at = AT.lock().unwrap_or_else(PoisonError::into_inner);
    at.since = Some(Instant::now());
    at.what.clear();
    let _ = std::fmt::Write::write_fmt(&mut at.what, what);
}

/// What was said since the last call.
pub fn take_said() -> Vec<String> {
    std::mem::take(&mut *SAID.lock().unwrap_or_else(PoisonError::into_inner))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_has_so_much_time_and_no_more() {
        let (start, patience) = (Instant::now(), Duration::from_secs(60));
        let at = At { since: Some(start), what: String::new() };
        assert!(!at.hangs(start + patience, patience) && at.hangs(start + Duration::from_secs(61), patience));
        assert!(!At { since: None, what: String::new() }.hangs(start + 2 * patience, patience));
    }
}
