//! The invariants that must hold in each frame, with any flight and any faults.

use std::collections::VecDeque;

use image::RgbaImage;
use terrane::pager::{DatabasePager, PagerConfig, PagerStats};
use terrane::scene::{PageId, Scene, SlotState};
use terrane::viewer::{Camera, CompositeViewer, HoleCheck, KEY_COLOR, SetBounds, ViewerError};

/// Maximum number of reported failures of a seed. The first is the most useful.
const MAX_FAILURES: usize = 20;

/// The violated invariants, each kind once.
#[derive(Debug, Default)]
pub struct Failures {
    list: Vec<String>,
    kinds: Vec<&'static str>,
}

impl Failures {
    /// Adds a failure unless there is one of the same kind.
    pub fn add(&mut self, kind: &'static str, frame: u32, what: impl FnOnce() -> String) {
        if !self.kinds.contains(&kind) && self.list.len() < MAX_FAILURES {
            self.kinds.push(kind);
            self.list.push(format!("frame {frame}: {kind}: {}", what()));
        }
    }

    /// Adds a failure unless `holds` is true.
    pub fn check(&mut self, holds: bool, kind: &'static str, frame: u32, what: impl FnOnce() -> String) {
        if !holds {
            self.add(kind, frame, what);
        }
    }

    /// Returns the failures, each with its frame and kind.
    pub fn into_list(self) -> Vec<String> {
        self.list
    }
}

/// Returns the maximum number of loads in flight, by the same rule as the pager.
fn max_loading(config: &PagerConfig) -> u64 {
    let (start, max) = (config.http_in_flight.max(1), config.http_in_flight_max);
    let (from_servers, decoders) = (4 * start + max.saturating_sub(start), config.decode_threads.max(1));
    let others = 4 * config.file_threads.max(1) + 2 * decoders;
    (others + from_servers.max(12 * decoders)) as u64
}

/// Returns the paths of the contents that failed to load, with the reasons. Ports of local servers differ between runs and are
/// left out.
pub fn lost_tiles(pager: &DatabasePager) -> String {
    let path = |uri: &str| match uri.split_once("://").and_then(|(_, rest)| rest.split_once('/')) {
        Some((_, path)) => path.to_owned(),
        None => uri.to_owned(),
    };
    let lost: Vec<String> = pager.errors().iter().map(|e| format!("{}: {}", path(&e.uri), e.reason)).collect();
    lost.join("; ")
}

/// Checks counters, budgets and errors of a pager after an update. Budgets apply to all its scenes together.
pub fn pager(failures: &mut Failures, frame: u32, number: usize, pager: &DatabasePager, config: &PagerConfig) {
    let s = *pager.stats();
    let stats = || format!("pager {number}: {s:?}");
    failures.check(s.cpu_bytes <= config.max_bytes_cpu, "CPU bytes over the budget", frame, stats);
    failures.check(s.gpu_bytes <= config.max_bytes_gpu, "GPU bytes over the budget", frame, stats);
    failures.check(s.resident <= config.max_tiles as u64, "pages over the budget", frame, stats);
    // Pages that are loaded or uploaded and not merged yet count as well.
    let is_within = s.cpu_bytes_held_peak <= config.max_bytes_cpu && s.gpu_bytes_held_peak <= config.max_bytes_gpu;
    failures.check(is_within, "bytes of loaded pages over the budget", frame, stats);
    let pages = s.held_peak.max(s.resident + s.compiling);
    failures.check(pages <= config.max_tiles as u64, "loaded pages over the budget", frame, stats);
    let is_counted = s.cpu_bytes <= s.cpu_bytes_held && s.gpu_bytes <= s.gpu_bytes_held;
    failures.check(
        is_counted && (s.compiling > 0 || s.cpu_bytes == s.cpu_bytes_held),
        "bytes in use do not add up",
        frame,
        stats,
    );
    let ended = s.merged + s.failed + s.cancelled + s.stale + s.declined + s.dropped;
    let has_end = s.requested + s.retried == ended + s.waiting + s.in_flight;
    failures.check(has_end, "requests without exactly one outcome", frame, stats);
    failures.check(s.merged == s.expired + s.resident, "pages merged twice or lost", frame, stats);
    failures.check(s.merged <= s.loaded, "more merged than loaded", frame, stats);
    let reported: u64 = pager.errors().iter().map(|e| e.count).sum();
    let all = s.failed + s.drawables_failed;
    failures.check(reported == all, "failures not reported", frame, || format!("{reported} reported, {}", stats()));
    let loading = s.in_flight.saturating_sub(s.compiling);
    failures.check(loading <= max_loading(config), "too many loads in flight", frame, stats);
    let named = pager.errors().iter().all(|e| !e.reason.is_empty());
    failures.check(named, "an error without a reason", frame, stats);
}

/// Returns the number of pages in a scene without its roots. Each page is found once.
pub fn pages_in(scene: &Scene) -> u64 {
    let mut open: Vec<PageId> = scene.roots().to_vec();
    let mut count = 0;
    while let Some(page) = open.pop() {
        for slot in scene.slots_of_page(page) {
            if let Some(SlotState::Resident(content)) = scene.slot(slot).map(|s| s.state) {
                count += 1;
                open.push(content);
            }
        }
    }
    count
}

