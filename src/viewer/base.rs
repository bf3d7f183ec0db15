//! [`ViewerBase`]: the frame of one view or of many; osgViewer's ViewerBase. Main thread; cull and draw run where the
//! threading model has them.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use image::RgbaImage;

use super::ViewerError;
use super::input::OnPicture;
use super::look_ahead::{LookFrom, Looker};
use super::paged_scene::PagedScene;
use super::rendering::{CullOutcome, FRAMES_IN_FLIGHT, FrameDone, FrameJob, Rendering, millis};
use super::scene_pager::ScenePager;
use super::stats::{FrameStats, StatsHistory};
use super::view::{ContextId, View};
use super::viewer::{FrameStamp, ViewerConfig};
use crate::cull::{CullCamera, CullVisitor, RenderStage};
use crate::draw::FrameClock;
use crate::gpu::{CompileBudget, CompilePace, GpuError};
use crate::timeline::{self, Span};

/// How often arrivals are looked for while the draw thread is busy.
const ARRIVAL_POLL: Duration = Duration::from_micros(300);
/// Between frames each of several pagers has so much time at once.
const WORK_TURN: Duration = Duration::from_millis(2);
/// Answers of the adapter that have not come so many frames after a change are not awaited: windows that are not seen
/// draw nothing, and ask nothing.
const MOST_AWAITED: u32 = 60;
/// A device that is lost within so many frames of the last loss is not replaced.
const FRAMES_TO_RENEW: u32 = 60;

pub(super) struct ViewerBase {
    pub(super) rendering: Rendering,
    pub(super) max_contexts: usize,
    pub(super) min_stencil_bits: u32,
    pub(super) pipeline_cache: Option<PathBuf>,
    pub(super) blocking: bool,
    /// Each with its scenes; a scene knows the place of its own.
    pub(super) pagers: Vec<ScenePager>,
    look_ahead_s: f64,
    pub(super) compile_budget: CompileBudget,
    compile_pace: CompilePace,
    /// Contexts, and what is painted over their next pictures.
    #[cfg(feature = "window")]
    overlays: Vec<(u32, super::overlay::OverlayPaint)>,
    /// For looking at the scene outside the frame's own culls, with a stage.
    pub(super) probe: CullVisitor,
    pub(super) probe_stage: RenderStage,
    pub(super) first_frame: Option<Instant>,
    last_frame: Option<Instant>,
    pub(super) stamp: FrameStamp,
    /// Frame in which a lost device was last replaced; 0 where none was.
    renewed: u32,
    /// Of a frame that was under way, told by the next one.
    pub(super) lost: Option<GpuError>,
    /// Seconds between the last two frames.
    delta_s: f64,
    pub(super) history: StatsHistory,
    /// Last frame that was drawn for something else than answers to occlusion queries, or in which one had changed
    /// what is hidden.
    changed: u32,
    /// Of the last frame; see [`CullCounters::answers_age`](crate::cull::CullCounters::answers_age).
    answers_age: u32,
    pub(super) gpu_bytes_peak: u64,
    /// What could not be drawn as it should, each once.
    pub(super) draw_errors: Vec<String>,
    /// Contexts whose next picture is read back.
    wanted: Vec<u32>,
    pictures: Vec<(u32, u32, RgbaImage)>,
    /// Contexts and frames of pictures that the application asked for, and those with what is done with them.
    asked: Vec<(u32, u32)>,
    captures: Vec<(u32, u32, OnPicture)>,
    /// Reading back in the frame being measured, milliseconds.
    read_back_ms: f64,
}

/// A frame whose rendering has not begun.
pub(super) struct FrameUnderWay {
    pub(super) start: Instant,
    /// Seconds since the frame before.
    pub(super) dt_s: f64,
    stats: FrameStats,
    /// On the timeline; ends before the frame's own.
    phase: Option<Span>,
    _frame: Span,
}

