//! Looking at the present view once more: its picture, its numbers, the contents it draws. Main thread, between
//! frames; leaves statistics, requests and the window as they are.

use std::sync::Arc;

use image::RgbaImage;

use super::rendering::FrameJob;
use super::report::{KEY_COLOR, Settled, coverage};
use super::stats::FrameStats;
use super::{Viewer, ViewerError};
use crate::draw::Sky;
use crate::scene::{DrawSlot, SlotState};

impl Viewer {
    /// Draws the present view once more, unseen and without statistics; on the key colour without fog if asked.
    fn draw_again(&mut self, on_key: bool) -> Result<(FrameStats, RgbaImage), ViewerError> {
        self.base.absorb_all()?;
        let context = self.view.context().ok_or(ViewerError::NoContext(self.context))?;
        self.cull_again();
        let mut environment = self.view.environment;
        if on_key {
            environment.sky = Sky::Background(KEY_COLOR);
            environment.fog.enabled = false;
        }
        let stage = std::mem::take(&mut self.base.probe_stage);
        let mut stats = FrameStats { tiles_drawn: stage.counters.tiles_drawn, ..FrameStats::default() };
        let job = FrameJob {
            context: context.0,
            stage: Some((stage, environment)),
            read_back: true,
            present: false,
            ..self.base.job()
        };
        let handle = self.base.rendering.device_of(context.0).ok_or(ViewerError::NoContext(context))?;
        let done = handle.draw_alone(job)?;
        self.base.probe_stage = done.stage.unwrap_or_default();
        self.base.took(done.errors, done.gpu_bytes_peak);
        let drawn = done.stats?;
        stats.triangles = drawn.triangles;
        stats.points = drawn.points;
        // A window that skipped it has none.
        let image = done.image.ok_or(ViewerError::HiddenWindow)??;
        Ok((stats, image))
    }

    /// Culls the present view once more into the viewer's own stage; nothing where the master camera has no context.
    fn cull_again(&mut self) {
        self.view.prepare(&self.base.rendering, self.paged.bounds.as_ref());
        let frame = self.base.stamp.frame;
        let camera = self.view.master.map(|place| place.camera);
        if let Some(task) = camera.and_then(|camera| self.view.task(camera, &self.paged, frame, Vec::new())) {
            task.run(&mut self.base.probe, &mut self.base.probe_stage);
        }
    }

    /// The present view's picture, drawn once more. [`ViewerError::HiddenWindow`] where a window shows nothing now.
    pub fn picture(&mut self) -> Result<RgbaImage, ViewerError> {
        Ok(self.draw_again(false)?.1)
    }

    /// What the present view draws, for the report; draws it once more, as [`Self::picture`] does.
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
        let context = self.view.context().map_or(u32::MAX, |c| c.0);
        let mut drawn: Vec<DrawSlot> = Vec::new();
        // In stereo the eyes are stages before it.
        let mut stages = vec![&self.base.probe_stage];
        while let Some(stage) = stages.pop() {
            drawn.extend(stage.bins.iter().flat_map(|bin| &bin.leaves).map(|leaf| leaf.slot));
            stages.extend(stage.pre_render.iter().chain(&stage.post_render));
        }
        drawn.retain(|slot| *slot != DrawSlot::NONE);
        drawn.sort_unstable();
        let mut uris = Vec::new();
        let mut pages = self.scene().roots().to_vec();
        while let Some(page) = pages.pop() {
            for slot in self.scene().slots_of_page(page).filter_map(|id| self.scene().slot(id)) {
                let SlotState::Resident(content) = slot.state else { continue };
                pages.push(content);
                let slots = self.scene().page(content).map_or(&[][..], |p| p.draw_slots_of(context));
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
