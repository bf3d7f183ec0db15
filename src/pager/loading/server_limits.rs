//! The number of requests that one server gets at once: more while it answers quickly, fewer when answers take longer or
//! fail. Written and read by the HTTP thread alone.
//!
//! Each answer in time adds one slot, so that the limit doubles within the time of an answer. Waiting in a server's or a
//! link's queue shows as longer answers and takes slots away again, as in TCP Vegas. After timeouts slots return one per
//! round of answers, because a narrow link would be overloaded again at once.

use std::collections::HashMap;

use super::config::LimitRange;
use crate::fetch::IoError;

/// Answers up to this factor longer than the quickest are in time.
const IN_TIME_FACTOR: f64 = 1.5;
/// Answers longer by this factor than the quickest have waited in a queue.
const QUEUED_FACTOR: f64 = 3.0;
/// The share by which each slower answer raises the quickest time while the limit is at its start: network paths change.
const QUICKEST_DECAY: f64 = 0.01;
/// Servers remembered beyond those in use.
const MAX_SERVERS: usize = 64;

/// The outcome of a request as a sign of its server's load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::pager) enum Outcome {
    /// The server answered after this many seconds, with bytes or with "not modified".
    AnsweredAfter(f64),
    /// The server was overloaded or unreachable.
    Failed,
    /// The server did not answer in time.
    TimedOut,
    /// The outcome says nothing about load: it came from the cache, was not found, or was invalid.
    Unrelated,
}

impl Outcome {
    /// Classifies a result; `asked` is false if it came from the cache.
    pub fn new<T>(result: &Result<T, IoError>, asked: bool, seconds: f64) -> Self {
        match result {
            Ok(_) if asked => Self::AnsweredAfter(seconds),
            Err(IoError::Timeout { .. }) => Self::TimedOut,
            Err(error) if error.is_transient() && !error.is_doubtful() => Self::Failed,
            _ => Self::Unrelated,
        }
    }
}

/// The limit of one server.
#[derive(Clone, Copy, Debug)]
struct ServerLimit {
    limit: usize,
    quickest_s: f64,
    /// Answers since the last slot returned, while slots return slowly after a timeout.
    slow_answers: Option<usize>,
}

impl ServerLimit {
    /// Lowers the limit by an eighth and at least by one, down to `min`.
    fn shrink(&mut self, min: usize) {
        self.limit = (self.limit - (self.limit / 8).max(1).min(self.limit)).max(min);
    }

    /// Raises the limit by one towards `start`; after a timeout, once per round of answers.
    fn regain(&mut self, start: usize) {
        if let Some(answers) = &mut self.slow_answers {
            *answers += 1;
            if *answers < self.limit {
                return;
            }
            *answers = 0;
        }
        self.limit += 1;
        if self.limit >= start {
            self.slow_answers = None;
        }
    }
}

/// The limits of all servers, by scheme, host and port.
#[derive(Debug)]
pub(in crate::pager) struct ServerLimits {
    range: LimitRange,
    servers: HashMap<String, ServerLimit>,
}

impl ServerLimits {
    /// Creates limits that start at `range.start` for each server.
    pub fn new(range: LimitRange) -> Self {
        Self { range, servers: HashMap::new() }
    }

    /// Returns the number of requests that a server may have in flight.
    pub fn limit(&self, server: &str) -> usize {
        self.servers.get(server).map_or(self.range.start, |known| known.limit)
    }

    /// Returns true if a server with `has` requests may have one more while `left` slots are free for all. The last slots
    /// are reserved for servers with fewer requests, so that servers that hang do not take all.
    pub fn leaves_enough(&self, has: usize, left: usize) -> bool {
        has == 0 || left > self.range.start || has + 1 < left
    }