/// Returns true if the coarsest content is loaded. From then on, terrain must cover all pixels that it should cover.
pub fn has_ground(scene: &Scene) -> bool {
    // The first root is that of the set. Slots are in depth-first order, so the first is that of the top tile.
    scene.roots().first().is_some_and(|root| {
        let top = scene.slots_of_page(*root).next().and_then(|slot| scene.slot(slot));
        top.is_none_or(|slot| slot.depth == 0 && !slot.is_proxy && matches!(slot.state, SlotState::Resident(_)))
    })
}

/// Returns true if the middle of a camera's image must show ground once any is loaded.
pub fn sees_ground(bounds: &SetBounds, camera: &Camera) -> bool {
    HoleCheck::new(bounds).is_some_and(|check| check.must_hit(camera.eye(), camera.direction()))
}

/// Checks that each view draws something if the middle of its image must show ground. All scenes show the set of
/// `bounds`.
pub fn ground(
    failures: &mut Failures,
    frame: u32,
    viewer: &CompositeViewer,
    bounds: &SetBounds,
) -> Result<(), ViewerError> {
    for (number, (id, view)) in viewer.views().enumerate() {
        let must_show = has_ground(viewer.scene(viewer.scene_of(id)?)?) && sees_ground(bounds, &view.camera);
        failures.check(!must_show || view.tiles_drawn() > 0, "a view without ground", frame, || {
            format!("view {number}, all views together: {:?}", viewer.stats().last().copied().unwrap_or_default())
        });
    }
    Ok(())
}

/// Returns the counters that change while a pager makes progress.
pub fn progress(s: &PagerStats) -> [u64; 6] {
    [s.loaded, s.merged, s.failed, s.expired, s.declined, s.bytes_read]
}

/// A requested image: its frame, its camera, and whether ground was loaded then.
pub struct RequestedImage {
    pub frame: u32,
    pub camera: Camera,
    pub has_ground: bool,
    /// True if the middle of the image must show ground.
    pub must_show: bool,
}

/// Checks images of the first view against the cameras of their frames.
pub struct ImageChecks {
    pub requested: VecDeque<RequestedImage>,
    pub holes: Option<HoleCheck>,
    /// The number of images checked so far.
    pub checked: u64,
    pub hole_px: u64,
}

impl ImageChecks {
    /// Checks an image that was read back.
    pub fn check(&mut self, failures: &mut Failures, frame: u32, image: &RgbaImage) {
        while let Some(requested) = self.requested.pop_front() {
            if requested.frame != frame {
                continue;
            }
            self.checked += 1;
            match &self.holes {
                Some(check) if requested.has_ground => {
                    let holes = check.count(image, &requested.camera, KEY_COLOR);
                    self.hole_px += holes;
                    let size = image.dimensions();
                    failures.check(holes == 0, "a hole", frame, || format!("{holes} pixels of {size:?}"));
                }
                Some(_) => {}
                None => {
                    // NaN and pixels that were not drawn are black, like space.
                    let (width, height) = image.dimensions();
                    let middle = image.get_pixel(width / 2, height / 2).0;
                    let is_lit = !requested.must_show || middle[..3] != [0, 0, 0];
                    failures.check(is_lit, "black ground", frame, || format!("{middle:?} of {width} x {height}"));
                    let opaque = image.pixels().all(|p| p.0[3] == 255);
                    failures.check(opaque, "a transparent image", frame, || format!("{width} x {height}"));
                }
            }
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use terrane::gpu::{AdapterChoice, GraphicsContext};
    use terrane::viewer::ViewerConfig;

    use super::*;

    /// Regression: a view that draws everything hid another one that draws nothing.
    #[test]
    fn views_are_checked_separately() {
        let folder = tempfile::tempdir().unwrap();
        let set = folder.path().join("set");
        let args = terrane_data_gen::GenArgs { levels: Some(2), ..terrane_data_gen::GenArgs::new(&set) };
        terrane_data_gen::run(&args).unwrap();
        let config = ViewerConfig { adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() };
        let mut viewer = CompositeViewer::new(&config).unwrap();
        let context = viewer.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
        let scene = viewer.add_scene().unwrap();
        viewer.load(scene, set.to_str().unwrap()).unwrap();
        let bounds = *viewer.bounds(scene).unwrap().unwrap();
        let views = [(); 2].map(|()| viewer.add_view(scene, context, None).unwrap());
        let start = Instant::now();
        while !has_ground(viewer.scene(scene).unwrap()) {
            assert!(start.elapsed() < Duration::from_secs(60), "no ground was loaded within 60 s");
            viewer.frame().unwrap();
            viewer.work_until(Instant::now() + Duration::from_millis(5));
        }
        let mut check = |blind: Option<usize>| {
            for (number, view) in views.iter().enumerate() {
                let settings = &mut viewer.view_mut(*view).unwrap().camera.settings;
                settings.cull_mask = if blind == Some(number) { 0 } else { u32::MAX };
            }
            viewer.frame().unwrap();
            let mut failures = Failures::default();
            ground(&mut failures, 7, &viewer, &bounds).unwrap();
            failures.into_list()
        };
        assert_eq!(check(None), Vec::<String>::new());
        for blind in [0, 1] {
            let failures = check(Some(blind));
            let says = format!("frame 7: a view without ground: view {blind}");
            assert!(failures.len() == 1 && failures[0].starts_with(&says), "{failures:?}");
        }
    }
}
