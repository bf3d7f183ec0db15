//! What must hold in each frame, whatever the flight and the faults.

use std::collections::VecDeque;

use image::RgbaImage;
use terrane::pager::{DatabasePager, PagerConfig, PagerStats};
use terrane::scene::{PageId, Scene, SlotState};
use terrane::viewer::{Camera, CompositeViewer, HoleCheck, KEY_COLOR, SetBounds, ViewerError};

/// Failures that are kept of a seed; the first says most.
const MOST_FAILURES: usize = 20;

/// What did not hold, each kind once.
#[derive(Debug, Default)]
pub struct Failures {
    list: Vec<String>,
    kinds: Vec<&'static str>,
}

impl Failures {
    /// Notes what did not hold.
    pub fn add(&mut self, kind: &'static str, frame: u32, what: impl FnOnce() -> String) {
        if !self.kinds.contains(&kind) && self.list.len() < MOST_FAILURES {
            self.kinds.push(kind);
            self.list.push(format!("frame {frame}: {kind}: {}", what()));
        }
    }

    pub fn check(&mut self, holds: bool, kind: &'static str, frame: u32, what: impl FnOnce() -> String) {
        if !holds {
            self.add(kind, frame, what);
        }
    }

    pub fn into_list(self) -> Vec<String> {
        self.list
    }
}

/// Loads that the threads and servers may have at once, as the pager reckons it.
fn most_loading(config: &PagerConfig) -> u64 {
    let (start, most) = (config.http_in_flight.max(1), config.http_in_flight_max);
    let (of_servers, decoders) = (4 * start + most.saturating_sub(start), config.decode_threads.max(1));
    let beside = 4 * config.file_threads.max(1) + 2 * decoders;
    (beside + of_servers.max(12 * decoders)) as u64
}

/// Counters, budgets and reports of a pager, after an update. Budgets are of all its scenes together.
pub fn pager(failures: &mut Failures, frame: u32, place: usize, pager: &DatabasePager, config: &PagerConfig) {
    let s = *pager.stats();
    let told = || format!("pager {place}: {s:?}");
    failures.check(s.cpu_bytes <= config.max_bytes_cpu, "CPU bytes over the budget", frame, told);
    failures.check(s.gpu_bytes <= config.max_bytes_gpu, "GPU bytes over the budget", frame, told);
    failures.check(s.resident <= config.max_tiles as u64, "pages over the budget", frame, told);
    // With what is loaded, uploaded and not merged.
    let is_within = s.cpu_bytes_held_peak <= config.max_bytes_cpu && s.gpu_bytes_held_peak <= config.max_bytes_gpu;
    failures.check(is_within, "arrived bytes over the budget", frame, told);
    let pages = s.held_peak.max(s.resident + s.compiling);
    failures.check(pages <= config.max_tiles as u64, "arrived pages over the budget", frame, told);
    let is_counted = s.cpu_bytes <= s.cpu_bytes_held && s.gpu_bytes <= s.gpu_bytes_held;
    failures.check(is_counted && (s.compiling > 0 || s.cpu_bytes == s.cpu_bytes_held), "held bytes", frame, told);
    let ended = s.merged + s.failed + s.cancelled + s.stale + s.declined + s.dropped;
    let has_end = s.requested + s.retried == ended + s.waiting + s.in_flight;
    failures.check(has_end, "requests that have no end or two", frame, told);
    failures.check(s.merged == s.expired + s.resident, "pages merged twice or lost", frame, told);
    failures.check(s.merged <= s.loaded, "more merged than loaded", frame, told);
    let reported: u64 = pager.errors().iter().map(|e| e.count).sum();
    let of_all = s.failed + s.drawables_failed;
    failures.check(reported == of_all, "failures not reported", frame, || format!("{reported} reported, {}", told()));
    let loading = s.in_flight.saturating_sub(s.compiling);
    failures.check(loading <= most_loading(config), "more under way than may be", frame, told);
    let named = pager.errors().iter().all(|e| !e.reason.is_empty());
    failures.check(named, "a failure without a reason", frame, told);
}

/// Pages that hang in the scene, roots left out; each is found once.
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

