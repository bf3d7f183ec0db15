//! [`SlotTable`]: entries by a number that stays valid until the entry is removed. Draw thread; plain values.

/// Entries by number. Insertion, look-up and removal take constant time; free numbers are reused, the last freed first.
#[derive(Debug)]
pub(super) struct SlotTable<T> {
    entries: Vec<Option<T>>,
    free: Vec<u32>,
}

impl<T> Default for SlotTable<T> {
    fn default() -> Self {
        Self { entries: Vec::new(), free: Vec::new() }
    }
}

impl<T> SlotTable<T> {
    /// Returns the number of the new entry.
    pub(super) fn insert(&mut self, entry: T) -> u32 {
        match self.free.pop() {
            Some(index) => {
                self.entries[index as usize] = Some(entry);
                index
            }
            None => {
                self.entries.push(Some(entry));
                self.entries.len() as u32 - 1
            }
        }
    }

    pub(super) fn get(&self, index: u32) -> Option<&T> {
        self.entries.get(index as usize)?.as_ref()
    }

    pub(super) fn get_mut(&mut self, index: u32) -> Option<&mut T> {
        self.entries.get_mut(index as usize)?.as_mut()
    }

    pub(super) fn remove(&mut self, index: u32) -> Option<T> {
        let entry = self.entries.get_mut(index as usize)?.take()?;
        self.free.push(index);
        Some(entry)
    }

    /// Iterates over the entries with their numbers, in ascending order.
    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = (u32, &mut T)> {
        (0..).zip(&mut self.entries).filter_map(|(index, entry)| Some((index, entry.as_mut()?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stay_valid_and_are_reused() {
        let mut table = SlotTable::default();
        let [a, b, c] = ["a", "b", "c"].map(|name| table.insert(name));
        assert_eq!([a, b, c], [0, 1, 2]);
        assert_eq!((table.remove(a), table.remove(a), table.remove(7)), (Some("a"), None, None));
        assert_eq!(table.remove(c), Some("c"));
        assert_eq!((table.get(a), table.get(b)), (None, Some(&"b")));
        assert_eq!([table.insert("d"), table.insert("e"), table.insert("f")], [c, a, 3]);
        *table.get_mut(b).unwrap() = "g";
        assert_eq!(
            table.iter_mut().map(|(index, name)| (index, *name)).collect::<Vec<_>>(),
            [(0, "e"), (1, "g"), (2, "d"), (3, "f")]
        );
    }
}
