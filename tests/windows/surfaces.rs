//! A window's surface that is late, outdated, lost or suboptimal while its device works. Frames are skipped and
//! counted, the surface is configured or created again, and the window shows the same as before. Needs Xvfb and a GPU;
//! a software adapter suffices. Skipped without them.

use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use glam::DVec3;
use image::RgbaImage;
use kit::display::Display;
use kit::process::test_name;
use kit::shapes::ball;
use kit::skip::skipped_unless_required;
use kit::viewer::Settle;

use terrane::gpu::{AdapterChoice, SurfaceAnswer};
use terrane::scene::{Node, Page, Sky};
use terrane::viewer::{ContextId, ThreadingModel, Viewer, ViewerConfig, ViewerError};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::platform::x11::EventLoopBuilderExtX11 as _;
use winit::window::{Window, WindowId};

use SurfaceAnswer::{Lost, Occluded, Outdated, Suboptimal, Timeout};

/// The time after which a frame counts as hanging.
const PATIENCE: Duration = Duration::from_secs(120);

/// Runs [`on_a_display`] in a separate process, which has a display.
#[test]
fn surface_recovers_without_losing_its_device() {
    let Some(display) = Display::start([640, 480]) else { return };
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", &test_name(module_path!(), "on_a_display"), "--ignored", "--nocapture"])
        .env("DISPLAY", &display.name)
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("WAYLAND_SOCKET")
        .output()
        .unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    said.lines().filter(|line| line.contains("skipped") || line.contains("checked")).for_each(|l| println!("{l}"));
    assert!(output.status.success(), "{}: {said}", output.status);
    assert!(said.contains("checked") || said.contains("skipped"), "{said}");
}

/// The body of the other test.
#[test]
#[ignore = "needs a display of its own: the other test gives it one"]
fn on_a_display() {
    std::thread::spawn(|| {
        std::thread::sleep(PATIENCE);
        eprintln!("a frame waits forever");
        std::process::exit(3);
    });
    let event_loop = EventLoop::builder().with_any_thread(true).build().unwrap();
    event_loop.set_control_flow(ControlFlow::Poll);
    event_loop.run_app(&mut Surfaces { is_done: false }).unwrap();
}

struct Surfaces {
    is_done: bool,
}

impl ApplicationHandler for Surfaces {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if std::mem::replace(&mut self.is_done, true) {
            return;
        }
        let attributes = Window::default_attributes().with_inner_size(PhysicalSize::new(96, 64));
        let window = Arc::new(event_loop.create_window(attributes).unwrap());
        for model in ThreadingModel::ALL {
            if !check(&window, model) {
                break;
            }
        }
        event_loop.exit();
    }

    fn window_event(&mut self, _: &ActiveEventLoop, _: WindowId, _: WindowEvent) {}
}

fn picture(viewer: &mut Viewer, context: ContextId) -> RgbaImage {
    viewer.composite_mut().want_picture(context);
    viewer.frame().unwrap();
    viewer.finish().unwrap();
    viewer.composite_mut().take_pictures(context).pop().unwrap().1
}

/// Returns false without an adapter.
fn check(window: &Arc<Window>, model: ThreadingModel) -> bool {
    let size = window.inner_size();
    let config = ViewerConfig {
        size_px: [size.width, size.height],
        adapter: AdapterChoice::Software,
        threading: model,
        vsync: false,
        ..ViewerConfig::default()
    };
    let mut viewer = match Viewer::new_window(Arc::clone(window), &config) {
        Ok(viewer) => viewer,
        Err(error) => {
            skipped_unless_required(error);
            return false;
        }
    };
    viewer.add_root(Page::from_node(Node::group(vec![ball(DVec3::ZERO, 1.0, [1.0; 4])])).unwrap()).unwrap();
    viewer.view_mut().environment.sky = Sky::Background([200, 0, 0]);
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z);
    let context = viewer.context();
    viewer.settle(3);
    let before = picture(&mut viewer, context);
    let white = before.pixels().filter(|p| p.0 == [255; 4]).count();
    assert!(white > 200, "the ball is visible: {white}");

    // A change that needs pipelines does not make the next frame of a window wait.
    viewer.view_mut().environment.sky = Sky::Atmosphere;
    assert!(picture(&mut viewer, context) == before, "{model:?}");
    viewer.view_mut().environment.sky = Sky::Background([200, 0, 0]);

    // A frame that the window skips has no image, which is no error.
    viewer.composite_mut().pretend_surface(context, &[Timeout]).unwrap();
    viewer.composite_mut().want_picture(context);
    viewer.frame().unwrap();
    viewer.finish().unwrap();
    assert!(viewer.composite_mut().take_pictures(context).is_empty());
    // A frame that is drawn again has none either, and that is reported.
    for answer in [Occluded, Timeout] {
        viewer.composite_mut().pretend_surface(context, &[answer]).unwrap();
        let error = viewer.picture().unwrap_err();
        assert!(matches!(error, ViewerError::HiddenWindow), "{model:?} {answer:?}: {error}");
        viewer.composite_mut().pretend_surface(context, &[answer]).unwrap();
        let error = viewer.settled().err().unwrap();
        assert!(matches!(error, ViewerError::HiddenWindow), "{model:?} {answer:?}: {error}");
        assert!(viewer.picture().unwrap() == before, "{model:?} {answer:?}: it is visible again");
        // The window shows the image that was drawn.
        assert!(picture(&mut viewer, context) == before, "{model:?} {answer:?}");
    }

    for (answers, skipped) in [
        (&[Timeout][..], 1),
        (&[Occluded, Timeout, Occluded], 3),
        // The surface is configured and acquired again in the same frame.
        (&[Outdated], 0),
        (&[Outdated, Outdated], 1),
        // The surface is created again.
        (&[Lost], 0),
        (&[Lost, Lost, Lost, Lost], 2),
        (&[Lost, Outdated, Outdated, Timeout], 2),
        (&[Suboptimal, Suboptimal, Suboptimal], 0),
    ] {
        viewer.composite_mut().pretend_surface(context, answers).unwrap();
        let first = viewer.frame_stamp().frame + 1;
        (0..5).for_each(|_| viewer.frame().unwrap());
        viewer.finish().unwrap();
        let frames: Vec<_> = viewer.stats().iter().filter(|s| s.frame >= first).collect();
        assert!(frames.len() == 5 && frames.iter().all(|s| s.drawn), "{model:?} {answers:?}");
        let of_skipped: u32 = frames.iter().map(|s| s.skipped).sum();
        let empty = frames.iter().filter(|s| s.leaves == 0).count();
        assert_eq!((of_skipped, empty), (skipped, skipped as usize), "{model:?} {answers:?}");
        assert!(picture(&mut viewer, context) == before, "{model:?} {answers:?}");
        assert_eq!(viewer.view().context(), Some(context), "the device and its uploads are the same");
    }
    // A surface that stays lost is an error after some frames, without a panic or a hang.
    viewer.composite_mut().pretend_surface(context, &[Lost; 64]).unwrap();
    let error = (0..40).find_map(|_| viewer.frame().and_then(|()| viewer.finish()).err()).unwrap();
    assert!(error.to_string().contains("still lost"), "{model:?}: {error}");
    println!("{model:?}: checked");
    true
}
