//! Looking at the present view once more: its picture, its numbers, the contents it draws. Main thread, between
//! frames; leaves statistics, requests and the window as they are.

use std::sync::Arc;

use image::RgbaImage;

use super::holes::{KEY_COLOR, coverage};
use super::rendering::FrameJob;
use super::report::Settled;
use super::stats::FrameStats;
use super::viewer::CONTEXT;
use super::{Viewer, ViewerError};
use crate::draw::Sky;
use crate::scene::{DrawSlot, SlotState};

impl Viewer {
    /// Draws the present view once more, unseen and without statistics; on the key colour without fog if asked.
    fn draw_again(&mut self, on_key: bool) -> Result<(FrameStats, RgbaImage), ViewerError> {
        self.absorb_all()?;
        self.cull_again();
        let stage = std::mem::take(&mut self.probe_stage);
        let mut stats = FrameStats { tiles_drawn: stage.counters.tiles_drawn, ..FrameStats::default() };
        let mut job = FrameJob { stage: Some(stage), read_back: true, present: false, ..self.job() };
        if on_key {
            job.environment.sky = Sky::Background(KEY_COLOR);
            job.environment.fog.enabled = false;
        }
        let context = self.rendering.context_mut(CONTEXT).ok_or(ViewerError::DrawThreadStopped)?;
        let done = context.draw_alone(job)?;
        self.probe_stage = done.stage.unwrap_or_default();
        let drawn = done.stats?;
        stats.triangles = drawn.triangles;
        stats.points = drawn.points;
        let image = done.image.ok_or(ViewerError::DrawThreadStopped)??;
        Ok((stats, image))
    }

    /// Culls the present view once more into the viewer's own stage.
    fn cull_again(&mut self) {
        self.prepare_eyes();
        let task = self.task(Vec::new());
        task.run(&mut self.probe, &mut self.probe_stage);
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
        self.cull_again();
        let mut drawn: Vec<DrawSlot> =
            self.probe_stage.bins.iter().flat_map(|b| &b.leaves).map(|leaf| leaf.slot).collect();
        drawn.retain(|slot| *slot != DrawSlot::NONE);
        drawn.sort_unstable();
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
