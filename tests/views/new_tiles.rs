//! The contents of new tiles are requested before a frame is drawn. The noop adapter suffices.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use kit::server::{Reply, Server};
use kit::tile_sets::write_implicit;
use terrane::draw::CameraCallbacks;
use terrane::gpu::AdapterChoice;
use terrane::viewer::{ThreadingModel, Viewer, ViewerConfig};

fn config(threading: ThreadingModel) -> ViewerConfig {
    ViewerConfig {
        size_px: [160, 120],
        adapter: AdapterChoice::Noop,
        validation: false,
        max_sse_px: 0.5,
        threading,
        ..ViewerConfig::default()
    }
}

/// Regression: without a thread for drawing, requests waited until the frame was drawn.
#[test]
fn first_requests_leave_before_the_frame_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    write_implicit(folder.path(), 2, 1);
    let files = folder.path().to_owned();
    let is_requested = Arc::new(AtomicBool::new(false));
    let seen = is_requested.clone();
    let server = Server::start(move |request| {
        seen.fetch_or(request.path().ends_with(".subtree"), Ordering::Relaxed);
        match std::fs::read(files.join(request.path().trim_start_matches('/'))) {
            Ok(bytes) => Reply::ok(bytes),
            Err(_) => Reply::new(404, ""),
        }
    });
    let mut viewer = Viewer::new_offscreen(&config(ThreadingModel::SingleThreaded)).unwrap();
    viewer.load(&format!("{}/tileset.json", server.url)).unwrap();
    let in_time = Arc::new(AtomicBool::new(false));
    let noted = in_time.clone();
    let callbacks = CameraCallbacks {
        initial: Some(Box::new(move |_, _| {
            let end = Instant::now() + Duration::from_secs(20);
            while !is_requested.load(Ordering::Relaxed) && Instant::now() < end {
                std::thread::yield_now();
            }
            noted.store(is_requested.load(Ordering::Relaxed), Ordering::Relaxed);
        })),
        ..CameraCallbacks::default()
    };
    viewer.view_mut().set_draw_callbacks(Some(callbacks));
    viewer.frame().unwrap();
    assert!(in_time.load(Ordering::Relaxed), "the subtree was not requested during the draw of the first frame");
}
