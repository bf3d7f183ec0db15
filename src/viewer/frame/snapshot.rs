//! Draws the present view of a [`Viewer`] once more: its image, its counters, the contents that it draws. Main thread,
//! between frames. Statistics, requests and the window stay as they are.

use std::sync::Arc;

use image::RgbaImage;

use super::frame_loop::FrameLoop;
use super::stats::FrameStats;

use crate::scene::{DrawSlot, Sky, SlotState};
use crate::viewer::paging::PagedScene;
use crate::viewer::rendering::FrameJob;
use crate::viewer::report::Settled;
use crate::viewer::view::View;
use crate::viewer::{ContextId, KEY_COLOR, Viewer, ViewerError, coverage};

impl FrameLoop {
    /// Draws a view once more, without presenting it and without statistics; on the key colour and without fog if asked.
    /// `context` is named in the error of a view whose own context was closed.
    fn draw_again(
        &mut self,
        view: &mut View,
        scene: &PagedScene,
        context: ContextId,
        on_key: bool,
    ) -> Result<(FrameStats, RgbaImage), ViewerError> {
        self.finish()?;
        let context = view.context().ok_or(ViewerError::NoContext(context))?;
        self.cull_again(view, scene, true);
        let mut environment = view.environment;
        if on_key {
            environment.sky = Sky::Background(KEY_COLOR);
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
    fn cull_again(&mut self, view: &mut View, scene: &PagedScene, culls_contents: bool) {
        view.prepare(&self.rendering, scene.bounds());
        let camera = view.master.map(|slot| slot.camera);
        let frame = self.stamp().frame;
        if let Some(mut task) = camera.and_then(|camera| view.task(camera, scene, frame, Vec::new())) {
            task.environment = view.environment;
            task.camera.culls_contents = culls_contents;
            self.probe.cull(task);
        }
    }

    /// The draw slots that the probe's last cull draws, sorted.
    fn drawn_slots(&self) -> Vec<DrawSlot> {
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

impl Viewer {
    fn draw_again(&mut self, on_key: bool) -> Result<(FrameStats, RgbaImage), ViewerError> {
        let context = self.context();
        let (frame, view, scene) = self.parts_mut();
        frame.draw_again(view, scene, context, on_key)
    }

    /// Draws the present view once more and returns its image. [`ViewerError::HiddenWindow`] when the window shows nothing
    /// now.
    pub fn picture(&mut self) -> Result<RgbaImage, ViewerError> {
        Ok(self.draw_again(false)?.1)
    }

    /// Draws the present view once more and returns its counters for the report.
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