impl FrameUnderWay {
    /// The event phase is over.
    pub(super) fn end_events(&mut self) {
        self.stats.event_ms = millis(self.start.elapsed());
        self.phase = None;
        self.phase = Some(timeline::span("update"));
    }
}

impl ViewerBase {
    pub(super) fn new(config: &ViewerConfig) -> Result<Self, ViewerError> {
        let mut rendering = Rendering::new(config.pager.blocking, config.cpu_affinity);
        rendering.set_model(config.threading)?;
        Ok(Self {
            rendering,
            max_contexts: config.max_contexts,
            min_stencil_bits: config.min_stencil_bits,
            pipeline_cache: config.pipeline_cache.clone(),
            blocking: config.pager.blocking,
            pagers: Vec::new(),
            look_ahead_s: config.look_ahead_s.max(0.0),
            compile_budget: config.compile_budget,
            compile_pace: config.compile_pace,
            #[cfg(feature = "window")]
            overlays: Vec::new(),
            probe: CullVisitor::looking(),
            probe_stage: RenderStage::new(),
            first_frame: None,
            last_frame: None,
            stamp: FrameStamp::default(),
            renewed: 0,
            lost: None,
            delta_s: 0.0,
            history: StatsHistory::new(config.history_frames),
            changed: 0,
            answers_age: 0,
            gpu_bytes_peak: 0,
            draw_errors: Vec::new(),
            wanted: Vec::new(),
            pictures: Vec::new(),
            asked: Vec::new(),
            captures: Vec::new(),
            read_back_ms: 0.0,
        })
    }

    /// The context's next picture is read back.
    pub(super) fn want_picture(&mut self, context: ContextId) {
        if !self.wanted.contains(&context.0) {
            self.wanted.push(context.0);
        }
    }

    /// Pictures of a context that were read back, with their frames.
    pub(super) fn take_pictures(&mut self, context: ContextId) -> Vec<(u32, RgbaImage)> {
        let of_context = self.pictures.extract_if(.., |(of, _, _)| *of == context.0);
        of_context.map(|(_, frame, picture)| (frame, picture)).collect()
    }

    /// Seconds since the first frame.
    pub(super) fn seconds(&self) -> f64 {
        self.first_frame.map_or(0.0, |first| first.elapsed().as_secs_f64())
    }

    /// Begins a frame; the event phase comes next. `changes`: something but answers of the adapter asks for it.
    pub(super) fn begin_frame(&mut self, simulation_time_s: f64, changes: bool) -> Result<FrameUnderWay, ViewerError> {
        let start = Instant::now();
        // One that nothing asks for is the application's wish, which knows of a change.
        if changes || !self.awaits_answers() {
            self.changed = self.stamp.frame + 1;
        }
        self.read_back_ms = 0.0;
        let dt_s = self.advance(start, simulation_time_s);
        let number = self.stamp.frame;
        let _frame = timeline::span_of("frame", || number.to_string().into());
        let stats = FrameStats { frame: number, ..FrameStats::default() };
        Ok(FrameUnderWay { start, dt_s, stats, phase: Some(timeline::span("event")), _frame })
    }

    /// Update after the application's own, and rendering. Where a device is lost the frame is, and another device takes
    /// its place for the next one.
    pub(super) fn end_frame(
        &mut self,
        frame: FrameUnderWay,
        views: &mut [View],
        scenes: &mut [PagedScene],
    ) -> Result<(), ViewerError> {
        match self.update_and_render(frame, views, scenes) {
            Err(ViewerError::Gpu(error @ GpuError::DeviceLost { .. })) if self.may_renew() => {
                log::warn!("{error}; another takes its place");
                self.renewed = self.stamp.frame;
                // Some may have been drawn, others tell what waits for their pictures.
                for done in self.rendering.end_frames()? {
                    if let Err(error) = self.absorb(done) {
                        self.draw_errors.push(error.to_string());
                    }
                }
                self.lost = None;
                // Nothing is under way.
                let next = self.stamp.frame + 1;
                self.captures.iter_mut().for_each(|(_, of_frame, _)| *of_frame = next.max(*of_frame));
                self.asked.clear();
                for device in self.rendering.renew_lost()? {
                    self.device_closed(scenes, device);
                    self.device_opened(scenes, device)?;
                }
                // Their textures were the old device's.
                #[cfg(feature = "window")]
                views.iter_mut().for_each(|view| view.input.reset_overlay());
                Ok(())
            }
            ended => ended,
        }
    }

