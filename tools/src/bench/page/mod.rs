//! Measures paging on the terrain of the `osg_page` peer: 5461 tiles in seven levels, with a flight on the same path.
//!
//! Prints one JSON object per phase with the peer's field names. A file is one tile here and four in the peer. The times
//! of frames exclude the uploads and merges between frames (`between`); the peer's include its merges. If that work takes
//! too long, the next frame is `late`. With `--osgb` the peer's own files are paged.

mod tiles;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use clap::ValueEnum as _;
use glam::{DAffine3, DVec3};
use serde_json::{Value, json};
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::fetch::Limits;
use terrane::formats::{Content, ReadOptions, decode};
use terrane::gpu::{AdapterChoice, CompileBudget, ContextTraits, GraphicsContext};
use terrane::pager::{
    CompileContext, DatabasePager, EyeMotion, MotionLooks, PagerConfig, PagerStats, PathLooks, frames_until,
};
use terrane::scene::{Node, Page, Scene};

use super::measurement::{UploadContext, percentile, print_line};
use crate::args::PageContent;
use crate::net::NetArgs;
use tiles::{ROOT, WORLD_M, height_m};

/// The options of `terrane bench page`.
#[derive(Clone, Debug)]
pub struct Options {
    /// The number of frames of the flight.
    pub frames: u32,
    /// Frames per second; 0 for no limit.
    pub pace_hz: f64,
    /// True to draw each frame.
    pub draw: bool,
    /// Maximum number of resident tiles.
    pub tiles: usize,
    /// The content of the tiles.
    pub content: PageContent,
    /// The folder of the peer's own files, which are paged instead.
    pub osgb: Option<PathBuf>,
    /// The number of copies of the terrain along each side, all from the same files.
    pub world: u32,
    /// The speed of a straight flight, in metres per second, instead of the peer's path.
    pub speed_m_s: Option<f64>,
    /// The time to prefetch for, in seconds.
    pub look_ahead_s: f64,
    /// See [`terrane::scene::CullSettings::skip_sse_factor`].
    pub skip_sse_factor: f64,
    /// True if the path is not announced, but extrapolated from the motion of the eye.
    pub by_motion: bool,
    /// The URL that serves the folder of the tiles; `None` reads files.
    pub url: Option<String>,
    /// The network options for that server.
    pub net: NetArgs,
}

/// The maximum duration of a phase that waits until everything is loaded.
const TIMEOUT: Duration = Duration::from_secs(60);

/// The number of frames of the phase `rest` after the flight.
const REST_FRAMES: u32 = 600;

/// Returns the position of the eye on the peer's path, and its horizontal direction. `u` is 0..1 over the path.
fn on_path(u: f64) -> (DVec3, DVec3) {
    use std::f64::consts::{PI, TAU};
    let (x, y) = (8192.0 + 49152.0 * u, 32768.0 + 20000.0 * (TAU * u).sin());
    let eye = DVec3::new(x, y, height_m(x, y) + 1200.0 + 400.0 * (3.0 * TAU * u).sin());
    (eye, DVec3::new(49152.0, 40000.0 * PI * (TAU * u).cos(), 0.0).normalize())
}

/// Returns the position and direction after `metres` on a straight line from the middle of the first terrain.
fn on_line(metres: f64) -> (DVec3, DVec3) {
    // The direction is not a diagonal of tiles.
    let ahead = DVec3::new(0.8, 0.6, 0.0);
    let position = DVec3::new(0.5, 0.5, 0.0) * WORLD_M + ahead * metres;
    let ground = height_m(position.x.rem_euclid(WORLD_M), position.y.rem_euclid(WORLD_M));
    (position.with_z(ground + 1200.0), ahead)
}

fn camera((eye, ahead): (DVec3, DVec3), frame: u32) -> CullCamera {
    let (sin, cos) = 20f64.to_radians().sin_cos();
    let view =
        glam::dcamera::rh::view::look_at_mat4(eye, eye + DVec3::new(ahead.x * cos, ahead.y * cos, -sin), DVec3::Z);
    CullCamera { eye_from_world: DAffine3::from_mat4(view), viewport_px: [64, 64], frame, ..CullCamera::default() }
}

/// Returns a value of `/proc/self/status` in MB, 0 if the system does not have it.
fn status_mb(name: &str) -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|l| l.strip_prefix(name));
    let kb = line.and_then(|l| l.trim_start_matches(':').trim().trim_end_matches("kB").trim().parse::<f64>().ok());
    kb.unwrap_or(0.0) / 1024.0
}

