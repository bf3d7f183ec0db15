//! [`OwnPages`]: the pages that the application added to a scene itself, and their uploads to each device. Main thread.
//!
//! The pager uploads only what it loads. Pages of the application are uploaded here, under running numbers that are
//! never used again, so that a result that arrives after its page was removed is recognised and released.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;

use crate::scene::{Drawable, Geometry, Mesh, Page, PageId, Scene};
use crate::state::DataVariance;
use crate::viewer::ViewerError;
use crate::viewer::rendering::Rendering;

/// A page whose drawables were sent to the devices.
struct OwnPage {
    page: PageId,
    /// The drawables, for devices that are opened later; empty when they are not kept.
    drawables: Vec<Drawable>,
}

/// The application's pages of one scene.
pub(in crate::viewer) struct OwnPages {
    /// Distinguishes the scene's uploads from those of other scenes.
    owner: u16,
    /// By upload number.
    pages: BTreeMap<u32, OwnPage>,
    /// The upload number of each page.
    numbers: HashMap<PageId, u32>,
    next_number: u32,
    /// Devices and upload numbers of the uploads in flight.
    in_flight: HashSet<(u32, u32)>,
    /// The number of uploads that pages have received.
    merged: u32,
    /// See [`ViewerConfig::keep_drawables`](crate::viewer::ViewerConfig::keep_drawables).
    keeps_drawables: bool,
}

impl OwnPages {
    pub(super) fn new(owner: u16, keeps_drawables: bool) -> Self {
        Self {
            owner,
            pages: BTreeMap::new(),
            numbers: HashMap::new(),
            next_number: 0,
            in_flight: HashSet::new(),
            merged: 0,
            keeps_drawables,
        }
    }

    pub(super) fn owner(&self) -> u16 {
        self.owner
    }

    /// Returns true while an upload is in flight.
    pub(super) fn is_uploading(&self) -> bool {
        !self.in_flight.is_empty()
    }

    /// Returns a number that changes when a page has received its upload.
    pub(super) fn merged(&self) -> u32 {
        self.merged
    }

    /// Uploads the drawables of a page to all devices.
    pub(super) fn upload(
        &mut self,
        page: PageId,
        drawables: Vec<Drawable>,
        rendering: &mut Rendering,
    ) -> Result<(), ViewerError> {
        let kept = if self.keeps_drawables { drawables.clone() } else { Vec::new() };
        let number = self.next_number;
        self.next_number += 1;
        rendering.compile_own(self.owner, number, drawables)?;
        self.in_flight.extend(rendering.device_ids().map(|device| (device, number)));
        self.pages.insert(number, OwnPage { page, drawables: kept });
        self.numbers.insert(page, number);
        Ok(())
    }

    /// Uploads all kept pages to a device that was opened later.
    pub(super) fn upload_to(&mut self, device: u32, rendering: &mut Rendering) -> Result<(), ViewerError> {
        for (number, own) in &self.pages {
            if !own.drawables.is_empty() {
                rendering.compile_own_in(device, self.owner, *number, own.drawables.clone())?;
                self.in_flight.insert((device, *number));
            }
        }
        Ok(())
    }

    /// Gives pages the draw slots of uploads that have finished.
    pub(super) fn merge_uploaded(&mut self, scene: &mut Scene, rendering: &mut Rendering) {
        if self.in_flight.is_empty() {
            return;
        }
        for (device, number, compiled) in rendering.take_compiled_own(self.owner) {
            self.in_flight.remove(&(device, number));
            for error in &compiled.errors {
                log::error!("a drawable of a root cannot be drawn: {error}");
            }
            match self.pages.get(&number).and_then(|own| scene.page_mut(own.page)) {
                Some(page) => {
                    page.set_draw_slots(device, compiled.slots);
                    self.merged = self.merged.wrapping_add(1);
                }
                // The page was removed meanwhile.
                None => rendering.release(device, compiled.slots),
            }
        }
    }

    /// Gives a page that was removed from the scene its kept drawables back, with meshes that the devices have not
    /// received yet. An upload still in flight finds no page and is released.
    pub(super) fn remove(&mut self, id: PageId, page: &mut Page, scene: &mut Scene) {
        let Some(mut own) = self.numbers.remove(&id).and_then(|number| self.pages.remove(&number)) else { return };
        for rewritten in scene.rewritten_mut().extract_if(.., |rewritten| rewritten.page == id) {
            if let Some(drawable) = own.drawables.get_mut(rewritten.drawable as usize) {
                drawable.geometry = Geometry::Mesh(rewritten.mesh);
            }
        }
        page.put_drawables(own.drawables);
    }

    /// Returns true when a page's drawables are on a device or will be. False only for pages that are not kept, on a device that
    /// was opened after their upload.
    pub(super) fn is_on_or_bound_for(&self, page: PageId, device: u32) -> bool {
        self.numbers.get(&page).is_none_or(|number| self.in_flight.contains(&(device, *number)))
    }

    /// Puts a changed mesh into the kept drawables. Dynamic meshes are not kept: the application alone must hold them to
    /// overwrite them.
    pub(super) fn keep_rewritten(&mut self, page: PageId, drawable: u32, mesh: Arc<Mesh>, variance: DataVariance) {
        if variance != DataVariance::Static {
            return;
        }
        let own = self.numbers.get(&page).and_then(|number| self.pages.get_mut(number));
        if let Some(drawable) = own.and_then(|own| own.drawables.get_mut(drawable as usize)) {
            drawable.geometry = Geometry::Mesh(mesh);
        }
    }

    /// Forgets the uploads to a device that is gone.
    pub(super) fn device_closed(&mut self, device: u32) {
        self.in_flight.retain(|(of, _)| *of != device);
    }
}

#[cfg(test)]
impl OwnPages {
    /// Returns the number of kept pages and of upload numbers.
    pub(super) fn counts(&self) -> (usize, usize) {
        (self.pages.len(), self.numbers.len())
    }

    pub(super) fn number_of(&self, page: PageId) -> Option<u32> {
        self.numbers.get(&page).copied()
    }
}