    /// Not again and again.
    fn may_renew(&self) -> bool {
        self.renewed == 0 || self.stamp.frame - self.renewed >= FRAMES_TO_RENEW
    }

    fn update_and_render(
        &mut self,
        frame: FrameUnderWay,
        views: &mut [View],
        scenes: &mut [PagedScene],
    ) -> Result<(), ViewerError> {
        let FrameUnderWay { start, mut stats, phase, _frame, .. } = frame;
        // A handler may have changed the model.
        self.rendering.start_threads()?;
        if self.blocking {
            self.absorb_all()?;
        }
        self.tell_loss()?;
        let mut is_dynamic = false;
        // The application's turn is over.
        scenes.iter_mut().for_each(|scene| scene.scene_mut().compute_bounds());
        self.look_ahead(views, scenes);
        for pager in &mut self.pagers {
            stats.merge_ms += pager.page(scenes, &mut self.rendering, self.stamp.frame);
        }
        for scene in scenes.iter_mut() {
            scene.page_images(&mut self.rendering, self.stamp.simulation_time_s)?;
            is_dynamic |= scene.send_rewritten(&mut self.rendering)?;
        }
        stats.update_ms = millis(start.elapsed()) - stats.event_ms;
        drop(phase);

        // Cull and draw, by the threads of the model.
        self.wait_for_stage(scenes)?;
        self.tell_loss()?;
        for view in views.iter_mut() {
            view.prepare(&self.rendering, scenes[view.scene].bounds.as_ref());
        }
        if self.blocking {
            for place in 0..self.pagers.len() {
                stats.merge_ms += self.settle(views, scenes, place);
            }
        }
        self.render(views, scenes, &mut stats, is_dynamic)?;
        self.history.push(stats);
        self.absorb_arrived()?;
        self.tell_loss()?;
        let frame_ms = (millis(start.elapsed()) - self.read_back_ms).max(0.0);
        if let Some(stats) = self.history.frame_mut(self.stamp.frame) {
            stats.frame_ms = frame_ms;
        }
        Ok(())
    }

    /// Finds what cameras will want.
    fn look_ahead(&mut self, views: &mut [View], scenes: &mut [PagedScene]) {
        for scene in scenes.iter_mut() {
            scene.requests_ahead.clear();
        }
        if self.blocking || self.look_ahead_s == 0.0 {
            return;
        }
        let _span = timeline::span("look ahead");
        let FrameStamp { frame, reference_time_s, simulation_time_s } = self.stamp;
        let from = LookFrom { frame, reference_time_s, simulation_time_s, ahead_s: self.look_ahead_s };
        for view in views {
            let scene = &mut scenes[view.scene];
            if self.pagers[scene.pager].pager().is_some() {
                let mut looks = std::mem::take(&mut view.look_ahead);
                let (visitor, stage) = (&mut self.probe, &mut self.probe_stage);
                looks.look(Looker { view, scene, visitor, stage }, from);
                scene.requests_ahead.extend(looks.requests());
                view.look_ahead = looks;
            }
        }
    }

