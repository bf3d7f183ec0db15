//! Paging along the default path in the phases of the `osg_page` peer: converge at the first camera, fly, converge
//! at the last. One JSON object a phase with the peer's field names; a file here is one tile.

use std::io::Write as _;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use serde_json::json;
use terrane::gpu::AdapterChoice;
use terrane::pager::PagerStats;
use terrane::viewer::{AnimationPath, FrameStats, Samples, Viewer, ViewerConfig};

use crate::args::BenchPageArgs;
use crate::default_set;

/// A phase that holds the camera ends after so many frames in which nothing was wanted and nothing pending.
const QUIET_FRAMES: u32 = 15;
const TIMEOUT: Duration = Duration::from_secs(60);
const NAMES: [&str; 3] = ["converge_start", "fly", "converge_end"];

pub fn run(args: &BenchPageArgs) -> Result<()> {
    let source = match &args.source {
        Some(source) => source.clone(),
        None => default_set::ensure()?,
    };
    let adapter = if args.draw { AdapterChoice::Any } else { AdapterChoice::Noop };
    let config = ViewerConfig {
        size_px: [256, 256],
        threading: args.threading,
        adapter,
        validation: false,
        max_sse_px: args.sse.0,
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config)?;
    viewer.load(&source)?;
    let bounds = *viewer.bounds().context("the set has no bounds")?;
    let path = bounds.default_path(&viewer.camera.world_from_eye);
    for name in NAMES {
        let line = phase(&mut viewer, &path, name, args)?;
        writeln!(std::io::stdout(), "{line}").context("stdout")?;
    }
    Ok(())
}

fn phase(viewer: &mut Viewer, path: &AnimationPath, name: &str, args: &BenchPageArgs) -> Result<serde_json::Value> {
    let fly = name == "fly";
    let before = stats(viewer);
    let first_frame = viewer.frame_stamp().frame;
    let start = Instant::now();
    let (mut last_busy, mut quiet, mut frames) = (start, 0, 0);
    let mut next = start;
    let converged = loop {
        if fly && frames == args.frames {
            break None;
        }
        let share = match name {
            "converge_start" => 0.0,
            "fly" => f64::from(frames) / f64::from(args.frames.saturating_sub(1).max(1)),
            _ => 1.0,
        };
        viewer.camera.world_from_eye = path.world_from_eye(path.first_s() + share * path.duration_s());
        viewer.frame()?;
        frames += 1;
        if !fly {
            if viewer.is_settled() {
                quiet += 1;
            } else {
                (quiet, last_busy) = (0, Instant::now());
            }
            if quiet >= QUIET_FRAMES {
                break Some(true);
            }
            if start.elapsed() > TIMEOUT {
                break Some(false);
            }
        }
        if args.pace > 0.0 {
            // A late frame is not made up for by more than one interval.
            let interval = Duration::from_secs_f64(1.0 / args.pace);
            next = (next + interval).max(Instant::now().checked_sub(interval).unwrap_or(start));
            std::thread::sleep(next.saturating_duration_since(Instant::now()));
        }
    };
    viewer.finish()?;
    let time_s = if fly { start.elapsed() } else { last_busy - start }.as_secs_f64();
    let after = stats(viewer);
    let of_phase = |value: fn(&FrameStats) -> f64| {
        Samples::new(viewer.stats().iter().filter(|s| s.frame > first_frame).map(value))
    };
    let (frame, update, missing) =
        (of_phase(|s| s.frame_ms), of_phase(|s| s.merge_ms), of_phase(|s| f64::from(s.wanted_missing)));
    let merged = after.merged - before.merged;
    let latency_s = after.latency_sum_s - before.latency_sum_s;
    Ok(json!({
        "bench": "page", "phase": name, "threading": args.threading.to_string(), "pace": args.pace,
        "draw": i32::from(args.draw), "sse": args.sse.0, "frames": frames, "converged": converged, "time_s": time_s,
        "frame_p50_ms": frame.median(), "frame_p95_ms": frame.percentile(0.95), "frame_p99_ms": frame.percentile(0.99),
        "frame_max_ms": frame.max(),
        "frames_over_budget": if args.pace > 0.0 { frame.above(1000.0 / args.pace) } else { 0 },
        "pager_update_p50_us": update.median() * 1e3, "pager_update_max_ms": update.max(),
        "files_requested": after.requested - before.requested, "files_read": after.loaded - before.loaded,
        "files_merged": merged, "files_deleted": after.expired - before.expired,
        "tiles_loaded": merged, "tiles_per_s": if time_s > 0.0 { merged as f64 / time_s } else { 0.0 },
        "read_failures": after.failed - before.failed, "missing_p50": missing.median(),
        "missing_p95": missing.percentile(0.95),
        "tile_latency_mean_ms": if merged > 0 { latency_s * 1e3 / merged as f64 } else { 0.0 },
        "tile_latency_max_ms": after.latency_max_s * 1e3,
    }))
}

fn stats(viewer: &Viewer) -> PagerStats {
    viewer.pager().map(|pager| *pager.stats()).unwrap_or_default()
}
