//! The hand-over of render stages between update, cull and draw under shuttle.
//!
//! The library's own rendering stage runs with its threads, queues and barriers, around stand-ins that check their
//! input. A schedule fails if a frame is not drawn, is drawn from data under change, or if a thread waits forever.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::schedules::{check, check_fairly, primitives};
use crate::stand_ins::{Panics, Reads, Seen, cull, draw, gpu, pager};
use crate::viewer::{Devices, ThreadingModel, Viewer, ViewerError};

use ThreadingModel::{CullDrawThreadPerContext, CullThreadPerCameraDrawThreadPerContext, DrawThreadPerContext};

/// Two contexts with separate devices, each with one camera.
const TWO_DEVICES: Devices = &[&[1], &[1]];
/// A device with two contexts, one with two cameras and one with one.
const TWO_CONTEXTS: Devices = &[&[2, 1]];

fn cameras(devices: Devices) -> usize {
    devices.iter().copied().flatten().sum()
}

/// The number of frames is greater than the number of stages of a camera.
const FRAMES: u32 = 4;

/// Checks that each camera is drawn in each frame, in order, and that all contexts show it together. The main thread is
/// alone with the scene in each update, and draw reads the data of its frame's update. Returns true if some schedule
/// culled a camera while an earlier frame of it was drawn.
fn draws_each_frame_once(model: ThreadingModel, devices: Devices, reads: Reads) -> bool {
    let overlapped = Arc::new(AtomicBool::new(false));
    let of_model = overlapped.clone();
    check(move || {
        let seen = Seen::new(reads, Panics::Never, cameras(devices), &of_model);
        let mut viewer = Viewer::new(model, devices, seen);
        (0..FRAMES).for_each(|_| viewer.frame().unwrap());
        viewer.finish().unwrap();
        for camera in 0..cameras(devices) {
            assert_eq!(viewer.seen.drawn(camera as u32), [1, 2, 3, 4], "camera {camera}");
        }
        assert!(viewer.is_alone());
    });
    overlapped.load(Ordering::Relaxed)
}

#[test]
fn model_without_overlap_draws_each_frame_before_the_next_update() {
    for devices in [TWO_DEVICES, TWO_CONTEXTS] {
        // This holds for any data that draw reads.
        assert!(!draws_each_frame_once(CullDrawThreadPerContext, devices, Reads::InTheFrame));
    }
}

#[test]
fn models_with_overlap_draw_each_frame_once_during_the_next_cull() {
    for model in [DrawThreadPerContext, CullThreadPerCameraDrawThreadPerContext] {
        for devices in [TWO_DEVICES, TWO_CONTEXTS] {
            assert!(draws_each_frame_once(model, devices, Reads::Nothing), "{model}");
        }
    }
}

#[test]
fn update_does_not_change_data_that_draw_still_reads() {
    for model in [DrawThreadPerContext, CullThreadPerCameraDrawThreadPerContext] {
        for reads in [Reads::InTheFrame, Reads::InCallbacks] {
            assert!(!draws_each_frame_once(model, TWO_DEVICES, reads), "{model}");
        }
    }
}

/// Threads end in any wait: without a frame in flight, with one, and with the maximum number.
#[test]
fn threads_end_with_the_viewer_at_any_time() {
    for model in &ThreadingModel::ALL[1..] {
        for frames in 1..=3 {
            check(move || {
                let seen = Seen::new(Reads::Nothing, Panics::Never, 2, &Arc::default());
                let mut viewer = Viewer::new(*model, TWO_DEVICES, seen);
                (0..frames).for_each(|_| viewer.frame().unwrap());
            });
        }
    }
}

/// Stages that ended threads have not drawn are dropped, and can be culled into again.
#[test]
fn frames_continue_in_another_model() {
    for model in &ThreadingModel::ALL {
        check(move || {
            let seen = Seen::new(Reads::Nothing, Panics::Never, 2, &Arc::default());
            let mut viewer = Viewer::new(CullThreadPerCameraDrawThreadPerContext, TWO_DEVICES, seen);
            (0..2).for_each(|_| viewer.frame().unwrap());
            viewer.seen.is_ending.store(true, Ordering::SeqCst);
            viewer.set_model(*model);
            viewer.seen.is_ending.store(false, Ordering::SeqCst);
            (0..3).for_each(|_| viewer.frame().unwrap());
            viewer.finish().unwrap();
            for camera in 0..2 {
                let drawn = viewer.seen.drawn(camera);
                assert!(drawn.is_sorted_by(|a, b| a < b) && drawn.ends_with(&[3, 4, 5]), "{drawn:?}");
            }
        });
    }
}

/// The panic is an error of a frame soon after, and of all later frames. The scene can be changed, because no draw
/// reads it, and the remaining threads end.
#[test]
fn panic_of_a_thread_is_reported_and_nothing_waits_for_it() {
    let in_draw = Panics::InDraw { camera: 1, frame: 2 };
    let in_cull = Panics::InCull { camera: 1, frame: 2 };
    let models = [
        (CullDrawThreadPerContext, in_draw),
        (CullDrawThreadPerContext, in_cull),
        (DrawThreadPerContext, in_draw),
        (CullThreadPerCameraDrawThreadPerContext, in_draw),
        (CullThreadPerCameraDrawThreadPerContext, in_cull),
    ];
    for (model, panics) in models {
        for reads in [Reads::Nothing, Reads::InTheFrame] {
            // A barrier that one thread has left does not block the other cull.
            check_fairly(move || {
                let seen = Seen::new(reads, panics, 2, &Arc::default());
                let mut viewer = Viewer::new(model, TWO_DEVICES, seen);
                let error = (0..FRAMES + 2).find_map(|_| viewer.frame().err()).expect("the panic is reported");
                assert!(matches!(error, ViewerError::DrawThreadStopped), "{error}");
                assert!(viewer.is_alone());
                assert!(viewer.frame().is_err(), "the error stays");
                assert!(viewer.is_alone());
            });
        }
    }
}
