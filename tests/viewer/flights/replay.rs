//! A flight that is repeated in the blocking mode holds and uses the same tiles in each frame, also where memory is short.
//! The noop adapter suffices.

use std::collections::BTreeSet;
use std::time::Duration;

use glam::{DAffine3, DVec3};
use kit::tile_sets::mountains;
use terrane::gpu::AdapterChoice;
use terrane::pager::{PagerConfig, PagerStats};
use terrane::scene::SlotState;
use terrane::viewer::{SetBounds, ThreadingModel, Viewer, ViewerConfig};

const FRAMES: u32 = 45;

/// The tiles of a scene after a frame, as numbers in the root's page, which has all of them.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Tiles {
    in_use: BTreeSet<usize>,
    resident: BTreeSet<usize>,
    /// Requested, loaded, merged, expired, declined, stale, dropped and retried so far.
    counts: [u64; 8],
}

/// Looks down at a point that wanders over the set, jumps half-way, and returns.
fn pose(bounds: &SetBounds, frame: u32) -> DAffine3 {
    let share = f64::from(frame.min(FRAMES - frame)) / f64::from(FRAMES);
    let jump = if (20..40).contains(&frame) { 0.9 } else { 0.0 };
    let half = bounds.half_size_m;
    let z = bounds.middle_m.z + half.z + 0.04 * half.y;
    let eye =
        DVec3::new(bounds.middle_m.x + half.x * (share - jump), bounds.middle_m.y + half.y * (0.8 - 2.0 * share), z);
    bounds.frame.world_from_local
        * terrane::viewer::world_from_eye(eye, DVec3::new(f64::from(frame).sin(), 1.0, -0.5), DVec3::Z)
}

/// Returns the tiles of each frame of the flight, and the pager's counters at its end.
fn fly(set: &str, pager: PagerConfig, threading: ThreadingModel, between: Duration) -> (Vec<Tiles>, PagerStats) {
    let config = ViewerConfig {
        size_px: [320, 180],
        adapter: AdapterChoice::Noop,
        validation: false,
        threading,
        max_sse_px: 3.0,
        look_ahead_s: 0.0,
        pager: PagerConfig { blocking: true, ..pager },
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer.load(set).unwrap();
    let bounds = *viewer.bounds().unwrap();
    let mut frames = Vec::new();
    for frame in 0..FRAMES {
        viewer.view_mut().camera.world_from_eye = pose(&bounds, frame);
        viewer.frame_at(f64::from(frame) / 60.0).unwrap();
        frames.push(tiles(&viewer));
        std::thread::sleep(between);
    }
    let stats = *viewer.pager().unwrap().stats();
    assert_eq!(stats.failed, 0);
    (frames, stats)
}

fn tiles(viewer: &Viewer) -> Tiles {
    let frame = viewer.frame_stamp().frame;
    let (mut in_use, mut resident) = (BTreeSet::new(), BTreeSet::new());
    for (number, tile) in viewer.scene().tiles().enumerate() {
        if matches!(tile.state, Some(SlotState::Resident(_))) {
            resident.insert(number);
            if tile.last_used_frame == frame {
                in_use.insert(number);
            }
        }
    }
    let s = viewer.pager().unwrap().stats();
    let counts = [s.requested, s.loaded, s.merged, s.expired, s.declined, s.stale, s.dropped, s.retried];
    Tiles { in_use, resident, counts }
}

#[test]
fn repeated_flight_has_the_same_tiles_in_each_frame() {
    let folder = tempfile::tempdir().unwrap();
    let set = mountains(folder.path(), 5);
    let roomy = PagerConfig { file_threads: 3, decode_threads: 3, ..PagerConfig::default() };
    let (_, all) = fly(&set, roomy.clone(), ThreadingModel::SingleThreaded, Duration::ZERO);
    let few_pages = PagerConfig { max_tiles: 40, ..roomy.clone() };
    // The tree of the root takes its part of the budget, up to half of it.
    let little = all.cpu_bytes_peak * 2 / 5;
    let little_memory = PagerConfig { max_bytes_cpu: little + all.root_bytes.min(little), ..roomy.clone() };
    let little_gpu_memory = PagerConfig { max_bytes_gpu: all.gpu_bytes_peak * 2 / 5, ..roomy.clone() };
    for (name, pager) in
        [("roomy", roomy), ("few pages", few_pages), ("CPU memory", little_memory), ("GPU memory", little_gpu_memory)]
    {
        let (first, stats) = fly(&set, pager.clone(), ThreadingModel::SingleThreaded, Duration::ZERO);
        let in_use: usize = first.iter().map(|tiles| tiles.in_use.len()).sum();
        assert!(in_use > 20 * FRAMES as usize, "{name}: {in_use}");
        assert!(name == "roomy" || stats.expired > 50, "{name}: {stats:?}");
        let (again, _) = fly(&set, pager, ThreadingModel::DrawThreadPerContext, Duration::from_millis(2));
        for (frame, (first, again)) in first.iter().zip(&again).enumerate() {
            assert_eq!(first.counts, again.counts, "{name}, frame {frame}");
            assert_eq!(first, again, "{name}, frame {frame}");
        }
    }
}
