//! Measures the pager's update of a frame with many resident pages, while nothing changes, and with many requests.
//!
//! All pages are the same small file and stay wanted. With a budget that is not exhausted no page is examined. With a full
//! budget a part of them is examined for eviction in each frame.
//!
//! At first no request is served. All requests appear at once. The camera stands still, then moves, so that the priorities of
//! all requests change in each frame; then many contents arrive at once. In the end it turns away, and nearly all requests are
//! unwanted at once. The ratio of the longest update to the median tells whether an update is bounded. It is printed by the
//! clock, which also counts the time in which loading threads have the core, and by the processor time of the updating thread.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use glam::{DAffine3, DVec3};
use serde_json::json;
use terrane::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use terrane::fetch::Limits;
use terrane::formats::ReadOptions;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::gpu::{AdapterChoice, CompileBudget, ContextTraits, GraphicsContext};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::pager::{CompileContext, DatabasePager, PagerConfig, RequestState};
use terrane::scene::{Node, NodeId, NodeKind, Page, PagedLod, RangeMode, Refine, Scene, SlotState};

use super::measurement::{UploadContext, percentile, print_line, thread_s};

/// The number of contents that are requested at the same time while the scene is filled.
const REQUESTS_AT_ONCE: usize = 2_000;
const TIMEOUT: Duration = Duration::from_secs(60);
/// The time for uploads in each frame.
const UPLOAD_TIME: Duration = Duration::from_millis(4);
/// The distance between two tiles in metres.
const SPACING_M: f64 = 10.0;
/// Contents that arrive at once while others wait.
const ANSWERS: usize = 1_000;
/// Contents that are loaded before the cases, so that the pager knows how large a content is.
const KNOWN: usize = 8;
/// The number of decode threads that allows [`ANSWERS`] contents to be under way.
const DECODE_THREADS: usize = 96;
/// Tiles that are wanted after the camera has turned away.
const LEFT: usize = 1_000;
/// The least number of updates measured in each case.
const MIN_UPDATES: usize = 30;

fn grid(uri: &Arc<str>, tiles: usize) -> Result<Page> {
    let across = tiles.isqrt().max(1);
    let tile = |n: usize| {
        let center = DVec3::new((n % across) as f64, (n / across) as f64, 0.0) * SPACING_M;
        Node::new(NodeKind::PagedLod(Box::new(PagedLod {
            bounds: BoundingVolume::Sphere(BoundingSphere { center, radius_m: 0.5 * SPACING_M }),
            range_mode: RangeMode::Distance { center, range_m: 0.0 },
            refine: Refine::Replace,
            content: Some(uri.clone()),
            content_transform: DAffine3::from_translation(center),
            reader_data: None,
            request_volume: None,
            paging: Default::default(),
        })))
    };
    Ok(Page::from_node(Node::group((0..tiles).map(tile).collect()))?)
}

/// Returns the reference time of a frame of 60 Hz.
fn time_s(frame: u32) -> f64 {
    f64::from(frame) / 60.0
}

fn noop() -> Result<UploadContext> {
    let traits = ContextTraits { adapter: AdapterChoice::Noop, validation: false, ..ContextTraits::default() };
    Ok(UploadContext(GraphicsContext::new_offscreen(&traits)?))
}

/// Loads and merges all tiles, and measures the updates after that in microseconds.
fn updates(uri: &Arc<str>, tiles: usize, max_tiles: usize, secs: f64) -> Result<(Vec<f64>, u64)> {
    let mut context = noop()?;
    let config = PagerConfig { max_tiles, ..PagerConfig::default() };
    let mut pager = DatabasePager::new(config, ReadOptions::for_root(uri, Limits::default()))?;
    let mut scene = Scene::new();
    let root = scene.add_root(grid(uri, tiles)?);
    let slots: Vec<_> = scene.slots_of_page(root).collect();
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    let middle = DVec3::new(0.5, 0.5, 0.0) * (tiles as f64).sqrt() * SPACING_M;
    let eye_from_world = DAffine3::from_translation(-(middle + DVec3::Z * 2.0 * middle.x));
    let (start, mut frame) = (Instant::now(), 0);
    // All tiles are visible in each frame, so they stay wanted.
    let mut see = |scene: &Scene, frame: u32| {
        let camera = CullCamera { eye_from_world, frame, ..CullCamera::default() };
        visitor.cull(scene, &camera, &mut stage);
        stage.requests.len()
    };
    for some in slots.chunks(REQUESTS_AT_ONCE) {
        let requests: Vec<_> =
            some.iter().map(|&slot| PageRequest { slot, priority: 1.0, error_px: 1.0, ahead_frames: 0 }).collect();
        let until = pager.stats().merged + some.len() as u64;
        while pager.stats().merged < until {
            frame += 1;
            pager.update_scene_graph(&mut scene, frame, time_s(frame), &requests, &mut [&mut context]);
            see(&scene, frame);
            pager.work_until(&mut scene, &mut [&mut context], Instant::now() + Duration::from_millis(100));
            ensure!(start.elapsed() < TIMEOUT, "not everything was loaded: {:?} {:?}", pager.stats(), pager.errors());
        }
    }
    let (mut times_us, until) = (Vec::new(), Instant::now() + Duration::from_secs_f64(secs.max(0.0)));
    while times_us.len() < MIN_UPDATES || Instant::now() < until {
        frame += 1;
        ensure!(see(&scene, frame) == 0, "a tile is missing");
        let start = Instant::now();
        pager.update_scene_graph(&mut scene, frame, time_s(frame), &[], &mut [&mut context]);
        times_us.push(start.elapsed().as_secs_f64() * 1e6);
    }
    ensure!(pager.stats().resident as usize == tiles, "pages were evicted: {:?}", pager.stats());
    Ok((times_us, pager.stats().resident))
}

