//! Measures what sharing of equal contents saves, and what the search for them costs if there are none.
//!
//! There are two sets of 1,024 tiles: in one all differ, the other repeats 32 of them. First the decoders run alone on all
//! cores, alternating without and with sharing. Then a pager loads everything from files and uploads to the noop adapter.
//! At first memory pools have to grow, which that adapter zeroes and copies (`load_first_s`). Then 1,024 other tiles
//! replace the first ones, as in a flight (`load_all_s`).

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use glam::{DAffine3, DMat3, DVec3};
use serde_json::json;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::fetch::Limits;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::formats::{Content, ReadOptions, decode};
use terrane::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
use terrane::math::{BoundingVolume, OrientedBox};
use terrane::pager::{DatabasePager, PagerConfig, PagerStats};
use terrane::scene::{Node, NodeKind, Page, PagedLod, RangeMode, Refine, Scene, ShareModes, SharedStateManager};

use super::measurement::{UploadContext, percentile, print_line};

const TILES: usize = 1024;
/// The number of different contents in the set that repeats them.
const REPEATED: usize = 32;
/// The side of a tile in metres.
const TILE_M: f64 = 100.0;
const SIDE: usize = 65;
const TEXELS: u32 = 256;
const TIMEOUT: Duration = Duration::from_secs(120);
/// The duration of a frame at 60 frames per second.
const FRAME: Duration = Duration::from_micros(16_667);

fn glb(seed: usize) -> Result<Vec<u8>> {
    let texel = |x: u32, y: u32| {
        let [x, y, s] = [x as f32, y as f32, seed as f32];
        let wave = |f: f32| (127.0 + 100.0 * (f * x + s).sin() * (0.7 * f * y + s).cos()) as u8;
        image::Rgb([wave(0.05), wave(0.031), wave(0.013)])
    };
    let mut picture = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_fn(TEXELS, TEXELS, texel).write_to(&mut picture, image::ImageFormat::Jpeg)?;
    let mut mesh = GlbMesh { image: Some(picture.into_inner()), base_color: [1.0; 4], ..GlbMesh::default() };
    for j in 0..SIDE {
        for i in 0..SIDE {
            let [u, v] = [i, j].map(|k| k as f32 / (SIDE - 1) as f32);
            let h = 5.0 * (6.0 * u + seed as f32).sin() * (5.0 * v).cos();
            mesh.positions.push([(u - 0.5) * TILE_M as f32, h, (v - 0.5) * TILE_M as f32]);
            mesh.normals.push([0.0, 1.0, 0.0]);
            mesh.uvs.push([u, v]);
        }
    }
    for j in 0..SIDE - 1 {
        for i in 0..SIDE - 1 {
            let a = (j * SIDE + i) as u16;
            let (b, c, d) = (a + 1, a + SIDE as u16, a + SIDE as u16 + 1);
            mesh.indices.extend([a, c, b, b, c, d]);
        }
    }
    Ok(write_glb(&mesh))
}

fn sharing(modes: ShareModes) -> Option<Arc<SharedStateManager>> {
    modes.any().then(|| Arc::new(SharedStateManager::new(modes)))
}

