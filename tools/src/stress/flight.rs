//! A seed, flown: a viewer with its scenes, views and contexts, the server with its faults, and the checks.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use glam::{DAffine3, DVec3};
use serde::{Deserialize, Serialize};
use terrane::draw::Sky;
use terrane::fetch::{CacheConfig, is_remote};
use terrane::gpu::{AdapterChoice, GpuError, GraphicsContext};
use terrane::pager::{PagerConfig, PagerStats};
use terrane::viewer::{
    self, CompositeViewer, ContextId, HoleCheck, KEY_COLOR, SceneId, SetBounds, SlaveId, ViewId, ViewerConfig,
};

use super::check::{self, Asked, Failures, Pictures};
use super::extras::{Proxies, Sign};
use super::plan::{Drawing, MOST_CONTEXTS, Plan, Pose, Slides, Way, Wire};
use super::{extras, fresh, watch};
use crate::serve::{Background, ServeArgs};

/// Frames within which everything comes to rest once faults have ceased. Latency and bandwidth stay, and all requests of
/// HTTP/2 share a line that may be narrow.
const MOST_SETTLING: u32 = 6000;
/// Frames after a clear: those that are drawn in any case, and those that the smallest budget needs for the upload that
/// was under way.
const LEAST_CLEARING: u32 = 4;
const MOST_CLEARING: u32 = 100;
/// The time of a frame while it settles: what requests wait for is given in time, not in frames.
pub const SETTLING_FRAME: Duration = Duration::from_millis(5);
/// A pager with budgets that are too small is at rest once nothing has changed for so many frames.
const AT_REST: u32 = 60;
/// A white texel.
const WHITE_BYTES: u64 = 4;
/// The end of a viewer, its threads and requests included.
const MOST_CLOSING: Duration = Duration::from_secs(10);

/// What a flight came to.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct Outcome {
    pub failures: Vec<String>,
    pub frames: u32,
    /// Frames from the end of the faults to rest.
    pub settling: u32,
    pub pictures: u64,
    /// Sums over the scenes.
    pub requested: u64,
    pub merged: u64,
    pub failed: u64,
    pub cancelled: u64,
    pub expired: u64,
    pub adapter: String,
    /// The last picture was compared with that of a new viewer.
    pub compared: bool,
}

/// Flies a seed over a set.
pub fn fly(plan: &Plan, source: &str) -> Result<Outcome> {
    let mut flight = Flight::new(plan, source)?;
    flight.all()
}

/// A folder for the cache, images and certificates of a seed; goes with it.
struct Scratch(PathBuf);

impl Scratch {
    fn new(seed: u64) -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("terrane-stress-{}-{seed}", std::process::id()));
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(Self(folder))
    }

    /// Where images of sequences are.
    fn images(&self) -> Result<PathBuf> {
        let folder = self.0.join("images");
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(folder)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

pub(super) struct Flight<'a> {
    pub(super) plan: &'a Plan,
    // Dropped in this order: the server outlives its clients.
    pub(super) viewer: Option<CompositeViewer>,
    sign: Option<Sign>,
    server: Option<Background>,
    /// Of the sign's images, until there is one.
    image_server: Option<Background>,
    /// The set is on a server of somebody else: what does not come from there is no fault of ours.
    is_elsewhere: bool,
    /// The set, where no server of ours is in between.
    files: &'a str,
    /// The set, as the viewer loads it.
    source: String,
    scratch: Scratch,
    pager: PagerConfig,
    config: ViewerConfig,
    pub(super) scenes: Vec<SceneId>,
    /// The scenes of each pager.
    pub(super) pagers: Vec<Vec<SceneId>>,
    /// The first stays in the first context, all of it.
    pub(super) views: Vec<(ViewId, ContextId)>,
    pub(super) slaves: Vec<(ViewId, SlaveId, ContextId)>,
    pub(super) contexts: Vec<ContextId>,
    pub(super) bounds: SetBounds,
    pub(super) proxies: Option<Proxies>,
    pictures: Pictures,
    pub(super) failures: Failures,
    /// The plan's frames so far; the viewer's own count begins at one.
    pub(super) frame: u32,
    outcome: Outcome,
}