/// The updates of a case with waiting requests.
struct Updates {
    case: &'static str,
    waiting: u64,
    times: Vec<UpdateTime>,
}

/// The time of an update in microseconds: by the clock, and of the processor.
struct UpdateTime {
    wall_us: f64,
    cpu_us: f64,
}

/// A pager of which each frame wants many tiles.
struct Crowd {
    scene: Scene,
    pager: DatabasePager,
    context: UploadContext,
    slots: Vec<NodeId>,
    requests: Vec<PageRequest>,
    frame: u32,
    /// The index of the tile below the camera; it sets the priorities.
    position: usize,
}

impl Crowd {
    fn new(uri: &Arc<str>, requests: usize) -> Result<Self> {
        let max_tiles = ANSWERS + KNOWN;
        // All contents of the burst may be under way at once.
        let config = PagerConfig {
            max_tiles,
            decode_threads: DECODE_THREADS,
            max_bytes_loading: 8 << 30,
            ..PagerConfig::default()
        };
        let pager = DatabasePager::new(config, ReadOptions::for_root(uri, Limits::default()))?;
        let mut scene = Scene::new();
        let root = scene.add_root(grid(uri, requests + KNOWN)?);
        let slots: Vec<_> = scene.slots_of_page(root).collect();
        let (first, others) = slots.split_at(KNOWN);
        let mut crowd =
            Self { scene, pager, context: noop()?, slots: first.to_vec(), requests: Vec::new(), frame: 0, position: 0 };
        let start = Instant::now();
        while crowd.pager.stats().merged < KNOWN as u64 {
            crowd.update();
            ensure!(start.elapsed() < TIMEOUT, "not all contents were merged: {:?}", crowd.pager.stats());
            std::thread::sleep(Duration::from_millis(1));
        }
        crowd.slots = others.to_vec();
        crowd.pager.set_paused(true);
        Ok(crowd)
    }

    /// Makes the requests of a cull, which lists every tile that is missing, and runs the update.
    fn update(&mut self) -> UpdateTime {
        self.frame += 1;
        self.requests.clear();
        let missing = self
            .slots
            .iter()
            .enumerate()
            .filter(|(_, slot)| self.scene.slot(**slot).is_some_and(|slot| slot.state == SlotState::Empty));
        self.requests.extend(missing.map(|(n, &slot)| {
            let priority = 1e6 / (1 + n.abs_diff(self.position)) as f32;
            PageRequest { slot, priority, error_px: priority, ahead_frames: 0 }
        }));
        let (start, cpu_s) = (Instant::now(), thread_s());
        let contexts: &mut [&mut dyn CompileContext] = &mut [&mut self.context];
        self.pager.update_scene_graph(&mut self.scene, self.frame, time_s(self.frame), &self.requests, contexts);
        let cpu_us = (thread_s() - cpu_s) * 1e6;
        let wall_us = start.elapsed().as_secs_f64() * 1e6;
        // The uploads of a frame are made by its draw, which is not measured.
        self.context.run_compiles(&CompileBudget { time: UPLOAD_TIME, bytes: u64::MAX });
        UpdateTime { wall_us, cpu_us }
    }

    /// Measures until as many requests wait as the cameras make.
    fn follow(&mut self, case: &'static str) -> Result<Updates> {
        let (mut times, start) = (Vec::new(), Instant::now());
        while times.len() < MIN_UPDATES || self.pager.stats().waiting != self.requests.len() as u64 {
            ensure!(start.elapsed() < TIMEOUT, "other requests wait: {:?}", self.pager.stats());
            times.push(self.update());
        }
        Ok(Updates { case, waiting: self.pager.stats().waiting, times })
    }

