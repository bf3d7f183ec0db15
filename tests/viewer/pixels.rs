//! Equal paths give equal images in blocking mode with every threading model, and stages and contexts end in order.
//! Needs a GPU; a software adapter suffices.

use image::RgbaImage;
use kit::tile_sets::mountains;
use kit::viewer::offscreen;
use terrane::gpu::AdapterChoice;
use terrane::pager::PagerConfig;
use terrane::viewer::{ThreadingModel, Viewer, ViewerConfig, ViewerError};

/// The number of frames of a flight.
const FRAMES: u32 = 30;

fn config(threading: ThreadingModel) -> ViewerConfig {
    ViewerConfig {
        size_px: [320, 180],
        threading,
        adapter: kit::adapter(),
        max_sse_px: 3.0,
        pager: PagerConfig { blocking: true, ..PagerConfig::default() },
        ..ViewerConfig::default()
    }
}

/// Returns every fifth image of the default path.
fn fly(set: &str, threading: ThreadingModel) -> Option<Vec<RgbaImage>> {
    let mut viewer = offscreen(&config(threading))?;
    viewer.load(set).unwrap();
    let path = viewer.bounds().unwrap().default_path(&viewer.view().camera.world_from_eye);
    for frame in 0..FRAMES {
        let time_s = path.duration_s() * f64::from(frame) / f64::from(FRAMES - 1);
        viewer.view_mut().camera.world_from_eye = path.world_from_eye(time_s);
        if frame % 5 == 0 {
            viewer.want_picture();
        }
        viewer.frame_at(time_s).unwrap();
        assert!(viewer.is_settled(), "frame {frame} of the blocking mode is not complete");
    }
    viewer.finish().unwrap();
    assert_eq!(viewer.stats().iter().filter(|s| s.drawn).count(), FRAMES as usize);
    Some(viewer.take_pictures().into_iter().map(|(_, picture)| picture).collect())
}

#[test]
fn same_path_gives_the_same_pixels_in_every_threading_model() {
    let folder = tempfile::tempdir().unwrap();
    let set = mountains(folder.path(), 4);
    let Some(first) = fly(&set, ThreadingModel::SingleThreaded) else { return };
    assert_eq!(first.len(), 6);
    let colours: std::collections::BTreeSet<_> = first[2].pixels().map(|p| p.0).collect();
    assert!(colours.len() > 50, "the image is empty: {} colours", colours.len());
    for threading in ThreadingModel::ALL {
        let again = fly(&set, threading).unwrap();
        for (index, (a, b)) in first.iter().zip(&again).enumerate() {
            let differing = a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
            assert_eq!(differing, 0, "{threading}: image {index} differs in {differing} pixels");
        }
    }
}

#[test]
fn threading_model_changes_at_run_time() {
    let folder = tempfile::tempdir().unwrap();
    let set = mountains(folder.path(), 4);
    let Some(expected) = fly(&set, ThreadingModel::SingleThreaded) else { return };
    let mut viewer = offscreen(&config(ThreadingModel::SingleThreaded)).unwrap();
    viewer.load(&set).unwrap();
    let path = viewer.bounds().unwrap().default_path(&viewer.view().camera.world_from_eye);
    let models = ThreadingModel::ALL;
    for frame in 0..FRAMES {
        // Each model follows each other one, in the middle of the flight.
        let model = models[(frame as usize * (1 + frame as usize / 10)) % 4];
        viewer.composite_mut().set_threading_model(model).unwrap();
        assert_eq!(viewer.composite().threading_model(), model);
        let time_s = path.duration_s() * f64::from(frame) / f64::from(FRAMES - 1);
        viewer.view_mut().camera.world_from_eye = path.world_from_eye(time_s);
        if frame % 5 == 0 {
            viewer.want_picture();
        }
        viewer.frame_at(time_s).unwrap();
    }
    viewer.finish().unwrap();
    assert_eq!(viewer.stats().iter().filter(|s| s.drawn).count(), FRAMES as usize);
    let pictures = viewer.take_pictures();
    assert_eq!(pictures.len(), expected.len());
    for ((frame, picture), expected) in pictures.iter().zip(&expected) {
        assert!(picture == expected, "frame {frame} differs");
    }
}

#[test]
fn settled_view_does_not_change() {
    let folder = tempfile::tempdir().unwrap();
    let set = mountains(folder.path(), 4);
    let Some(mut viewer) = offscreen(&config(ThreadingModel::DrawThreadPerContext)) else { return };
    viewer.load(&set).unwrap();
    viewer.frame().unwrap();
    let before = viewer.read_back().unwrap();
    let settled = viewer.settled().unwrap();
    assert!(settled.coverage > 0.05 && settled.coverage < 0.95 && settled.tiles > 0, "{settled:?}");
    let drawn = viewer.drawn_contents();
    assert_eq!(drawn.len() as u64, settled.contents);
    let selected = viewer.selected_contents();
    assert!(drawn.iter().all(|uri| selected.contains(uri)), "{drawn:?} {selected:?}");
    for _ in 0..5 {
        viewer.frame().unwrap();
    }
    assert!(viewer.read_back().unwrap() == before, "reading the image has changed it");
    assert!(viewer.converge_s().is_some());
}

#[test]
fn viewer_is_resized_and_dropped_at_any_time() {
    let folder = tempfile::tempdir().unwrap();
    let set = mountains(folder.path(), 4);
    for threading in ThreadingModel::ALL {
        let mut config = config(threading);
        config.pager.blocking = false;
        let Some(mut viewer) = offscreen(&config) else { return };
        viewer.load(&set).unwrap();
        viewer.frame().unwrap();
        viewer.resize([123, 77]).unwrap();
        viewer.frame().unwrap();
        let picture = viewer.read_back().unwrap();
        assert_eq!((picture.width(), picture.height()), (123, 77));
        for _ in 0..3 {
            viewer.frame().unwrap();
        }
        // It is dropped with frames and loads in flight.
    }
}

#[test]
fn frames_run_without_a_gpu() {
    let folder = tempfile::tempdir().unwrap();
    let set = mountains(folder.path(), 4);
    let mut viewer = Viewer::new_offscreen(&ViewerConfig {
        adapter: AdapterChoice::Noop,
        validation: false,
        ..config(ThreadingModel::DrawThreadPerContext)
    })
    .unwrap();
    viewer.load(&set).unwrap();
    for _ in 0..5 {
        viewer.frame().unwrap();
    }
    let report = viewer.report().unwrap();
    assert_eq!(report.frames, 5);
    assert!(report.tiles.merged > 0 && report.draw.triangles > 0, "{report:?}");
}

#[test]
fn missing_root_is_an_error() {
    let config = ViewerConfig { adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    let error = viewer.load("no/such/set").unwrap_err();
    assert!(matches!(error, ViewerError::Io(_)) && error.to_string().contains("no/such/set"), "{error}");
    // Without a root nothing is drawn, which is no error.
    viewer.frame().unwrap();
}
