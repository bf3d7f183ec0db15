//! When what failed is tried again: tiles and images of sequences. Update thread.

use std::time::Duration;

use crate::io::IoError;

/// No wait grows beyond this, unless the first one does, or a server asks for it: a network that comes back is found.
const LONGEST_WAIT: Duration = Duration::from_secs(300);

/// As good as never, and still a time that can be reckoned with.
const NEVER: Duration = Duration::from_secs(u32::MAX as u64);

/// Tries of what may pass and mostly does not: a server that always sends rubbish is left alone.
const MOST_DOUBTFUL: u32 = 5;

/// Tries of a URI that failed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tries {
    failed: u32,
    /// Of these, with errors that mostly stay.
    doubtful: u32,
}

impl Tries {
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Counts one, and says how long to wait before the next: from `first` on twice as long each time, at least what the
    /// server asked for. `None` where there is to be no other, or `most` have been made.
    pub fn fail(&mut self, error: &IoError, first: Duration, most: Option<u32>) -> Option<Duration> {
        self.failed = self.failed.saturating_add(1);
        self.doubtful = self.doubtful.saturating_add(u32::from(error.is_doubtful()));
        let again = error.is_transient() && self.doubtful < MOST_DOUBTFUL && most.is_none_or(|most| self.failed < most);
        again.then(|| self.wait(first, error))
    }

    fn wait(&self, first: Duration, error: &IoError) -> Duration {
        let doubled = first.saturating_mul(2u32.saturating_pow(self.failed.saturating_sub(1)));
        doubled.min(LONGEST_WAIT.max(first)).max(error.retry_after().unwrap_or_default()).min(NEVER)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn status(retry_after: Option<Duration>) -> IoError {
        IoError::Status { uri: "http://h/a".into(), status: 503, retry_after }
    }

    #[test]
    fn waits_grow_to_some_minutes() {
        let wait = |failed, first, error: &IoError| Tries { failed, doubtful: 0 }.wait(first, error);
        let waits =
            [1, 2, 3, 4, 5, 6, 7, 8, 100, u32::MAX].map(|tries| wait(tries, 5 * SECOND, &status(None)).as_secs());
        assert_eq!(waits, [5, 10, 20, 40, 80, 160, 300, 300, 300, 300]);
        let long = 1000 * SECOND;
        assert_eq!((wait(1, long, &status(None)), wait(9, long, &status(None))), (long, long), "as was asked for");
        assert_eq!(wait(1, 5 * SECOND, &status(Some(3600 * SECOND))), 3600 * SECOND);
        assert_eq!(wait(9, Duration::MAX, &status(None)), NEVER);
    }

    /// One answer that was changed on its way lost a tile until the program was started again.
    #[test]
    fn what_mostly_stays_is_tried_a_few_times() {
        let (remote, local) = (IoError::invalid("http://h/a", "no glTF"), IoError::invalid("/set/a", "no glTF"));
        let mut tries = Tries::default();
        let waits: Vec<u64> = std::iter::from_fn(|| Some(tries.fail(&remote, SECOND, None)?.as_secs())).collect();
        assert_eq!(waits, [1, 2, 4, 8]);
        assert_eq!(Tries::default().fail(&local, SECOND, None), None, "a file stays as it is");
        // An outage before takes none of them.
        let mut tries = Tries::default();
        assert!((0..100).all(|_| tries.fail(&status(None), SECOND, None).is_some()));
        assert_eq!(tries.fail(&remote, SECOND, None), Some(LONGEST_WAIT));
        assert!(!tries.is_none() && tries.fail(&remote, SECOND, Some(102)).is_none());
    }
}