/// Returns the tiles per second that are decoded from memory, without and with sharing. Each worker decodes each of its
/// tiles in both ways, so that other load on the machine affects both alike. It keeps the last 32 payloads, like tiles that
/// wait for their upload, and the shared content of all pages.
fn decode_rates(contents: &[Vec<u8>]) -> [f64; 2] {
    let options =
        |modes| ReadOptions { sharing: sharing(modes), ..ReadOptions::for_root("/set/t.json", Limits::default()) };
    let options = [options(ShareModes::NONE), options(ShareModes::default())];
    let next = AtomicUsize::new(0);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let work = || {
        let mut spent = [Duration::ZERO; 2];
        let (mut pages, mut waiting) = (Vec::new(), std::collections::VecDeque::new());
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            let Some(bytes) = contents.get(i) else { return spent };
            let order = if i.is_multiple_of(2) { [0, 1] } else { [1, 0] };
            for mode in order {
                let uri = "/set/t.glb".into();
                let content = Content { uri, bytes: bytes.clone(), reader_data: None, companions: Vec::new() };
                let start = Instant::now();
                let decoded = decode(content, &options[mode]);
                spent[mode] += start.elapsed();
                let Ok(mut page) = decoded else { continue };
                waiting.push_back(page.take_drawables());
                if waiting.len() > 64 {
                    waiting.pop_front();
                }
                pages.push(page);
            }
        }
    };
    let spent = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..cores).map(|_| scope.spawn(work)).collect();
        let spent = workers.into_iter().filter_map(|w| w.join().ok());
        spent.fold([Duration::ZERO; 2], |sum, s| [sum[0] + s[0], sum[1] + s[1]])
    });
    spent.map(|spent| (contents.len() * cores) as f64 / spent.as_secs_f64())
}

/// A temporary folder of this run. Dropping it removes the folder.
struct Folder(std::path::PathBuf);

