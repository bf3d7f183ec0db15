//! Flights from 20,000 km to 100 m above the ground: no background is seen where the earth is. Needs a GPU; a software
//! adapter suffices.

use glam::DVec3;
use kit::quantized::{tile_at, write_set};
use kit::viewer::offscreen;
use terrane::math::{Geodetic, WGS84};
use terrane::pager::PagerConfig;
use terrane::viewer::{LoadedRoot, ViewerConfig, world_from_eye};

use super::holes::{count_holes, show_holes};

const FRAMES: u32 = 30;
/// A place near the antimeridian, radians.
const PLACE: [f64; 2] = [3.1413, -0.52];

fn height(longitude: f64, latitude: f64) -> f64 {
    900.0 + 800.0 * (90.0 * longitude).sin() * (80.0 * latitude).cos()
}

/// Returns the number of hole pixels in a flight down to the place, and that of checked pixels.
fn fly_down(root: LoadedRoot, config: &ViewerConfig, ground_m: f64) -> Option<(u64, u64)> {
    let mut viewer = offscreen(config)?;
    viewer.set_root(root).unwrap();
    show_holes(&mut viewer);
    assert!(viewer.bounds().unwrap().frame.is_georeferenced(), "a globe is on the earth");
    let [longitude, latitude] = PLACE;
    let pose_at = |share: f64| {
        let height_m = ground_m + 2e7 * (5e-6f64).powf(share);
        let local = WGS84.ecef_from_enu(&Geodetic { longitude, latitude, height_m });
        // Straight down from space, and along the ground in the end.
        let pitch = (1.0 - share) * -1.5 - 0.1;
        let direction = local.matrix3 * DVec3::new(0.3 * pitch.cos(), pitch.cos(), pitch.sin());
        world_from_eye(local.translation, direction, local.matrix3.z_axis)
    };
    Some(count_holes(&mut viewer, "viewer_globe", FRAMES, pose_at))
}

#[test]
fn earth_has_no_holes_from_orbit_to_the_ground() {
    let config = ViewerConfig {
        size_px: [320, 180],
        adapter: kit::adapter(),
        pager: PagerConfig { blocking: true, ..PagerConfig::default() },
        ..ViewerConfig::default()
    };
    let folder = tempfile::tempdir().unwrap();
    // Two levels of the whole earth; below them the quads that hold the place, of which some have gaps.
    let contains = |level, x, y| tile_at(level, PLACE[0], PLACE[1]) == [level, x, y];
    let has = |[level, x, y]: [u32; 3]| {
        level < 2 || contains(level, x, y) || contains(level - 1, x / 2, y / 2) && (x + y + level) % 3 != 0
    };
    write_set(folder.path(), 12, has, height);
    let terrain = LoadedRoot::read(folder.path().to_str().unwrap(), &config.pager).unwrap();
    let ground = height(PLACE[0], PLACE[1]);
    for (root, ground_m) in [(LoadedRoot::ellipsoid(&config.pager).unwrap(), 0.0), (terrain, ground)] {
        let Some((holes, judged)) = fly_down(root, &config, ground_m) else { return };
        assert!(judged > u64::from(FRAMES) * 320 * 180 / 10, "hardly any pixel was checked: {judged}");
        assert_eq!(holes, 0);
    }
}
