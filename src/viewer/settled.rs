//! Looking at the present view once more: its picture, its numbers, the contents it draws. Main thread, between
//! frames; leaves statistics, requests and the window as they are.

use std::sync::Arc;

use image::RgbaImage;

use super::holes::{KEY_COLOR, coverage};
use super::report::Settled;
use super::stats::FrameStats;
use super::viewer::CONTEXT;
use super::{Viewer, ViewerError};
use crate::cull::RenderStage;
use crate::draw::Sky;
use crate::scene::{DrawSlot, SlotState};

impl Viewer {
    /// Draws the present view once more, unseen and without statistics; on the key colour without fog if asked.
    fn draw_again(&mut self, on_key: bool) -> Result<(FrameStats, RgbaImage), ViewerError> {
        self.absorb_all()?;
        let stage = self.cull_again();
        let mut stats = FrameStats { tiles_drawn: stage.counters.tiles_drawn, ..FrameStats::default() };
        let mut job = self.job(stage);
        if on_key {
            job.environment.sky = Sky::Background(KEY_COLOR);
            job.environment.fog.enabled = false;
        }
        job.read_back = true;
        job.present = false;
        self.context.frame(job)?;
        let done = self.context.wait_done()?.ok_or(ViewerError::DrawThreadStopped)?;
        self.free_stages.push(done.stage);
        let drawn = done.stats?;
        stats.triangles = drawn.triangles;
        stats.points = drawn.points;
        let image = done.image.ok_or(ViewerError::DrawThreadStopped)??;
        Ok((stats, image))
    }

    /// Culls the present view once more, leaving requests and counters as they are.
    fn cull_again(&mut self) -> RenderStage {
        let mut stage = self.free_stages.pop().unwrap_or_default();
        let (requests, wanted_missing) = (std::mem::take(&mut self.requests), self.wanted_missing);
        self.cull_into(&mut stage);
        (self.requests, self.wanted_missing) = (requests, wanted_missing);
        stage
    }

    /// The present view's picture, drawn once more.
    pub fn picture(&mut self) -> Result<RgbaImage, ViewerError> {
        Ok(self.draw_again(false)?.1)
    }

    /// What the present view draws, for the report; draws it once more.
    pub fn settled(&mut self) -> Result<Settled, ViewerError> {
        let (stats, image) = self.draw_again(true)?;
        Ok(Settled {
            tiles: u64::from(stats.tiles_drawn),
            contents: self.drawn_contents().len() as u64,
            triangles: stats.triangles,
            points: stats.points,
            coverage: coverage(&image, KEY_COLOR),
        })
    }

    /// URIs of the contents that the present view draws, sorted.
    pub fn drawn_contents(&mut self) -> Vec<Arc<str>> {
        let stage = self.cull_again();
        let mut drawn: Vec<DrawSlot> = stage.bins.iter().flat_map(|b| &b.leaves).map(|leaf| leaf.slot).collect();
        drawn.retain(|slot| *slot != DrawSlot::NONE);
        drawn.sort_unstable();
        self.free_stages.push(stage);
        let mut uris = Vec::new();
        let mut pages = self.scene.roots().to_vec();
        while let Some(page) = pages.pop() {
            for slot in self.scene.slots_of_page(page).filter_map(|id| self.scene.slot(id)) {
                let SlotState::Resident(content) = slot.state else { continue };
                pages.push(content);
                let slots = self.scene.page(content).map_or(&[][..], |p| p.draw_slots_of(CONTEXT));
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
