//! [`ContentKey`]: a hash that stands for the bytes of an image or a mesh. Any thread.
//!
//! The hash is HighwayHash (Alakuijala, Cox, Wassenberg: "Fast keyed hash/pseudo-random function using SIMD multiply and
//! permute") of 256 bits, with a random key per process. An author of contents therefore cannot construct two with equal
//! keys, and random collisions do not happen. It hashes some GB/s; a cryptographic hash would double the time to decode a
//! mesh.

use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::sync::OnceLock;

use highway::{HighwayHash as _, HighwayHasher, Key};

use crate::scene::geometry::{MeshVertex, VertexAttributes};

/// Stands for content: two keys of this process are equal if the contents are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ContentKey([u64; 4]);

impl ContentKey {
    /// Returns the key of parts in order; the boundaries between parts count.
    pub fn of(parts: &[&[u8]]) -> Self {
        let mut hasher = HighwayHasher::new(key());
        for part in parts {
            hasher.append(&(part.len() as u64).to_le_bytes());
            hasher.append(part);
        }
        Self(hasher.finalize256())
    }

    /// Returns the key of a mesh's vertices with their custom attributes.
    pub(crate) fn of_vertices(vertices: &[MeshVertex], attributes: &VertexAttributes) -> Self {
        let vertices = bytemuck::cast_slice(vertices);
        if attributes.is_empty() {
            return Self::of(&[vertices]);
        }
        // `Debug` quotes the names, so that different layouts give different text.
        let layout = format!("{:?}", attributes.layout());
        let elements = attributes.iter().map(|(_, _, elements)| elements);
        Self::of(&[vertices, layout.as_bytes()].into_iter().chain(elements).collect::<Vec<_>>())
    }

    /// Returns the key as bytes, to be hashed into another key.
    pub(crate) fn bytes(&self) -> [u8; 32] {
        let mut bytes = [0; 32];
        for (to, word) in bytes.chunks_exact_mut(8).zip(self.0) {
            to.copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }

    /// Returns the part of a table that the key belongs to.
    pub(super) fn shard(&self, count: usize) -> usize {
        (self.0[0] as usize) % count
    }
}

fn key() -> Key {
    static KEY: OnceLock<Key> = OnceLock::new();
    *KEY.get_or_init(|| {
        let random = RandomState::new();
        Key([0u8, 1, 2, 3].map(|i| {
            let mut hasher = random.build_hasher();
            hasher.write_u8(i);
            hasher.finish()
        }))
    })
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn key_depends_on_bytes_length_and_parts() {
        let base: Vec<u8> = (0..5000u32).map(|i| (i * 31 + 1) as u8).collect();
        let mut seen = HashSet::new();
        for length in (0..300).chain([1023, 1024, 1025, 2048, 4999, 5000]) {
            assert!(seen.insert(ContentKey::of(&[&base[..length]])), "{length}");
            // Trailing zeros count.
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
    fn swapped_blocks_change_the_key() {
        let mut data: Vec<u8> = (0..8 * 1024).map(|i| (i / 7) as u8).collect();
        let key = ContentKey::of(&[&data]);
        data[..2048].rotate_left(1024);
        assert_ne!(key, ContentKey::of(&[&data]));
    }
}
