//! Ctrl-C: ends the process at once while it prepares, and later asks for an orderly end.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The exit code that shells use for a process that Ctrl-C has ended.
const INTERRUPTED: i32 = 130;

/// The handler of Ctrl-C. First it ends the process; after [`Self::stop_in_order`] it only sets a flag.
pub struct Interrupt {
    /// Set by the main thread, read by the handler.
    is_orderly: Arc<AtomicBool>,
    /// Set by the handler when the flight should end, read by the main thread.
    pub stop: Arc<AtomicBool>,
}

impl Interrupt {
    /// Installs the handler.
    pub fn new() -> Self {
        let (is_orderly, stop) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let interrupt = Self { is_orderly: is_orderly.clone(), stop: stop.clone() };
        // Setting a second handler in one process fails, which only happens in tests.
        let _ = ctrlc::set_handler(move || match is_orderly.load(Ordering::Relaxed) {
            true => stop.store(true, Ordering::Relaxed),
            false => std::process::exit(INTERRUPTED),
        });
        interrupt
    }

    /// From now on Ctrl-C sets `stop` instead of ending the process.
    pub fn stop_in_order(&self) {
        self.is_orderly.store(true, Ordering::Relaxed);
    }
}
