//! When a failed load is requested again, and how often; tiles and images of sequences. The HTTP client has retried
//! already (`fetch/http/retry_policy.rs`). Update thread.

use std::time::{Duration, Instant};

use crate::fetch::IoError;

/// No back-off exceeds this, unless the first one does or a server asks for it: a network that returns is noticed.
const MAX_BACKOFF: Duration = Duration::from_secs(300);

/// Practically never, and still a duration that can be added to others.
const NEVER: Duration = Duration::from_secs(u32::MAX as u64);

/// Attempts in all with errors that rarely pass: a server that always sends garbage is left alone.
const MAX_DOUBTFUL: u32 = 5;

/// When failed loads are retried.
#[derive(Clone, Copy, Debug)]
pub(in crate::pager) struct RetryPolicy {
    /// The first back-off; doubled with each failure, up to five minutes.
    pub first_backoff: Duration,
    /// Attempts of a URI in all; `None` for no limit.
    pub max_attempts: Option<u32>,
}

/// The failed attempts of a URI.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::pager) struct RetryState {
    failed: u32,
    /// Failures with errors that rarely pass; see [`IoError::is_doubtful`].
    doubtful: u32,
}

impl RetryState {
    /// Returns true if no attempt has failed.
    pub fn is_fresh(&self) -> bool {
        *self == Self::default()
    }

    /// Counts a failure and returns the back-off before the next attempt, at least what the server asked for. Returns
    /// `None` if there should be no other attempt.
    pub fn fail(&mut self, error: &IoError, policy: RetryPolicy) -> Option<Duration> {
        self.failed = self.failed.saturating_add(1);
        self.doubtful = self.doubtful.saturating_add(u32::from(error.is_doubtful()));
        let again = error.is_transient()
            && self.doubtful < MAX_DOUBTFUL
            && policy.max_attempts.is_none_or(|max| self.failed < max);
        again.then(|| self.backoff(policy.first_backoff, error))
    }

    fn backoff(&self, first: Duration, error: &IoError) -> Duration {
        let doubled = first.saturating_mul(2u32.saturating_pow(self.failed.saturating_sub(1)));
        doubled.min(MAX_BACKOFF.max(first)).max(error.retry_after().unwrap_or_default()).min(NEVER)
    }
}

/// Returns the moment after a back-off; `None`, which is never, beyond the range of the clock.
pub(in crate::pager) fn retry_moment(backoff: Option<Duration>) -> Option<Instant> {
    Instant::now().checked_add(backoff?)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);
    const POLICY: RetryPolicy = RetryPolicy { first_backoff: SECOND, max_attempts: None };

    fn status(retry_after: Option<Duration>) -> IoError {
        IoError::Status { uri: "http://h/a".into(), status: 503, retry_after }
    }

    #[test]
    fn backoff_doubles_up_to_five_minutes() {
        let backoff = |failed, first, error: &IoError| RetryState { failed, doubtful: 0 }.backoff(first, error);
        let backoffs = [1, 2, 3, 4, 5, 6, 7, 8, 100, u32::MAX]
            .map(|failures| backoff(failures, 5 * SECOND, &status(None)).as_secs());
        assert_eq!(backoffs, [5, 10, 20, 40, 80, 160, 300, 300, 300, 300]);
        let long = 1000 * SECOND;
        assert_eq!((backoff(1, long, &status(None)), backoff(9, long, &status(None))), (long, long), "as configured");
        assert_eq!(backoff(1, 5 * SECOND, &status(Some(3600 * SECOND))), 3600 * SECOND);
        assert_eq!(backoff(9, Duration::MAX, &status(None)), NEVER);
    }

    /// Regression: one answer that was corrupted in transit lost a tile until the program was restarted.
    #[test]
    fn errors_that_rarely_pass_are_retried_a_few_times() {
        let (remote, local) = (IoError::invalid("http://h/a", "no glTF"), IoError::invalid("/set/a", "no glTF"));
        let mut retries = RetryState::default();
        let backoffs: Vec<u64> = std::iter::from_fn(|| Some(retries.fail(&remote, POLICY)?.as_secs())).collect();
        assert_eq!(backoffs, [1, 2, 4, 8]);
        assert_eq!(RetryState::default().fail(&local, POLICY), None, "a local file stays as it is");
        // A previous outage uses up none of these attempts.
        let mut retries = RetryState::default();
        assert!((0..100).all(|_| retries.fail(&status(None), POLICY).is_some()));
        assert_eq!(retries.fail(&remote, POLICY), Some(MAX_BACKOFF));
        let limited = RetryPolicy { max_attempts: Some(102), ..POLICY };
        assert!(!retries.is_fresh() && retries.fail(&remote, limited).is_none());
    }
}
