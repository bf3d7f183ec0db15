//! The flight of a seed: a viewer with scenes, views and contexts, servers with faults, and the checks of invariants.

use std::collections::VecDeque;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use glam::{DAffine3, DVec3};
use terrane::fetch::{CacheConfig, IoError, is_remote};
use terrane::gpu::{AdapterChoice, GpuError, GraphicsContext};
use terrane::pager::{PagerConfig, PagerStats};
use terrane::scene::Sky;
use terrane::viewer::{
    self, CompositeViewer, ContextId, HoleCheck, KEY_COLOR, SceneId, SetBounds, SlaveId, ViewId, ViewerConfig,
    ViewerError,
};

use super::checks::invariants::{self, Failures, ImageChecks, RequestedImage};
use super::checks::{reference, watchdog};
use super::extra_roots::{self, Proxies, Sign};
use super::plan::{Drawing, MAX_CONTEXTS, Plan, Pose, Protocol, Slides, Transport};
use super::report::Outcome;
use super::sources::servers::{self, TempFolder};
use crate::serve::Background;

/// Maximum number of frames until everything is loaded after the faults end. Latency and bandwidth stay limited, and all
/// requests of HTTP/2 share one connection.
const MAX_SETTLE_FRAMES: u32 = 6000;
/// Minimum number of frames after a clear.
const MIN_CLEAR_FRAMES: u32 = 4;
/// Maximum number of frames after a clear. The smallest budget needs this many for the upload in flight.
const MAX_CLEAR_FRAMES: u32 = 100;
/// The number of frames without a change after which a pager with too small budgets counts as settled.
const QUIET_FRAMES: u32 = 60;
/// The size of the white texel of drawables without a texture.
const WHITE_TEXEL_BYTES: u64 = 4;
/// The number of attempts to load a root, whose server has no faults then.
const MAX_ROOT_ATTEMPTS: u32 = 50;
/// Maximum duration of closing a viewer with its threads and requests.
const MAX_CLOSE_TIME: Duration = Duration::from_secs(10);

/// Flies a seed over a set and returns its result. If `is_strict` is true, faults of the local server may not keep a tile from
/// loading.
pub fn fly(plan: &Plan, source: &str, is_strict: bool) -> Result<Outcome> {
    let mut flight = Flight::new(plan, source)?;
    flight.is_strict = is_strict;
    flight.all()
}

/// The state of a flight. It has many fields because events, checks and the end of the flight all work on the viewer and the lists
/// of its objects.
pub(super) struct Flight<'a> {
    pub(super) plan: &'a Plan,
    // Fields are dropped in this order: the server must outlive its clients.
    pub(super) viewer: Option<CompositeViewer>,
    sign: Option<Sign>,
    server: Option<Background>,
    /// The server of the sign's images, until the sign is created.
    image_server: Option<Background>,
    /// True if the set is on a remote server, whose failures are not ours.
    is_remote: bool,
    /// True if tiles that faults of the local server kept from loading count as failures.
    is_strict: bool,
    /// The source of the set without the local server.
    files: &'a str,
    /// The source of the set that the viewer loads.
    source: String,
    temp_folder: TempFolder,
    pager: PagerConfig,
    config: ViewerConfig,
    pub(super) scenes: Vec<SceneId>,
    /// The scenes of each pager.
    pub(super) pagers: Vec<Vec<SceneId>>,
    /// The views with their contexts. The first view stays and fills the first context.
    pub(super) views: Vec<(ViewId, ContextId)>,
    pub(super) slaves: Vec<(ViewId, SlaveId, ContextId)>,
    pub(super) contexts: Vec<ContextId>,
    pub(super) bounds: SetBounds,
    pub(super) proxies: Option<Proxies>,
    images: ImageChecks,
    pub(super) failures: Failures,
    /// The number of the frame in the plan. The viewer counts its frames from 1.
    pub(super) frame: u32,
    outcome: Outcome,
}

/// Returns the simulation time of a frame, so that animations are the same in each run.
pub(super) fn time_s(frame: u32) -> f64 {
    f64::from(frame) / 60.0
}

