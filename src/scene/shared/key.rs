//! [`ContentKey`]: what stands for the bytes of an image or a mesh. Any thread.
//!
//! A keyed universal hash: NH (Black, Halevi, Krawczyk, Krovetz, Rogaway: "UMAC") over blocks of 1 KiB, two Toeplitz
//! lanes of 128 bits, then over what comes out of the blocks until one is left. The key is drawn once a process, so
//! that two different contents get equal keys with a probability below 2^-120, whoever made them. It reads some
//! 10 GB/s, where a cryptographic hash would double the time to decode a mesh.

use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::sync::OnceLock;

/// Bytes of a block.
const BLOCK: usize = 1024;
/// Words of key for a block, its length and the second lane.
const WORDS: usize = BLOCK / 8 + 4;
/// Each level makes 32 bytes of a block: seven take more than any memory holds.
const LEVELS: usize = 8;

/// Stands for content: equal where the content is, in this process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ContentKey([u128; 2]);

impl ContentKey {
    /// The key of some parts in order; where one ends and the next begins counts.
    pub fn of(parts: &[&[u8]]) -> Self {
        let keys = keys();
        if let [one] = parts {
            return Self(digest(keys, one));
        }
        let mut joined = Vec::with_capacity(parts.len() * 32);
        for part in parts {
            joined.extend(Self(digest(keys, part)).bytes());
        }
        Self(digest(keys, &joined))
    }

    /// As bytes, to be part of another key.
    pub(crate) fn bytes(&self) -> [u8; 32] {
        let mut bytes = [0; 32];
        bytes[..16].copy_from_slice(&self.0[0].to_le_bytes());
        bytes[16..].copy_from_slice(&self.0[1].to_le_bytes());
        bytes
    }

    /// Spreads keys over tables.
    pub(super) fn shard(&self, count: usize) -> usize {
        (self.0[0] as usize) % count
    }
}

type Keys = [[u64; WORDS]; LEVELS];

fn keys() -> &'static Keys {
    static KEYS: OnceLock<Box<Keys>> = OnceLock::new();
    KEYS.get_or_init(|| {
        let random = RandomState::new();
        let mut keys = Box::new([[0; WORDS]; LEVELS]);
        for (i, word) in keys.iter_mut().flatten().enumerate() {
            let mut hasher = random.build_hasher();
            hasher.write_usize(i);
            *word = hasher.finish();
        }
        keys
    })
}

/// One block, at most [`BLOCK`] bytes, as if filled up with zeros.
fn nh(keys: &[u64; WORDS], block: &[u8]) -> [u128; 2] {
    let word = |bytes: &[u8]| {
        let mut padded = [0; 8];
        padded[..bytes.len()].copy_from_slice(bytes);
        u64::from_le_bytes(padded)
    };
    let (mut a, mut b) = (0u128, 0u128);
    let mut add = |at: usize, m: [u64; 2]| {
        let k: &[u64; 4] = keys[at..].first_chunk().expect("a block has no more words than there are keys");
        let product = |k: [u64; 2]| u128::from(m[0].wrapping_add(k[0])) * u128::from(m[1].wrapping_add(k[1]));
        a = a.wrapping_add(product([k[0], k[1]]));
        b = b.wrapping_add(product([k[2], k[3]]));
    };
    let mut pairs = block.chunks_exact(16);
    let mut at = 0;
    for pair in &mut pairs {
        add(at, [word(&pair[..8]), word(&pair[8..])]);
        at += 2;
    }
    let rest = pairs.remainder();
    if !rest.is_empty() {
        let (first, second) = rest.split_at(rest.len().min(8));
        add(at, [word(first), word(second)]);
        at += 2;
    }
    while at < BLOCK / 8 {
        add(at, [0, 0]);
        at += 2;
    }
    [a, b]
}

fn digest(keys: &Keys, data: &[u8]) -> [u128; 2] {
    let mut level = 0;
    let mut reduced: Vec<u8> = Vec::new();
    while level + 1 < LEVELS {
        let from: &[u8] = if level == 0 { data } else { &reduced };
        if from.len() <= BLOCK {
            break;
        }
        let mut next = Vec::with_capacity(from.len().div_ceil(BLOCK) * 32);
        for block in from.chunks(BLOCK) {
            let [a, b] = nh(&keys[level], block);
            next.extend(a.to_le_bytes());
            next.extend(b.to_le_bytes());
        }
        reduced = next;
        level += 1;
    }
    let last: &[u8] = if level == 0 { data } else { &reduced };
    // The length is a word of the last block, under a key of its own.
    let [mut a, mut b] = nh(&keys[LEVELS - 1], last);
    let [.., k0, k1, k2, k3] = keys[LEVELS - 2];
    let length = data.len() as u64;
    a = a.wrapping_add(u128::from(length.wrapping_add(k0)) * u128::from(k1));
    b = b.wrapping_add(u128::from(length.wrapping_add(k2)) * u128::from(k3));
    [a, b]
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn every_byte_the_length_and_the_parts_count() {
        let base: Vec<u8> = (0..5000u32).map(|i| (i * 31 + 1) as u8).collect();
        let mut seen = HashSet::new();
        for length in (0..300).chain([1023, 1024, 1025, 2048, 4999, 5000]) {
            assert!(seen.insert(ContentKey::of(&[&base[..length]])), "{length}");
            // Zeros at the end are not nothing.
            let zeros = vec![0; length];
            assert!(length == 0 || seen.insert(ContentKey::of(&[&zeros])), "{length} zeros");
        }
        for at in (0..5000).step_by(37) {
            for bit in [0, 7] {
                let mut other = base.clone();
                other[at] ^= 1 << bit;
                assert!(seen.insert(ContentKey::of(&[&other])), "bit {bit} of byte {at}");
            }
        }
        let [ab, c, a, bc] = [&b"ab"[..], b"c", b"a", b"bc"];
        assert_ne!(ContentKey::of(&[ab, c]), ContentKey::of(&[a, bc]));
        assert_ne!(ContentKey::of(&[a, ab]), ContentKey::of(&[ab, a]));
        assert_eq!(ContentKey::of(&[&base]), ContentKey::of(&[&base.clone()]));
    }

    #[test]
    fn blocks_change_places_not_unseen() {
        let mut data: Vec<u8> = (0..8 * BLOCK as u32).map(|i| (i / 7) as u8).collect();
        let key = ContentKey::of(&[&data]);
        data[..2 * BLOCK].rotate_left(BLOCK);
        assert_ne!(key, ContentKey::of(&[&data]));
    }
}
