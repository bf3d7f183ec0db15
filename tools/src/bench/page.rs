//! Paging cost on the terrain of the `osg_page` peer: 5461 tiles in seven levels, flown over on the same path.
//!
//! One JSON object per phase with the peer's field names. A file is one tile here (four in the peer).

use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use clap::ValueEnum as _;
use serde_json::{Value, json};
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::gpu::{AdapterChoice, CompileBudget, CompileOperation, Compiled, ContextTraits, GraphicsContext};
use terrane::io::write::{GlbMesh, write_glb, write_height_exr};
use terrane::io::{Limits, ReadOptions};
use terrane::math::{BoundingSphere, BoundingVolume, OrientedBox};
use terrane::pager::{CompileContext, DatabasePager, PagerConfig, PagerStats};
use terrane::scene::{DrawSlot, Node, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine, Scene};

use glam::{DAffine3, DMat3, DVec3};

use super::percentile;
use crate::args::PageContent;
use crate::net::NetArgs;

/// What is measured, from the command line.
#[derive(Clone, Debug)]
pub struct Options {
    /// Frames of the flight.
    pub frames: u32,
    /// Frames a second; 0 for as many as go.
    pub pace_hz: f64,
    /// Draw each frame too.
    pub draw: bool,
    /// Most tiles that are kept.
    pub tiles: usize,
    /// What the tiles hold.
    pub content: PageContent,
    /// Where the folder of the tiles is served; `None` reads the files.
    pub url: Option<String>,
    /// How that server is talked to.
    pub net: NetArgs,
}

/// Side of the terrain in metres, corner at the origin.
const WORLD_M: f64 = 65536.0;
/// Deepest level.
const LEVELS: u32 = 6;
/// Vertices and texels along a tile's side.
const SIDE: usize = 33;
const TEXELS: usize = 64;
/// A tile gives way to its children nearer than so many radii.
const RATIO: f64 = 7.0;
/// Changes when the tiles' form does: other folders are not read.
const VERSION: &str = "bench-page-2";
/// A phase that does not come to rest ends.
const TIMEOUT: Duration = Duration::from_secs(60);

fn height_m(x: f64, y: f64) -> f64 {
    800.0 * (x / 5000.0).sin() * (y / 7000.0).cos()
        + 200.0 * (x / 900.0 + 1.0).sin() * (y / 1100.0).sin()
        + 40.0 * (x / 170.0).sin() * (y / 130.0).cos()
}

/// A tile of the quadtree.
#[derive(Clone, Copy)]
struct Tile {
    level: u32,
    x: u32,
    y: u32,
}

impl Tile {
    fn side_m(self) -> f64 {
        WORLD_M / f64::from(1u32 << self.level)
    }

    fn corner(self) -> [f64; 2] {
        [f64::from(self.x) * self.side_m(), f64::from(self.y) * self.side_m()]
    }

    fn center(self) -> DVec3 {
        let [x, y] = self.corner().map(|c| c + 0.5 * self.side_m());
        DVec3::new(x, y, height_m(x, y))
    }

    fn file(self, extension: &str) -> String {
        format!("t_{}_{}_{}.{extension}", self.level, self.x, self.y)
    }

    /// The content's URI, and what its reader needs beside it.
    fn content(self, base: &str, content: PageContent) -> (Arc<str>, Option<Arc<str>>) {
        let uri = |extension| format!("{base}{}", self.file(extension));
        if content == PageContent::Mesh {
            return (uri("glb").into(), None);
        }
        let half = 0.5 * self.side_m();
        let data = json!({
            "plane": [-half, -half, half, half], "side": SIDE, "border": 1, "level": self.level, "errors_m": [1.0],
            "imagery": uri("png"),
        });
        (uri("exr").into(), Some(data.to_string().into()))
    }

    fn children(self) -> impl Iterator<Item = Self> {
        let inner = self.level < LEVELS;
        let child = move |i: u32| Self { level: self.level + 1, x: 2 * self.x + i % 2, y: 2 * self.y + i / 2 };
        (0..if inner { 4 } else { 0 }).map(child)
    }

