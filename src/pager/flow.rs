//! How many requests a server gets at once: more while it answers as quickly as ever, fewer when answers take longer or
//! fail. Written and read by the HTTP thread alone.
//!
//! Each answer in time adds one place, so that the number doubles in the time of an answer; waiting in a server's or a
//! link's queue shows as longer answers (as in TCP Vegas) and takes places away again. Where answers did not come in time
//! at all, places come back one for each round of answers: a narrow line would be too narrow again at once.

use std::collections::HashMap;

use crate::io::IoError;

/// Answers up to so much longer than the quickest are in time.
const IN_TIME: f64 = 1.5;
/// Answers that take so much longer have waited in a queue.
const QUEUED: f64 = 3.0;
/// The quickest answer is forgotten by this share with each slower one at the start's limit: paths change.
const FORGET: f64 = 0.01;
/// Servers remembered beyond those in use.
const MOST_SERVERS: usize = 64;

/// Limits of one server.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Range {
    /// At the start, and the least while answers only take longer.
    pub start: usize,
    /// The most; not beyond `start` where it is less.
    pub most: usize,
}

/// What an answer says about its server.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Answered {
    /// After so many seconds, with bytes or without ("not modified").
    After(f64),
    /// It was overloaded or not there.
    Failed,
    /// It did not answer in time.
    TooLate,
    /// Nothing: from the cache, not found, or not as it should be.
    Else,
}

impl Answered {
    pub fn of<T>(result: &Result<T, IoError>, asked: bool, seconds: f64) -> Self {
        match result {
            Ok(_) if asked => Self::After(seconds),
            Err(IoError::Timeout { .. }) => Self::TooLate,
            Err(error) if error.is_transient() && !error.is_doubtful() => Self::Failed,
            _ => Self::Else,
        }
    }
}

/// One server.
#[derive(Clone, Copy, Debug)]
struct Flow {
    limit: usize,
    quickest_s: f64,
    /// Answers since the last place came back, while places come back slowly.
    slow_answers: Option<usize>,
}

impl Flow {
    fn lose(&mut self, least: usize) {
        self.limit = (self.limit - (self.limit / 8).max(1).min(self.limit)).max(least);
    }

    /// One more place, of those that there were at the start.
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

/// All servers, by scheme, name and port.
#[derive(Debug)]
pub(super) struct Flows {
    range: Range,
    flows: HashMap<String, Flow>,
}

impl Flows {
    pub fn new(range: Range) -> Self {
        Self { range, flows: HashMap::new() }
    }

    /// Requests that a server may have.
    pub fn limit(&self, server: &str) -> usize {
        self.flows.get(server).map_or(self.range.start, |flow| flow.limit)
    }

    /// A server with so many requests may have one more, of so many places that are left to all: the last ones are for those
    /// that have fewer, so that servers that hang do not have all.
    pub fn leaves_enough(&self, has: usize, left: usize) -> bool {
        has == 0 || left > self.range.start || has + 1 < left
    }

