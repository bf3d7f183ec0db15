//! The windows of a view that runs: they are set up anew, closed one by one, and the run ends with the last. Needs Xvfb and a
//! GPU; a software adapter suffices.

use std::cell::{Cell, RefCell};
use std::process::Command;
use std::rc::Rc;
use std::sync::OnceLock;

use glam::DVec2;
use kit::display::Display;
use kit::process::test_name;
use kit::skip::or_skip;
use terrane::gpu::{AdapterChoice, GpuError, GraphicsContext};
use terrane::scene::{Node, Page};
use terrane::viewer::{
    Arrangement, MouseCursor, Viewer, ViewerConfig, ViewerError, WindowCommand, WindowOptions, run_window,
};
use x11rb::connection::Connection as _;
use x11rb::protocol::xfixes::ConnectionExt as _;
use x11rb::protocol::xproto::ConnectionExt as _;

const SCREEN_PX: [u32; 2] = [640, 480];

fn config() -> ViewerConfig {
    ViewerConfig {
        size_px: [120, 90],
        adapter: AdapterChoice::Software,
        validation: false,
        vsync: false,
        ..ViewerConfig::default()
    }
}

#[test]
fn view_moves_between_windows_while_it_runs() {
    let Some(display) = Display::start(SCREEN_PX) else { return };
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", &test_name(module_path!(), "on_a_display"), "--ignored", "--nocapture"])
        .env("DISPLAY", &display.name)
        .env("TERRANE_TEST_SET_UPS", "1")
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("WAYLAND_SOCKET")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    said.lines().filter(|line| line.contains("skipped")).for_each(|line| println!("{line}"));
    assert!(output.status.success(), "{}: {said}{}", output.status, String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("all steps are done") || said.contains("skipped"), "{said}");
}

/// A step: what is asked for, and what holds before the next step.
type Step = (fn(&mut Viewer), fn(&Viewer) -> bool);

const STEPS: &[Step] = &[
    (
        |viewer| {
            let screens = viewer.composite().screens();
            assert_eq!(screens.iter().map(|screen| screen.size_px).collect::<Vec<_>>(), [SCREEN_PX]);
            assert_eq!(screens[0].position_px, [0, 0]);
            viewer.view_mut().set_up_view_in_window([30, 40], [200, 100], None);
        },
        |viewer| viewer.contexts().count() == 1 && viewer.view().size_px() == [200, 100],
    ),
    (
        |viewer| viewer.view_mut().warp_pointer(DVec2::new(50.0, 20.0)),
        // The display has no window manager, so the window is where it was asked for.
        |_| pointer() == [80, 60],
    ),
    (|viewer| viewer.view_mut().set_cursor(MouseCursor::None), |_| !is_visible(&cursor_pixels())),
    (
        |viewer| viewer.view_mut().set_cursor(MouseCursor::Crosshair),
        |_| {
            let pixels = cursor_pixels();
            is_visible(&pixels).then(|| CROSSHAIR.set(pixels).ok()).is_some()
        },
    ),
    (
        |viewer| viewer.view_mut().set_cursor(MouseCursor::Arrow),
        |_| {
            let pixels = cursor_pixels();
            is_visible(&pixels) && CROSSHAIR.get() != Some(&pixels)
        },
    ),
    // A wall of two windows: the one with the master camera is on the right.
    (
        |viewer| viewer.view_mut().set_up(Arrangement::wall([2, 1], [100, 80], None)),
        |viewer| viewer.contexts().count() == 2 && viewer.view().size_px() == [100, 80],
    ),
    (
        |viewer| {
            let contexts: Vec<_> = viewer.contexts().collect();
            let (_, slave) = viewer.view().slaves().next().unwrap();
            assert_eq!(contexts, [slave.context, viewer.view().context().unwrap()], "from left to right");
            assert_eq!(viewer.context(), contexts[1]);
            // The window with the master camera is closed; the other stays open.
            viewer.view_mut().request_window(WindowCommand::Close(contexts[1]));
        },
        |viewer| viewer.contexts().count() == 1 && viewer.view().context().is_none(),
    ),
    (
        |viewer| viewer.view_mut().set_up_view_across_all_screens(),
        |viewer| viewer.contexts().count() == 1 && viewer.view().size_px() == SCREEN_PX,
    ),
    (
        |viewer| viewer.view_mut().set_up_view_on_single_screen(7),
        // There is no such screen, and the window stays.
        |viewer| viewer.contexts().count() == 1 && viewer.view().size_px() == SCREEN_PX,
    ),
    (
        |viewer| {
            let last = viewer.contexts().next().unwrap();
            viewer.view_mut().request_window(WindowCommand::Close(last));
        },
        |_| false,
    ),
];

/// The pixels of the crosshair, once it was shown.
static CROSSHAIR: OnceLock<Vec<u32>> = OnceLock::new();

/// Returns the pixels of the pointer's shape, ARGB.
fn cursor_pixels() -> Vec<u32> {
    let (x, _) = x11rb::connect(None).unwrap();
    x.xfixes_query_version(5, 0).unwrap().reply().unwrap();
    x.xfixes_get_cursor_image().unwrap().reply().unwrap().cursor_image
}

fn is_visible(pixels: &[u32]) -> bool {
    pixels.iter().any(|argb| argb >> 24 > 0)
}

/// Returns the position of the pointer on the display.
fn pointer() -> [i16; 2] {
    let (x, screen) = x11rb::connect(None).unwrap();
    let root = x.setup().roots[screen].root;
    let at = x.query_pointer(root).unwrap().reply().unwrap();
    [at.root_x, at.root_y]
}

/// The body of the other test.
#[test]
#[ignore = "needs a display: the other test gives it one"]
fn on_a_display() {
    if std::env::var("TERRANE_TEST_SET_UPS").is_err() {
        return;
    }
    if let Err(error @ GpuError::NoAdapter { .. }) = GraphicsContext::new_offscreen(&config().traits()) {
        let _ = or_skip(Err::<(), _>(error));
        return;
    }
    // The step that was begun last, and the frames since.
    let (begun, frames) = (Rc::new(Cell::new(0)), Rc::new(Cell::new(0)));
    let step = begun.clone();
    let started = Rc::new(RefCell::new(false));
    let options = WindowOptions {
        on_open: Box::new(|viewer| {
            viewer.add_root(Page::from_node(Node::group(vec![])).map_err(|e| ViewerError::Setting(e.to_string()))?)?;
            Ok(())
        }),
        after_frame: Box::new(move |viewer| {
            if viewer.contexts().next().is_none() {
                return Ok(());
            }
            frames.set(frames.get() + 1);
            assert!(frames.get() < 2000, "step {} never ends", step.get());
            let is_first = !std::mem::replace(&mut *started.borrow_mut(), true);
            // Some frames pass before a step counts as done.
            if is_first || frames.get() > 5 && STEPS[step.get()].1(viewer) {
                step.set(step.get() + usize::from(!is_first));
                frames.set(0);
                STEPS[step.get()].0(viewer);
            }
            Ok(())
        }),
        ..WindowOptions::default()
    };
    let viewer = run_window(config(), options).unwrap().expect("the viewer is returned");
    assert_eq!(begun.get(), STEPS.len() - 1, "the run ends with its last window");
    assert_eq!(viewer.contexts().count(), 0);
    println!("all steps are done");
}