    /// The tile and everything below it.
    fn node(self, base: &str, content: PageContent) -> Node {
        let center = self.center();
        let radius_m = self.side_m() * 0.5f64.sqrt();
        let bounds = if self.level < LEVELS {
            BoundingVolume::Sphere(BoundingSphere { center, radius_m })
        } else {
            // A leaf of the peer is its mesh, with the mesh's own box.
            let [x0, y0] = self.corner();
            let step = self.side_m() / (SIDE - 1) as f64;
            let heights =
                (0..SIDE * SIDE).map(|k| height_m(x0 + (k % SIDE) as f64 * step, y0 + (k / SIDE) as f64 * step));
            let (low, high) = heights.fold((f64::MAX, f64::MIN), |(l, h), z| (l.min(z), h.max(z)));
            let half = DVec3::new(0.5 * self.side_m(), 0.5 * self.side_m(), 0.5 * (high - low));
            let center = DVec3::new(center.x, center.y, 0.5 * (low + high));
            BoundingVolume::Box(OrientedBox { center, half_axes: DMat3::from_diagonal(half) })
        };
        let (uri, reader_data) = self.content(base, content);
        let lod = PagedLod {
            bounds,
            range_mode: RangeMode::Distance { center, range_m: RATIO * radius_m },
            refine: Refine::Replace,
            content: Some(uri),
            content_transform: DAffine3::from_translation(DVec3::new(center.x, center.y, 0.0)),
            reader_data,
            request_volume: None,
            paging: PagingOptions::default(),
        };
        let children = self.children().map(|c| c.node(base, content)).collect();
        Node { children, ..Node::new(NodeKind::PagedLod(Box::new(lod))) }
    }

    /// The tile as binary glTF: y-up, east and north relative to its centre; a stored (not deflated) PNG.
    fn glb(self, png: &[u8]) -> Result<Vec<u8>> {
        let ([x0, y0], center, side_m) = (self.corner(), self.center(), self.side_m());
        let step = side_m / (SIDE - 1) as f64;
        let mut mesh = GlbMesh { image: Some(png.to_vec()), base_color: [1.0; 4], ..GlbMesh::default() };
        for j in 0..SIDE {
            for i in 0..SIDE {
                let (x, y) = (x0 + i as f64 * step, y0 + j as f64 * step);
                let n = DVec3::new(
                    height_m(x - step, y) - height_m(x + step, y),
                    height_m(x, y - step) - height_m(x, y + step),
                    2.0 * step,
                )
                .normalize();
                mesh.positions.push([(x - center.x) as f32, height_m(x, y) as f32, (center.y - y) as f32]);
                mesh.normals.push([n.x as f32, n.z as f32, -n.y as f32]);
                mesh.uvs.push([i as f32 / (SIDE - 1) as f32, 1.0 - j as f32 / (SIDE - 1) as f32]);
            }
        }
        for j in 0..SIDE - 1 {
            for i in 0..SIDE - 1 {
                let a = (j * SIDE + i) as u16;
                let (b, c, d) = (a + 1, a + SIDE as u16, a + SIDE as u16 + 1);
                mesh.indices.extend([a, b, d, a, d, c]);
            }
        }
        Ok(write_glb(&mesh))
    }

    /// The tile's heights as EXR, first row in the north, one sample around.
    fn exr(self) -> Result<Vec<u8>> {
        let ([x0, y0], step) = (self.corner(), self.side_m() / (SIDE - 1) as f64);
        let stride = SIDE + 2;
        let height = |k: usize| {
            let (i, j) = ((k % stride) as f64 - 1.0, (SIDE - k / stride) as f64);
            height_m(x0 + i * step, y0 + j * step) as f32
        };
        Ok(write_height_exr("tile", stride, (0..stride * stride).map(height).collect())?)
    }

