//! What happens to an answer: a function of the seed, of what is asked for, and of how often that was asked for before.
//!
//! What is asked for is the path with the range, so that parts of an archive that are asked for side by side meet the
//! same whichever comes first, as different files do. Two that ask for the same thing at the same time are told apart by
//! nothing but who comes first.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use terrane::math::random::{SplitMix64, fnv1a};

/// What happens to an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Fate {
    Whole,
    Error,
    Truncated,
    Corrupted,
    Stalled,
    Reset,
    Silent,
    Page,
}

/// How often each thing was asked for.
#[derive(Default)]
pub(super) struct Turns {
    /// By what is asked for; written by the connections.
    counts: Mutex<HashMap<String, u64>>,
}

impl Turns {
    /// The number of a request for this, from 1.
    pub(super) fn next(&self, wanted: &str) -> u64 {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(wanted.to_owned()).or_insert(0);
        *count += 1;
        *count
    }
}

/// Random numbers that are the same each time: seeded by a hash of the path and the number of the request.
pub(super) struct Chance(SplitMix64);

impl Chance {
    pub(super) fn new(seed: u64, wanted: &str, number: u64) -> Self {
        let number = number.wrapping_mul(SplitMix64::GOLDEN_GAMMA);
        Self(SplitMix64::new(fnv1a(wanted.as_bytes()) ^ seed.rotate_left(32) ^ number))
    }

    /// Returns the next number, from 0 to below 1.
    pub(super) fn share(&mut self) -> f64 {
        self.0.next_unit()
    }

    /// One of the fates by their shares of all answers.
    pub(super) fn fate(&mut self, rates: &[(f64, Fate)]) -> Fate {
        let mut share = self.share();
        for (rate, fate) in rates {
            if share < *rate {
                return *fate;
            }
            share -= rate;
        }
        Fate::Whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chance_is_even_and_repeats() {
        let mut a = Chance::new(7, "/x", 1);
        let mut b = Chance::new(7, "/x", 1);
        let shares: Vec<f64> = (0..1000).map(|_| a.share()).collect();
        assert!(shares.iter().all(|s| *s == b.share() && (0.0..1.0).contains(s)));
        let mean = shares.iter().sum::<f64>() / 1000.0;
        assert!((0.45..0.55).contains(&mean), "{mean}");
        assert_ne!(Chance::new(7, "/x", 2).share(), shares[0]);
        assert_ne!(Chance::new(8, "/x", 1).share(), shares[0]);
    }

    /// By tile, by range, by number and by seed each fate has its share; and what failed once has no other chance the next
    /// time than what did not.
    #[test]
    fn fates_have_their_shares() {
        let rates = [(0.1, Fate::Error), (0.05, Fate::Truncated), (0.2, Fate::Reset)];
        let fate = |seed: u64, wanted: &str, number: u64| Chance::new(seed, wanted, number).fate(&rates);
        let tile = |k: u64| format!("/{}/{}/{}.glb", k % 7, k / 7, k % 31);
        let range = |k: u64| format!("/set.3tz bytes={}-{}", 4096 * k, 4096 * k + 4095);
        let of_each: [Vec<Fate>; 4] = [
            (0..8000).map(|k| fate(3, &tile(k), 1)).collect(),
            (0..8000).map(|k| fate(3, &range(k), 1)).collect(),
            (0..8000).map(|k| fate(3, "/tileset.json", k)).collect(),
            (0..8000).map(|k| fate(k, "/tileset.json", 1)).collect(),
        ];
        for fates in &of_each {
            for (rate, of) in rates {
                let share = fates.iter().filter(|fate| **fate == of).count() as f64 / 8000.0;
                assert!((share - rate).abs() < 0.02, "{of:?}: {share}");
            }
        }
        let failed: Vec<u64> = (0..8000).filter(|k| fate(3, &tile(*k), 1) == Fate::Error).collect();
        let again =
            failed.iter().filter(|k| fate(3, &tile(**k), 2) == Fate::Error).count() as f64 / failed.len() as f64;
        assert!((again - 0.1).abs() < 0.04, "{again}");
    }
}
