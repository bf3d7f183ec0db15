//! No hole and no crack: low flights over a generated height set show no background below the horizon, while tiles load
//! and when all are loaded. Needs a GPU; a software adapter suffices.

use std::path::Path;

use glam::{DAffine3, DVec3};
use kit::tile_sets::generate;
use kit::viewer::offscreen;
use terrane::pager::PagerConfig;
use terrane::scene::{Sky, SlotState};
use terrane::viewer::{HoleCheck, KEY_COLOR, ThreadingModel, Viewer, ViewerConfig};
use terrane_data_gen::{Color, ContentKind};

/// Returns the number of frames of a flight.
fn frames() -> u32 {
    if kit::long_tests() { 100 } else { 30 }
}

/// The treatment of a set in a flight.
#[derive(Clone, Copy, Debug)]
struct Flight {
    refine: &'static str,
    /// See [`CullSettings::skip_sse_factor`](terrane::cull::CullSettings::skip_sse_factor).
    skip_sse_factor: f64,
    blocking: bool,
    /// Every third tile below the root's children is missing.
    has_gaps: bool,
}

impl Flight {
    /// Changes a set for the flight: sets the rule of refinement, and removes contents if it has gaps.
    fn change_set(&self, set: &Path) {
        let root = set.join("tileset.json");
        let json = std::fs::read_to_string(&root).unwrap();
        assert!(json.contains("\"REPLACE\"") || json.contains("\"ADD\""));
        let refine = format!("\"{}\"", self.refine);
        std::fs::write(&root, json.replace("\"REPLACE\"", &refine).replace("\"ADD\"", &refine)).unwrap();
        if self.has_gaps {
            let mut number = 0;
            for level in 2..5 {
                for column in std::fs::read_dir(set.join(level.to_string())).unwrap() {
                    for tile in std::fs::read_dir(column.unwrap().path()).unwrap() {
                        let path = tile.unwrap().path();
                        if path.extension().is_some_and(|e| e == "exr" || e == "glb") {
                            number += 1;
                            if number % 3 == 0 {
                                std::fs::remove_file(path).unwrap();
                            }
                        }
                    }
                }
            }
            assert!(number > 100);
        }
    }
}

/// Generates a set without colours, which holes do not depend on.
fn write_set(folder: &Path, content: ContentKind, seed: u64) -> String {
    generate(&folder.join(format!("{content:?}-{seed}")), |args| {
        (args.levels, args.seed, args.size) = (Some(5), seed, 20_000.0);
        (args.content, args.color) = (content, Color::None);
    })
}

/// Returns the number of hole pixels in a low flight, and that of checked pixels.
fn fly_low(set: &str, flight: &Flight) -> Option<(u64, u64)> {
    let config = ViewerConfig {
        size_px: [320, 180],
        threading: ThreadingModel::DrawThreadPerContext,
        adapter: kit::adapter(),
        max_sse_px: 3.0,
        skip_sse_factor: flight.skip_sse_factor,
        pager: PagerConfig { blocking: flight.blocking, ..PagerConfig::default() },
        ..ViewerConfig::default()
    };
    let mut viewer = offscreen(&config)?;
    viewer.load(set).unwrap();
    show_holes(&mut viewer);
    let bounds = *viewer.bounds().unwrap();
    // The path leads from edge to edge just above the highest point, looking down a little.
    let half = bounds.half_size_m;
    let eye_at = |share: f64| {
        let z = bounds.middle_m.z + half.z + 0.02 * half.y;
        DVec3::new(bounds.middle_m.x + 0.1 * half.x, bounds.middle_m.y + half.y * (1.6 * share - 0.9), z)
    };
    // The root is loaded before the first frame that is checked.
    viewer.view_mut().camera.world_from_eye = pose(&bounds, eye_at(0.0), 0.0);
    let root = |viewer: &Viewer| viewer.scene().tiles().next().and_then(|tile| tile.state);
    while !matches!(root(&viewer), Some(SlotState::Resident(_)))
        || viewer.stats().last().is_none_or(|s| s.tiles_drawn == 0)
    {
        viewer.frame().unwrap();
    }
    let pose_at = |share: f64| pose(&bounds, eye_at(share), 0.6 * (share * 12.0).sin());
    Some(count_holes(&mut viewer, "viewer_holes", frames(), pose_at))
}

