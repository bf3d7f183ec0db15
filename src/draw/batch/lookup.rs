//! A small hash table from u64 to u32 that is emptied in constant time. Draw thread.

use crate::math::random::fibonacci_hash;

/// Uses open addressing. Entries from before the last [`Self::clear`] have another stamp than the table.
#[derive(Default)]
pub(in crate::draw) struct Lookup {
    /// Stamp, value and key.
    table: Vec<(u32, u32, u64)>,
    stamp: u32,
    len: usize,
}

impl Lookup {
    /// Removes all entries.
    pub(in crate::draw) fn clear(&mut self) {
        if self.table.is_empty() || self.stamp == u32::MAX {
            self.table.clear();
            self.table.resize(64, (0, 0, 0));
            self.stamp = 0;
        }
        self.stamp += 1;
        self.len = 0;
    }

    /// Returns the value of a key; inserts the given value if it has none.
    #[inline]
    pub(in crate::draw) fn get_or_insert(&mut self, key: u64, value: u32) -> u32 {
        let mask = self.table.len() - 1;
        let mut slot = (fibonacci_hash(key) >> 32) as usize & mask;
        loop {
            let (stamp, found, known) = self.table[slot];
            if stamp != self.stamp {
                self.table[slot] = (self.stamp, value, key);
                self.len += 1;
                if self.len * 2 > self.table.len() {
                    self.grow();
                }
                return value;
            }
            if known == key {
                return found;
            }
            slot = (slot + 1) & mask;
        }
    }

    #[cold]
    fn grow(&mut self) {
        let size = self.table.len() * 2;
        let old = std::mem::replace(&mut self.table, vec![(0, 0, 0); size]);
        let stamp = std::mem::replace(&mut self.stamp, 1);
        self.len = 0;
        for (s, value, key) in old {
            if s == stamp {
                self.get_or_insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn behaves_as_a_hash_map(rounds in prop::collection::vec(prop::collection::vec(0u64..400, 0..500), 1..5)) {
            let mut lookup = Lookup::default();
            for keys in rounds {
                lookup.clear();
                let mut map = std::collections::HashMap::new();
                for (i, key) in keys.iter().enumerate() {
                    let key = key.wrapping_mul(0x1_0000_0001);
                    prop_assert_eq!(lookup.get_or_insert(key, i as u32), *map.entry(key).or_insert(i as u32));
                }
            }
        }
    }
}