/// Returns the processor time of this process in seconds, 0 if the system does not report it.
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = text.rsplit_once(')').map_or(Vec::new(), |(_, rest)| rest.split_whitespace().collect());
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

/// The state of all phases.
struct Bench {
    options: Options,
    scene: Scene,
    pager: DatabasePager,
    context: UploadContext,
    /// The start of the reference time.
    started: Instant,
    renderer: Option<terrane::draw::Renderer>,
    visitor: CullVisitor,
    stage: RenderStage,
    looks: PathLooks,
    motion: EyeMotion,
    guesses: MotionLooks,
    /// The result of prefetch culls, whose requests go to the pager.
    ahead: RenderStage,
    frame: u32,
    rss_start_mb: f64,
}

/// The times of one phase in seconds.
#[derive(Default)]
struct Times {
    work: Vec<f64>,
    update: Vec<f64>,
    cull: Vec<f64>,
    compile: Vec<f64>,
    missing: Vec<f64>,
    /// The time between two frames for uploads and merges, including waiting for them.
    between: Vec<f64>,
    /// The delay of the next frame.
    late: Vec<f64>,
    /// The time since when a visible tile is missing, and the bytes that had been read by then.
    missing_since: Option<(Instant, u64)>,
    /// The longest such duration, and the bytes that were read in it.
    longest_gap: (Duration, u64),
}

impl Times {
    /// Records whether a visible tile is missing in this frame.
    fn gap(&mut self, is_missing: bool, bytes_read: u64) {
        let Some((since, bytes_before)) = self.missing_since else {
            self.missing_since = is_missing.then(|| (Instant::now(), bytes_read));
            return;
        };
        self.longest_gap = self.longest_gap.max((since.elapsed(), bytes_read - bytes_before));
        if !is_missing {
            self.missing_since = None;
        }
    }
}

/// Runs the phases and prints a line for each.
pub fn run(options: Options) -> Result<()> {
    ensure!(options.pace_hz.is_finite() && options.pace_hz >= 0.0, "--pace must be zero or above");
    ensure!(options.frames >= 2, "--frames must be at least 2");
    ensure!(options.look_ahead_s.is_finite() && options.look_ahead_s >= 0.0, "--look-ahead must be zero or above");
    ensure!(options.world >= 1, "--world must be at least 1");
    let (read, root) = match &options.osgb {
        Some(folder) => osgb_terrain(folder)?,
        None => terrain(&options)?,
    };
    let mut scene = Scene::new();
    scene.add_root(root);
    let traits = |adapter| ContextTraits { size_px: [64, 64], adapter, ..ContextTraits::default() };
    let mut graphics = GraphicsContext::new_offscreen(&traits(AdapterChoice::Software))
        .or_else(|_| GraphicsContext::new_offscreen(&traits(AdapterChoice::Noop)))?;
    let http = options.net.http(options.url.as_deref().unwrap_or_default())?;
    let config = PagerConfig { max_tiles: options.tiles, http, ..PagerConfig::default() };
    let pager = DatabasePager::new(config, read)?;
    let renderer = options.draw.then(|| terrane::draw::Renderer::new(&mut graphics));
    let mut bench = Bench {
        options,
        scene,
        pager,
        context: UploadContext(graphics),
        started: Instant::now(),
        renderer,
        visitor: CullVisitor::new(),
        stage: RenderStage::new(),
        looks: PathLooks::default(),
        motion: EyeMotion::default(),
        guesses: MotionLooks::default(),
        ahead: RenderStage::new(),
        frame: 0,
        rss_start_mb: status_mb("VmRSS"),
    };
    for phase in ["converge_start", "fly", "converge_end", "rest"] {
        let line = bench.phase(phase)?;
        if bench.pager.stats().loaded == 0 {
            let first = bench.pager.errors().into_iter().next();
            bail!(
                "no tile was loaded; {}",
                first.map_or("no request failed".to_owned(), |e| format!("{}: {}", e.uri, e.reason))
            );
        }
        print_line(line);
    }
    Ok(())
}