/// Replaces sky and air by a colour that is seen through holes.
pub(super) fn show_holes(viewer: &mut Viewer) {
    viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
    viewer.view_mut().environment.fog.enabled = false;
}

/// Draws the frames of a flight, whose camera `pose_at` a share of the flight has. Returns the number of hole pixels, and that
/// of checked pixels. The first picture with a hole is kept under a name.
pub(super) fn count_holes(
    viewer: &mut Viewer,
    name: &str,
    frames: u32,
    pose_at: impl Fn(f64) -> DAffine3,
) -> (u64, u64) {
    let check = HoleCheck::new(viewer.bounds().unwrap()).expect("a set with known bounds");
    let (mut holes, mut judged) = (0, 0);
    for frame in 0..frames {
        viewer.view_mut().camera.world_from_eye = pose_at(f64::from(frame) / f64::from(frames - 1));
        viewer.want_picture();
        viewer.frame().unwrap();
        let camera = viewer.view().camera;
        viewer.finish().unwrap();
        for (number, picture) in viewer.take_pictures() {
            let found = check.count(&picture, &camera, KEY_COLOR);
            if found > 0 && holes == 0 {
                let file = std::env::temp_dir().join(format!("{name}-{number}.actual.png"));
                picture.save(&file).unwrap();
                eprintln!("frame {number}: {found} hole pixels, see {}", file.display());
            }
            holes += found;
            let all = image::RgbaImage::from_pixel(32, 18, image::Rgba([255, 0, 255, 255]));
            judged += 100 * check.count(&all, &camera, KEY_COLOR);
        }
    }
    (holes, judged)
}

fn pose(bounds: &terrane::viewer::SetBounds, eye: DVec3, turn: f64) -> DAffine3 {
    let direction = DVec3::new(turn.sin(), turn.cos(), -0.35);
    bounds.frame.world_from_local * terrane::viewer::world_from_eye(eye, direction, DVec3::Z)
}

/// Flights over both kinds of content, each with its terrain, both rules of refinement, skipped levels and missing tiles. A long
/// test flies each over another terrain.
#[test]
fn no_holes_while_loading_nor_when_settled() {
    let usual = Flight { refine: "REPLACE", skip_sse_factor: 1.0, blocking: false, has_gaps: false };
    let skipping = Flight { skip_sse_factor: 16.0, ..usual };
    let adding = Flight { refine: "ADD", ..usual };
    // Gaps are last, since they remove files of the set.
    let with_gaps = Flight { has_gaps: true, ..usual };
    let over_heights = [usual, Flight { blocking: true, ..usual }, skipping, adding, with_gaps];
    let over_meshes = [usual, Flight { blocking: true, ..skipping }, adding, with_gaps];
    for (first_seed, content, flights) in
        [(1, ContentKind::Height, &over_heights[..]), (101, ContentKind::Mesh, &over_meshes[..])]
    {
        let folder = tempfile::tempdir().unwrap();
        let mut set = write_set(folder.path(), content, first_seed);
        for (seed, flight) in (first_seed + 1..).zip(flights) {
            flight.change_set(Path::new(&set));
            let Some((holes, judged)) = fly_low(&set, flight) else { return };
            assert!(
                judged > u64::from(frames()) * 320 * 180 / 10,
                "hardly any pixel was checked: {judged}, {flight:?}"
            );
            assert_eq!(holes, 0, "{content:?}, {flight:?}");
            if kit::long_tests() {
                set = write_set(folder.path(), content, seed);
            }
        }
    }
}
