//! [`DrawableTable`]: the uploaded drawables by [`DrawSlot`], and their bind classes. Draw thread.

use std::collections::HashMap;

use super::drawable_entry::{BindClass, DrawableEntry};
use super::slot_table::SlotTable;
use crate::scene::DrawSlot;

/// Drawables by slot. Slots are reused, the last freed first.
#[derive(Default)]
pub(super) struct DrawableTable {
    /// Each class once; classes are never removed.
    classes: Vec<BindClass>,
    /// Never iterated.
    index_of_class: HashMap<BindClass, u32>,
    entries: SlotTable<DrawableEntry>,
}

impl DrawableTable {
    fn classify(&mut self, entry: &mut DrawableEntry) {
        let class = entry.bind_class();
        entry.class = *self.index_of_class.entry(class).or_insert_with(|| {
            self.classes.push(class);
            self.classes.len() as u32 - 1
        });
    }

    pub(super) fn insert(&mut self, mut entry: DrawableEntry) -> DrawSlot {
        self.classify(&mut entry);
        DrawSlot(self.entries.insert(entry))
    }

    /// Replaces the drawable in a slot.
    pub(super) fn replace(&mut self, slot: DrawSlot, mut entry: DrawableEntry) {
        self.classify(&mut entry);
        if let Some(old) = self.entries.get_mut(slot.0) {
            *old = entry;
        }
    }

    pub(super) fn remove(&mut self, slot: DrawSlot) -> Option<DrawableEntry> {
        self.entries.remove(slot.0)
    }

    pub(super) fn entry(&self, slot: DrawSlot) -> Option<&DrawableEntry> {
        self.entries.get(slot.0)
    }

    /// Returns the classes by [`DrawableEntry::class`].
    pub(super) fn classes(&self) -> &[BindClass] {
        &self.classes
    }
}
