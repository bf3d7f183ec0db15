//! Attributions of what is on screen. Main thread, not frame-time code.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::graph::Scene;
use super::id::NodeId;

/// A page whose tile a cull wanted within this many frames counts as shown: frames may overlap.
const SHOWN_FRAMES: u32 = 2;

impl Scene {
    /// Returns the attributions of the pages that culls wanted in the last frames, and of root pages: those that most pages
    /// have first, each once. They are the `asset.copyright` of tilesets and glTFs, and the credits of raster overlays. Takes
    /// some ten nanoseconds for each page. `frame` is the number of the current frame.
    pub fn credits(&self, frame: u32) -> Vec<Arc<str>> {
        let mut counts: BTreeMap<Arc<str>, u64> = BTreeMap::new();
        for at in 0..self.page_table_len() {
            let Some(page) = self.page_at(at).filter(|page| !page.credits().is_empty()) else { continue };
            let is_shown = |slot| self.last_used(slot).is_some_and(|used| used.saturating_add(SHOWN_FRAMES) >= frame);
            if self.slot_at(at).is_none_or(is_shown) {
                page.credits().iter().for_each(|credit| *counts.entry(credit.clone()).or_default() += 1);
            }
        }
        let mut credits: Vec<(Arc<str>, u64)> = counts.into_iter().collect();
        credits.sort_by_key(|(_, count)| Reverse(*count));
        credits.into_iter().map(|(credit, _)| credit).collect()
    }

    fn last_used(&self, slot: NodeId) -> Option<u32> {
        let page = self.page(slot.page)?;
        let tile = page.tile_of(slot.index)?;
        Some(page.tiles().last_used().get(tile)?.load(Ordering::Relaxed))
    }
}