    /// Turns the camera away from most tiles, and measures until their requests are dropped.
    fn turn(&mut self) -> Result<Updates> {
        self.pager.set_paused(true);
        self.slots.drain(..self.slots.len().saturating_sub(LEFT));
        self.follow("camera turns")
    }

    fn updates(&mut self, case: &'static str, secs: f64, moves: bool) -> Updates {
        let (mut times, until) = (Vec::new(), Instant::now() + Duration::from_secs_f64(secs.max(0.0)));
        while times.len() < MIN_UPDATES || Instant::now() < until {
            self.position += usize::from(moves);
            times.push(self.update());
        }
        Updates { case, waiting: self.pager.stats().waiting, times }
    }

    /// Lets [`ANSWERS`] contents arrive at once, which fills the budget, and measures until all of them are merged.
    fn burst(&mut self, secs: f64) -> Result<Updates> {
        // The median is that of frames in which nothing arrives.
        let mut updates = self.updates("answers at once", secs, false);
        self.pager.set_paused(false);
        updates.times.push(self.update());
        let (start, merged) = (Instant::now(), self.pager.stats().merged);
        let decoded = |pager: &DatabasePager| {
            pager.request_states().filter(|(_, state)| *state == RequestState::Decoding).count()
        };
        while decoded(&self.pager) < ANSWERS {
            ensure!(start.elapsed() < TIMEOUT, "not all contents were read: {:?}", self.pager.stats());
            std::thread::sleep(Duration::from_millis(10));
        }
        // They are read; what remains is to decode the last of them.
        std::thread::sleep(Duration::from_millis(500));
        while self.pager.stats().merged - merged < ANSWERS as u64 {
            ensure!(start.elapsed() < TIMEOUT, "not all contents were merged: {:?}", self.pager.stats());
            updates.times.push(self.update());
        }
        updates.waiting = self.pager.stats().waiting;
        Ok(updates)
    }
}

/// Measures updates while `requests` wait: when they appear, with a camera that stands, with one that moves, while contents
/// arrive, and when the camera turns away.
fn crowded_updates(uri: &Arc<str>, requests: usize, secs: f64) -> Result<[Updates; 5]> {
    let mut crowd = Crowd::new(uri, requests + ANSWERS)?;
    let new = crowd.follow("requests appear")?;
    let still = crowd.updates("camera stands", secs, false);
    let moving = crowd.updates("camera moves", secs, true);
    Ok([new, still, moving, crowd.burst(secs)?, crowd.turn()?])
}

/// Prints a line for a budget with spare room and one for a full budget, and a line for each case with waiting requests.
pub fn run(tiles: usize, requests: usize, secs: f64) -> Result<()> {
    let folder = std::env::temp_dir().join(format!("terrane-bench-resident-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let file = folder.join("tile.glb");
    let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    let mesh = GlbMesh { positions, indices: vec![0, 2, 1], base_color: [1.0; 4], ..GlbMesh::default() };
    std::fs::write(&file, write_glb(&mesh))?;
    let uri: Arc<str> = file.display().to_string().into();
    let round = |v: f64| (v * 100.0).round() / 100.0;
    for (budget, max_tiles) in [("room to spare", tiles * 2), ("full", tiles)] {
        let (mut times_us, resident) = updates(&uri, tiles, max_tiles, secs)?;
        print_line(json!({
            "bench": "resident", "budget": budget, "resident": resident, "frames": times_us.len(),
            "update_p50_us": round(percentile(&mut times_us, 0.5)),
            "update_p99_us": round(percentile(&mut times_us, 0.99)),
        }));
    }
    for Updates { case, waiting, times } in crowded_updates(&uri, requests, secs)? {
        let longest_at = (0..times.len()).max_by(|a, b| times[*a].cpu_us.total_cmp(&times[*b].cpu_us));
        let mut times_us: Vec<f64> = times.iter().map(|time| time.wall_us).collect();
        let (median, longest) = (percentile(&mut times_us, 0.5), percentile(&mut times_us, 1.0));
        let mut cpu_us: Vec<f64> = times.iter().map(|time| time.cpu_us).collect();
        let (cpu_median, cpu_longest) = (percentile(&mut cpu_us, 0.5), percentile(&mut cpu_us, 1.0));
        print_line(json!({
            "bench": "resident", "budget": case, "waiting": waiting, "frames": times_us.len(),
            "update_p50_us": round(median), "update_p99_us": round(percentile(&mut times_us, 0.99)),
            "update_max_us": round(longest), "max_to_p50": round(longest / median),
            "cpu_p50_us": round(cpu_median), "cpu_max_us": round(cpu_longest), "cpu_max_at": longest_at,
            "cpu_max_to_p50": round(cpu_longest / cpu_median),
        }));
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}