    /// The peer's texels, its first row in the south.
    fn png(self) -> Result<Vec<u8>> {
        use image::ImageEncoder as _;
        use image::codecs::png::{CompressionType, FilterType, PngEncoder};
        let ([x0, y0], side_m) = (self.corner(), self.side_m());
        let mut pixels = Vec::with_capacity(TEXELS * TEXELS * 3);
        for j in (0..TEXELS).rev() {
            for i in 0..TEXELS {
                let at = |k: usize| (k as f64 + 0.5) * side_m / TEXELS as f64;
                let h = height_m(x0 + at(i), y0 + at(j));
                pixels.push((60 + self.level * 25) as u8);
                pixels.push((127.0 + h * 0.12).clamp(0.0, 255.0) as u8);
                pixels.push(((i * 4) ^ (j * 4)) as u8);
            }
        }
        let mut out = Vec::new();
        let side = TEXELS as u32;
        PngEncoder::new_with_quality(&mut out, CompressionType::Uncompressed, FilterType::NoFilter).write_image(
            &pixels,
            side,
            side,
            image::ExtendedColorType::Rgb8,
        )?;
        Ok(out)
    }
}

const ROOT: Tile = Tile { level: 0, x: 0, y: 0 };

/// The folder of the tiles; writes them, once.
fn tiles() -> Result<PathBuf> {
    let cache = crate::default_set::cache_folder().unwrap_or_else(std::env::temp_dir);
    let folder = cache.join("terrane").join(VERSION);
    let complete = folder.join("complete");
    if !complete.exists() {
        let made = || format!("cannot write tiles to {}", folder.display());
        std::fs::create_dir_all(&folder).with_context(made)?;
        eprintln!("writing 5461 tiles in two forms to {} (420 MB)", folder.display());
        let mut open = vec![ROOT];
        while let Some(tile) = open.pop() {
            let png = tile.png()?;
            std::fs::write(folder.join(tile.file("glb")), tile.glb(&png)?).with_context(made)?;
            std::fs::write(folder.join(tile.file("exr")), tile.exr()?).with_context(made)?;
            std::fs::write(folder.join(tile.file("png")), png).with_context(made)?;
            open.extend(tile.children());
        }
        std::fs::write(&complete, "").with_context(made)?;
    }
    // Into the page cache: both sides are measured warm.
    for entry in std::fs::read_dir(&folder)? {
        std::io::copy(&mut std::fs::File::open(entry?.path())?, &mut std::io::sink())?;
    }
    Ok(folder)
}

/// A graphics context that compiles on the thread that updates; as the viewer without a draw thread.
struct Context {
    graphics: GraphicsContext,
}

impl CompileContext for Context {
    fn id(&self) -> u32 {
        0
    }

    fn compile(&mut self, operation: CompileOperation) {
        self.graphics.compile(operation);
    }

    fn run_compiles(&mut self, budget: &CompileBudget) {
        self.graphics.run_compiles(budget);
    }

    fn take_compiled(&mut self) -> Vec<Compiled> {
        self.graphics.take_compiled()
    }

    fn release(&mut self, slots: Vec<DrawSlot>) {
        self.graphics.release(&slots);
    }
}

/// The camera at `u` of the path.
fn camera(u: f64, frame: u32) -> CullCamera {
    use std::f64::consts::{PI, TAU};
    let (x, y) = (8192.0 + 49152.0 * u, 32768.0 + 20000.0 * (TAU * u).sin());
    let eye = DVec3::new(x, y, height_m(x, y) + 1200.0 + 400.0 * (3.0 * TAU * u).sin());
    let ahead = DVec3::new(49152.0, 40000.0 * PI * (TAU * u).cos(), 0.0).normalize();
    let (sin, cos) = 20f64.to_radians().sin_cos();
    let view =
        glam::dcamera::rh::view::look_at_mat4(eye, eye + DVec3::new(ahead.x * cos, ahead.y * cos, -sin), DVec3::Z);
    CullCamera { eye_from_world: DAffine3::from_mat4(view), viewport_px: [64, 64], frame, ..CullCamera::default() }
}

