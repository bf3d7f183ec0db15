//! Measures frames with each threading model: the time of a frame and that of the longest of the steps that can run in
//! parallel, and the time to stop and start the threads of a model. The noop adapter draws, so that no threads of a driver
//! occupy the cores. Prints one JSON object per line.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use glam::{DAffine3, DVec3};
use serde_json::json;
use terrane::gpu::AdapterChoice;
use terrane::scene::{CullingMode, Node, NodeId, Page};
use terrane::state::{Attribute, StateSet, SurfaceMaterial};
use terrane::viewer::{FrameStats, ThreadingModel, Viewer, ViewerConfig};

use super::cull::triangle;
use super::measurement::{percentile, print_line};

/// The number of drawables, each below a separate transform.
const LEAVES: u32 = 60_000;
/// The number of materials, which are assigned in turn.
const STATE_SETS: u32 = 64;
/// The number of transforms below one group, which determines the cost of moving one of them.
const SIDE: u32 = 100;
/// The number of measured stops and starts.
const SWITCHES: usize = 200;

/// Measures each case for about `seconds` and prints a line for it.
pub fn run(seconds: f64) -> Result<()> {
    let time = Duration::from_secs_f64(if seconds.is_finite() { seconds.clamp(0.0, 3600.0) } else { 1.0 });
    for moved in [0, LEAVES / 192, LEAVES / 64] {
        // The times of update, cull and draw in the model that runs them one after the other.
        let mut alone = None;
        for threading in ThreadingModel::ALL {
            print_line(measure(moved, threading, time, &mut alone)?);
        }
    }
    Ok(())
}

fn root() -> Result<Page> {
    let sets: Vec<_> = (0..STATE_SETS)
        .map(|i| {
            let material = SurfaceMaterial { shininess: i as f32, ..SurfaceMaterial::default() };
            Arc::new(StateSet::default().with(Attribute::SurfaceMaterial(material)))
        })
        .collect();
    let leaf = |i: u32| {
        let place = DVec3::new(f64::from(i % SIDE), f64::from(i / SIDE), 0.0);
        let geode = Node::geode(vec![triangle(DVec3::ZERO)]).with_state_set(sets[(i % STATE_SETS) as usize].clone());
        Node::transform(DAffine3::from_translation(place), vec![geode])
    };
    let rows = (0..LEAVES / SIDE).map(|row| Node::group((row * SIDE..(row + 1) * SIDE).map(leaf).collect()));
    Ok(Page::from_node(Node::group(rows.collect()))?)
}

fn viewer(moved: u32, threading: ThreadingModel) -> Result<Viewer> {
    let config = ViewerConfig {
        size_px: [64, 64],
        threading,
        adapter: AdapterChoice::Noop,
        validation: false,
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config)?;
    let root = viewer.add_root(root()?)?;
    let center = DVec3::new(f64::from(SIDE), f64::from(LEAVES / SIDE), 0.0) * 0.5;
    let height = 1.2 * f64::from(SIDE.max(LEAVES / SIDE));
    viewer.view_mut().camera.look_at(center + DVec3::new(0.0, 0.0, height), center, DVec3::Y);
    // Sample culling would skip most of these small triangles, whose draw is measured.
    let culling = viewer.view().camera.settings.culling.0;
    viewer.view_mut().camera.settings.culling = CullingMode(culling & !CullingMode::SAMPLES.0);
    let mut refused = false;
    viewer.on_update(Box::new(move |scene, stamp| {
        let lift = DVec3::new(0.0, 0.0, f64::from(stamp.frame % 8));
        for i in 0..moved {
            // A row has one node for its group and two for each leaf.
            let (row, column) = (i / SIDE, i % SIDE);
            let node = NodeId { page: root, index: 1 + row * (1 + 2 * SIDE) + 1 + 2 * column };
            let place = DVec3::new(f64::from(column), f64::from(row), 0.0) + lift;
            refused |= scene.set_transform(node, DAffine3::from_translation(place)).is_err();
        }
        debug_assert!(!refused, "the nodes have the indices of the scene");
    }));
    Ok(viewer)
}

fn measure(
    moved: u32,
    threading: ThreadingModel,
    time: Duration,
    alone: &mut Option<[f64; 3]>,
) -> Result<serde_json::Value> {
    let mut viewer = viewer(moved, threading)?;
    let patience = Instant::now() + Duration::from_secs(60);
    while viewer.stats().last_drawn().is_none_or(|f| f.leaves < LEAVES) {
        viewer.frame()?;
        anyhow::ensure!(Instant::now() < patience, "some of the {LEAVES} leaves are not drawn");
    }
    for _ in 0..20 {
        viewer.frame()?;
    }
    viewer.finish()?;
    let first = viewer.frame_stamp().frame + 1;
    let start = Instant::now();
    let mut times = Vec::new();
    while start.elapsed() < time || times.len() < 20 {
        let before = Instant::now();
        viewer.frame()?;
        times.push(before.elapsed().as_secs_f64() * 1e3);
    }
    let frames = times.len();
    let frame_ms = percentile(&mut times, 0.5);
    viewer.finish()?;
    // Medians are robust against other load on the machine.
    let median = |value: fn(&FrameStats) -> f64| {
        let drawn = viewer.stats().iter().filter(|f| f.frame >= first && f.drawn);
        percentile(&mut drawn.map(value).collect::<Vec<_>>(), 0.5)
    };
    let own = [median(|f| f.event_ms + f.update_ms), median(|f| f.cull_ms), median(|f| f.draw_ms + f.compile_ms)];
    let bound = |[update, cull, draw]: [f64; 3]| match threading {
        ThreadingModel::SingleThreaded | ThreadingModel::CullDrawThreadPerContext => update + cull + draw,
        _ => (update + cull).max(draw),
    };
    let alone = *alone.get_or_insert(own);
    let [stop_ms, start_ms] = switches(&mut viewer)?;
    let round = |v: f64| (v * 1e3).round() / 1e3;
    let times =
        |mut ms: Vec<f64>| json!({ "p50": round(percentile(&mut ms, 0.5)), "max": round(percentile(&mut ms, 1.0)) });
    Ok(json!({
        "bench": "terrane_threading", "threading": threading.to_string(), "n": LEAVES, "statesets": STATE_SETS,
        "moved": moved, "frames": frames, "frame_p50_ms": round(frame_ms),
        "update_p50_ms": round(own[0]), "cull_p50_ms": round(own[1]), "draw_p50_ms": round(own[2]),
        "bound_ms": round(bound(own)), "frame_per_bound": round(frame_ms / bound(own)),
        "alone_ms": alone.map(round), "frame_per_bound_alone": round(frame_ms / bound(alone)),
        "stop_ms": times(stop_ms), "start_ms": times(start_ms),
    }))
}

/// Returns the milliseconds to stop and to start the threads, with one frame between measurements.
fn switches(viewer: &mut Viewer) -> Result<[Vec<f64>; 2]> {
    let (mut stop_ms, mut start_ms) = (Vec::new(), Vec::new());
    for _ in 0..SWITCHES {
        viewer.frame()?;
        viewer.finish()?;
        let before = Instant::now();
        viewer.composite_mut().stop_threading()?;
        let stopped = Instant::now();
        viewer.composite_mut().start_threading()?;
        stop_ms.push((stopped - before).as_secs_f64() * 1e3);
        start_ms.push(stopped.elapsed().as_secs_f64() * 1e3);
    }
    Ok([stop_ms, start_ms])
}
