//! Measures the pager's update of a frame with many resident pages, while nothing changes.
//!
//! All pages are the same small file and stay wanted. With a budget that is not exhausted no page is examined. With a full
//! budget a part of them is examined for eviction in each frame.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use glam::{DAffine3, DVec3};
use serde_json::json;
use terrane::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use terrane::fetch::Limits;
use terrane::formats::ReadOptions;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::pager::{DatabasePager, PagerConfig};
use terrane::scene::{Node, NodeKind, Page, PagedLod, RangeMode, Refine, Scene};

use super::measurement::{UploadContext, percentile, print_line};

/// The number of contents that are requested at the same time while the scene is filled.
const REQUESTS_AT_ONCE: usize = 2_000;
const TIMEOUT: Duration = Duration::from_secs(300);
/// The distance between two tiles in metres.
const SPACING_M: f64 = 10.0;

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

/// Loads and merges all tiles, and measures the updates after that in microseconds.
fn updates(uri: &Arc<str>, tiles: usize, max_tiles: usize, secs: f64) -> Result<(Vec<f64>, u64)> {
    let traits = ContextTraits { adapter: AdapterChoice::Noop, validation: false, ..ContextTraits::default() };
    let mut context = UploadContext(GraphicsContext::new_offscreen(&traits)?);
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
            pager.update_scene_graph(&mut scene, frame, &requests, &mut [&mut context]);
            see(&scene, frame);
            pager.work_until(&mut scene, &mut [&mut context], Instant::now() + Duration::from_millis(100));
            ensure!(start.elapsed() < TIMEOUT, "not everything was loaded: {:?} {:?}", pager.stats(), pager.errors());
        }
    }
    let (mut times_us, until) = (Vec::new(), Instant::now() + Duration::from_secs_f64(secs.max(0.0)));
    while times_us.len() < 30 || Instant::now() < until {
        frame += 1;
        ensure!(see(&scene, frame) == 0, "a tile is missing");
        let start = Instant::now();
        pager.update_scene_graph(&mut scene, frame, &[], &mut [&mut context]);
        times_us.push(start.elapsed().as_secs_f64() * 1e6);
    }
    ensure!(pager.stats().resident as usize == tiles, "pages were evicted: {:?}", pager.stats());
    Ok((times_us, pager.stats().resident))
}

/// Prints a line for a budget with spare room and one for a full budget.
pub fn run(tiles: usize, secs: f64) -> Result<()> {
    let folder = std::env::temp_dir().join(format!("terrane-bench-resident-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let file = folder.join("tile.glb");
    let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    let mesh = GlbMesh { positions, indices: vec![0, 2, 1], base_color: [1.0; 4], ..GlbMesh::default() };
    std::fs::write(&file, write_glb(&mesh))?;
    let uri: Arc<str> = file.display().to_string().into();
    for (budget, max_tiles) in [("room to spare", tiles * 2), ("full", tiles)] {
        let (mut times_us, resident) = updates(&uri, tiles, max_tiles, secs)?;
        let round = |v: f64| (v * 100.0).round() / 100.0;
        print_line(json!({
            "bench": "resident", "budget": budget, "resident": resident, "frames": times_us.len(),
            "update_p50_us": round(percentile(&mut times_us, 0.5)),
            "update_p99_us": round(percentile(&mut times_us, 0.99)),
        }));
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}