    fn advance(&mut self, now: Instant, simulation_time_s: f64) -> f64 {
        let first = *self.first_frame.get_or_insert(now);
        let dt_s = self.last_frame.map_or(0.0, |last| (now - last).as_secs_f64());
        self.last_frame = Some(now);
        self.delta_s = dt_s;
        self.stamp = FrameStamp {
            frame: self.stamp.frame + 1,
            reference_time_s: (now - first).as_secs_f64(),
            simulation_time_s,
        };
        dt_s
    }

    /// Hands jobs and tasks to the contexts and cameras, and takes what the culls found.
    fn render(
        &mut self,
        views: &mut [View],
        scenes: &mut [PagedScene],
        stats: &mut FrameStats,
        is_dynamic: bool,
    ) -> Result<(), ViewerError> {
        let (wanted, job) = (std::mem::take(&mut self.wanted), self.job());
        #[cfg(feature = "window")]
        let mut overlays = std::mem::take(&mut self.overlays);
        let view_of = |camera| views.iter().find(|view| view.has_camera(camera));
        let FrameStamp { frame, simulation_time_s, .. } = self.stamp;
        self.asked.extend(wanted.iter().map(|context| (*context, frame)));
        let captures = &self.captures;
        let captured = |context| captures.iter().any(|(c, f, _)| (*c, *f) == (context, frame));
        let rendered = self.rendering.frame(
            |context| FrameJob {
                read_back: wanted.contains(&context) || captured(context),
                #[cfg(feature = "window")]
                overlays: overlays.extract_if(.., |(of, _)| *of == context).map(|(_, paint)| paint).collect(),
                ..job.again()
            },
            |camera, last| {
                let view = view_of(camera)?;
                let task = view.task(camera, &scenes[view.scene], frame, last.requests)?;
                let camera = CullCamera { simulation_time_s, ..task.camera };
                Some(super::rendering::CullTask { camera, is_dynamic, ..task })
            },
        );
        self.wanted = wanted;
        self.wanted.clear();
        #[cfg(feature = "window")]
        {
            overlays.clear();
            self.overlays = overlays;
        }
        rendered?;
        self.answers_age = 0;
        for scene in scenes.iter_mut() {
            scene.requests.clear();
            scene.wanted_missing = 0;
            scene.fading = 0;
        }
        for (camera, CullOutcome { requests, counters, cull_ms, .. }) in self.rendering.outcomes() {
            let Some(view) = views.iter_mut().find(|view| view.has_camera(camera)) else { continue };
            view.was_culled(camera, counters.tiles_drawn);
            let scene = &mut scenes[view.scene];
            scene.requests.extend_from_slice(requests);
            scene.wanted_missing += counters.wanted_missing;
            scene.fading += counters.fading;
            stats.tiles_drawn += counters.tiles_drawn;
            stats.tiles_visited += counters.tiles_visited;
            stats.occluded += counters.occluded;
            stats.wanted_missing += counters.wanted_missing;
            stats.cull_ms += cull_ms;
            self.answers_age = self.answers_age.max(counters.answers_age);
        }
        if self.answers_age == u32::MAX {
            self.changed = frame;
        }
        for pager in &mut self.pagers {
            pager.request(scenes);
        }
        Ok(())
    }

    /// What a context is told to draw: what its cameras cull.
    pub(super) fn job(&self) -> FrameJob {
        let busy = self.history.busy(self.rendering.model());
        FrameJob {
            frame: self.stamp.frame,
            clock: FrameClock {
                reference_time_s: self.stamp.reference_time_s,
                delta_s: self.delta_s,
                simulation_time_s: self.stamp.simulation_time_s,
            },
            budget: self.compile_budget.beside(busy, &self.compile_pace),
            present: true,
            ..FrameJob::default()
        }
    }