impl Folder {
    fn new() -> Result<Self> {
        let path = std::env::temp_dir().join(format!("terrane-bench-share-{}", std::process::id()));
        std::fs::create_dir_all(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // Files that cannot be removed from the temporary folder are harmless.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Returns the side of a square of tiles, and the distance between the two squares, in metres.
fn reach_m() -> f64 {
    TILES.isqrt() as f64 * TILE_M
}

const APART_M: f64 = 1e6;

/// Returns a page with two squares of tiles that are too far apart for one camera to see both.
fn root(folder: &str) -> Result<Page> {
    let across = TILES.isqrt();
    let tile = |n: usize| {
        let (square, at) = (n / TILES, n % TILES);
        let [x, y] = [at % across, at / across].map(|k| (k as f64 + 0.5) * TILE_M);
        let center = DVec3::new(x + square as f64 * APART_M, y, 0.0);
        let half_axes = DMat3::from_diagonal(DVec3::new(0.5 * TILE_M, 0.5 * TILE_M, 10.0));
        Node::new(NodeKind::PagedLod(Box::new(PagedLod {
            bounds: BoundingVolume::Box(OrientedBox { center, half_axes }),
            range_mode: RangeMode::Distance { center, range_m: 0.0 },
            refine: Refine::Replace,
            content: Some(format!("{folder}/{n}.glb").into()),
            content_transform: DAffine3::from_translation(center),
            reader_data: None,
            request_volume: None,
            paging: Default::default(),
        })))
    };
    let square = |from: usize| Node::group((from..from + TILES).map(tile).collect());
    Ok(Page::from_node(Node::group(vec![square(0), square(TILES)]))?)
}

/// The cost of loading.
struct Loads {
    /// Seconds to load the first square, and then the second instead of it.
    seconds: [f64; 2],
    /// GPU memory of the first square in bytes.
    gpu_bytes: u64,
    stats: PagerStats,
}

/// Loads and uploads one square, and then the other. The budget has room for little more than one.
fn load_all(folder: &str, modes: ShareModes) -> Result<Loads> {
    let traits = ContextTraits { adapter: AdapterChoice::Noop, validation: false, ..ContextTraits::default() };
    let mut context = UploadContext(GraphicsContext::new_offscreen(&traits)?);
    let config = PagerConfig { sharing: modes, max_tiles: TILES + TILES / 8, ..PagerConfig::default() };
    let options = ReadOptions::for_root(&format!("{folder}/tileset.json"), Limits::default());
    let mut pager = DatabasePager::new(config, options)?;
    let mut scene = Scene::new();
    scene.add_root(root(folder)?);
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    let (begun, mut frame) = (Instant::now(), 0);
    let mut loads = Loads { seconds: [0.0; 2], gpu_bytes: 0, stats: PagerStats::default() };
    for square in 0..2 {
        let middle = DVec3::new(0.5 * reach_m() + square as f64 * APART_M, 0.5 * reach_m(), 2.0 * reach_m());
        let eye_from_world = DAffine3::from_translation(-middle);
        let start = Instant::now();
        loop {
            frame += 1;
            let due = Instant::now() + FRAME;
            let camera = CullCamera { eye_from_world, frame, ..CullCamera::default() };
            visitor.cull(&scene, &camera, &mut stage);
            let time_s = begun.elapsed().as_secs_f64();
            pager.update_scene_graph(&mut scene, frame, time_s, &stage.requests, &mut [&mut context]);
            if pager.stats().merged as usize == (square + 1) * TILES {
                break;
            }
            ensure!(start.elapsed() < TIMEOUT, "not everything was loaded: {:?} {:?}", pager.stats(), pager.errors());
            pager.work_until(&mut scene, &mut [&mut context], due);
        }
        loads.seconds[square] = start.elapsed().as_secs_f64();
        if square == 0 {
            (loads.gpu_bytes, loads.stats) = (context.0.bytes_in_use(), *pager.stats());
        }
    }
    Ok(loads)
}

/// Prints a line for each set, without and with sharing.
pub fn run(secs: f64) -> Result<()> {
    for (set, different) in [("unique", TILES), ("repeated", REPEATED)] {
        // Contents of both squares.
        let distinct: Vec<Vec<u8>> = (0..2 * different).map(glb).collect::<Result<_>>()?;
        let of = |n: usize| distinct[n / TILES * different + n % different].clone();
        let contents: Vec<Vec<u8>> = (0..TILES).map(of).collect();
        let end = Instant::now() + Duration::from_secs_f64(secs.max(0.0));
        let (mut off, mut on, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
        decode_rates(&contents);
        while ratios.len() < 3 || Instant::now() < end {
            let [without, with] = decode_rates(&contents);
            off.push(without);
            on.push(with);
            ratios.push(with / without);
        }
        let ratio = percentile(&mut ratios, 0.5);
        let folder = Folder::new()?;
        for n in 0..2 * TILES {
            std::fs::write(folder.0.join(format!("{n}.glb")), of(n))?;
        }
        let path = folder.0.display().to_string();
        for (name, modes, rates) in [("off", ShareModes::NONE, &mut off), ("on", ShareModes::default(), &mut on)] {
            let loads = (0..5).map(|_| load_all(&path, modes)).collect::<Result<Vec<_>>>()?;
            let median =
                |square: usize| percentile(&mut loads.iter().map(|l| l.seconds[square]).collect::<Vec<_>>(), 0.5);
            let (first_s, all_s) = (median(0), median(1));
            let (rate, load_rate) = (percentile(rates, 0.5), TILES as f64 / all_s);
            let Some(Loads { gpu_bytes, stats, .. }) = loads.last() else { continue };
            let mb = |bytes: u64| (bytes as f64 / f64::from(1 << 20) * 10.0).round() / 10.0;
            print_line(json!({
                "bench": "share", "set": set, "sharing": name, "tiles": TILES, "different": different,
                "decode_tiles_per_s": rate.round(), "load_tiles_per_s": load_rate.round(),
                "load_to_decode": (load_rate / rate * 1e3).round() / 1e3,
                "decode_ratio_on_to_off": (ratio * 1e3).round() / 1e3, "rounds": rates.len(),
                "load_first_s": (first_s * 1e3).round() / 1e3,
                "load_all_s": (all_s * 1e3).round() / 1e3, "gpu_mb": mb(*gpu_bytes), "gpu_saved_mb": mb(stats.shared_gpu_bytes_saved),
                "payload_spared_mb": mb(stats.sharing.payload_bytes_spared),
                "decodes_spared": stats.sharing.decodes_spared,
                "geometry_hits": stats.sharing.geometry_hits, "texture_hits": stats.sharing.texture_hits,
            }));
        }
    }
    Ok(())
}
