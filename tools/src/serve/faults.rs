//! The fault of an answer: a function of the seed, the requested bytes, and the number of earlier requests for them.
//!
//! The requested bytes are the path with the range. So requests for different parts of an archive have the same faults in
//! whatever order they arrive, like requests for different files. Only simultaneous requests for the same bytes depend on
//! their order of arrival.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use terrane::math::random::{SplitMix64, fnv1a};

/// The faults of an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Fault {
    /// No fault.
    None,
    Error,
    Truncated,
    Corrupted,
    Stalled,
    Reset,
    Silent,
    Page,
}

/// The number of requests for each range of bytes.
#[derive(Default)]
pub(super) struct RequestCounts {
    /// Counts by [`Request::key`](super::answer::Request::key), written by the threads of connections.
    counts: Mutex<HashMap<String, u64>>,
}

impl RequestCounts {
    /// Counts a request and returns its number among those with the same key, from 1.
    pub(super) fn next(&self, key: &str) -> u64 {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(key.to_owned()).or_insert(0);
        *count += 1;
        *count
    }
}

/// Random numbers for one answer, seeded by the seed, the key and the number of the request.
pub(super) struct FaultRandom(SplitMix64);

impl FaultRandom {
    pub(super) fn new(seed: u64, key: &str, number: u64) -> Self {
        let number = number.wrapping_mul(SplitMix64::GOLDEN_GAMMA);
        Self(SplitMix64::new(fnv1a(key.as_bytes()) ^ seed.rotate_left(32) ^ number))
    }

    /// Returns the next number, from 0 to below 1.
    pub(super) fn share(&mut self) -> f64 {
        self.0.next_unit()
    }

    /// Draws a fault by the shares of all answers.
    pub(super) fn fault(&mut self, rates: &[(f64, Fault)]) -> Fault {
        let mut share = self.share();
        for (rate, fault) in rates {
            if share < *rate {
                return *fault;
            }
            share -= rate;
        }
        Fault::None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_numbers_are_uniform_and_repeat() {
        let mut a = FaultRandom::new(7, "/x", 1);
        let mut b = FaultRandom::new(7, "/x", 1);
        let shares: Vec<f64> = (0..1000).map(|_| a.share()).collect();
        assert!(shares.iter().all(|s| *s == b.share() && (0.0..1.0).contains(s)));
        let mean = shares.iter().sum::<f64>() / 1000.0;
        assert!((0.45..0.55).contains(&mean), "{mean}");
        assert_ne!(FaultRandom::new(7, "/x", 2).share(), shares[0]);
        assert_ne!(FaultRandom::new(8, "/x", 1).share(), shares[0]);
    }

    /// Each fault has its share over tiles, ranges, numbers of requests and seeds. A request that failed fails again with
    /// the same probability as others.
    #[test]
    fn faults_have_their_shares() {
        let rates = [(0.1, Fault::Error), (0.05, Fault::Truncated), (0.2, Fault::Reset)];
        let fault = |seed: u64, key: &str, number: u64| FaultRandom::new(seed, key, number).fault(&rates);
        let tile = |k: u64| format!("/{}/{}/{}.glb", k % 7, k / 7, k % 31);
        let range = |k: u64| format!("/set.3tz bytes={}-{}", 4096 * k, 4096 * k + 4095);
        let of_each: [Vec<Fault>; 4] = [
            (0..8000).map(|k| fault(3, &tile(k), 1)).collect(),
            (0..8000).map(|k| fault(3, &range(k), 1)).collect(),
            (0..8000).map(|k| fault(3, "/tileset.json", k)).collect(),
            (0..8000).map(|k| fault(k, "/tileset.json", 1)).collect(),
        ];
        for faults in &of_each {
            for (rate, of) in rates {
                let share = faults.iter().filter(|fault| **fault == of).count() as f64 / 8000.0;
                assert!((share - rate).abs() < 0.02, "{of:?}: {share}");
            }
        }
        let failed: Vec<u64> = (0..8000).filter(|k| fault(3, &tile(*k), 1) == Fault::Error).collect();
        let again =
            failed.iter().filter(|k| fault(3, &tile(**k), 2) == Fault::Error).count() as f64 / failed.len() as f64;
        assert!((again - 0.1).abs() < 0.04, "{again}");
    }
}