/// Returns the pose of a camera over a set.
pub(super) fn world_from_eye(bounds: &SetBounds, pose: &Pose) -> DAffine3 {
    let frame = bounds.frame;
    let local = DVec3::new(
        bounds.middle_m.x + pose.east * bounds.half_size_m.x,
        bounds.middle_m.y + pose.north * bounds.half_size_m.y,
        bounds.middle_m.z + bounds.half_size_m.z + pose.height * bounds.sphere.radius_m,
    );
    let eye = frame.world_from_local.transform_point3(local);
    viewer::world_from_eye(eye, frame.direction(pose.heading, pose.pitch), frame.up())
}

impl<'a> Flight<'a> {
    fn new(plan: &'a Plan, files: &'a str) -> Result<Self> {
        watchdog::step(format_args!("start"));
        let temp_folder = TempFolder::new(plan.seed)?;
        let mut pager = plan.pager.clone();
        if plan.has_cache && plan.transport == Transport::Server {
            pager.http.cache = Some(CacheConfig::new(temp_folder.join("cache")));
        }
        let is_remote = is_remote(files);
        let (mut server, mut image_server, mut source) = (None, None, files.to_owned());
        if plan.transport == Transport::Server && !is_remote {
            pager.http.http2_only = plan.protocol == Protocol::Http2;
            let mut start = |folder: &Path, certificate: &str| {
                let certificate = temp_folder.join(certificate);
                let server = servers::start(plan, folder, &certificate)?;
                pager.http.root_certificates.extend(plan.protocol.is_encrypted().then_some(certificate));
                anyhow::Ok(server)
            };
            let (folder, name) = servers::folder_and_path(files)?;
            let started = start(&folder, "set.pem")?;
            source = format!("{}{name}", started.url());
            server = Some(started);
            if plan.slides.is_some() {
                image_server = Some(start(&temp_folder.images()?, "images.pem")?);
            }
        }
        let config = ViewerConfig {
            size_px: plan.size_px,
            threading: plan.model,
            adapter: if plan.drawing == Drawing::None { AdapterChoice::Noop } else { AdapterChoice::Any },
            validation: false,
            pager: pager.clone(),
            max_sse_px: plan.sse_px,
            skip_sse_factor: plan.skip_sse_factor,
            look_ahead_s: plan.look_ahead_s,
            compile_contexts: plan.compile_contexts,
            compile_budget: plan.compile_budget,
            history_frames: 64,
            max_contexts: MAX_CONTEXTS,
            ..ViewerConfig::default()
        };
        let mut flight = Self {
            plan,
            viewer: None,
            sign: None,
            proxies: None,
            server,
            image_server,
            is_remote,
            is_strict: false,
            files,
            source,
            temp_folder,
            pager,
            config,
            scenes: Vec::new(),
            pagers: Vec::new(),
            views: Vec::new(),
            slaves: Vec::new(),
            contexts: Vec::new(),
            bounds: SetBounds::from_sphere(terrane::math::BoundingSphere::new(DVec3::ZERO, 1.0)),
            images: ImageChecks { requested: VecDeque::new(), holes: None, checked: 0, hole_px: 0 },
            failures: Failures::default(),
            frame: 0,
            outcome: Outcome::default(),
        };
        flight.open()?;
        Ok(flight)
    }

