//! Runs work that may hang, such as a read from a network drive whose server is gone, without hanging with it. Any
//! thread.

use std::sync::mpsc::sync_channel;
use std::time::Duration;

/// Runs work on a new thread and waits for it. Returns `None` if it takes longer than `limit`, or if the system starts no more
/// threads. The thread continues after `limit`, since a call of the operating system cannot be stopped.
pub(crate) fn run_within<T: Send + 'static>(limit: Duration, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    let (sender, receiver) = sync_channel(1);
    let run = move || {
        // Fails only if the caller has stopped waiting.
        let _ = sender.send(work());
    };
    std::thread::Builder::new().name("disk".to_owned()).spawn(run).ok()?;
    receiver.recv_timeout(limit).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hung_work_is_left_alone() {
        assert_eq!(run_within(Duration::from_secs(60), || 1), Some(1));
        let (release, hangs) = std::sync::mpsc::channel::<()>();
        assert_eq!(run_within(Duration::from_millis(20), move || hangs.recv().is_err()), None);
        drop(release);
    }
}
