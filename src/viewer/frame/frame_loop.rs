//! [`FrameLoop`]: runs the frame of one view or of many; osgViewer's FrameLoop. Main thread; cull and draw run on the
//! threads of the threading model.
//!
//! ```text
//! begin_frame   advance the clock
//!               (the viewer: events of each view, update callbacks of each scene, cameras)
//! end_frame     look ahead; each pager merges, expires, uploads; image pagers; changed meshes
//!               wait until each camera has a free render stage, merging what arrives meanwhile
//!               decide which environments are shown, and rehearse those whose pipelines are missing
//!               cull and draw on the threads of the model; take the results of the culls; send requests to the pagers
//!               take the frames that draw threads have finished
//! ```

use std::time::{Duration, Instant};

use super::changes::{EnvironmentChanges, EnvironmentRehearsals, NewStates, Rehearsals};
use super::config::ViewerConfig;
use super::device_loss::DeviceLoss;
use super::draw_results::DrawResults;
use super::pictures::{OnPicture, PictureRequests};
use super::query_answers::QueryAnswers;
use super::stats::FrameStats;
use crate::cull::CullCamera;
use crate::gpu::{CompileBudget, GpuError};
use crate::trace::{self, Span};
use crate::viewer::ViewerError;
use crate::viewer::clock::{FrameStamp, FrameTimer};
use crate::viewer::ids::ContextId;
use crate::viewer::paging::{EarlyLook, LookAheads, LookFrom, PagedScene, PagerGroup, Pagers, SceneList, load_all};
use crate::viewer::rendering::{CullOutcome, CullTask, FrameJob, Rendering, ThreadingModel, millis};
use crate::viewer::view::{Probe, ViewList};

/// The interval at which arrived pages are merged while the main thread waits for the draw thread.
pub(super) const ARRIVAL_POLL: Duration = Duration::from_micros(300);
/// The time slice of each of several pagers that work between frames.
const WORK_SLICE: Duration = Duration::from_millis(2);

/// Everything that a viewer needs for its frames besides its views and scenes, which it passes in.
pub(in crate::viewer) struct FrameLoop {
    pub(super) config: ViewerConfig,
    pub(in crate::viewer) rendering: Rendering,
    pub(in crate::viewer) pagers: Pagers,
    pub(in crate::viewer) look_aheads: LookAheads,
    /// Overlays to be painted over the next frame, with their contexts.
    #[cfg(feature = "window")]
    overlays: Vec<(u32, crate::viewer::overlay::OverlayPaint)>,
    /// The screens of the display, as the window's event loop found them.
    #[cfg(feature = "window")]
    pub(in crate::viewer) screens: Vec<crate::viewer::Screen>,
    pub(super) probe: Probe,
    pub(super) early_look: EarlyLook,
    pub(super) timer: FrameTimer,
    pub(super) device_loss: DeviceLoss,
    pub(super) query_answers: QueryAnswers,
    pub(in crate::viewer) results: DrawResults,
    pub(super) pictures: PictureRequests,
    pub(super) rehearsals: EnvironmentRehearsals,
}

/// A frame between its event phase and rendering.
pub(in crate::viewer) struct FrameInProgress {
    pub(in crate::viewer) start: Instant,
    /// Seconds since the frame before.
    pub(in crate::viewer) dt_s: f64,
    stats: FrameStats,
    /// The timeline span of the current phase; it ends before the frame's own.
    phase: Option<Span>,
    _frame: Span,
}

impl FrameInProgress {
    /// Ends the event phase and begins update.
    pub(in crate::viewer) fn end_events(&mut self) {
        self.stats.event_ms = millis(self.start.elapsed());
        self.phase = None;
        self.phase = Some(trace::span("update"));
    }
}

impl FrameLoop {
    pub(in crate::viewer) fn new(config: &ViewerConfig) -> Result<Self, ViewerError> {
        let mut config = config.clone();
        config.look_ahead_s = config.look_ahead_s.max(0.0);
        let mut rendering = Rendering::new(config.pager.blocking, config.cpu_affinity);
        rendering.set_model(config.threading)?;
        rendering.set_realize_operation(config.realize_operation.clone());
        Ok(Self {
            rendering,
            pagers: Pagers::new(config.pager.blocking),
            look_aheads: LookAheads::default(),
            #[cfg(feature = "window")]
            overlays: Vec::new(),
            #[cfg(feature = "window")]
            screens: Vec::new(),
            probe: Probe::new(),
            early_look: EarlyLook::new(),
            timer: FrameTimer::default(),
            device_loss: DeviceLoss::default(),
            query_answers: QueryAnswers::default(),
            results: DrawResults::new(config.history_frames),
            pictures: PictureRequests::default(),
            rehearsals: EnvironmentRehearsals::default(),
            config,
        })
    }

