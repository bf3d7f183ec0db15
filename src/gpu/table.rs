//! Things by a number that stays: places are used again, last freed first, and nothing is looked for. Used on the draw
//! thread.

/// Things by their places.
#[derive(Debug)]
pub(super) struct Table<T> {
    entries: Vec<Option<T>>,
    free: Vec<u32>,
}

impl<T> Default for Table<T> {
    fn default() -> Self {
        Self { entries: Vec::new(), free: Vec::new() }
    }
}

impl<T> Table<T> {
    /// Its place.
    pub(super) fn insert(&mut self, entry: T) -> u32 {
        match self.free.pop() {
            Some(place) => {
                self.entries[place as usize] = Some(entry);
                place
            }
            None => {
                self.entries.push(Some(entry));
                self.entries.len() as u32 - 1
            }
        }
    }

    pub(super) fn get(&self, place: u32) -> Option<&T> {
        self.entries.get(place as usize)?.as_ref()
    }

    pub(super) fn get_mut(&mut self, place: u32) -> Option<&mut T> {
        self.entries.get_mut(place as usize)?.as_mut()
    }

    pub(super) fn remove(&mut self, place: u32) -> Option<T> {
        let entry = self.entries.get_mut(place as usize)?.take()?;
        self.free.push(place);
        Some(entry)
    }

    /// All that there are, with their places.
    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = (u32, &mut T)> {
        (0..).zip(&mut self.entries).filter_map(|(place, entry)| Some((place, entry.as_mut()?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_stay_and_are_used_again() {
        let mut table = Table::default();
        let [a, b, c] = ["a", "b", "c"].map(|name| table.insert(name));
        assert_eq!([a, b, c], [0, 1, 2]);
        assert_eq!((table.remove(a), table.remove(a), table.remove(7)), (Some("a"), None, None));
        assert_eq!(table.remove(c), Some("c"));
        assert_eq!((table.get(a), table.get(b)), (None, Some(&"b")));
        assert_eq!([table.insert("d"), table.insert("e"), table.insert("f")], [c, a, 3]);
        *table.get_mut(b).unwrap() = "g";
        assert_eq!(
            table.iter_mut().map(|(place, name)| (place, *name)).collect::<Vec<_>>(),
            [(0, "e"), (1, "g"), (2, "d"), (3, "f")]
        );
    }
}
