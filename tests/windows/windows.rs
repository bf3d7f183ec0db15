//! Real windows open and close at random while threading models change and frames are in flight. No thread may wait
//! forever, and the other windows continue. Needs Xvfb and a GPU; a software adapter suffices. Skipped without them.
//! Contexts without windows are tested in `tests/views/threads.rs`.

use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use glam::DVec3;
use kit::display::Display;
use kit::process::test_name;
use kit::skip::skipped_unless_required;
use terrane::gpu::{AdapterChoice, GraphicsContext};
use terrane::scene::{Drawable, Geometry, Material, Mesh, Node, Page};
use terrane::viewer::{ContextId, Slave, ThreadingModel, Viewer, ViewerConfig};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::platform::x11::EventLoopBuilderExtX11 as _;
use winit::window::{Window, WindowId};

/// The maximum number of contexts besides the first.
const MORE: usize = 3;
/// The time after which a step counts as hanging.
const PATIENCE: Duration = Duration::from_secs(90);
/// Tells the program on the display how many switches to make.
const SWITCHES: &str = "TERRANE_TEST_SWITCHES";

/// Runs [`on_a_display`] in a separate process with a display: a process has one event loop, and its environment must
/// not change while it runs.
fn churn(switches: u64) {
    let Some(display) = Display::start([640, 480]) else { return };
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", &test_name(module_path!(), "on_a_display"), "--ignored", "--nocapture"])
        .env("DISPLAY", &display.name)
        .env(SWITCHES, switches.to_string())
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("WAYLAND_SOCKET")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    let all = format!("{said}{}", String::from_utf8_lossy(&output.stderr));
    said.lines().filter(|line| line.contains("windows") || line.contains("skipped")).for_each(|l| println!("{l}"));
    assert!(output.status.success(), "{}: {all}", output.status);
}

#[test]
fn windows_open_and_close_while_models_change() {
    churn(60);
}

/// Run by `cargo test --release --test windows -- --ignored --nocapture ten_thousand`. `SEED` sets the first seed.
#[test]
#[ignore = "takes many minutes"]
fn ten_thousand_switches_with_windows() {
    churn(10_000);
}

/// The body of the other tests.
#[test]
#[ignore = "needs a display of its own: the other tests give it one"]
fn on_a_display() {
    let Ok(switches) = std::env::var(SWITCHES) else { return };
    let switches = switches.parse().unwrap();
    let step = Arc::new(AtomicU64::new(0));
    let watched = step.clone();
    std::thread::spawn(move || {
        let mut before = u64::MAX;
        loop {
            let now = watched.load(Ordering::Relaxed);
            if now == before {
                eprintln!("step {now} waits forever");
                std::process::exit(3);
            }
            before = now;
            std::thread::sleep(PATIENCE);
        }
    });
    let event_loop = EventLoop::builder().with_any_thread(true).build().unwrap();
    event_loop.set_control_flow(ControlFlow::Poll);
    let seed = std::env::var("SEED").map_or(11, |seed| seed.parse().unwrap());
    let mut churn = Churn {
        switches,
        step,
        random: Random(seed),
        viewer: viewer(),
        windows: Vec::new(),
        orphans: Vec::new(),
        opened: 0,
        // Short runs open windows more often.
        rarity: if switches > 1000 { 60 } else { 4 },
        times: Vec::new(),
        has_adapter: true,
    };
    event_loop.run_app(&mut churn).unwrap();
    if !churn.has_adapter {
        return;
    }
    churn.times.sort_unstable();
    let slowest = churn.times.last().unwrap().as_secs_f64() * 1e3;
    let median = churn.times[churn.times.len() / 2].as_secs_f64() * 1e3;
    println!("{switches} switches, {} windows: median {median:.2} ms, slowest {slowest:.2} ms", churn.opened);
    assert!(churn.opened > 3, "{} windows opened", churn.opened);
    assert!(cfg!(debug_assertions) || switches < 1000 || slowest < 50.0, "{slowest} ms");
}

struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % n as u64) as usize
    }
}

fn config(adapter: AdapterChoice) -> ViewerConfig {
    ViewerConfig {
        size_px: [32, 32],
        threading: ThreadingModel::SingleThreaded,
        adapter,
        validation: false,
        vsync: false,
        history_frames: 64,
        max_contexts: 1 + MORE,
        ..ViewerConfig::default()
    }
}

fn offscreen() -> GraphicsContext {
    GraphicsContext::new_offscreen(&config(AdapterChoice::Noop).traits()).unwrap()
}