    /// Learns from the outcome of a request to a server that had `running` requests in flight meanwhile.
    pub fn learn(&mut self, server: &str, running: usize, outcome: Outcome) {
        if outcome == Outcome::Unrelated {
            return;
        }
        if self.servers.len() >= MAX_SERVERS && !self.servers.contains_key(server) {
            self.servers.clear();
        }
        let LimitRange { start, max } = self.range;
        let new = ServerLimit { limit: start, quickest_s: f64::INFINITY, slow_answers: None };
        let known = self.servers.entry(server.to_owned()).or_insert(new);
        match outcome {
            Outcome::AnsweredAfter(seconds) => {
                if seconds < known.quickest_s {
                    known.quickest_s = seconds;
                } else if known.limit <= start {
                    // Above the start limit, longer answers are caused by the load.
                    known.quickest_s += QUICKEST_DECAY * (seconds - known.quickest_s);
                }
                // A higher limit helps only if the present one is used.
                let is_used = 4 * running >= 3 * known.limit;
                if known.limit < start {
                    known.regain(start);
                } else if seconds <= IN_TIME_FACTOR * known.quickest_s && is_used {
                    known.limit = (known.limit + 1).min(max.max(start));
                } else if seconds > QUEUED_FACTOR * known.quickest_s && known.limit > start {
                    known.limit -= 1;
                }
            }
            Outcome::Failed => known.shrink((start / 4).max(1).min(known.limit)),
            Outcome::TimedOut => {
                known.shrink(1);
                known.slow_answers = Some(0);
            }
            Outcome::Unrelated => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> ServerLimits {
        ServerLimits::new(LimitRange { start: 8, max: 64 })
    }

    /// Runs rounds of as many answers as the limit allows, each after `seconds(limit)`; returns the limit after them.
    fn rounds(limits: &mut ServerLimits, count: usize, seconds: impl Fn(usize) -> f64) -> usize {
        for _ in 0..count {
            let limit = limits.limit("a");
            for _ in 0..limit {
                // Free slots are taken at once.
                limits.learn("a", limits.limit("a"), Outcome::AnsweredAfter(seconds(limit)));
            }
        }
        limits.limit("a")
    }

    #[test]
    fn distant_server_gets_more_each_round_and_overloaded_one_does_not() {
        let mut far = limits();
        assert_eq!(rounds(&mut far, 1, |_| 0.1), 16);
        assert_eq!(rounds(&mut far, 9, |_| 0.1), 64, "the maximum");
        // A server that answers 100 a second: further requests only wait in its queue.
        let mut slow = limits();
        let limit = rounds(&mut slow, 50, |limit| 0.05 + limit as f64 / 100.0);
        assert!((8..=20).contains(&limit), "{limit}");
        // The distant server becomes slow.
        let limit = rounds(&mut far, 5, |limit| 0.1 + limit as f64 / 20.0);
        assert!(limit < 20, "{limit}");
    }

    #[test]
    fn failures_lower_and_answers_restore_the_limit() {
        let mut limits = limits();
        rounds(&mut limits, 5, |_| 0.1);
        for _ in 0..100 {
            limits.learn("a", 1, Outcome::Failed);
        }
        assert_eq!(limits.limit("a"), 2);
        limits.learn("a", 1, Outcome::Unrelated);
        assert_eq!(limits.limit("a"), 2);
        for _ in 0..6 {
            limits.learn("a", 1, Outcome::AnsweredAfter(9.0));
        }
        assert_eq!((limits.limit("a"), limits.limit("b")), (8, 8), "the start limit");
    }

    /// Regression: all slots returned at once, and all requests timed out again.
    #[test]
    fn limit_recovers_round_by_round_after_timeouts() {
        let mut limits = limits();
        for _ in 0..6 {
            limits.learn("a", 8, Outcome::TimedOut);
        }
        assert_eq!(limits.limit("a"), 2);
        limits.learn("a", 2, Outcome::Failed);
        assert_eq!(limits.limit("a"), 2, "a failure never raises the limit");
        let mut answers = 0;
        for limit in 3..=8 {
            while limits.limit("a") < limit {
                limits.learn("a", 2, Outcome::AnsweredAfter(0.3));
                answers += 1;
            }
        }
        assert_eq!(answers, 2 + 3 + 4 + 5 + 6 + 7);
        // Grows as before from then on.
        limits.learn("a", 8, Outcome::AnsweredAfter(0.1));
        assert_eq!(limits.limit("a"), 9);
    }

    /// Regression: fewer than half arrived in time.
    #[test]
    fn most_answers_over_a_narrow_link_arrive_in_time() {
        let mut limits = ServerLimits::new(LimitRange { start: 24, max: 64 });
        let (mut in_time, mut too_late) = (0, 0);
        for _ in 0..100 {
            let limit = limits.limit("a");
            // Six at once time out.
            let outcome = if limit < 6 { Outcome::AnsweredAfter(0.1 * limit as f64) } else { Outcome::TimedOut };
            for _ in 0..limit {
                limits.learn("a", limit, outcome);
            }
            if limit < 6 { in_time += limit } else { too_late += limit }
        }
        assert!(in_time >= 2 * too_late, "{in_time} in time, {too_late} timed out");
    }

    #[test]
    fn unused_limit_does_not_grow_and_fixed_limit_stays() {
        let mut idle = limits();
        for _ in 0..100 {
            idle.learn("a", 3, Outcome::AnsweredAfter(0.1));
        }
        assert_eq!(idle.limit("a"), 8);
        let mut fixed = ServerLimits::new(LimitRange { start: 4, max: 0 });
        assert_eq!(rounds(&mut fixed, 20, |_| 0.1), 4);
    }

    #[test]
    fn number_of_remembered_servers_is_bounded() {
        let mut limits = limits();
        for i in 0..1000 {
            limits.learn(&i.to_string(), 8, Outcome::AnsweredAfter(0.1));
        }
        assert!(limits.servers.len() <= MAX_SERVERS);
    }
}
