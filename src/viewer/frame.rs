//! The frame: advance, event, update and rendering of a [`Viewer`]. Main thread; cull and draw run where the threading
//! model has them.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::home::{LocalFrame, SetBounds};
use super::rendering::{CullOutcome, CullTask, FRAMES_IN_FLIGHT, FrameDone, FrameJob, Lens, millis};
use super::stats::FrameStats;
use super::viewer::{CONTEXT, FrameStamp, QUIET_FRAMES, alone};
use super::{Viewer, ViewerError};
use crate::cull::{CullCamera, CullCounters};
use crate::draw::FrameClock;
use crate::pager::CompileContext;
use crate::scene::{Attachment, CameraTarget, DataVariance, DrawSlot};
use crate::state::{TextureFormat, TextureObject};

/// How often arrivals are looked for while the draw thread is busy.
const ARRIVAL_POLL: Duration = Duration::from_micros(300);
/// Rounds of cull and load in one frame of the blocking mode: the deepest tree of tilesets that is followed.
const MAX_BLOCKING_ROUNDS: u32 = 256;

impl Viewer {
    /// Starts what the first frame needs: the threads of the model.
    pub fn realize(&mut self) -> Result<(), ViewerError> {
        self.rendering.start_threads()
    }

    /// Renders one frame at a simulation time.
    pub fn frame_at(&mut self, simulation_time_s: f64) -> Result<(), ViewerError> {
        let start = Instant::now();
        self.realize()?;
        self.read_back_ms = 0.0;
        let dt_s = self.advance(start, simulation_time_s);
        let mut stats = FrameStats { frame: self.stamp.frame, ..FrameStats::default() };

        self.event(dt_s);
        let after_event = Instant::now();
        stats.event_ms = millis(after_event - start);

        // Update: everything with &mut Scene.
        for callback in &mut self.update_callbacks {
            callback(alone(&mut self.scene), &self.stamp);
        }
        if self.pager_config.blocking {
            self.absorb_all()?;
        }
        stats.merge_ms = self.page();
        let is_dynamic = self.send_rewritten()?;
        stats.update_ms = millis(after_event.elapsed());

        // Rendering: cull and draw, by the threads of the model.
        self.wait_for_stage()?;
        self.prepare_eyes();
        if self.pager_config.blocking {
            self.probe();
            let mut rounds = 0;
            while !self.is_settled() && rounds < MAX_BLOCKING_ROUNDS {
                stats.merge_ms += self.page();
                self.probe();
                rounds += 1;
            }
        }
        self.render(&mut stats, is_dynamic)?;
        self.note_convergence(start);
        self.history.push(stats);
        self.absorb_arrived()?;
        let frame_ms = (millis(start.elapsed()) - self.read_back_ms).max(0.0);
        if let Some(stats) = self.history.frame_mut(self.stamp.frame) {
            stats.frame_ms = frame_ms;
        }
        Ok(())
    }

    /// Hands jobs and tasks to the contexts and cameras, and takes what the culls found.
    fn render(&mut self, stats: &mut FrameStats, is_dynamic: bool) -> Result<(), ViewerError> {
        let mut job = Some(self.job());
        // The closures may not borrow what the rendering is part of.
        let task = self.task(Vec::new());
        let rendered = self.rendering.frame(
            |_| job.take().unwrap_or_default(),
            |_, last| CullTask { requests: last.requests, is_dynamic, ..task.clone() },
        );
        drop(task);
        rendered?;
        let mut counters = CullCounters::default();
        self.requests.clear();
        for CullOutcome { requests, counters: of_camera, cull_ms } in self.rendering.outcomes() {
            self.requests.extend_from_slice(requests);
            counters.add(of_camera);
            stats.cull_ms += cull_ms;
        }
        stats.tiles_drawn = counters.tiles_drawn;
        stats.tiles_visited = counters.tiles_visited;
        stats.occluded = counters.occluded;
        stats.wanted_missing = counters.wanted_missing;
        self.wanted_missing = counters.wanted_missing;
        Ok(())
    }

