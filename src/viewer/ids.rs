//! The ids by which a viewer knows its contexts, scenes, views and slave cameras, and [`KeyedList`], which gives them out.
//! An id is never used again after its object is gone.

use std::ops::{Index, IndexMut};

/// A graphics context of a viewer: one target (a window or an offscreen texture) on a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ContextId(pub(super) u32);

/// A scene of a [`CompositeViewer`](super::CompositeViewer).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SceneId(u32);

/// A view of a [`CompositeViewer`](super::CompositeViewer).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ViewId(u32);

/// A slave camera of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SlaveId(pub(super) u32);

/// A pager of a viewer, which serves one scene or several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PagerId(u32);

/// An id that a [`KeyedList`] makes of a running number.
pub(super) trait ListKey: Copy + Eq {
    fn from_number(number: u32) -> Self;
}

impl ListKey for SceneId {
    fn from_number(number: u32) -> Self {
        Self(number)
    }
}

impl ListKey for ViewId {
    fn from_number(number: u32) -> Self {
        Self(number)
    }
}

impl ListKey for PagerId {
    fn from_number(number: u32) -> Self {
        Self(number)
    }
}

/// A short list in the order added, whose entries are found by id. Look-ups are linear: a viewer has few of each.
#[derive(Debug)]
pub(super) struct KeyedList<K, V> {
    entries: Vec<(K, V)>,
    next: u32,
}

impl<K: ListKey, V> KeyedList<K, V> {
    pub(super) fn new() -> Self {
        Self { entries: Vec::new(), next: 0 }
    }

    /// Returns the id that the next entry gets.
    pub(super) fn next_key(&self) -> K {
        K::from_number(self.next)
    }

    /// Appends an entry and returns its id.
    pub(super) fn push(&mut self, value: V) -> K {
        let key = self.next_key();
        self.next += 1;
        self.entries.push((key, value));
        key
    }

    pub(super) fn remove(&mut self, key: K) -> Option<V> {
        let index = self.entries.iter().position(|(of, _)| *of == key)?;
        Some(self.entries.remove(index).1)
    }

    pub(super) fn get(&self, key: K) -> Option<&V> {
        self.entries.iter().find(|(of, _)| *of == key).map(|(_, value)| value)
    }

    pub(super) fn get_mut(&mut self, key: K) -> Option<&mut V> {
        self.entries.iter_mut().find(|(of, _)| *of == key).map(|(_, value)| value)
    }

    pub(super) fn contains(&self, key: K) -> bool {
        self.get(key).is_some()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (K, &V)> {
        self.entries.iter().map(|(key, value)| (*key, value))
    }

    pub(super) fn values(&self) -> impl Iterator<Item = &V> {
        self.entries.iter().map(|(_, value)| value)
    }

    pub(super) fn values_mut(&mut self) -> impl Iterator<Item = &mut V> {
        self.entries.iter_mut().map(|(_, value)| value)
    }
}

/// For ids that one object keeps of another that outlives it, such as a view's scene.
impl<K: ListKey, V> Index<K> for KeyedList<K, V> {
    type Output = V;

    fn index(&self, key: K) -> &V {
        self.get(key).expect("an object that others refer to is not removed")
    }
}

impl<K: ListKey, V> IndexMut<K> for KeyedList<K, V> {
    fn index_mut(&mut self, key: K) -> &mut V {
        self.get_mut(key).expect("an object that others refer to is not removed")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_not_used_again_and_order_is_kept() {
        let mut list: KeyedList<ViewId, char> = KeyedList::new();
        let [a, b, c] = ['a', 'b', 'c'].map(|value| list.push(value));
        assert_eq!(list.remove(b), Some('b'));
        assert_eq!(list.remove(b), None);
        let d = list.push('d');
        assert!(![a, b, c].contains(&d));
        assert_eq!(list.iter().collect::<Vec<_>>(), [(a, &'a'), (c, &'c'), (d, &'d')]);
        assert!(list.get(b).is_none() && !list.contains(b));
        list[c] = 'x';
        assert_eq!(list[c], 'x');
    }
}
