//! Culls or draws a view once more. Main thread, between frames. Statistics, requests and the window stay as they are.

use image::RgbaImage;

use super::frame_loop::FrameLoop;
use super::stats::FrameStats;
use crate::scene::{DrawSlot, Sky};
use crate::viewer::paging::PagedScene;
use crate::viewer::rendering::FrameJob;
use crate::viewer::view::View;
use crate::viewer::{ContextId, ViewerError};

impl FrameLoop {
    /// Draws a view once more, without presenting it and without statistics; on a background in sRGB and without fog if asked.
    /// `context` is named in the error of a view whose own context was closed.
    pub(in crate::viewer) fn draw_again(
        &mut self,
        view: &mut View,
        scene: &PagedScene,
        context: ContextId,
        background: Option<[u8; 3]>,
    ) -> Result<(FrameStats, RgbaImage), ViewerError> {
        self.finish()?;
        let context = view.context().ok_or(ViewerError::NoContext(context))?;
        self.cull_again(view, scene, true);
        let mut environment = view.environment;
        if let Some(color) = background {
            environment.sky = Sky::Background(color);
            environment.fog.enabled = false;
        }
        let stage = self.probe.take_stage();
        let mut stats = FrameStats { tiles_drawn: stage.counters.tiles_drawn, ..FrameStats::default() };
        let job = FrameJob {
            context: context.0,
            stage: Some((stage, environment)),
            read_back: true,
            present: false,
            ..self.job()
        };
        let device = self.rendering.device_of(context.0).ok_or(ViewerError::NoContext(context))?;
        let done = device.draw_alone(job)?;
        self.probe.put_back_stage(done.stage.unwrap_or_default());
        self.results.add_report(done.errors, done.gpu_bytes_peak);
        let drawn = done.stats?;
        stats.triangles = drawn.triangles;
        stats.points = drawn.points;
        // A window that skipped the frame has no image.
        let image = done.image.ok_or(ViewerError::HiddenWindow)??;
        Ok((stats, image))
    }

    /// Culls a view once more into the probe's stage; does nothing when its master camera has no context. Contents of tiles
    /// are tested against the frustum only if `culls_contents` is set.
    pub(in crate::viewer) fn cull_again(&mut self, view: &mut View, scene: &PagedScene, culls_contents: bool) {
        view.prepare(&self.rendering, scene.bounds());
        let camera = view.master.map(|slot| slot.camera);
        let frame = self.stamp().frame;
        if let Some(mut task) = camera.and_then(|camera| view.task(camera, scene, frame, Vec::new())) {
            task.environment = view.environment;
            task.camera.culls_contents = culls_contents;
            self.probe.cull(task);
        }
    }

    /// Returns the draw slots that the probe's last cull draws, sorted.
    pub(in crate::viewer) fn drawn_slots(&self) -> Vec<DrawSlot> {
        let mut drawn: Vec<DrawSlot> = Vec::new();
        // In stereo the eyes are pre-render stages.
        let mut stages = vec![self.probe.stage()];
        while let Some(stage) = stages.pop() {
            drawn.extend(stage.bins.iter().flat_map(|bin| &bin.leaves).map(|leaf| leaf.slot));
            stages.extend(stage.pre_render.iter().chain(&stage.post_render));
        }
        drawn.retain(|slot| *slot != DrawSlot::NONE);
        drawn.sort_unstable();
        drawn
    }
}
