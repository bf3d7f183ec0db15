//! No hole and no crack: low flights over a generated height set show no background below the horizon, while tiles load
//! and when all are loaded. Needs a GPU; a software adapter suffices.

use std::path::Path;
use terrane::scene::Sky;

use kit::viewer::offscreen;

use terrane::pager::PagerConfig;
use terrane::viewer::{HoleCheck, KEY_COLOR, ThreadingModel, ViewerConfig};

const FRAMES: u32 = 200;

fn height_set(folder: &Path) -> String {
    let set = folder.join("set");
    let args =
        terrane_data_gen::GenArgs { levels: Some(5), seed: 11, size: 20_000.0, ..terrane_data_gen::GenArgs::new(&set) };
    terrane_data_gen::run(&args).unwrap();
    set.display().to_string()
}

/// Returns the number of hole pixels in a low flight, and that of checked pixels.
fn fly_low(set: &str, blocking: bool) -> Option<(u64, u64)> {
    let config = ViewerConfig {
        size_px: [320, 180],
        threading: ThreadingModel::DrawThreadPerContext,
        adapter: kit::adapter(),
        max_sse_px: 3.0,
        pager: PagerConfig { blocking, ..PagerConfig::default() },
        ..ViewerConfig::default()
    };
    let mut viewer = offscreen(&config)?;
    viewer.load(set).unwrap();
    viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
    viewer.view_mut().environment.fog.enabled = false;
    let bounds = *viewer.bounds().unwrap();
    let check = HoleCheck::new(&bounds).expect("a height set has known bounds");
    // The path leads from edge to edge just above the highest point, looking down a little.
    let half = bounds.half_size_m;
    let eye_at = |share: f64| {
        let z = bounds.middle_m.z + half.z + 0.02 * half.y;
        glam::DVec3::new(bounds.middle_m.x + 0.1 * half.x, bounds.middle_m.y + half.y * (1.6 * share - 0.9), z)
    };
    // The root is loaded before the first frame that is checked.
    viewer.view_mut().camera.world_from_eye = pose(&bounds, eye_at(0.0), 0.0);
    while viewer.stats().last().is_none_or(|s| s.tiles_drawn == 0) {
        viewer.frame().unwrap();
    }
    let (mut holes, mut judged) = (0, 0);
    for frame in 0..FRAMES {
        let share = f64::from(frame) / f64::from(FRAMES - 1);
        viewer.view_mut().camera.world_from_eye = pose(&bounds, eye_at(share), 0.6 * (share * 12.0).sin());
        viewer.want_picture();
        viewer.frame().unwrap();
        let camera = viewer.view().camera;
        viewer.finish().unwrap();
        for (number, picture) in viewer.take_pictures() {
            let found = check.count(&picture, &camera, KEY_COLOR);
            if found > 0 && holes == 0 {
                let file = std::env::temp_dir().join(format!("viewer_holes-{number}.actual.png"));
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

fn pose(bounds: &terrane::viewer::SetBounds, eye: glam::DVec3, turn: f64) -> glam::DAffine3 {
    let direction = glam::DVec3::new(turn.sin(), turn.cos(), -0.35);
    bounds.frame.world_from_local * terrane::viewer::world_from_eye(eye, direction, glam::DVec3::Z)
}

#[test]
fn no_holes_while_loading_nor_when_settled() {
    let folder = tempfile::tempdir().unwrap();
    let set = height_set(folder.path());
    for blocking in [false, true] {
        let Some((holes, judged)) = fly_low(&set, blocking) else { return };
        assert!(judged > u64::from(FRAMES) * 320 * 180 / 10, "hardly any pixel was checked: {judged}");
        assert_eq!(holes, 0, "blocking: {blocking}");
    }
}