/// A server of the plan for a folder. Where its connections are encrypted, its certificate becomes that file.
fn serve(plan: &Plan, folder: &Path, certificate: &Path) -> Result<Background> {
    let Plan { faults, wire, .. } = plan;
    Background::start(ServeArgs {
        http1: *wire == Wire::Tls1,
        http2: *wire == Wire::Http2,
        tls: plan.wire.is_encrypted().then(|| certificate.to_owned()),
        latency_ms: faults.latency_ms,
        jitter_ms: faults.jitter_ms,
        bandwidth: faults.bandwidth,
        error_rate: faults.error,
        truncate_rate: faults.truncate,
        corrupt_rate: faults.corrupt,
        stall_rate: faults.stall,
        reset_rate: faults.reset,
        silent_rate: faults.silent,
        page_rate: faults.page,
        seed: plan.seed,
        ..ServeArgs::new(folder)
    })
}

/// A synthetic clock: what is animated is the same in each run.
pub(super) fn time_s(frame: u32) -> f64 {
    f64::from(frame) / 60.0
}

/// Where a camera over a set is.
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

/// A local source as the folder to serve and the path in it.
fn served(source: &str) -> Result<(PathBuf, String)> {
    let path = std::path::absolute(source)?;
    if path.is_dir() {
        return Ok((path, String::new()));
    }
    let name = path.file_name().and_then(|n| n.to_str()).with_context(|| source.to_owned())?.to_owned();
    let folder = path.parent().with_context(|| source.to_owned())?.to_owned();
    Ok((folder, name))
}