/// Returns the terrain as a tile tree that names one file for each tile, and how to read these.
fn terrain(options: &Options) -> Result<(ReadOptions, Page)> {
    let folder = tiles::tiles()?;
    let base = match &options.url {
        Some(url) => {
            eprintln!("the tiles are in {}", folder.display());
            format!("{}/", url.trim_end_matches('/'))
        }
        None => format!("{}/", folder.to_str().context("the cache folder's path is not UTF-8")?),
    };
    let terrain = ROOT.node(&base, options.content);
    let beside = |n: u32| DVec3::new(f64::from(n % options.world), f64::from(n / options.world), 0.0) * WORLD_M;
    let terrains = (0..options.world * options.world)
        .map(|n| Node::transform(DAffine3::from_translation(beside(n)), vec![terrain.clone()]));
    let root = Page::from_node(if options.world == 1 { terrain } else { Node::group(terrains.collect()) })?;
    Ok((ReadOptions::for_root(&format!("{base}{}", ROOT.file("glb")), Limits::default()), root))
}

/// Returns the root of the peer's own files, which name those below them, and how to read these.
fn osgb_terrain(folder: &Path) -> Result<(ReadOptions, Page)> {
    let file = folder.join("root.osgb");
    let uri = file.to_str().with_context(|| format!("the path {} is not UTF-8", file.display()))?;
    let read = ReadOptions::for_root(uri, Limits::default());
    // All files are read once, so that the system has them in its cache: the peer is measured warm as well.
    let unread = || format!("cannot read {}; the peer's `osg_page build` writes it", folder.display());
    for entry in std::fs::read_dir(folder).with_context(unread)? {
        std::io::copy(&mut std::fs::File::open(entry?.path())?, &mut std::io::sink())?;
    }
    let bytes = std::fs::read(&file).with_context(unread)?;
    let root = decode(Content { uri: uri.into(), bytes, reader_data: None, companions: Vec::new() }, &read)?;
    Ok((read, root))
}

impl Bench {
    /// Uploads and merges until the next frame. Requests what new tiles name at once, as a viewer does.
    fn work_until(&mut self, next: Instant, frame: f64) {
        let camera = self.camera(self.pose(frame), self.frame);
        loop {
            let contexts: &mut [&mut dyn CompileContext] = &mut [&mut self.context];
            self.pager.work_until_new_tiles(&mut self.scene, contexts, next);
            if !self.pager.has_new_tiles() || Instant::now() >= next {
                return;
            }
            self.visitor.traverse(&self.scene, &camera, &mut self.ahead);
            self.pager.request_now(&self.scene, &self.ahead.requests);
        }
    }

    fn phase(&mut self, name: &str) -> Result<Value> {
        let fly = name == "fly";
        // The other phases end when no tile is missing.
        let frames = match name {
            "fly" => Some(self.options.frames),
            // Frames in which nothing changes show the noise of the machine.
            "rest" => Some(self.options.frames.min(REST_FRAMES)),
            _ => None,
        };
        let before = *self.pager.stats();
        self.pager.reset_latency_max();
        let (cpu, start) = (cpu_s(), Instant::now());
        let mut times = Times::default();
        let (mut next, mut last_busy, mut quiet, mut converged) = (start, start, 0, false);
        let mut merged = before.merged;
        let mut tiles_peak = 0;
        let period = Duration::from_secs_f64(if self.options.pace_hz > 0.0 { 1.0 / self.options.pace_hz } else { 0.0 });
        let mut i = 0;
        while frames.is_none_or(|frames| i < frames) {
            let last = self.options.frames - 1;
            let frame = match name {
                "fly" => i,
                "converge_end" | "rest" => last,
                _ => 0,
            };
            i += 1;
            self.one_frame(f64::from(frame), fly, &mut times)?;
            times.gap(self.stage.counters.wanted_missing > 0, self.pager.stats().bytes_read);
            let stats = self.pager.stats();
            tiles_peak = tiles_peak.max(stats.resident);
            if frames.is_none() {
                // A page that was merged between frames counts until the end of the frame that shows it.
                let merged_now = stats.merged;
                if std::mem::replace(&mut merged, merged_now) != merged_now
                    || !self.stage.requests.is_empty()
                    || !self.pager.is_idle()
                {
                    (last_busy, quiet) = (Instant::now(), 0);
                } else {
                    quiet += 1;
                    if quiet >= 15 {
                        converged = true;
                        break;
                    }
                }
                if start.elapsed() > TIMEOUT {
                    break;
                }
            }
            let now = Instant::now();
            next = (next + period).max(now.checked_sub(period).unwrap_or(now));
            self.work_until(next, f64::from(frame));
            let worked = Instant::now();
            times.between.push((worked - now).as_secs_f64());
            std::thread::sleep(next.saturating_duration_since(worked));
            times.late.push(Instant::now().saturating_duration_since(next).as_secs_f64());
        }
        let time_s = if frames.is_some() { start.elapsed() } else { last_busy - start }.as_secs_f64();
        let converged = frames.is_none().then_some(converged);
        Ok(self.line(name, &before, time_s, converged, cpu_s() - cpu, tiles_peak, times))
    }