    /// Culls on this very thread, without a frame: what would be requested, and what misses.
    fn probe(&mut self) {
        let memory = std::mem::take(&mut self.requests);
        let task = self.task(memory);
        let outcome = task.run(&mut self.probe, &mut self.probe_stage);
        self.requests = outcome.requests;
        self.wanted_missing = outcome.counters.wanted_missing;
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

    fn event(&mut self, dt_s: f64) {
        if let Some(manipulator) = &mut self.manipulator {
            for event in &self.events {
                manipulator.handle(event);
            }
            self.camera.world_from_eye = manipulator.advance(dt_s);
        }
        self.events.clear();
    }

    /// The pager's turn with the scene; milliseconds.
    fn page(&mut self) -> f64 {
        let start = Instant::now();
        self.merge_own();
        if let Some(pager) = &mut self.pager {
            let contexts = &mut self.rendering.compile_contexts();
            pager.update_scene_graph(alone(&mut self.scene), self.stamp.frame, &self.requests, contexts);
            self.quiet_frames = if pager.is_idle() { self.quiet_frames.saturating_add(1) } else { 0 };
        } else {
            self.quiet_frames = QUIET_FRAMES;
        }
        millis(start.elapsed())
    }

    /// Gives pages that the application made the slots of their uploaded drawables.
    fn merge_own(&mut self) {
        let nobody_else_asks = self.pager.is_none() && !self.compiling.is_empty();
        let scene = alone(&mut self.scene);
        for context in self.rendering.contexts_mut() {
            if nobody_else_asks {
                context.take_compiled();
            }
            for (number, compiled) in context.take_compiled_own() {
                for error in &compiled.errors {
                    log::error!("a drawable of a root cannot be drawn: {error}");
                }
                match self.compiling.get(number as usize).and_then(|id| scene.page_mut(*id)) {
                    Some(page) => page.set_draw_slots(context.id(), compiled.slots),
                    // Removed meanwhile.
                    None => context.release(compiled.slots),
                }
            }
        }
    }

    /// Tells the contexts of meshes that update has changed; whether draw reads what the next update writes in place.
    fn send_rewritten(&mut self) -> Result<bool, ViewerError> {
        let scene = alone(&mut self.scene);
        let mut is_dynamic = false;
        for rewritten in std::mem::take(scene.rewritten_mut()) {
            let Some(page) = scene.page(rewritten.page) else { continue };
            let slots = |context: u32| page.draw_slots_of(context);
            if self.rendering.contexts().iter().any(|c| slots(c.id()).is_empty()) {
                // Not uploaded yet.
                scene.rewritten_mut().push(rewritten);
                continue;
            }
            is_dynamic |= rewritten.variance == DataVariance::Dynamic;
            for context in self.rendering.contexts_mut() {
                match slots(context.id()).get(rewritten.drawable as usize) {
                    Some(slot) if *slot != DrawSlot::NONE => context.rewrite(*slot, rewritten.mesh.clone())?,
                    _ => {}
                }
            }
        }
        Ok(is_dynamic)
    }

    /// What culling the present view is told.
    pub(super) fn task(&self, requests: Vec<crate::cull::PageRequest>) -> CullTask {
        let horizon = self.bounds.as_ref().and_then(SetBounds::body);
        let camera = CullCamera { horizon, ..self.camera.cull_camera(self.size_px, self.stamp.frame, CONTEXT) };
        CullTask {
            scene: self.scene.clone(),
            camera,
            lens: Lens { camera: self.camera, size_px: self.size_px, offset: glam::DMat4::IDENTITY },
            stereo: self.stereo.zip(self.eyes.clone()),
            viewport_px: None,
            is_dynamic: false,
            requests,
        }
    }

    /// Makes what the eyes' pictures are drawn into, where there are two and none is there.
    pub(super) fn prepare_eyes(&mut self) {
        if let (Some(stereo), None) = (&self.stereo, &self.eyes) {
            self.eyes = Some(eye_targets(stereo.eye_size_px(self.size_px), self.samples));
        }
    }

    fn note_convergence(&mut self, now: Instant) {
        let pose = self.camera.world_from_eye;
        let first_pose = *self.first_pose.get_or_insert(pose);
        if self.converge_s.is_none() && first_pose == pose && self.is_settled() {
            self.converge_s = self.first_frame.map(|first| now.max(first).duration_since(first).as_secs_f64());
        }
    }

    /// What the context is told to draw: what its cameras cull.
    pub(super) fn job(&mut self) -> FrameJob {
        // Over a globe, up is a matter of where one is.
        if let Some(bounds) = self.bounds.filter(|b| b.frame.georeferenced) {
            self.environment.up_in_world = LocalFrame::at(self.camera.eye(), bounds.frame.georeferenced).up();
        }
        FrameJob {
            frame: self.stamp.frame,
            stage: None,
            environment: self.environment,
            clock: FrameClock {
                reference_time_s: self.stamp.reference_time_s,
                delta_s: self.delta_s,
                simulation_time_s: self.stamp.simulation_time_s,
            },
            budget: self.compile_budget,
            read_back: std::mem::take(&mut self.picture_wanted),
            present: true,
            #[cfg(feature = "window")]
            overlay: self.overlay.take(),
        }
    }

    fn absorb_arrived(&mut self) -> Result<(), ViewerError> {
        for place in 0..self.rendering.contexts().len() {
            while let Some(done) = self.rendering.context_at(place).and_then(|c| c.try_done()) {
                self.absorb(place, *done)?;
            }
        }
        Ok(())
    }

    fn absorb_next(&mut self, place: usize) -> Result<(), ViewerError> {
        let start = Instant::now();
        let Some(context) = self.rendering.context_at(place) else { return Ok(()) };
        if let Some(done) = context.wait_done()? {
            self.read_back_ms += done.read_back_ms.min(millis(start.elapsed()));
            self.absorb(place, *done)?;
        }
        Ok(())
    }

    /// Waits until each camera has a free stage, merging what arrives meanwhile.
    fn wait_for_stage(&mut self) -> Result<(), ViewerError> {
        for place in 0..self.rendering.contexts().len() {
            while self.rendering.in_flight(place) >= FRAMES_IN_FLIGHT {
                match &mut self.pager {
                    Some(pager) if !self.pager_config.blocking && !pager.is_idle() => {
                        pager.merge_arrived(alone(&mut self.scene), &mut self.rendering.compile_contexts());
                        let start = Instant::now();
                        let Some(context) = self.rendering.context_at(place) else { break };
                        if let Some(done) = context.wait_done_for(ARRIVAL_POLL)? {
                            self.read_back_ms += done.read_back_ms.min(millis(start.elapsed()));
                            self.absorb(place, *done)?;
                        }
                    }
                    _ => self.absorb_next(place)?,
                }
            }
        }
        Ok(())
    }

    pub(super) fn absorb_all(&mut self) -> Result<(), ViewerError> {
        for place in 0..self.rendering.contexts().len() {
            while self.rendering.in_flight(place) > 0 {
                self.absorb_next(place)?;
            }
        }
        Ok(())
    }

    fn absorb(&mut self, place: usize, done: FrameDone) -> Result<(), ViewerError> {
        let frame = done.frame;
        self.gpu_bytes_peak = self.gpu_bytes_peak.max(done.gpu_bytes_peak);
        if !self.rendering.overlaps() {
            self.read_back_ms += done.read_back_ms;
        }
        self.draw_errors.extend(done.errors);
        let drawn = done.stats?;
        let is_last = self.rendering.contexts().iter().all(|c| c.done_frame >= frame);
        if let Some(stats) = self.history.frame_mut(frame) {
            stats.draw_ms = stats.draw_ms.max(done.draw_ms);
            stats.compile_ms = stats.compile_ms.max(done.compile_ms);
            stats.gpu_ms = drawn.gpu_ms.map(|ms| ms.max(stats.gpu_ms.unwrap_or(0.0))).or(stats.gpu_ms);
            stats.leaves += drawn.leaves;
            stats.draw_calls += drawn.draw_calls;
            stats.state_changes += drawn.state_changes;
            stats.state_changes_skipped += drawn.state_changes_skipped;
            stats.triangles += drawn.triangles;
            stats.points += drawn.points;
            stats.drawn = is_last;
        }
        if let (0, Some(image)) = (place, done.image) {
            self.pictures.push((frame, image?));
        }
        Ok(())
    }
}

/// A texture for each eye.
fn eye_targets(size_px: [u32; 2], samples: u32) -> [Arc<CameraTarget>; 2] {
    ["left eye", "right eye"].map(|name| {
        let texture = TextureObject::target(name, size_px, TextureFormat::Rgba8Srgb);
        Arc::new(CameraTarget { colors: vec![Attachment::new(texture)], samples, ..CameraTarget::default() })
    })
}
