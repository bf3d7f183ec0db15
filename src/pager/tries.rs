//! When what failed is tried again: tiles and images of sequences. Update thread.

use std::time::Duration;

use crate::io::IoError;

/// No wait grows beyond this, unless the first one does, or a server asks for it: a network that comes back is found.
const LONGEST_WAIT: Duration = Duration::from_secs(300);

/// As good as never, and still a time that can be reckoned with.
const NEVER: Duration = Duration::from_secs(u32::MAX as u64);

/// The wait after so many tries that failed: from `first` on twice as long each time; at least what the server asked for.
pub(super) fn wait_after(first: Duration, tries: u32, error: &IoError) -> Duration {
    let doubled = first.saturating_mul(2u32.saturating_pow(tries.saturating_sub(1)));
    doubled.min(LONGEST_WAIT.max(first)).max(error.retry_after().unwrap_or_default()).min(NEVER)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_grow_to_some_minutes() {
        let error = |retry_after| IoError::Status { uri: "http://h/a".into(), status: 503, retry_after };
        let seconds = |first: u64, tries: u32| wait_after(Duration::from_secs(first), tries, &error(None)).as_secs();
        let waits = [1, 2, 3, 4, 5, 6, 7, 8, 100, u32::MAX].map(|tries| seconds(5, tries));
        assert_eq!(waits, [5, 10, 20, 40, 80, 160, 300, 300, 300, 300]);
        assert_eq!((seconds(1000, 1), seconds(1000, 9)), (1000, 1000), "as long as was asked for");
        let hour = Duration::from_secs(3600);
        assert_eq!(wait_after(Duration::from_secs(5), 1, &error(Some(hour))), hour);
        assert_eq!(wait_after(Duration::MAX, 9, &error(None)), NEVER);
    }
}