    /// Returns the duration of a frame on the path in seconds.
    fn frame_s(&self) -> f64 {
        1.0 / if self.options.pace_hz > 0.0 { self.options.pace_hz } else { 60.0 }
    }

    fn camera(&self, pose: (DVec3, DVec3), frame: u32) -> CullCamera {
        let mut camera = camera(pose, frame);
        camera.settings.skip_sse_factor = self.options.skip_sse_factor;
        camera
    }

    /// Returns the position and direction of the eye in a frame of the flight; `frame` may lie between two.
    fn pose(&self, frame: f64) -> (DVec3, DVec3) {
        match self.options.speed_m_s {
            Some(speed) => on_line(speed * frame * self.frame_s()),
            None => on_path((frame / f64::from(self.options.frames - 1)).min(1.0)),
        }
    }

    /// Requests the tiles that the flight will want, as a viewer does with an announced path.
    fn look_ahead(&mut self, frame: f64) {
        if self.options.by_motion {
            return self.look_by_motion(frame);
        }
        let frame_s = self.frame_s();
        self.looks.start_frame(frame * frame_s);
        while let Some(at_s) = self.looks.next(self.options.look_ahead_s, frame_s) {
            let frames = frames_until(at_s - frame * frame_s, frame_s);
            let camera = CullCamera { ahead_frames: frames, ..self.camera(self.pose(at_s / frame_s), self.frame) };
            self.visitor.traverse(&self.scene, &camera, &mut self.ahead);
            self.looks.found(&self.ahead.requests);
        }
        self.stage.requests.extend(self.looks.requests(frame_s));
    }

    /// Requests the tiles that the flight will want, as a viewer does without an announced path.
    fn look_by_motion(&mut self, frame: f64) {
        let now_s = frame * self.frame_s();
        let here = self.camera(self.pose(frame), 0).eye_from_world.inverse();
        self.motion.observe(now_s, &here);
        self.guesses.start_frame(now_s, &here, &self.motion);
        while let Some((then, frames)) = self.guesses.next(self.options.look_ahead_s, &self.motion) {
            let camera = CullCamera {
                eye_from_world: then.inverse(),
                ahead_frames: frames,
                ..self.camera(self.pose(frame), self.frame)
            };
            self.visitor.traverse(&self.scene, &camera, &mut self.ahead);
            self.guesses.found(&self.ahead.requests, &self.motion);
        }
        self.stage.requests.extend(self.guesses.requests(&self.motion));
    }

    /// Runs update, cull, upload and, if the options ask for it, draw.
    fn one_frame(&mut self, frame: f64, is_flying: bool, times: &mut Times) -> Result<()> {
        self.frame += 1;
        let t0 = Instant::now();
        if is_flying {
            self.look_ahead(frame);
        }
        let time_s = self.started.elapsed().as_secs_f64();
        let contexts: &mut [&mut dyn CompileContext] = &mut [&mut self.context];
        self.pager.update_scene_graph(&mut self.scene, self.frame, time_s, &self.stage.requests, contexts);
        let t1 = Instant::now();
        self.visitor.cull(&self.scene, &self.camera(self.pose(frame), self.frame), &mut self.stage);
        self.pager.request(&self.scene, &self.stage.requests);
        let t2 = Instant::now();
        self.context.0.run_compiles(&CompileBudget::default());
        let t3 = Instant::now();
        if let Some(renderer) = &mut self.renderer {
            renderer.draw(&mut self.context.0, &self.stage, &terrane::scene::Environment::default())?;
        }
        let t4 = Instant::now();
        times.update.push((t1 - t0).as_secs_f64());
        times.cull.push((t2 - t1).as_secs_f64());
        times.compile.push((t3 - t2).as_secs_f64());
        times.work.push((t4 - t0).as_secs_f64());
        times.missing.push(f64::from(self.stage.counters.wanted_missing));
        Ok(())
    }

