//! [`Availability`]: which elements of a subtree exist, and the rows of their metadata. Immutable; decode threads.

use crate::formats::properties::SharedBytes;

/// The number of elements of a block whose available ones are counted ahead.
const BLOCK: u64 = 512;

/// Whether each element of a set is available. The bits stay as they are in the file.
#[derive(Clone, Debug)]
pub(super) enum Availability {
    /// All are, or none is.
    Constant(bool),
    /// A bit for each, lowest first.
    Bits(SharedBytes),
}

impl Availability {
    /// Returns true if an element is available.
    pub fn has(&self, index: u64) -> bool {
        match self {
            Self::Constant(constant) => *constant,
            Self::Bits(bits) => bits.get((index >> 3) as usize).is_some_and(|byte| byte >> (index & 7) & 1 == 1),
        }
    }
}

/// The number of available elements before each block of [`BLOCK`]; empty for constants.
#[derive(Clone, Debug)]
pub(super) struct Ranks(Vec<u32>);

impl Ranks {
    pub fn new(of: &Availability) -> Self {
        let Availability::Bits(bits) = of else { return Self(Vec::new()) };
        let mut before = 0;
        let blocks = bits.chunks((BLOCK / 8) as usize);
        let ranks = blocks.map(|block| {
            let before_block = before;
            before += ones(block);
            before_block
        });
        Self(ranks.collect())
    }

    /// Returns the number of available elements before an element of the set that this was made of: the row of its metadata.
    pub fn row(&self, of: &Availability, index: u64) -> usize {
        let Availability::Bits(bits) = of else { return index as usize };
        let block = index / BLOCK;
        let before = self.0.get(block as usize).copied().unwrap_or(0);
        let bytes = bits.get((block * BLOCK / 8) as usize..=(index >> 3) as usize).unwrap_or_default();
        let Some((last, whole)) = bytes.split_last() else { return before as usize };
        let below = (last & ((1_u16 << (index & 7)) - 1) as u8).count_ones();
        (before + ones(whole) + below) as usize
    }

    /// Returns the bytes of CPU memory.
    pub fn size_bytes(&self) -> u64 {
        4 * self.0.len() as u64
    }
}

/// Returns the number of bits that are set.
fn ones(bytes: &[u8]) -> u32 {
    bytes.iter().map(|byte| byte.count_ones()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_count_the_available_elements_before() {
        let bytes: Vec<u8> = (0..300_u32).map(|i| (i * 37 % 251) as u8).collect();
        let bits = Availability::Bits(bytes.clone().into());
        let ranks = Ranks::new(&bits);
        let mut before = 0;
        for index in 0..2400 {
            assert_eq!(ranks.row(&bits, index), before, "{index}");
            assert_eq!(bits.has(index), bytes[index as usize / 8] >> (index % 8) & 1 == 1);
            before += usize::from(bits.has(index));
        }
        assert!(!bits.has(2400) && ranks.row(&bits, u64::MAX >> 1) == 0);
        let all = Availability::Constant(true);
        assert_eq!((Ranks::new(&all).row(&all, 7), all.has(7)), (7, true));
    }
}