    pub(in crate::viewer) fn config(&self) -> &ViewerConfig {
        &self.config
    }

    /// Sets [`ViewerConfig::compile_budget`] from the next frame on.
    pub(in crate::viewer) fn set_compile_budget(&mut self, budget: CompileBudget) {
        self.config.compile_budget = budget;
    }

    /// Sets [`ViewerConfig::environment_changes`] from the next frame on.
    pub(in crate::viewer) fn set_environment_changes(&mut self, changes: EnvironmentChanges) {
        self.config.environment_changes = changes;
    }

    pub(in crate::viewer) fn stamp(&self) -> FrameStamp {
        self.timer.stamp()
    }

    pub(in crate::viewer) fn timer(&self) -> &FrameTimer {
        &self.timer
    }

    pub(in crate::viewer) fn results(&self) -> &DrawResults {
        &self.results
    }

    pub(in crate::viewer) fn pictures_mut(&mut self) -> &mut PictureRequests {
        &mut self.pictures
    }

    /// Returns the threading model that runs, or will run from the first frame on.
    pub(in crate::viewer) fn threading_model(&self) -> ThreadingModel {
        self.rendering.model()
    }

    /// Changes the threading model after all frames are drawn.
    pub(in crate::viewer) fn set_threading_model(&mut self, model: ThreadingModel) -> Result<(), ViewerError> {
        self.finish()?;
        self.rendering.set_model(model)
    }

    pub(in crate::viewer) fn pager_of(&self, scene: &PagedScene) -> &PagerGroup {
        self.pagers.of(scene)
    }

    /// Has an image read back and given to `then`; see [`PictureRequests::capture`].
    pub(in crate::viewer) fn capture(&mut self, context: ContextId, frame: u32, then: OnPicture) {
        self.pictures.capture(context.0, frame, then);
    }

    /// Returns true while a requested image has not arrived.
    pub(in crate::viewer) fn awaits_picture(&self) -> bool {
        self.pictures.is_waiting()
    }

    /// Returns true while results of occlusion queries, or of cameras that are read back, are older than the last change.
    pub(in crate::viewer) fn awaits_answers(&self) -> bool {
        self.query_answers.is_waiting(self.stamp().frame)
    }

    /// Begins a frame with its event phase. `has_changes` is true when something besides missing query results asks for
    /// the frame.
    pub(in crate::viewer) fn begin_frame(&mut self, simulation_time_s: f64, has_changes: bool) -> FrameInProgress {
        let start = Instant::now();
        self.query_answers.begin_frame(self.stamp().frame + 1, has_changes);
        self.results.begin_frame();
        let dt_s = self.timer.advance(start, simulation_time_s);
        let number = self.stamp().frame;
        let _frame = trace::span_of("frame", || number.to_string().into());
        let stats = FrameStats { frame: number, ..FrameStats::default() };
        FrameInProgress { start, dt_s, stats, phase: Some(trace::span("event")), _frame }
    }

    /// Finishes update after the application's callbacks, and renders. When a device was lost, the frame is not drawn, and
    /// another device replaces it for the next frame.
    pub(in crate::viewer) fn end_frame(
        &mut self,
        frame: FrameInProgress,
        views: &mut ViewList,
        scenes: &mut SceneList,
    ) -> Result<(), ViewerError> {
        let ended = self.update_and_render(frame, views, scenes);
        match ended {
            Err(ViewerError::Gpu(error @ GpuError::DeviceLost { .. }))
                if self.device_loss.may_replace(self.stamp().frame) =>
            {
                log::warn!("{error}; another takes its place");
                self.replace_lost_devices(views, scenes)
            }
            ended => ended,
        }
    }

