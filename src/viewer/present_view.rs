//! The present view of a [`Viewer`]: its image, its counters, the contents that it draws. Main thread, between frames.

use std::sync::Arc;

use image::RgbaImage;

use super::ViewerError;
use super::frame::FrameStats;
use super::report::{KEY_COLOR, Settled, coverage};
use super::viewer::Viewer;
use crate::scene::SlotState;

impl Viewer {
    fn draw_again(&mut self, background: Option<[u8; 3]>) -> Result<(FrameStats, RgbaImage), ViewerError> {
        let context = self.context();
        let (frame, view, scene) = self.parts_mut();
        frame.draw_again(view, scene, context, background)
    }

    /// Draws the present view once more and returns its image. [`ViewerError::HiddenWindow`] when the window shows nothing
    /// now.
    pub fn picture(&mut self) -> Result<RgbaImage, ViewerError> {
        Ok(self.draw_again(None)?.1)
    }

    /// Draws the present view once more and returns its counters for the report.
    pub fn settled(&mut self) -> Result<Settled, ViewerError> {
        let (stats, image) = self.draw_again(Some(KEY_COLOR))?;
        Ok(Settled {
            tiles: u64::from(stats.tiles_drawn),
            contents: self.drawn_contents().len() as u64,
            triangles: stats.triangles,
            points: stats.points,
            coverage: coverage(&image, KEY_COLOR),
        })
    }

    /// Returns the URIs of the contents that the present view draws, sorted.
    pub fn drawn_contents(&mut self) -> Vec<Arc<str>> {
        self.contents_in_view(true)
    }

    /// Returns the URIs of the contents whose tiles the present view selects, sorted: also those whose tile's bounding volume
    /// is in view and whose content is not. This is the selection of tiles of other clients for 3D Tiles.
    pub fn selected_contents(&mut self) -> Vec<Arc<str>> {
        self.contents_in_view(false)
    }

    fn contents_in_view(&mut self, culls_contents: bool) -> Vec<Arc<str>> {
        let (frame, view, scene) = self.parts_mut();
        frame.cull_again(view, scene, culls_contents);
        let drawn = frame.drawn_slots();
        let device = view.master.map_or(u32::MAX, |slot| slot.device);
        let scene = scene.scene();
        let mut uris = Vec::new();
        let mut pages = scene.roots().to_vec();
        while let Some(page) = pages.pop() {
            for slot in scene.slots_of_page(page).filter_map(|id| scene.slot(id)) {
                let SlotState::Resident(content) = slot.state else { continue };
                pages.push(content);
                let slots = scene.page(content).map_or(&[][..], |p| p.draw_slots_of(device));
                if slots.iter().any(|s| drawn.binary_search(s).is_ok()) {
                    uris.push(Arc::clone(slot.uri));
                }
            }
        }
        uris.sort();
        uris.dedup();
        uris
    }
}
