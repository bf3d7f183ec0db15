//! Takes the frames that the draw threads have finished, and replaces devices that were lost. Main thread.

use std::time::Instant;

use super::draw_results::ContextFigures;
use super::frame_loop::{ARRIVAL_POLL, FrameLoop};
use crate::gpu::GpuError;
use crate::trace;
use crate::viewer::ViewerError;
use crate::viewer::paging::{PagerGroup, SceneList};
use crate::viewer::rendering::{FRAMES_IN_FLIGHT, FrameDone, millis};
use crate::viewer::view::ViewList;

impl FrameLoop {
    /// Takes the frames that have been drawn, without waiting.
    pub(super) fn collect_arrived(&mut self) -> Result<(), ViewerError> {
        for device in 0..self.rendering.device_count() {
            while let Some(done) = self.rendering.device_at(device).and_then(|d| d.try_done()) {
                self.collect(*done)?;
            }
        }
        Ok(())
    }

    /// Waits for the next frame of a device.
    fn collect_next(&mut self, device: usize) -> Result<(), ViewerError> {
        let start = Instant::now();
        let Some(device) = self.rendering.device_at(device) else { return Ok(()) };
        let span = trace::span("wait for draw");
        let done = device.wait_done()?;
        drop(span);
        if let Some(done) = done {
            self.collect_waited(*done, start)?;
        }
        Ok(())
    }

    /// Takes a frame that was waited for since `start`.
    fn collect_waited(&mut self, done: FrameDone, start: Instant) -> Result<(), ViewerError> {
        self.results.add_read_back_ms(done.read_back_ms.min(millis(start.elapsed())));
        self.collect(done)
    }

    /// Waits until each camera has a free render stage. Meanwhile arrived pages are merged and the contents of new tiles
    /// requested.
    pub(super) fn wait_for_stage(&mut self, views: &ViewList, scenes: &mut SceneList) -> Result<(), ViewerError> {
        let _span = trace::span("wait for stage");
        for device in 0..self.rendering.device_count() {
            while self.rendering.in_flight(device) >= FRAMES_IN_FLIGHT {
                if !self.pagers.iter().any(PagerGroup::is_paging) {
                    self.collect_next(device)?;
                    continue;
                }
                for group in self.pagers.iter_mut().filter(|group| group.is_paging()) {
                    group.merge_arrived(scenes, &mut self.rendering);
                }
                self.look_early(views, scenes, None);
                let start = Instant::now();
                let Some(device) = self.rendering.device_at(device) else { break };
                if let Some(done) = device.wait_done_for(ARRIVAL_POLL)? {
                    self.collect_waited(*done, start)?;
                }
            }
        }
        Ok(())
    }

    /// Waits until all frames in flight are drawn. Frames that were lost with their device are no error here.
    pub(in crate::viewer) fn finish(&mut self) -> Result<(), ViewerError> {
        for device in 0..self.rendering.device_count() {
            while self.rendering.in_flight(device) > 0 {
                self.collect_next(device)?;
            }
        }
        Ok(())
    }

    /// Takes the results of a drawn frame. The loss of a device is noted; the next frame reports it and replaces the device.
    fn collect(&mut self, done: FrameDone) -> Result<(), ViewerError> {
        self.rehearsals.take(&done);
        let (context, frame, next_frame) = (done.context, done.frame, self.stamp().frame + 1);
        if !self.rendering.overlaps() {
            self.results.add_read_back_ms(done.read_back_ms);
        }
        self.results.add_report(done.errors, done.gpu_bytes_peak);
        let drawn = match done.stats {
            Err(lost @ GpuError::DeviceLost { .. }) => {
                self.device_loss.note(lost);
                self.pictures.postpone(context, frame, next_frame);
                return Ok(());
            }
            Err(error) => {
                self.pictures.postpone(context, frame, next_frame);
                return Err(error.into());
            }
            Ok(drawn) => drawn,
        };
        let figures = ContextFigures {
            drawn,
            draw_ms: done.draw_ms,
            compile_ms: done.compile_ms,
            gpu_bytes: done.gpu_bytes,
            gpu_bytes_allocated: done.gpu_bytes_allocated,
            is_complete: self.rendering.all_done(frame),
        };
        self.results.add_drawn(frame, &figures);
        match done.image {
            Some(Ok(image)) => self.pictures.deliver(context, frame, image),
            Some(Err(lost @ GpuError::DeviceLost { .. })) => {
                self.device_loss.note(lost);
                self.pictures.postpone(context, frame, next_frame);
            }
            Some(Err(error)) => {
                self.pictures.fail(context, frame);
                self.results.add_error(format!("the picture of frame {frame}: {error}"));
            }
            None => self.pictures.postpone(context, frame, next_frame),
        }
        Ok(())
    }

    /// Replaces lost devices and uploads everything to the new ones.
    pub(super) fn replace_lost_devices(
        &mut self,
        views: &mut ViewList,
        scenes: &mut SceneList,
    ) -> Result<(), ViewerError> {
        self.device_loss.note_replacement(self.stamp().frame);
        // Frames in flight may have been drawn; the others postpone the requests for their images.
        for done in self.rendering.end_frames()? {
            if let Err(error) = self.collect(done) {
                self.results.add_error(error.to_string());
            }
        }
        self.device_loss.clear();
        self.pictures.restart(self.stamp().frame + 1);
        for device in self.rendering.renew_lost()? {
            self.pagers.device_closed(scenes, device, &mut self.rendering);
            self.pagers.device_opened(scenes, device, &mut self.rendering)?;
        }
        for view in views.values_mut() {
            view.shown.reset();
            // The textures of the overlays were on the old device.
            #[cfg(feature = "window")]
            view.input.reset_overlay();
        }
        Ok(())
    }
}