    fn update_and_render(
        &mut self,
        frame: FrameInProgress,
        views: &mut ViewList,
        scenes: &mut SceneList,
    ) -> Result<(), ViewerError> {
        let FrameInProgress { start, mut stats, phase, _frame, .. } = frame;
        // A handler may have changed the threading model.
        self.rendering.start_threads()?;
        if let Some(core) = self.rendering.pager_core() {
            self.pagers.set_processor_affinity(scenes, core);
        }
        if self.is_blocking() {
            self.finish()?;
        }
        self.device_loss.report()?;
        let is_dynamic = self.update(views, scenes, &mut stats)?;
        stats.update_ms = millis(start.elapsed()) - stats.event_ms;
        drop(phase);

        self.wait_for_stage(views, scenes)?;
        self.device_loss.report()?;
        for view in views.values_mut() {
            view.prepare(&self.rendering, scenes[view.scene()].bounds());
        }
        let changes = if self.is_blocking() { EnvironmentChanges::AtOnce } else { self.config.environment_changes };
        let (frame, hides_unready) = (self.stamp().frame, self.hides_unready());
        let probe = &mut self.probe;
        let rehearsals = self.rehearsals.follow_environments(changes, hides_unready, frame, views, scenes, probe);
        if self.is_blocking() {
            let stamp = self.stamp();
            for group in self.pagers.iter_mut() {
                stats.merge_ms += load_all(group, views, scenes, &mut self.rendering, &mut self.probe, &stamp);
            }
        }
        if !self.rendering.overlaps() {
            // Otherwise these requests would wait until the frame is drawn.
            self.look_early(views, scenes, None);
        }
        self.cull_and_draw(views, scenes, is_dynamic, rehearsals)?;
        self.take_culled(views, scenes, &mut stats);
        self.results.push(stats);
        self.collect_arrived()?;
        self.device_loss.report()?;
        self.results.set_frame_ms(self.timer.stamp().frame, millis(start.elapsed()));
        Ok(())
    }

    fn is_blocking(&self) -> bool {
        self.config.pager.blocking
    }

    /// Returns true if frames leave out what lacks a pipeline.
    fn hides_unready(&self) -> bool {
        self.config.new_states == NewStates::WhenReady && !self.is_blocking()
    }

    /// Runs the part of update after the application's callbacks. Returns true when draw reads data that the next update
    /// overwrites.
    fn update(
        &mut self,
        views: &ViewList,
        scenes: &mut SceneList,
        stats: &mut FrameStats,
    ) -> Result<bool, ViewerError> {
        scenes.values_mut().for_each(|scene| scene.scene_mut().compute_bounds());
        self.look_ahead(views, scenes);
        let stamp @ FrameStamp { simulation_time_s, .. } = self.stamp();
        for group in self.pagers.iter_mut() {
            stats.merge_ms += group.page(scenes, &mut self.rendering, &stamp);
        }
        let mut is_dynamic = false;
        for scene in scenes.values_mut() {
            scene.page_images(&mut self.rendering, simulation_time_s)?;
            is_dynamic |= scene.send_rewritten(&mut self.rendering)?;
        }
        Ok(is_dynamic)
    }

    /// Finds the pages to prefetch.
    fn look_ahead(&mut self, views: &ViewList, scenes: &mut SceneList) {
        scenes.values_mut().for_each(|scene| scene.findings_mut().clear_prefetches());
        if self.is_blocking() || self.config.look_ahead_s == 0.0 {
            return;
        }
        let _span = trace::span("look ahead");
        let FrameStamp { frame, reference_time_s, simulation_time_s } = self.stamp();
        let from = LookFrom { frame, reference_time_s, simulation_time_s, ahead_s: self.config.look_ahead_s };
        for (id, view) in views.iter() {
            let scene = &mut scenes[view.scene()];
            if self.pagers.of(scene).pager().is_some() {
                let requests = self.look_aheads.look(id, view, scene, &mut self.probe, from);
                scene.findings_mut().add_prefetches(requests);
            }
        }
    }

    /// Hands jobs to the contexts and cull tasks to the cameras.
    fn cull_and_draw(
        &mut self,
        views: &ViewList,
        scenes: &SceneList,
        is_dynamic: bool,
        mut rehearsals: Rehearsals,
    ) -> Result<(), ViewerError> {
        let job = self.job();
        #[cfg(feature = "window")]
        let mut overlays = std::mem::take(&mut self.overlays);
        let FrameStamp { frame, simulation_time_s, .. } = self.stamp();
        self.pictures.begin_frame(frame);
        let (pictures, hides_unready) = (&self.pictures, self.hides_unready());
        let rendered = self.rendering.frame(
            |context| FrameJob {
                read_back: pictures.reads_back(context, frame),
                hides_unready,
                rehearsals: rehearsals.extract_if(.., |(of, ..)| *of == context).map(|(_, s, e)| (s, e)).collect(),
                #[cfg(feature = "window")]
                overlays: overlays.extract_if(.., |(of, _)| *of == context).map(|(_, paint)| paint).collect(),
                ..job.again()
            },
            |camera, last| {
                let view = views.values().find(|view| view.has_camera(camera))?;
                let task = view.task(camera, &scenes[view.scene()], frame, last.requests)?;
                let camera = CullCamera { simulation_time_s, ..task.camera };
                Some(CullTask { camera, is_dynamic, ..task })
            },
        );
        #[cfg(feature = "window")]
        {
            overlays.clear();
            self.overlays = overlays;
        }
        rendered
    }