    /// Learns from an answer of a server that had so many requests while it came.
    pub fn learn(&mut self, server: &str, running: usize, answered: Answered) {
        if answered == Answered::Else {
            return;
        }
        if self.flows.len() >= MOST_SERVERS && !self.flows.contains_key(server) {
            self.flows.clear();
        }
        let Range { start, most } = self.range;
        let new = Flow { limit: start, quickest_s: f64::INFINITY, slow_answers: None };
        let flow = self.flows.entry(server.to_owned()).or_insert(new);
        match answered {
            Answered::After(seconds) => {
                if seconds < flow.quickest_s {
                    flow.quickest_s = seconds;
                } else if flow.limit <= start {
                    // Under more requests, longer answers say nothing of the path.
                    flow.quickest_s += FORGET * (seconds - flow.quickest_s);
                }
                // More is of use only where what it may have is used.
                let is_used = 4 * running >= 3 * flow.limit;
                if flow.limit < start {
                    flow.regain(start);
                } else if seconds <= IN_TIME * flow.quickest_s && is_used {
                    flow.limit = (flow.limit + 1).min(most.max(start));
                } else if seconds > QUEUED * flow.quickest_s && flow.limit > start {
                    flow.limit -= 1;
                }
            }
            Answered::Failed => flow.lose((start / 4).max(1).min(flow.limit)),
            Answered::TooLate => {
                flow.lose(1);
                flow.slow_answers = Some(0);
            }
            Answered::Else => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flows() -> Flows {
        Flows::new(Range { start: 8, most: 64 })
    }

    /// Rounds of as many answers as the limit allows, each after what `seconds` says of the limit.
    fn rounds(flows: &mut Flows, count: usize, seconds: impl Fn(usize) -> f64) -> usize {
        for _ in 0..count {
            let limit = flows.limit("a");
            for _ in 0..limit {
                // Free places are taken at once.
                flows.learn("a", flows.limit("a"), Answered::After(seconds(limit)));
            }
        }
        flows.limit("a")
    }

    #[test]
    fn a_far_server_gets_more_each_round_and_a_slow_one_does_not() {
        let mut far = flows();
        assert_eq!(rounds(&mut far, 1, |_| 0.1), 16);
        assert_eq!(rounds(&mut far, 9, |_| 0.1), 64, "the most");
        // One that does 100 a second: what more it gets only waits.
        let mut slow = flows();
        let limit = rounds(&mut slow, 50, |limit| 0.05 + limit as f64 / 100.0);
        assert!((8..=20).contains(&limit), "{limit}");
        // It was far and is slow now.
        let limit = rounds(&mut far, 5, |limit| 0.1 + limit as f64 / 20.0);
        assert!(limit < 20, "{limit}");
    }

    #[test]
    fn failures_take_and_answers_give_back() {
        let mut flows = flows();
        rounds(&mut flows, 5, |_| 0.1);
        for _ in 0..100 {
            flows.learn("a", 1, Answered::Failed);
        }
        assert_eq!(flows.limit("a"), 2);
        flows.learn("a", 1, Answered::Else);
        assert_eq!(flows.limit("a"), 2);
        for _ in 0..6 {
            flows.learn("a", 1, Answered::After(9.0));
        }
        assert_eq!((flows.limit("a"), flows.limit("b")), (8, 8), "what it had at the start");
    }

    /// All came back at once, and all were too late again.
    #[test]
    fn a_line_that_was_too_narrow_gets_more_round_by_round() {
        let mut flows = flows();
        for _ in 0..6 {
            flows.learn("a", 8, Answered::TooLate);
        }
        assert_eq!(flows.limit("a"), 2);
        flows.learn("a", 2, Answered::Failed);
        assert_eq!(flows.limit("a"), 2, "a failure takes places, and gives none");
        let mut answers = 0;
        for limit in 3..=8 {
            while flows.limit("a") < limit {
                flows.learn("a", 2, Answered::After(0.3));
                answers += 1;
            }
        }
        assert_eq!(answers, 2 + 3 + 4 + 5 + 6 + 7);
        // As quick as before from then on.
        flows.learn("a", 8, Answered::After(0.1));
        assert_eq!(flows.limit("a"), 9);
    }

    /// Fewer than half did.
    #[test]
    fn most_answers_of_a_narrow_line_come_in_time() {
        let mut flows = Flows::new(Range { start: 24, most: 64 });
        let (mut in_time, mut too_late) = (0, 0);
        for _ in 0..100 {
            let limit = flows.limit("a");
            // Six at once take until the time is over.
            let answered = if limit < 6 { Answered::After(0.1 * limit as f64) } else { Answered::TooLate };
            for _ in 0..limit {
                flows.learn("a", limit, answered);
            }
            if limit < 6 { in_time += limit } else { too_late += limit }
        }
        assert!(in_time >= 2 * too_late, "{in_time} came, {too_late} did not");
    }

    #[test]
    fn what_is_not_used_does_not_grow_and_a_fixed_limit_is_fixed() {
        let mut idle = flows();
        for _ in 0..100 {
            idle.learn("a", 3, Answered::After(0.1));
        }
        assert_eq!(idle.limit("a"), 8);
        let mut fixed = Flows::new(Range { start: 4, most: 0 });
        assert_eq!(rounds(&mut fixed, 20, |_| 0.1), 4);
    }

    #[test]
    fn many_servers_are_not_all_remembered() {
        let mut flows = flows();
        for i in 0..1000 {
            flows.learn(&i.to_string(), 8, Answered::After(0.1));
        }
        assert!(flows.flows.len() <= MOST_SERVERS);
    }
}
