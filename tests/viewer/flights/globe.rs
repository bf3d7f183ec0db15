//! Flights from 20,000 km to 100 m above the ground: no background is seen where the earth is. Needs a GPU; a software
//! adapter suffices.

use glam::DVec3;
use kit::quantized::{tile_at, write_set};
use kit::viewer::offscreen;
use terrane::math::{Geodetic, WGS84};
use terrane::pager::PagerConfig;
use terrane::scene::Sky;
use terrane::viewer::{HoleCheck, KEY_COLOR, LoadedRoot, ViewerConfig, world_from_eye};

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
    viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
    viewer.view_mut().environment.fog.enabled = false;
    let bounds = *viewer.bounds().unwrap();
    assert!(bounds.frame.georeferenced, "a globe is on the earth");
    let check = HoleCheck::new(&bounds).expect("a globe has known bounds");
    let [longitude, latitude] = PLACE;
    let (mut holes, mut judged) = (0, 0);
    for frame in 0..FRAMES {
        let share = f64::from(frame) / f64::from(FRAMES - 1);
        let height_m = ground_m + 2e7 * (5e-6f64).powf(share);
        let eye = Geodetic { longitude, latitude, height_m };
        let local = WGS84.ecef_from_enu(&eye);
        // Straight down from space, and along the ground in the end.
        let pitch = (1.0 - share) * -1.5 - 0.1;
        let direction = local.matrix3 * DVec3::new(0.3 * pitch.cos(), pitch.cos(), pitch.sin());
        viewer.view_mut().camera.world_from_eye = world_from_eye(local.translation, direction, local.matrix3.z_axis);
        viewer.want_picture();
        viewer.frame().unwrap();
        let camera = viewer.view().camera;
        viewer.finish().unwrap();
        for (number, picture) in viewer.take_pictures() {
            let found = check.count(&picture, &camera, KEY_COLOR);
            if found > 0 && holes == 0 {
                let file = std::env::temp_dir().join(format!("viewer_globe-{number}.actual.png"));
                picture.save(&file).unwrap();
                eprintln!("frame {number}: {found} hole pixels, see {}", file.display());
            }
            holes += found;
            let all = image::RgbaImage::from_pixel(32, 18, image::Rgba([255, 0, 255, 255]));
            judged += 100 * check.count(&all, &camera, KEY_COLOR);
        }
    }
    Some((holes, judged))
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