impl<'a> Flight<'a> {
    fn new(plan: &'a Plan, files: &'a str) -> Result<Self> {
        watch::step(format_args!("start"));
        let scratch = Scratch::new(plan.seed)?;
        let mut pager = plan.pager.clone();
        if plan.has_cache && plan.way == Way::Http {
            pager.http.cache = Some(CacheConfig::new(scratch.0.join("cache")));
        }
        let is_elsewhere = is_remote(files);
        let (mut server, mut image_server, mut source) = (None, None, files.to_owned());
        if plan.way == Way::Http && !is_elsewhere {
            pager.http.http2_only = plan.wire == Wire::Http2;
            let mut start = |folder: &Path, certificate: &str| {
                let certificate = scratch.0.join(certificate);
                let server = serve(plan, folder, &certificate)?;
                pager.http.root_certificates.extend(plan.wire.is_encrypted().then_some(certificate));
                anyhow::Ok(server)
            };
            let (folder, name) = served(files)?;
            let started = start(&folder, "set.pem")?;
            source = format!("{}{name}", started.url());
            server = Some(started);
            if plan.slides.is_some() {
                image_server = Some(start(&scratch.images()?, "images.pem")?);
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
            max_contexts: MOST_CONTEXTS,
            ..ViewerConfig::default()
        };
        let mut flight = Self {
            plan,
            viewer: None,
            sign: None,
            proxies: None,
            server,
            image_server,
            is_elsewhere,
            files,
            source,
            scratch,
            pager,
            config,
            scenes: Vec::new(),
            pagers: Vec::new(),
            views: Vec::new(),
            slaves: Vec::new(),
            contexts: Vec::new(),
            bounds: SetBounds::from_sphere(terrane::math::BoundingSphere::new(DVec3::ZERO, 1.0)),
            pictures: Pictures { asked: VecDeque::new(), holes: None, seen: 0, hole_px: 0 },
            failures: Failures::default(),
            frame: 0,
            outcome: Outcome::default(),
        };
        flight.open()?;
        Ok(flight)
    }

    /// A context of the seed's adapter, or of none where there is no adapter.
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

    fn open(&mut self) -> Result<()> {
        let first = self.context()?;
        self.outcome.adapter = first.adapter_name();
        let mut viewer = CompositeViewer::new(&self.config)?;
        self.contexts.push(viewer.open_context(first)?);
        // The root must come; what is below it may not.
        self.set_faulty(false);
        for _ in 0..self.plan.scenes {
            self.add_scene(&mut viewer)?;
        }
        self.set_faulty(true);
        self.bounds = *viewer.bounds(self.scenes[0])?.context("the set has no bounds")?;
        if self.plan.has_proxies {
            self.proxies = Proxies::hang(&mut viewer, self.scenes[0], &self.bounds)?;
        }
        if let Some(slides) = &self.plan.slides {
            self.sign = Some(self.sign(slides, &mut viewer)?);
        }
        self.viewer = Some(viewer);
        self.add_view(0, 0, false)?;
        if self.plan.drawing == Drawing::Holes && self.config.adapter != AdapterChoice::Noop {
            self.pictures.holes = HoleCheck::new(&self.bounds);
        }
        Ok(())
    }

    /// Another scene of the same set. Its root must come: faults have to be off.
    pub(super) fn add_scene(&mut self, viewer: &mut CompositeViewer) -> Result<()> {
        let shared = self.pagers.first_mut().filter(|_| self.plan.share_pager);
        let scene = match &shared {
            Some(scenes) => viewer.add_scene_with_pager_of(scenes[0])?,
            None => viewer.add_scene()?,
        };
        viewer.load(scene, &self.source)?;
        match shared {
            Some(scenes) => scenes.push(scene),
            None => self.pagers.push(vec![scene]),
        }
        self.scenes.push(scene);
        Ok(())
    }

    /// A sign, whose images come as the set does: from the disk, or from a server with the same faults.
    fn sign(&mut self, slides: &Slides, viewer: &mut CompositeViewer) -> Result<Sign> {
        let folder = self.scratch.images()?;
        let names = extras::write_images(slides, &folder)?;
        let server = self.image_server.take();
        let uri = |name: &String| match &server {
            Some(server) => format!("{}{name}", server.url()),
            None => folder.join(name).display().to_string(),
        };
        let uris = names.iter().map(uri).collect();
        Sign::hang(viewer, self.scenes[0], &self.bounds, slides, uris, server)
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

    fn all(&mut self) -> Result<Outcome> {
        for frame in 0..self.plan.frames {
            self.frame = frame;
            let plan = self.plan;
            for (_, event) in plan.events.iter().filter(|(of, _)| *of == frame) {
                watch::step(format_args!("frame {frame}, before it {event:?}"));
                self.happen(*event).with_context(|| format!("frame {frame}, {event:?}"))?;
            }
            for (place, (view, _)) in self.views.clone().into_iter().enumerate() {
                let pose = plan.poses[place % plan.poses.len()][frame as usize];
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

    fn one_frame(&mut self) -> Result<()> {
        let number = self.frame;
        watch::step(format_args!("frame {number}"));
        let wants_picture = self.is_drawn() && number.is_multiple_of(self.plan.picture_every) && self.views.len() == 1;
        let (first_view, first_context) = self.views[0];
        let slaves_there = self.slaves.iter().any(|(_, _, context)| *context == first_context);
        let wants_picture = wants_picture && !slaves_there;
        let viewer = self.viewer()?;
        if wants_picture {
            viewer.want_picture(first_context);
        }
        viewer.frame_at(time_s(number))?;
        let (frame, camera) = (viewer.frame_stamp().frame, viewer.view_mut(first_view)?.camera);
        let pictures = viewer.take_pictures(first_context);
        // As cull has seen it: nothing is merged or expired between cull and here.
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        if wants_picture {
            let has_ground = check::has_ground(viewer.scene(self.scenes[0])?);
            let must_show = has_ground && check::sees_ground(&self.bounds, &camera);
            self.pictures.asked.push_back(Asked { frame, camera, has_ground, must_show });
        }
        for (frame, picture) in pictures {
            self.pictures.look(&mut self.failures, frame, &picture);
        }
        check::ground(&mut self.failures, number, viewer, &self.bounds)?;
        self.outcome.frames += 1;
        Ok(())
    }

    /// Everything that holds in each frame.
    fn check(&mut self) -> Result<()> {
        let number = self.frame;
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        for (place, scenes) in self.pagers.iter().enumerate() {
            let Some(pager) = viewer.pager(scenes[0])? else { continue };
            check::pager(&mut self.failures, number, place, pager, &self.pager);
            let resident = pager.stats().resident;
            let mut there = 0;
            for scene in scenes {
                there += check::pages_in(viewer.scene(*scene)?);
            }
            let says = || format!("pager {place}: {there} hang in its scenes, {resident} are counted");
            self.failures.check(there == resident, "pages that are not counted", number, says);
            let is_on_disk = self.server.is_none() && !self.is_elsewhere;
            let lost = is_on_disk && pager.stats().failed > 0 && !self.pager_is_too_small();
            let says = || format!("{:?}", pager.errors());
            self.failures.check(!lost, "a good file that failed", number, says);
        }
        if let Some(proxies) = &self.proxies {
            proxies.check(&mut self.failures, number, viewer)?;
        }
        if let Some(sign) = &self.sign {
            sign.check(&mut self.failures, number, viewer)?;
        }
        let errors = viewer.draw_errors();
        self.failures.check(errors.is_empty(), "an error of the device", number, || format!("{errors:?}"));
        let said = watch::take_said();
        self.failures.check(said.is_empty(), "an error in the log", number, || format!("{said:?}"));
        Ok(())
    }

    /// A single page may be beyond a tiny budget, which is its failure.
    fn pager_is_too_small(&self) -> bool {
        self.plan.is_tiny
    }

    /// Pages that hang in each scene.
    pub(super) fn pages_in_each(&self) -> Result<Vec<u64>> {
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        self.scenes.iter().map(|scene| Ok(check::pages_in(viewer.scene(*scene)?))).collect()
    }

    /// Faults cease and cameras stay: everything comes to rest.
    fn settle(&mut self) -> Result<()> {
        self.set_faulty(false);
        for scene in self.scenes.clone() {
            if let Some(pager) = self.viewer()?.pager_mut(scene)? {
                pager.set_paused(false);
                pager.set_takes_requests(true);
            }
        }
        for (place, (view, _)) in self.views.clone().into_iter().enumerate() {
            let pose = self.plan.last_poses[place % self.plan.last_poses.len()];
            self.place_camera(view, &pose)?;
            self.viewer()?.view_mut(view)?.announced = None;
        }
        let (mut quiet, mut last) = (0, Vec::new());
        for settling in 0..MOST_SETTLING {
            self.frame = self.plan.frames + settling;
            self.outcome.settling = settling + 1;
            self.one_frame()?;
            let until = Instant::now() + SETTLING_FRAME;
            self.viewer()?.work_until(until);
            self.check()?;
            let viewer = self.viewer.as_ref().context("the viewer is gone")?;
            let stats: Vec<_> = self.pagers.iter().filter_map(|s| Some(*viewer.pager(s[0]).ok()??.stats())).collect();
            let now: Vec<_> = stats.iter().map(check::progress).collect();
            let in_flight: u64 = stats.iter().map(|s| s.in_flight).sum();
            quiet = if now == last && in_flight == 0 { quiet + 1 } else { 0 };
            last = now;
            let sign_shows = self.sign.as_ref().map_or(Ok(true), |sign| sign.has_shown(viewer))?;
            if (viewer.is_settled() && quiet > 4 && sign_shows) || (self.plan.is_tiny && quiet >= AT_REST) {
                if let Some(proxies) = self.proxies.as_ref().filter(|_| !self.plan.is_tiny) {
                    proxies.check_at_rest(&mut self.failures, self.frame, viewer)?;
                }
                return Ok(());
            }
        }
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        let missing = viewer.stats().last().map_or(0, |s| s.wanted_missing);
        let stats: Vec<_> = self.pagers.iter().filter_map(|s| Some(*viewer.pager(s[0]).ok()??.stats())).collect();
        self.failures.add("does not come to rest", self.frame, || format!("{missing} missing, {stats:?}"));
        Ok(())
    }

    /// Where nothing was lost the first view shows what it would if the flight had not been.
    fn compare(&mut self) -> Result<()> {
        watch::step(format_args!("compare"));
        let viewer = self.viewer.as_ref().context("the viewer is gone")?;
        let mut pagers = self.scenes.iter().filter_map(|scene| viewer.pager(*scene).ok()?);
        let is_whole = viewer.is_settled() && pagers.all(|p| p.stats().failed + p.stats().drawables_failed == 0);
        let may_be_bent = self.server.is_some() && self.plan.faults.corrupt > 0.0;
        if !(is_whole && self.is_drawn()) || self.plan.is_tiny || self.is_elsewhere || may_be_bent {
            return Ok(());
        }
        for (view, slave, _) in std::mem::take(&mut self.slaves) {
            self.viewer()?.remove_slave(view, slave)?;
        }
        for (view, _) in self.views.split_off(1) {
            self.viewer()?.remove_view(view)?;
        }
        let first = self.views[0].0;
        self.viewer()?.view_mut(first)?.camera.settings.cull_mask &= !extras::MASK;
        self.settle()?;
        for _ in 0..fresh::LAST_FRAMES {
            self.frame += 1;
            self.one_frame()?;
        }
        let (first_view, first_context) = self.views[0];
        let viewer = self.viewer()?;
        viewer.finish()?;
        let flown = viewer.read_back(first_context)?;
        let view = viewer.view_mut(first_view)?;
        let (camera, environment) = (view.camera, view.environment);
        let fresh = fresh::picture(&self.config, self.files, flown.dimensions().into(), &camera, &environment)?;
        self.outcome.compared = true;
        if let Some(difference) = fresh::difference(&flown, &fresh) {
            let folder = std::env::temp_dir();
            let names = ["flown", "fresh"].map(|name| folder.join(format!("terrane-{}-{name}.png", self.plan.seed)));
            flown.save(&names[0])?;
            fresh.save(&names[1])?;
            let says = || format!("{difference}; {} and {}", names[0].display(), names[1].display());
            self.failures.add("not what a new viewer shows", self.frame, says);
        }
        Ok(())
    }

    /// Counts what a pager did that ends.
    pub(super) fn sum_up(&mut self, stats: &PagerStats) {
        self.outcome.requested += stats.requested;
        self.outcome.merged += stats.merged;
        self.outcome.failed += stats.failed;
        self.outcome.cancelled += stats.cancelled;
        self.outcome.expired += stats.expired;
    }

    /// Nothing is left of what was loaded.
    fn clear(&mut self) -> Result<()> {
        watch::step(format_args!("clear"));
        if let (Some(sign), Some(viewer)) = (self.sign.take(), &mut self.viewer) {
            sign.take_down(viewer)?;
        }
        for (place, scenes) in self.pagers.clone().into_iter().enumerate() {
            let viewer = self.viewer()?;
            let Some(pager) = viewer.pager_mut(scenes[0])? else { continue };
            pager.set_takes_requests(false);
            let before = *pager.stats();
            self.sum_up(&before);
            let mut there = 0;
            for scene in &scenes {
                let viewer = self.viewer()?;
                viewer.clear_pages(*scene)?;
                there += check::pages_in(viewer.scene(*scene)?);
            }
            let Some(s) = self.viewer()?.pager(scenes[0])?.map(|pager| *pager.stats()) else { continue };
            let left = [there, s.resident, s.cpu_bytes_held, s.gpu_bytes_held, s.waiting, s.in_flight];
            let says = || format!("pager {place}: {s:?}");
            self.failures.check(left == [0; 6], "something is left after a clear", self.frame, says);
        }
        // The texel of drawables without a texture, such as the sign's, stays in each device.
        let of_each = if self.plan.slides.is_some() { WHITE_BYTES } else { 0 };
        let empty = of_each * self.contexts.len() as u64;
        let mut bytes = 0;
        for frames in 1..=MOST_CLEARING {
            self.frame += 1;
            self.one_frame()?;
            let until = Instant::now() + SETTLING_FRAME;
            self.viewer()?.work_until(until);
            self.check()?;
            self.viewer()?.finish()?;
            bytes = self.viewer()?.stats().last().map_or(0, |s| s.gpu_bytes);
            if frames >= LEAST_CLEARING && bytes <= empty {
                break;
            }
        }
        let says = || format!("{bytes} bytes, {empty} of what is never freed");
        self.failures.check(bytes <= empty, "GPU memory is left after a clear", self.frame, says);
        Ok(())
    }

    /// The viewer ends in time, whatever its server does.
    fn close(&mut self) -> Result<()> {
        watch::step(format_args!("close"));
        // Its last pictures.
        let first = self.views[0].1;
        for (frame, picture) in self.viewer()?.take_pictures(first) {
            self.pictures.look(&mut self.failures, frame, &picture);
        }
        self.set_faulty(true);
        let start = Instant::now();
        self.viewer = None;
        let took = start.elapsed();
        self.failures.check(took < MOST_CLOSING, "the viewer is slow to end", self.frame, || format!("{took:?}"));
        let said = watch::take_said();
        self.failures.check(said.is_empty(), "an error in the log", self.frame, || format!("{said:?}"));
        self.outcome.pictures = self.pictures.seen;
        self.outcome.failures = std::mem::take(&mut self.failures).into_list();
        Ok(())
    }
}