/// A figure of this process from the system, in MB; 0 where there is none.
fn status_mb(name: &str) -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|l| l.strip_prefix(name));
    let kb = line.and_then(|l| l.trim_start_matches(':').trim().trim_end_matches("kB").trim().parse::<f64>().ok());
    kb.unwrap_or(0.0) / 1024.0
}

/// Processor time of this process, seconds; 0 where the system does not say.
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = text.rsplit_once(')').map_or(Vec::new(), |(_, rest)| rest.split_whitespace().collect());
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

/// Everything that lives through the phases.
struct Bench {
    options: Options,
    scene: Scene,
    pager: DatabasePager,
    context: Context,
    renderer: Option<terrane::draw::Renderer>,
    visitor: CullVisitor,
    stage: RenderStage,
    frame: u32,
    rss_start_mb: f64,
}

/// Times of one phase, seconds.
#[derive(Default)]
struct Times {
    work: Vec<f64>,
    update: Vec<f64>,
    cull: Vec<f64>,
    compile: Vec<f64>,
    missing: Vec<f64>,
    /// Uploads and merges between two frames, waiting for them included.
    between: Vec<f64>,
    /// How much later than due the next frame began.
    late: Vec<f64>,
}

/// Runs the three phases and prints a line for each.
pub fn run(options: Options) -> Result<()> {
    ensure!(options.pace_hz.is_finite() && options.pace_hz >= 0.0, "--pace must be zero or above");
    ensure!(options.frames >= 2, "--frames must be at least 2");
    let folder = tiles()?;
    let mut scene = Scene::new();
    let base = match &options.url {
        Some(url) => {
            eprintln!("the tiles are in {}", folder.display());
            format!("{}/", url.trim_end_matches('/'))
        }
        None => format!("{}/", folder.to_str().context("the cache folder's path is not UTF-8")?),
    };
    scene.add_root(Page::from_node(ROOT.node(&base, options.content))?);
    let traits = |adapter| ContextTraits { size_px: [64, 64], adapter, ..ContextTraits::default() };
    let mut graphics = GraphicsContext::new_offscreen(&traits(AdapterChoice::Software))
        .or_else(|_| GraphicsContext::new_offscreen(&traits(AdapterChoice::Noop)))?;
    let read = ReadOptions::for_root(&format!("{base}{}", ROOT.file("glb")), Limits::default());
    let http = options.net.http(&base)?;
    let config = PagerConfig { max_tiles: options.tiles, http, ..PagerConfig::default() };
    let pager = DatabasePager::new(config, read)?;
    let renderer = options.draw.then(|| terrane::draw::Renderer::new(&mut graphics));
    let mut bench = Bench {
        options,
        scene,
        pager,
        context: Context { graphics },
        renderer,
        visitor: CullVisitor::new(),
        stage: RenderStage::new(),
        frame: 0,
        rss_start_mb: status_mb("VmRSS"),
    };
    for phase in ["converge_start", "fly", "converge_end"] {
        println!("{}", bench.phase(phase)?);
    }
    Ok(())
}