    /// Takes the results of the culls, and hands their requests to the pagers.
    fn take_culled(&mut self, views: &mut ViewList, scenes: &mut SceneList, stats: &mut FrameStats) {
        scenes.values_mut().for_each(|scene| scene.findings_mut().begin_frame());
        for (camera, CullOutcome { requests, counters, cull_ms, .. }) in self.rendering.outcomes() {
            let Some(view) = views.values_mut().find(|view| view.has_camera(camera)) else { continue };
            view.set_culled(camera, counters.tiles_drawn + counters.stand_ins);
            scenes[view.scene()].findings_mut().add(requests, counters);
            stats.tiles_drawn += counters.tiles_drawn;
            stats.tiles_visited += counters.tiles_visited;
            stats.occluded += counters.occluded;
            stats.wanted_missing += counters.wanted_missing;
            stats.cull_ms += cull_ms;
        }
        let ages = self.rendering.outcomes().map(|(_, outcome)| outcome.counters.answers_age);
        self.query_answers.end_cull(self.timer.stamp().frame, ages);
        for group in self.pagers.iter_mut() {
            group.request(scenes);
        }
    }

    /// Requests the contents of tiles that were merged since the last culls.
    pub(super) fn look_early(&mut self, views: &ViewList, scenes: &SceneList, deadline: Option<Instant>) {
        let frame = self.stamp().frame;
        for group in self.pagers.iter_mut() {
            self.early_look.look(group, views, scenes, &mut self.probe, frame, deadline);
        }
    }

    /// Returns the job of a context for the current frame: to draw what its cameras cull.
    pub(super) fn job(&self) -> FrameJob {
        let busy = self.results.history().busy(self.rendering.model());
        FrameJob {
            frame: self.stamp().frame,
            clock: self.timer.shader_clock(),
            budget: self.config.compile_budget.beside(&busy, &self.config.compile_pace),
            present: true,
            ..FrameJob::default()
        }
    }

    /// Merges and uploads arrived pages until shortly before `deadline`, then sleeps until it.
    pub(in crate::viewer) fn work_until(&mut self, views: &ViewList, scenes: &mut SceneList, deadline: Instant) {
        let _span = trace::span("between frames");
        // A pager that waits for its server leaves its time to the others.
        while self.pagers.iter().filter(|group| group.is_paging()).count() > 1 && Instant::now() < deadline {
            let begun = Instant::now();
            self.look_early(views, scenes, Some(deadline));
            for group in self.pagers.iter_mut() {
                group.work_until(scenes, &mut self.rendering, deadline.min(Instant::now() + WORK_SLICE));
            }
            if begun.elapsed() < ARRIVAL_POLL {
                break; // no pager has anything in flight
            }
        }
        let frame = self.stamp().frame;
        for group in self.pagers.iter_mut() {
            loop {
                group.work_until_new_tiles(scenes, &mut self.rendering, deadline);
                let due = self.early_look.next();
                if !group.has_new_tiles() || due >= deadline {
                    break;
                }
                group.work_until(scenes, &mut self.rendering, due);
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
                if !self.early_look.look(group, views, scenes, &mut self.probe, frame, Some(deadline)) {
                    break;
                }
            }
            group.work_until(scenes, &mut self.rendering, deadline);
        }
        std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
    }

    /// Paints an overlay over the next frame of a context, above the overlays that are set already.
    #[cfg(feature = "window")]
    pub(in crate::viewer) fn set_overlay(&mut self, context: u32, paint: crate::viewer::overlay::OverlayPaint) {
        let same = self.overlays.iter().position(|(of, earlier)| *of == context && earlier.is_same_overlay(&paint));
        let unpainted = same.map(|index| self.overlays.remove(index).1);
        self.overlays.push((context, paint.after(unpainted)));
    }
}