    /// Works until shortly before `deadline`, sleeps the rest.
    pub(super) fn work_until(&mut self, scenes: &mut [PagedScene], deadline: Instant) {
        let _span = timeline::span("between frames");
        // One that waits for its server leaves time to the others.
        while self.pagers.iter().filter(|pager| pager.is_paging()).count() > 1 && Instant::now() < deadline {
            let begun = Instant::now();
            for pager in &mut self.pagers {
                pager.work_until(scenes, &mut self.rendering, deadline.min(Instant::now() + WORK_TURN));
            }
            if begun.elapsed() < ARRIVAL_POLL {
                break; // nothing is under way
            }
        }
        for pager in &mut self.pagers {
            pager.work_until(scenes, &mut self.rendering, deadline);
        }
        std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
    }

    /// Paints an overlay over the next frame of a context, over those that are there.
    #[cfg(feature = "window")]
    pub(super) fn set_overlay(&mut self, context: u32, paint: super::overlay::OverlayPaint) {
        let same = self.overlays.iter().position(|(of, earlier)| *of == context && earlier.is_same_overlay(&paint));
        let unpainted = same.map(|place| self.overlays.remove(place).1);
        self.overlays.push((context, paint.after(unpainted)));
    }

    /// The picture of a frame that has not been drawn goes to `then`.
    pub(super) fn capture(&mut self, context: ContextId, frame: u32, then: OnPicture) {
        self.captures.push((context.0, frame, then));
    }

    fn picture_came(&mut self, context: u32, frame: u32, picture: RgbaImage) {
        for (_, _, then) in self.captures.extract_if(.., |(c, f, _)| (*c, *f) == (context, frame)) {
            then(frame, picture.clone());
        }
        if let Some(place) = self.asked.iter().position(|of| *of == (context, frame)) {
            self.asked.swap_remove(place);
            self.pictures.push((context, frame, picture));
        }
    }

    /// What a context that was closed would have given does not come.
    pub(super) fn forget_pictures(&mut self, context: u32) {
        self.wanted.retain(|of| *of != context);
        self.asked.retain(|(of, _)| *of != context);
        self.captures.retain(|(of, ..)| *of != context);
    }

    /// Of a frame that was lost or that its window skipped: what waits for its picture gets the next one's.
    fn no_picture_came(&mut self, context: u32, frame: u32) {
        let next = self.stamp.frame + 1;
        for (_, f, _) in self.captures.iter_mut().filter(|(c, f, _)| (*c, *f) == (context, frame)) {
            *f = next;
        }
        self.asked.retain(|of| *of != (context, frame));
    }

    fn absorb_arrived(&mut self) -> Result<(), ViewerError> {
        for place in 0..self.rendering.device_count() {
            while let Some(done) = self.rendering.device_at(place).and_then(|c| c.try_done()) {
                self.absorb(*done)?;
            }
        }
        Ok(())
    }

    fn absorb_next(&mut self, place: usize) -> Result<(), ViewerError> {
        let start = Instant::now();
        let Some(context) = self.rendering.device_at(place) else { return Ok(()) };
        let span = timeline::span("wait for draw");
        let done = context.wait_done()?;
        drop(span);
        if let Some(done) = done {
            self.read_back_ms += done.read_back_ms.min(millis(start.elapsed()));
            self.absorb(*done)?;
        }
        Ok(())
    }

    /// Waits until each camera has a free stage, merging what arrives meanwhile.
    fn wait_for_stage(&mut self, scenes: &mut [PagedScene]) -> Result<(), ViewerError> {
        let _span = timeline::span("wait for stage");
        for place in 0..self.rendering.device_count() {
            while self.rendering.in_flight(place) >= FRAMES_IN_FLIGHT {
                if !self.pagers.iter().any(ScenePager::is_paging) {
                    self.absorb_next(place)?;
                    continue;
                }
                for pager in self.pagers.iter_mut().filter(|pager| pager.is_paging()) {
                    pager.merge_arrived(scenes, &mut self.rendering);
                }
                let start = Instant::now();
                let Some(context) = self.rendering.device_at(place) else { break };
                if let Some(done) = context.wait_done_for(ARRIVAL_POLL)? {
                    self.read_back_ms += done.read_back_ms.min(millis(start.elapsed()));
                    self.absorb(*done)?;
                }
            }
        }
        Ok(())
    }

