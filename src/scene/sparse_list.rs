//! A sorted list of the few elements of an array that have some value. Plain data.

/// Values of some nodes, drawables or tiles, sorted by index.
#[derive(Debug)]
pub(crate) struct SparseList<T>(Vec<(u32, T)>);

impl<T> Default for SparseList<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> SparseList<T> {
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Appends a value. Indices must arrive in ascending order.
    pub fn push(&mut self, index: u32, value: T) {
        debug_assert!(self.0.last().is_none_or(|(last, _)| *last < index));
        self.0.push((index, value));
    }

    /// Returns the value at an index.
    pub fn get(&self, index: u32) -> Option<&T> {
        let at = self.0.binary_search_by_key(&index, |(i, _)| *i).ok()?;
        self.0.get(at).map(|(_, value)| value)
    }

    /// Returns the values in the order of their indices.
    pub fn values(&self) -> impl Iterator<Item = &T> {
        self.0.iter().map(|(_, value)| value)
    }

    /// Returns the first value at an index or behind it.
    pub fn at_or_after(&self, index: u32) -> Option<&(u32, T)> {
        self.0.get(self.0.partition_point(|(i, _)| *i < index))
    }

    /// Returns true if an index of `range` has a value.
    pub fn has_any_in(&self, range: std::ops::Range<usize>) -> bool {
        self.at_or_after(range.start as u32).is_some_and(|(index, _)| (*index as usize) < range.end)
    }

    /// Sets or removes the value at an index.
    pub fn set(&mut self, index: u32, value: Option<T>) {
        match (self.0.binary_search_by_key(&index, |(i, _)| *i), value) {
            (Ok(at), Some(value)) => self.0[at].1 = value,
            (Ok(at), None) => drop(self.0.remove(at)),
            (Err(at), Some(value)) => self.0.insert(at, (index, value)),
            (Err(_), None) => {}
        }
    }

    /// Replaces every index by another, after what is numbered was reordered.
    pub fn renumber(&mut self, new_index: &[u32]) {
        self.0.iter_mut().for_each(|(index, _)| *index = new_index[*index as usize]);
        self.0.sort_unstable_by_key(|(index, _)| *index);
    }
}
