//! What goes wrong outside the frame: panics of any thread, errors in the log, and coming to a stop.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Errors that were logged, and panics. Written by any thread, taken by the main one.
static SAID: Mutex<Vec<String>> = Mutex::new(Vec::new());
/// Steps that the main thread took; read by the watch.
static STEPS: AtomicU64 = AtomicU64::new(0);
/// What the main thread is at; for the watch.
static AT: Mutex<String> = Mutex::new(String::new());

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
    let watch = move || {
        let mut last = STEPS.load(Ordering::Relaxed);
        loop {
            std::thread::sleep(patience);
            let now = STEPS.load(Ordering::Relaxed);
            if now == last {
                let at = AT.lock().map(|at| at.clone()).unwrap_or_default();
                eprintln!("no step for {} s: {at}", patience.as_secs());
                std::process::exit(HUNG);
            }
            last = now;
        }
    };
    std::thread::Builder::new().name("watch".to_owned()).spawn(watch).map(drop)
}

/// The main thread goes on, with this.
pub fn step(what: std::fmt::Arguments<'_>) {
    STEPS.fetch_add(1, Ordering::Relaxed);
    let mut at = AT.lock().unwrap_or_else(PoisonError::into_inner);
    at.clear();
    let _ = std::fmt::Write::write_fmt(&mut *at, what);
}

/// What was said since the last call.
pub fn take_said() -> Vec<String> {
    std::mem::take(&mut *SAID.lock().unwrap_or_else(PoisonError::into_inner))
}