    pub(super) fn absorb_all(&mut self) -> Result<(), ViewerError> {
        for place in 0..self.rendering.device_count() {
            while self.rendering.in_flight(place) > 0 {
                self.absorb_next(place)?;
            }
        }
        Ok(())
    }

    /// What became of a frame that was under way.
    fn tell_loss(&mut self) -> Result<(), ViewerError> {
        self.lost.take().map_or(Ok(()), |lost| Err(lost.into()))
    }

    /// What a drawn frame told besides its figures.
    pub(super) fn took(&mut self, errors: Vec<String>, gpu_bytes_peak: u64) {
        self.draw_errors.extend(errors);
        self.gpu_bytes_peak = self.gpu_bytes_peak.max(gpu_bytes_peak);
    }

    /// Some picture was asked for that has not come.
    pub(super) fn awaits_picture(&self) -> bool {
        !(self.captures.is_empty() && self.wanted.is_empty() && self.asked.is_empty())
    }

    /// Some occlusion query or camera that is read back of what was last drawn has no answer as new as the last change.
    pub(super) fn awaits_answers(&self) -> bool {
        let frames = self.stamp.frame.saturating_sub(self.changed);
        self.answers_age > frames && frames < MOST_AWAITED
    }

    /// A frame that is lost with its device is over too: the next one says so, and replaces the device.
    fn absorb(&mut self, done: FrameDone) -> Result<(), ViewerError> {
        let frame = done.frame;
        if !self.rendering.overlaps() {
            self.read_back_ms += done.read_back_ms;
        }
        self.took(done.errors, done.gpu_bytes_peak);
        let drawn = match done.stats {
            Err(lost @ GpuError::DeviceLost { .. }) => {
                self.lost.get_or_insert(lost);
                self.no_picture_came(done.context, frame);
                return Ok(());
            }
            Err(error) => {
                self.no_picture_came(done.context, frame);
                return Err(error.into());
            }
            Ok(drawn) => drawn,
        };
        let is_last = self.rendering.all_done(frame);
        if let Some(stats) = self.history.frame_mut(frame) {
            stats.draw_ms = stats.draw_ms.max(done.draw_ms);
            stats.compile_ms = stats.compile_ms.max(done.compile_ms);
            stats.gpu_ms = drawn.gpu_ms.map(|ms| ms.max(stats.gpu_ms.unwrap_or(0.0))).or(stats.gpu_ms);
            stats.skipped += u32::from(drawn.skipped);
            stats.leaves += drawn.leaves;
            stats.unsampled_leaves += drawn.unsampled_leaves;
            stats.draw_calls += drawn.draw_calls;
            stats.shadow_leaves += drawn.shadow_leaves;
            stats.shadow_draw_calls += drawn.shadow_draw_calls;
            stats.pipelines_created += drawn.pipelines_created;
            stats.state_changes += drawn.state_changes;
            stats.state_changes_skipped += drawn.state_changes_skipped;
            stats.triangles += drawn.triangles;
            stats.points += drawn.points;
            stats.gpu_bytes += done.gpu_bytes;
            stats.drawn = is_last;
        }
        match done.image {
            Some(Ok(image)) => self.picture_came(done.context, frame, image),
            Some(Err(lost @ GpuError::DeviceLost { .. })) => {
                self.lost.get_or_insert(lost);
                self.no_picture_came(done.context, frame);
            }
            Some(Err(error)) => {
                // It would be the same in the next frame.
                self.captures.retain(|(c, f, _)| (*c, *f) != (done.context, frame));
                self.no_picture_came(done.context, frame);
                self.draw_errors.push(format!("the picture of frame {frame}: {error}"));
            }
            None => self.no_picture_came(done.context, frame),
        }
        Ok(())
    }
}