/// The coarsest contents are there: from now on no pixel that must show terrain may lack it.
pub fn has_ground(scene: &Scene) -> bool {
    // The set's root is the first; of its slots, depth first, the first is the top tile's.
    scene.roots().first().is_some_and(|root| {
        let top = scene.slots_of_page(*root).next().and_then(|slot| scene.slot(slot));
        top.is_none_or(|slot| slot.depth == 0 && !slot.is_proxy && matches!(slot.state, SlotState::Resident(_)))
    })
}

/// The middle of a camera's picture must show ground, once there is any.
pub fn sees_ground(bounds: &SetBounds, camera: &Camera) -> bool {
    HoleCheck::new(bounds).is_some_and(|check| check.must_hit(camera.eye(), camera.direction()))
}

/// Each view draws something where the middle of its own picture must show ground. All scenes show the set of `bounds`.
pub fn ground(
    failures: &mut Failures,
    frame: u32,
    viewer: &CompositeViewer,
    bounds: &SetBounds,
) -> Result<(), ViewerError> {
    for (place, (id, view)) in viewer.views().enumerate() {
        let must_show = has_ground(viewer.scene(viewer.scene_of(id)?)?) && sees_ground(bounds, &view.camera);
        failures.check(!must_show || view.tiles_drawn() > 0, "nothing where ground is", frame, || {
            format!("view {place}, all together: {:?}", viewer.stats().last().copied().unwrap_or_default())
        });
    }
    Ok(())
}

/// Numbers that change while a pager gets anywhere.
pub fn progress(s: &PagerStats) -> [u64; 6] {
    [s.loaded, s.merged, s.failed, s.expired, s.declined, s.bytes_read]
}

/// A picture that was asked for: its frame, the camera, and whether there was ground then.
pub struct Asked {
    pub frame: u32,
    pub camera: Camera,
    pub has_ground: bool,
    /// Its middle must show ground.
    pub must_show: bool,
}

/// Pictures of the first view, against the cameras they were taken with.
pub struct Pictures {
    pub asked: VecDeque<Asked>,
    pub holes: Option<HoleCheck>,
    /// Looked at so far.
    pub seen: u64,
    pub hole_px: u64,
}

impl Pictures {
    pub fn look(&mut self, failures: &mut Failures, frame: u32, picture: &RgbaImage) {
        while let Some(asked) = self.asked.pop_front() {
            if asked.frame != frame {
                continue;
            }
            self.seen += 1;
            match &self.holes {
                Some(check) if asked.has_ground => {
                    let holes = check.count(picture, &asked.camera, KEY_COLOR);
                    self.hole_px += holes;
                    let size = picture.dimensions();
                    failures.check(holes == 0, "a hole", frame, || format!("{holes} pixels of {size:?}"));
                }
                Some(_) => {}
                None => {
                    // A driver makes black of what is not a number, and of what was not drawn; so is space.
                    let (width, height) = picture.dimensions();
                    let middle = picture.get_pixel(width / 2, height / 2).0;
                    let is_lit = !asked.must_show || middle[..3] != [0, 0, 0];
                    failures.check(is_lit, "black ground", frame, || format!("{middle:?} of {width} x {height}"));
                    let opaque = picture.pixels().all(|p| p.0[3] == 255);
                    failures.check(opaque, "a transparent picture", frame, || format!("{width} x {height}"));
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

    /// A view that draws all there is hid another that draws nothing.
    #[test]
    fn each_view_is_looked_at_by_itself() {
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
            assert!(start.elapsed() < Duration::from_secs(60), "no ground comes");
            viewer.frame().unwrap();
            viewer.work_until(Instant::now() + Duration::from_millis(5));
        }
        let mut looked = |blind: Option<usize>| {
            for (place, view) in views.iter().enumerate() {
                let settings = &mut viewer.view_mut(*view).unwrap().camera.settings;
                settings.cull_mask = if blind == Some(place) { 0 } else { u32::MAX };
            }
            viewer.frame().unwrap();
            let mut failures = Failures::default();
            ground(&mut failures, 7, &viewer, &bounds).unwrap();
            failures.into_list()
        };
        assert_eq!(looked(None), Vec::<String>::new());
        for blind in [0, 1] {
            let failures = looked(Some(blind));
            let says = format!("frame 7: nothing where ground is: view {blind}");
            assert!(failures.len() == 1 && failures[0].starts_with(&says), "{failures:?}");
        }
    }
}