/// A context without a window, so that all windows may close.
fn viewer() -> Viewer {
    let mut viewer = Viewer::new(offscreen(), &config(AdapterChoice::Noop)).unwrap();
    let ball = Geometry::Mesh(Arc::new(Mesh::sphere(DVec3::ZERO, 1.0, 8)));
    let node = Node::geode(vec![Drawable::new(ball, Material::default())]);
    viewer.add_root(Page::from_node(node).unwrap()).unwrap();
    viewer
}

struct Churn {
    switches: u64,
    step: Arc<AtomicU64>,
    random: Random,
    viewer: Viewer,
    windows: Vec<(Option<Arc<Window>>, ContextId)>,
    /// Windows whose contexts were closed first.
    orphans: Vec<Arc<Window>>,
    opened: u32,
    /// One in this number of steps opens a window.
    rarity: usize,
    times: Vec<Duration>,
    has_adapter: bool,
}

impl Churn {
    fn open(&mut self, event_loop: &ActiveEventLoop) {
        let size = PhysicalSize::new(16 + self.random.below(32) as u32, 16 + self.random.below(32) as u32);
        let window = event_loop.create_window(Window::default_attributes().with_inner_size(size)).unwrap();
        let window = Arc::new(window);
        let size = window.inner_size();
        let traits = config(AdapterChoice::Software).traits();
        let traits = terrane::gpu::ContextTraits { size_px: [size.width.max(1), size.height.max(1)], ..traits };
        let context = match GraphicsContext::new_window(Arc::clone(&window), &traits) {
            Ok(context) => context,
            Err(error) => {
                skipped_unless_required(error);
                self.has_adapter = false;
                event_loop.exit();
                return;
            }
        };
        let context = self.viewer.open_context(context).unwrap();
        self.viewer.add_slave(Slave::new(context)).unwrap();
        self.opened += 1;
        self.windows.push((Some(window), context));
    }

    fn change(&mut self, event_loop: &ActiveEventLoop) {
        let open = self.viewer.contexts().count();
        if self.random.below(self.rarity) == 0 && open <= MORE {
            return self.open(event_loop);
        }
        match self.random.below(8 * self.rarity) {
            // The context is closed, and its window soon after or at once.
            0..8 if !self.windows.is_empty() => {
                let (window, context) = self.windows.swap_remove(self.random.below(self.windows.len()));
                if self.random.below(2) == 0 {
                    self.orphans.extend(window);
                }
                assert!(self.viewer.composite_mut().close_context(context).unwrap());
            }
            // Only the context owns the window now.
            8..11 if !self.windows.is_empty() => {
                let place = self.random.below(self.windows.len());
                self.windows[place].0 = None;
            }
            11..14 if open <= MORE => {
                let context = self.viewer.open_context(offscreen()).unwrap();
                self.viewer.add_slave(Slave::new(context)).unwrap();
                self.windows.push((None, context));
            }
            14..18 => {
                for (window, _) in &self.windows {
                    let size = PhysicalSize::new(1 + self.random.below(48) as u32, 1 + self.random.below(48) as u32);
                    let _ = window.as_ref().and_then(|window| window.request_inner_size(size));
                }
            }
            18 => {
                // Everything is dropped at once with frames in flight.
                self.viewer = viewer();
                let windows = std::mem::take(&mut self.windows);
                self.orphans.extend(windows.into_iter().filter_map(|(window, _)| window));
            }
            19..22 => self.orphans.clear(),
            22 => self.viewer.composite_mut().stop_threading().unwrap(),
            _ => {}
        }
    }
}

impl ApplicationHandler for Churn {
    fn resumed(&mut self, _: &ActiveEventLoop) {}

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        if event_loop.exiting() {
            return;
        }
        if self.step.fetch_add(1, Ordering::Relaxed) >= self.switches {
            self.viewer.finish().unwrap();
            assert!(self.viewer.stats().iter().all(|s| s.drawn));
            event_loop.exit();
            return;
        }
        let model = ThreadingModel::ALL[self.random.below(4)];
        self.viewer.finish().unwrap();
        let start = Instant::now();
        self.viewer.composite_mut().set_threading_model(model).unwrap();
        self.viewer.composite_mut().start_threading().unwrap();
        self.times.push(start.elapsed());
        assert_eq!(self.viewer.composite().threading_model(), model);
        for _ in 0..self.random.below(4) {
            self.change(event_loop);
            self.viewer.frame().unwrap();
        }
    }

    fn window_event(&mut self, _: &ActiveEventLoop, id: WindowId, event: WindowEvent) {
        let WindowEvent::Resized(size) = event else { return };
        let of = self.windows.iter().find(|(window, _)| window.as_ref().is_some_and(|window| window.id() == id));
        if let Some((_, context)) = of {
            self.viewer.resize_context(*context, [size.width, size.height]).unwrap();
        }
    }
}
