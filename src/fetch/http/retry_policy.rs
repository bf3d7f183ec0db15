//! Delays between the retries of one HTTP request: exponential back-off with seeded jitter, `Retry-After`, and pauses that a
//! server imposed on all requests to it. The pager requests failed tiles again by its own policy
//! (`pager/requests/retry_policy.rs`). Plain values.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use reqwest::header::{DATE, HeaderMap, RETRY_AFTER};

use crate::math::random::{SplitMix64, fnv1a};

/// The longest pause that is respected, whatever a server asks for.
const MAX_PAUSE: Duration = Duration::from_secs(3600);
/// The number of remembered pauses at which expired ones are removed.
const MAX_PAUSES: usize = 256;

/// The back-off of one request.
pub(super) struct Backoff {
    /// The next delay before jitter.
    next: Duration,
    max: Duration,
    random: SplitMix64,
}

impl Backoff {
    pub fn new(first: Duration, max: Duration, seed: u64, uri: &str) -> Self {
        // The FNV-1a hash of the URI makes requests that failed together retry at different times.
        let random = SplitMix64::new(fnv1a(uri.as_bytes()) ^ seed.rotate_left(32));
        Self { next: first.min(max), max, random }
    }

    /// Returns the delay before the next retry, at least the pause that the server asked for. Returns `None` if that pause
    /// exceeds the limit.
    pub fn wait(&mut self, asked: Option<Duration>) -> Option<Duration> {
        let own = self.next.mul_f64(0.5 + 0.5 * self.random.next_unit());
        self.next = (2 * self.next).min(self.max);
        let wait = own.max(asked.unwrap_or_default());
        (wait <= self.max).then_some(wait)
    }

    /// Returns a random delay up to the next back-off. It spreads requests that wait for the end of the same pause.
    pub fn stagger(&mut self) -> Duration {
        self.next.mul_f64(self.random.next_unit())
    }
}

/// Parses `Retry-After`: seconds, or a date (RFC 9110, 10.2.3). A date is relative to the header `Date` if there is one, and
/// to `now` otherwise.
pub(super) fn retry_after(headers: &HeaderMap, now: SystemTime) -> Option<Duration> {
    let text = headers.get(RETRY_AFTER)?.to_str().ok()?.trim();
    if !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit()) {
        // A number with too many digits is a very long time.
        return Some(Duration::from_secs(text.parse::<u32>().unwrap_or(u32::MAX).into()));
    }
    let server_time = headers.get(DATE).and_then(|date| httpdate::parse_http_date(date.to_str().ok()?.trim()).ok());
    Some(httpdate::parse_http_date(text).ok()?.duration_since(server_time.unwrap_or(now)).unwrap_or_default())
}

/// A pause that a server asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pause {
    /// Status of the answer that asked for it.
    pub status: u16,
    /// Remaining time.
    pub left: Duration,
}

/// Status and end of the pause of each server that asked for one. Shared by the requests of a client; locked briefly.
#[derive(Debug, Default)]
pub(super) struct Pauses(Mutex<HashMap<String, (u16, Instant)>>);

impl Pauses {
    /// Returns the current pause of a server, if any.
    pub fn of(&self, origin: &str) -> Option<Pause> {
        let mut pauses = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (status, until) = *pauses.get(origin)?;
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            pauses.remove(origin);
            return None;
        }
        Some(Pause { status, left })
    }

    /// Starts a pause, unless a longer one is running.
    pub fn pause(&self, origin: &str, Pause { status, left }: Pause) {
        let until = Instant::now() + left.min(MAX_PAUSE);
        let mut pauses = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if pauses.len() >= MAX_PAUSES {
            let now = Instant::now();
            pauses.retain(|_, (_, until)| *until > now);
        }
        let entry = pauses.entry(origin.to_owned()).or_insert((status, until));
        if until > entry.1 {
            *entry = (status, until);
        }
    }
}

#[cfg(test)]
mod tests {
    use reqwest::header::HeaderValue;

    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn waits(seed: u64, uri: &str) -> Vec<Duration> {
        let mut backoff = Backoff::new(100 * MS, 1000 * MS, seed, uri);
        (0..6).map(|_| backoff.wait(None).unwrap()).collect()
    }

    #[test]
    fn delays_grow_and_their_jitter_depends_on_the_seed() {
        let first = waits(1, "http://a/x");
        assert_eq!(first, waits(1, "http://a/x"));
        assert!(first != waits(2, "http://a/x") && first != waits(1, "http://a/y"));
        for (wait, full) in first.iter().zip([100, 200, 400, 800, 1000, 1000]) {
            assert!((full * MS / 2..=full * MS).contains(wait), "{first:?}");
        }
    }

    #[test]
    fn servers_may_ask_for_longer_delays_up_to_the_limit() {
        let mut backoff = Backoff::new(100 * MS, 1000 * MS, 1, "");
        assert_eq!(backoff.wait(Some(900 * MS)), Some(900 * MS));
        assert!(backoff.wait(Some(Duration::ZERO)).unwrap() >= 100 * MS);
        assert_eq!(backoff.wait(Some(1001 * MS)), None);
    }

    #[test]
    fn retry_after_as_seconds_and_as_date() {
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000_000);
        let of = |text: &'static str| {
            retry_after(&HeaderMap::from_iter([(RETRY_AFTER, HeaderValue::from_static(text))]), now)
        };
        assert_eq!(of("120"), Some(Duration::from_secs(120)));
        assert_eq!(of("99999999999999999999999"), Some(Duration::from_secs(u32::MAX.into())));
        assert_eq!(of("Sun, 09 Sep 2001 01:47:10 GMT"), Some(Duration::from_secs(30)));
        assert_eq!(of("Sun, 09 Sep 2001 01:46:00 GMT"), Some(Duration::ZERO), "in the past");
        // The clock of the server may differ from this one: a local comparison would give an hour, or nothing.
        for (date, until) in [
            ("Sun, 09 Sep 2001 00:46:40 GMT", "Sun, 09 Sep 2001 00:47:10 GMT"),
            ("Sun, 09 Sep 2001 02:46:40 GMT", "Sun, 09 Sep 2001 02:47:10 GMT"),
        ] {
            let headers = [(DATE, date), (RETRY_AFTER, until)].map(|(n, v)| (n, HeaderValue::from_static(v)));
            assert_eq!(retry_after(&HeaderMap::from_iter(headers), now), Some(Duration::from_secs(30)), "{date}");
        }
        for odd in ["", "-5", "soon", "1.5"] {
            assert_eq!(of(odd), None, "{odd}");
        }
    }

    #[test]
    fn pauses_apply_to_one_server() {
        let pauses = Pauses::default();
        let seconds = |status, seconds| Pause { status, left: Duration::from_secs(seconds) };
        pauses.pause("http://a", seconds(503, 100));
        pauses.pause("http://a", seconds(429, 1));
        let longest = pauses.of("http://a").unwrap();
        assert!(longest.left > Duration::from_secs(90) && longest.status == 503, "the longest pause wins");
        assert_eq!(pauses.of("http://b"), None);
        pauses.pause("http://b", seconds(503, u64::MAX));
        assert!(pauses.of("http://b").unwrap().left <= MAX_PAUSE);
        pauses.pause("http://c", seconds(503, 0));
        assert_eq!(pauses.of("http://c"), None);
    }
}
