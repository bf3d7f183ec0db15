//! Small repeatable hashes and random numbers: jitter, procedural terrain, fault injection. Any thread. Not for secrets.
//!
//! Sequences are part of what the project promises: the same seed gives the same terrain, the same faults and the same
//! test plans in every version and on every machine.

/// SplitMix64, a random generator of 64 bits of state (Steele, Lea, Flood: "Fast Splittable Pseudorandom Number
/// Generators", 2014).
///
/// Every state is a good one, so that seeds may be small numbers or hashes. The period is 2^64.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SplitMix64 {
    state: u64,
}

impl SplitMix64 {
    /// The step of the state: 2^64 divided by the golden ratio.
    pub const GOLDEN_GAMMA: u64 = 0x9e37_79b9_7f4a_7c15;

    /// Creates a generator that starts from a state.
    pub const fn new(state: u64) -> Self {
        Self { state }
    }

    /// Returns the next number, uniform over all of u64.
    pub const fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(Self::GOLDEN_GAMMA);
        mix64(self.state)
    }

    /// Returns the next number, uniform from 0 to below 1 in steps of 2^-53.
    pub const fn next_unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Mixes the bits of a number so that each input bit changes about half of the output bits; SplitMix64's finaliser. It
/// maps u64 one to one.
#[inline]
pub const fn mix64(mut bits: u64) -> u64 {
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// Hashes bytes by 64-bit FNV-1a (Fowler, Noll, Vo): short names and URIs, not data from an attacker.
pub fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

/// Spreads a key over the upper bits of the product, for the index of a hash table (Fibonacci hashing, Knuth volume 3,
/// section 6.4).
#[inline]
pub const fn fibonacci_hash(key: u64) -> u64 {
    key.wrapping_mul(SplitMix64::GOLDEN_GAMMA)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first numbers of the reference implementation from state 0 (<https://prng.di.unimi.it/splitmix64.c>).
    #[test]
    fn split_mix_gives_the_reference_sequence() {
        let mut random = SplitMix64::new(0);
        assert_eq!(random.next_u64(), 0xe220_a839_7b1d_cdaf);
        assert_eq!(random.next_u64(), 0x6e78_9e6a_a1b9_65f4);
        let unit = random.next_unit();
        assert!((0.0..1.0).contains(&unit));
    }

    #[test]
    fn fnv_gives_the_published_values() {
        assert_eq!(fnv1a(b""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv1a(b"foobar"), 0x8594_4171_f739_67e8);
    }
}