    /// Opens a context on the seed's adapter, or on the noop adapter if there is none.
    pub(super) fn context(&mut self) -> Result<GraphicsContext> {
        match GraphicsContext::new_offscreen(&self.config.traits()) {
            Ok(context) => Ok(context),
            Err(GpuError::NoAdapter { .. }) => {
                self.config.adapter = AdapterChoice::Noop;
                Ok(GraphicsContext::new_offscreen(&self.config.traits())?)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Opens the first context and adds the scenes, additional roots and the first view.
    fn open(&mut self) -> Result<()> {
        let first = self.context()?;
        self.outcome.adapter = first.adapter_name();
        let mut viewer = CompositeViewer::new(&self.config)?;
        self.contexts.push(viewer.open_context(first)?);
        // The root must load, so faults are off. Other requests may fail.
        self.set_faulty(false);
        for _ in 0..self.plan.scenes {
            self.add_scene(&mut viewer)?;
        }
        self.set_faulty(true);
        self.bounds = *viewer.bounds(self.scenes[0])?.context("the set has no bounds")?;
        if self.plan.has_proxies {
            self.proxies = Proxies::add(&mut viewer, self.scenes[0], &self.bounds)?;
        }
        if let Some(slides) = &self.plan.slides {
            self.sign = Some(self.sign(slides, &mut viewer)?);
        }
        self.viewer = Some(viewer);
        self.add_view(0, 0, false)?;
        if self.plan.drawing == Drawing::Holes && self.config.adapter != AdapterChoice::Noop {
            self.images.holes = HoleCheck::new(&self.bounds);
        }
        Ok(())
    }

    /// Adds a scene of the same set. Faults must be off, because the root must load.
    pub(super) fn add_scene(&mut self, viewer: &mut CompositeViewer) -> Result<()> {
        let shared = self.pagers.first_mut().filter(|_| self.plan.share_pager);
        let scene = match &shared {
            Some(scenes) => viewer.add_scene_with_pager_of(scenes[0])?,
            None => viewer.add_scene()?,
        };
        // A machine with much else to do may not answer within the short timeouts of plans.
        let mut attempts = 1..MAX_ROOT_ATTEMPTS;
        while let Err(error) = viewer.load(scene, &self.source) {
            let is_late = matches!(error, ViewerError::Io(IoError::Timeout { .. }));
            if !is_late || attempts.next().is_none() {
                return Err(error.into());
            }
        }
        match shared {
            Some(scenes) => scenes.push(scene),
            None => self.pagers.push(vec![scene]),
        }
        self.scenes.push(scene);
        Ok(())
    }

    /// Adds a sign. Its images come from disk or from a server with the same faults, like the set.
    fn sign(&mut self, slides: &Slides, viewer: &mut CompositeViewer) -> Result<Sign> {
        let folder = self.temp_folder.images()?;
        let names = extra_roots::write_images(slides, &folder)?;
        let server = self.image_server.take();
        let uri = |name: &String| match &server {
            Some(server) => format!("{}{name}", server.url()),
            None => folder.join(name).display().to_string(),
        };
        let uris = names.iter().map(uri).collect();
        Sign::add(viewer, self.scenes[0], &self.bounds, slides, uris, server)
    }

    pub(super) fn set_faulty(&self, is_faulty: bool) {
        if let Some(server) = &self.server {
            server.set_faulty(is_faulty);
        }
        if let Some(sign) = &self.sign {
            sign.set_faulty(is_faulty);
        }
    }

    pub(super) fn viewer(&mut self) -> Result<&mut CompositeViewer> {
        self.viewer.as_mut().context("the viewer is gone")
    }

    fn is_drawn(&self) -> bool {
        self.plan.drawing != Drawing::None && self.config.adapter != AdapterChoice::Noop
    }

    /// Adds a view of a scene, of a part of the context if `part` is true.
    pub(super) fn add_view(&mut self, scene: usize, context: usize, part: bool) -> Result<()> {
        let (scene, context) = (self.scenes[scene % self.scenes.len()], self.contexts[context % self.contexts.len()]);
        let part = part.then_some([3, 5, 40, 30]);
        let on_key = self.plan.drawing == Drawing::Holes;
        let viewer = self.viewer()?;
        let id = viewer.add_view(scene, context, part)?;
        if on_key {
            let view = viewer.view_mut(id)?;
            view.environment.sky = Sky::Background(KEY_COLOR);
            view.environment.fog.enabled = false;
        }
        self.views.push((id, context));
        Ok(())
    }

    /// Flies all frames of the plan, then settles, compares, clears and closes.
    fn all(&mut self) -> Result<Outcome> {
        for frame in 0..self.plan.frames {
            self.frame = frame;
            let plan = self.plan;
            for (_, event) in plan.events.iter().filter(|(of, _)| *of == frame) {
                watchdog::step(format_args!("frame {frame}, event {event:?}"));
                self.apply(*event).with_context(|| format!("frame {frame}, {event:?}"))?;
            }
            for (number, (view, _)) in self.views.clone().into_iter().enumerate() {
                let pose = plan.poses[number % plan.poses.len()][frame as usize];
                self.place_camera(view, &pose)?;
            }
            self.one_frame().with_context(|| format!("frame {frame}"))?;
            let until = Instant::now() + Duration::from_micros(plan.between_us);
            self.viewer()?.work_until(until);
            self.check()?;
        }
        self.settle()?;
        self.compare()?;
        self.clear()?;
        self.close()?;
        Ok(std::mem::take(&mut self.outcome))
    }

    fn place_camera(&mut self, view: ViewId, pose: &Pose) -> Result<()> {
        let bounds = self.bounds;
        self.viewer()?.view_mut(view)?.camera.world_from_eye = world_from_eye(&bounds, pose);
        Ok(())
    }

    /// Draws a frame and checks the images that were read back.
    fn one_frame(&mut self) -> Result<()> {
        let number = self.frame;
        watchdog::step(format_args!("frame {number}"));
        let wants_image = self.is_drawn() && number.is_multiple_of(self.plan.image_interval) && self.views.len() == 1;
        let (first_view, first_context) = self.views[0];
        let has_slaves = self.slaves.iter().any(|(_, _, context)| *context == first_context);
        let wants_image = wants_image && !has_slaves;
        let viewer = self.viewer()?;
        if wants_image {
            viewer.want_picture(first_context);
        }
        viewer.frame_at(time_s(number))?;
        let (frame, camera) = (viewer.frame_stamp().frame, viewer.view_mut(first_view)?.camera);
        let images = viewer.take_pictures(first_context);
        // The scene is the one that was culled: nothing is merged or expired between cull and here.
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        if wants_image {
            let has_ground = invariants::has_ground(viewer.scene(self.scenes[0])?);
            let must_show = has_ground && invariants::sees_ground(&self.bounds, &camera);
            self.images.requested.push_back(RequestedImage { frame, camera, has_ground, must_show });
        }
        for (frame, image) in images {
            self.images.check(&mut self.failures, frame, &image);
        }
        invariants::ground(&mut self.failures, number, viewer, &self.bounds)?;
        self.outcome.frames += 1;
        Ok(())
    }

    /// Checks all invariants after a frame.
    fn check(&mut self) -> Result<()> {
        let number = self.frame;
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        for (index, scenes) in self.pagers.iter().enumerate() {
            let Some(pager) = viewer.pager(scenes[0])? else { continue };
            invariants::pager(&mut self.failures, number, index, pager, &self.pager);
            let resident = pager.stats().resident;
            let mut found = 0;
            for scene in scenes {
                found += invariants::pages_in(viewer.scene(*scene)?);
            }
            let says = || format!("pager {index}: {found} pages in its scenes, {resident} are counted");
            self.failures.check(found == resident, "pages that are not counted", number, says);
            let is_on_disk = self.server.is_none() && !self.is_remote;
            // With a tiny budget a single page may exceed it, which is a failure.
            let lost = is_on_disk && pager.stats().failed > 0 && !self.plan.is_tiny;
            let says = || format!("{:?}", pager.errors());
            self.failures.check(!lost, "a valid file failed to load", number, says);
            let lost = self.is_strict && !is_on_disk && pager.stats().failed > 0;
            let says = || invariants::lost_tiles(pager);
            self.failures.check(!lost, "faults kept tiles from loading", number, says);
        }
        if let Some(proxies) = &self.proxies {
            proxies.check(&mut self.failures, number, viewer)?;
        }
        if let Some(sign) = &self.sign {
            sign.check(&mut self.failures, number, viewer)?;
        }
        let errors = viewer.draw_errors();
        self.failures.check(errors.is_empty(), "an error of the device", number, || format!("{errors:?}"));
        let logged = watchdog::take_errors();
        self.failures.check(logged.is_empty(), "an error in the log", number, || format!("{logged:?}"));
        Ok(())
    }

    /// Returns the number of pages in each scene.
    pub(super) fn pages_in_each(&self) -> Result<Vec<u64>> {
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        self.scenes.iter().map(|scene| Ok(invariants::pages_in(viewer.scene(*scene)?))).collect()
    }

    /// Ends the faults, stops the cameras, and draws frames until everything is loaded.
    fn settle(&mut self) -> Result<()> {
        self.set_faulty(false);
        for scene in self.scenes.clone() {
            if let Some(pager) = self.viewer()?.pager_mut(scene)? {
                pager.set_paused(false);
                pager.set_takes_requests(true);
            }
        }
        for (number, (view, _)) in self.views.clone().into_iter().enumerate() {
            let pose = self.plan.last_poses[number % self.plan.last_poses.len()];
            self.place_camera(view, &pose)?;
            self.viewer()?.view_mut(view)?.announced = None;
        }
        let (mut quiet, mut last) = (0, Vec::new());
        for settling in 0..MAX_SETTLE_FRAMES {
            self.frame = self.plan.frames + settling;
            self.outcome.settling = settling + 1;
            self.one_frame()?;
            let until = Instant::now() + reference::SETTLING_FRAME;
            self.viewer()?.work_until(until);
            self.check()?;
            let viewer = self.viewer.as_ref().context("the viewer is gone")?;
            let stats: Vec<_> = self.pagers.iter().filter_map(|s| Some(*viewer.pager(s[0]).ok()??.stats())).collect();
            let now: Vec<_> = stats.iter().map(invariants::progress).collect();
            let in_flight: u64 = stats.iter().map(|s| s.in_flight).sum();
            quiet = if now == last && in_flight == 0 { quiet + 1 } else { 0 };
            last = now;
            let sign_shows = self.sign.as_ref().map_or(Ok(true), |sign| sign.has_shown(viewer))?;
            if (viewer.is_settled() && quiet > 4 && sign_shows) || (self.plan.is_tiny && quiet >= QUIET_FRAMES) {
                if let Some(proxies) = self.proxies.as_ref().filter(|_| !self.plan.is_tiny) {
                    proxies.check_at_rest(&mut self.failures, self.frame, viewer)?;
                }
                return Ok(());
            }
        }
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        let missing = viewer.stats().last().map_or(0, |s| s.wanted_missing);
        let stats: Vec<_> = self.pagers.iter().filter_map(|s| Some(*viewer.pager(s[0]).ok()??.stats())).collect();
        self.failures.add("the flight does not settle", self.frame, || format!("{missing} missing, {stats:?}"));
        Ok(())
    }

    /// Compares the image of the first view with that of a new viewer, if no content was lost.
    fn compare(&mut self) -> Result<()> {
        watchdog::step(format_args!("compare"));
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        let mut pagers = self.scenes.iter().filter_map(|scene| viewer.pager(*scene).ok()?);
        let is_whole = viewer.is_settled() && pagers.all(|p| p.stats().failed + p.stats().drawables_failed == 0);
        let may_be_corrupt = self.server.is_some() && self.plan.faults.corrupt > 0.0;
        if !(is_whole && self.is_drawn()) || self.plan.is_tiny || self.is_remote || may_be_corrupt {
            return Ok(());
        }
        for (view, slave, _) in std::mem::take(&mut self.slaves) {
            self.viewer()?.remove_slave(view, slave)?;
        }
        for (view, _) in self.views.split_off(1) {
            self.viewer()?.remove_view(view)?;
        }
        let first = self.views[0].0;
        self.viewer()?.view_mut(first)?.camera.settings.cull_mask &= !extra_roots::MASK;
        self.settle()?;
        for _ in 0..reference::FADE_FRAMES {
            self.frame += 1;
            self.one_frame()?;
        }
        let (first_view, first_context) = self.views[0];
        let viewer = self.viewer()?;
        viewer.finish()?;
        let flown = viewer.read_back(first_context)?;
        let view = viewer.view_mut(first_view)?;
        let (camera, environment) = (view.camera, view.environment);
        let fresh = reference::image(&self.config, self.files, flown.dimensions().into(), &camera, &environment)?;
        self.outcome.compared = true;
        if let Some(difference) = reference::difference(&flown, &fresh) {
            let folder = std::env::temp_dir();
            let names = ["flown", "fresh"].map(|name| folder.join(format!("terrane-{}-{name}.png", self.plan.seed)));
            flown.save(&names[0])?;
            fresh.save(&names[1])?;
            let says = || format!("{difference}; {} and {}", names[0].display(), names[1].display());
            self.failures.add("the image differs from that of a new viewer", self.frame, says);
        }
        Ok(())
    }

    /// Adds the counters of a pager to the result.
    pub(super) fn sum_up(&mut self, stats: &PagerStats) {
        self.outcome.requested += stats.requested;
        self.outcome.merged += stats.merged;
        self.outcome.failed += stats.failed;
        self.outcome.cancelled += stats.cancelled;
        self.outcome.expired += stats.expired;
    }

    /// Clears all pages and checks that no memory is left in use.
    fn clear(&mut self) -> Result<()> {
        watchdog::step(format_args!("clear"));
        if let (Some(sign), Some(viewer)) = (self.sign.take(), &mut self.viewer) {
            sign.remove(viewer)?;
        }
        for (index, scenes) in self.pagers.clone().into_iter().enumerate() {
            let viewer = self.viewer()?;
            let Some(pager) = viewer.pager_mut(scenes[0])? else { continue };
            pager.set_takes_requests(false);
            let before = *pager.stats();
            self.sum_up(&before);
            let mut found = 0;
            for scene in &scenes {
                let viewer = self.viewer()?;
                viewer.clear_pages(*scene)?;
                found += invariants::pages_in(viewer.scene(*scene)?);
            }
            let Some(s) = self.viewer()?.pager(scenes[0])?.map(|pager| *pager.stats()) else { continue };
            let left = [found, s.resident, s.cpu_bytes_held, s.gpu_bytes_held, s.waiting, s.in_flight];
            let says = || format!("pager {index}: {s:?}");
            self.failures.check(left == [0; 6], "pages or bytes are left after a clear", self.frame, says);
        }
        // The white texel of drawables without a texture, such as the sign and tiles whose image has failed, stays in each
        // device.
        let empty = WHITE_TEXEL_BYTES * self.contexts.len() as u64;
        let mut bytes = 0;
        for frames in 1..=MAX_CLEAR_FRAMES {
            self.frame += 1;
            self.one_frame()?;
            let until = Instant::now() + reference::SETTLING_FRAME;
            self.viewer()?.work_until(until);
            self.check()?;
            self.viewer()?.finish()?;
            bytes = self.viewer()?.stats().last().map_or(0, |s| s.gpu_bytes);
            if frames >= MIN_CLEAR_FRAMES && bytes <= empty {
                break;
            }
        }
        let says = || format!("{bytes} bytes, of which up to {empty} are never freed");
        self.failures.check(bytes <= empty, "GPU memory is left after a clear", self.frame, says);
        Ok(())
    }

    /// Closes the viewer with faults on, and checks the duration.
    fn close(&mut self) -> Result<()> {
        watchdog::step(format_args!("close"));
        // The last images are checked as well.
        let first = self.views[0].1;
        for (frame, image) in self.viewer()?.take_pictures(first) {
            self.images.check(&mut self.failures, frame, &image);
        }
        self.set_faulty(true);
        let start = Instant::now();
        self.viewer = None;
        let took = start.elapsed();
        self.failures
            .check(took < MAX_CLOSE_TIME, "closing the viewer took too long", self.frame, || format!("{took:?}"));
        let logged = watchdog::take_errors();
        self.failures.check(logged.is_empty(), "an error in the log", self.frame, || format!("{logged:?}"));
        self.outcome.pictures = self.images.checked;
        self.outcome.failures = std::mem::take(&mut self.failures).into_list();
        Ok(())
    }
}