impl Bench {
    fn phase(&mut self, name: &str) -> Result<Value> {
        let fly = name == "fly";
        let before = *self.pager.stats();
        self.pager.reset_latency_max();
        let (cpu, start) = (cpu_s(), Instant::now());
        let mut times = Times::default();
        let (mut next, mut last_busy, mut quiet, mut converged) = (start, start, 0, false);
        let mut merged = before.merged;
        let (mut tiles_peak, mut drawn) = (0, HashSet::new());
        let period = Duration::from_secs_f64(if self.options.pace_hz > 0.0 { 1.0 / self.options.pace_hz } else { 0.0 });
        let mut i = 0;
        while !fly || i < self.options.frames {
            let u = match name {
                "fly" => f64::from(i) / f64::from(self.options.frames - 1),
                "converge_end" => 1.0,
                _ => 0.0,
            };
            i += 1;
            self.one_frame(u, &mut times)?;
            let stats = self.pager.stats();
            tiles_peak = tiles_peak.max(stats.resident);
            drawn.insert(self.stage.counters.tiles_drawn);
            if !fly {
                // What was merged between the frames counts until the end of the frame that shows it.
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
            let contexts: &mut [&mut dyn CompileContext] = &mut [&mut self.context];
            self.pager.work_until(&mut self.scene, contexts, next);
            let worked = Instant::now();
            times.between.push((worked - now).as_secs_f64());
            std::thread::sleep(next.saturating_duration_since(worked));
            times.late.push(Instant::now().saturating_duration_since(next).as_secs_f64());
        }
        let time_s = if fly { start.elapsed() } else { last_busy - start }.as_secs_f64();
        Ok(self.line(name, &before, time_s, converged, cpu_s() - cpu, tiles_peak, times))
    }

    /// Update, cull, upload and, if asked for, draw.
    fn one_frame(&mut self, u: f64, times: &mut Times) -> Result<()> {
        self.frame += 1;
        let t0 = Instant::now();
        self.pager.update_scene_graph(&mut self.scene, self.frame, &self.stage.requests, &mut [&mut self.context]);
        let t1 = Instant::now();
        self.visitor.cull(&self.scene, &camera(u, self.frame), &mut self.stage);
        self.pager.request(&self.scene, &self.stage.requests);
        let t2 = Instant::now();
        self.context.graphics.run_compiles(&CompileBudget::default());
        let t3 = Instant::now();
        if let Some(renderer) = &mut self.renderer {
            renderer.draw(&mut self.context.graphics, &self.stage, &terrane::draw::Environment::default())?;
        }
        let t4 = Instant::now();
        times.update.push((t1 - t0).as_secs_f64());
        times.cull.push((t2 - t1).as_secs_f64());
        times.compile.push((t3 - t2).as_secs_f64());
        times.work.push((t4 - t0).as_secs_f64());
        times.missing.push(f64::from(self.stage.counters.wanted_missing));
        Ok(())
    }

    #[allow(clippy::too_many_arguments, reason = "the figures of one line")]
    fn line(
        &self,
        phase: &str,
        before: &PagerStats,
        time_s: f64,
        converged: bool,
        cpu_s: f64,
        tiles_peak: u64,
        mut times: Times,
    ) -> Value {
        let now = self.pager.stats();
        let merged = now.merged - before.merged;
        let (frames, missing_sum) = (times.work.len(), times.missing.iter().sum::<f64>());
        let round = |v: f64| (v * 1e3).round() / 1e3;
        let ms = |v: &mut Vec<f64>, p: f64| round(percentile(v, p) * 1e3);
        // Before the times are sorted: frames beyond twice the median that would not be without their paging.
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
            "adapter": self.context.graphics.adapter_name(),
            "frames": frames, "converged": if phase == "fly" { Value::Null } else { converged.into() },
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
            "gpu_mb": round(self.context.graphics.bytes_peak() as f64 / 1048576.0),
            "rss_start_mb": round(self.rss_start_mb), "rss_mb": round(status_mb("VmRSS")),
            "peak_rss_mb": round(status_mb("VmHWM")), "cpu_s": round(cpu_s),
        });
        let label = self.options.content.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned());
        line["label"] = label.into();
        for (name, value) in [
            ("hitches_from_paging", (hitches as f64)),
            ("between_p50_ms", ms(&mut times.between, 0.5)),
            ("between_max_ms", ms(&mut times.between, 1.0)),
            ("late_p50_ms", ms(&mut times.late, 0.5)),
            ("late_p99_ms", ms(&mut times.late, 0.99)),
            ("late_max_ms", ms(&mut times.late, 1.0)),
        ] {
            line[name] = value.into();
        }
        line
    }
}