    #[allow(clippy::too_many_arguments, reason = "the values of one line")]
    fn line(
        &self,
        phase: &str,
        before: &PagerStats,
        time_s: f64,
        converged: Option<bool>,
        cpu_s: f64,
        tiles_peak: u64,
        mut times: Times,
    ) -> Value {
        let now = self.pager.stats();
        let merged = now.merged - before.merged;
        let (frames, missing_sum) = (times.work.len(), times.missing.iter().sum::<f64>());
        let round = |v: f64| (v * 1e3).round() / 1e3;
        let ms = |v: &mut Vec<f64>, p: f64| round(percentile(v, p) * 1e3);
        // Hitches are frames over twice the median that would not be so without paging. `percentile` sorts the times, so they
        // are counted first.
        let mut sorted = times.work.clone();
        let median = percentile(&mut sorted, 0.5);
        let hitches = (times.work.iter().zip(&times.update).zip(&times.compile))
            .filter(|((work, update), compile)| **work > 2.0 * median && **work - *update - *compile <= 2.0 * median)
            .count();
        let over = times.work.iter().filter(|w| self.options.pace_hz > 0.0 && **w > 1.0 / self.options.pace_hz).count();
        let latency_ms = (now.latency_sum_s - before.latency_sum_s) * 1e3 / merged.max(1) as f64;
        let mut line = json!({
            "bench": "terrane_page", "phase": phase, "source": if self.options.url.is_some() { "http" } else { "file" },
            "pace": self.options.pace_hz,
            "maxtiles": self.options.tiles, "draw": u32::from(self.options.draw),
            "adapter": self.context.0.adapter_name(),
            "frames": frames, "converged": converged,
            "time_s": round(time_s),
            "frame_p50_ms": ms(&mut times.work, 0.5), "frame_p95_ms": ms(&mut times.work, 0.95),
            "frame_p99_ms": ms(&mut times.work, 0.99), "frame_max_ms": ms(&mut times.work, 1.0),
            "frames_over_budget": over,
            "pager_update_p50_us": round(percentile(&mut times.update, 0.5) * 1e6),
            "pager_update_max_ms": ms(&mut times.update, 1.0),
            "cull_p50_us": round(percentile(&mut times.cull, 0.5) * 1e6), "cull_max_ms": ms(&mut times.cull, 1.0),
            "compile_p50_us": round(percentile(&mut times.compile, 0.5) * 1e6),
            "compile_max_ms": ms(&mut times.compile, 1.0),
            "files_requested": now.requested - before.requested, "files_read": now.loaded - before.loaded,
            "files_merged": merged,
            "files_read_but_dropped": (now.loaded - before.loaded) as i64 - merged as i64,
            "files_deleted": now.expired - before.expired,
            "tiles_loaded": merged, "tiles_per_s": round(merged as f64 / time_s.max(1e-9)),
            "read_failures": now.failed,
            "missing_mean": round(missing_sum / frames.max(1) as f64),
            "missing_p95": round(percentile(&mut times.missing, 0.95)),
            "drawables": self.stage.counters.leaves, "tiles_peak": tiles_peak, "tiles_end": now.resident,
            "tile_latency_mean_ms": round(latency_ms), "tile_latency_max_ms": round(now.latency_max_s * 1e3),
            "gpu_mb": round(self.context.0.bytes_peak() as f64 / 1048576.0),
            "rss_start_mb": round(self.rss_start_mb), "rss_mb": round(status_mb("VmRSS")),
            "peak_rss_mb": round(status_mb("VmHWM")), "cpu_s": round(cpu_s),
        });
        let content = self.options.content.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned());
        line["label"] = if self.options.osgb.is_some() { "osgb".into() } else { content.into() };
        for (name, value) in [
            ("hitches_from_paging", (hitches as f64)),
            ("between_p50_ms", ms(&mut times.between, 0.5)),
            ("between_max_ms", ms(&mut times.between, 1.0)),
            ("late_p50_ms", ms(&mut times.late, 0.5)),
            ("late_p99_ms", ms(&mut times.late, 0.99)),
            ("late_max_ms", ms(&mut times.late, 1.0)),
            ("missing_longest_ms", round(times.longest_gap.0.as_secs_f64() * 1e3)),
            ("missing_longest_bytes", times.longest_gap.1 as f64),
            ("cpu_mb_peak", round(now.cpu_bytes_peak as f64 / 1048576.0)),
            ("tiles_of_set", f64::from(self.options.world * self.options.world) * tiles::COUNT),
        ] {
            line[name] = value.into();
        }
        line
    }
}
