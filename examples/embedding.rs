//! Terrane inside another toolkit: the host owns the window, the event loop and the decision when to draw; the viewer
//! gets the window's handle, and the host's events in its queue. The host is winit here; with any other it is the same.
//!
//! ```text
//! cargo run --release --example embedding -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a ball that drags turn and the wheel zooms. Offscreen the host gets a picture to show where it likes.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use glam::{DVec2, DVec3};
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::viewer::manipulators::TrackballManipulator;
use terrane::viewer::{MouseButton, Viewer, ViewerConfig, has_display};
use winit::application::ApplicationHandler;
use winit::event::{MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::window::{Window, WindowId};

fn fill(viewer: &mut Viewer) -> Result<()> {
    let ball = Mesh::sphere(DVec3::ZERO, 1.0, 12);
    let material = Material { base_color: [0.8, 0.5, 0.1, 1.0], ..Material::default() };
    viewer.add_root(Page::from_node(Node::geode(vec![Drawable::new(ball.into(), material)]))?)?;
    viewer.set_manipulator(Some(Box::new(TrackballManipulator::default())));
    Ok(())
}

#[derive(Default)]
struct Host(Option<(Viewer, Arc<Window>)>);

impl ApplicationHandler for Host {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        let window = Arc::new(event_loop.create_window(Window::default_attributes()).expect("a window"));
        // Anything with a window handle and a display handle will do.
        let mut viewer = Viewer::new_window(window.clone(), &ViewerConfig::default()).expect("an adapter");
        viewer.resize(window.inner_size().into()).expect("a size");
        fill(&mut viewer).expect("a scene");
        self.0 = Some((viewer, window));
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some((viewer, _)) = &mut self.0 else { return };
        let queue = viewer.view_mut().event_queue();
        let now_s = queue.time_s();
        match event {
            WindowEvent::CloseRequested => event_loop.exit(),
            WindowEvent::Resized(size) => viewer.resize(size.into()).expect("a size"),
            WindowEvent::CursorMoved { position: p, .. } => queue.mouse_motion(DVec2::new(p.x, p.y), now_s),
            WindowEvent::MouseInput { state, .. } if state.is_pressed() => {
                queue.mouse_button_press(MouseButton::Left, now_s)
            }
            WindowEvent::MouseInput { .. } => queue.mouse_button_release(MouseButton::Left, now_s),
            WindowEvent::MouseWheel { delta: MouseScrollDelta::LineDelta(_, y), .. } => {
                queue.mouse_scroll(DVec2::new(0.0, y.into()), now_s);
            }
            WindowEvent::RedrawRequested => viewer.frame().expect("a frame"),
            _ => {}
        }
    }

    /// The host asks whether there is anything new to draw, and sleeps otherwise; what failed may be tried again later.
    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let busy = self.0.as_ref().filter(|(viewer, _)| viewer.check_need_to_do_frame());
        busy.into_iter().for_each(|(_, window)| window.request_redraw());
        let again = ControlFlow::wait_duration(Duration::from_millis(250));
        event_loop.set_control_flow(if busy.is_some() { ControlFlow::Poll } else { again });
    }
}

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        return Ok(EventLoop::new()?.run_app(&mut Host::default())?);
    }
    let mut viewer = Viewer::new_offscreen(&ViewerConfig::default())?;
    fill(&mut viewer)?;
    viewer.actions().home();
    for _ in 0..value("--frames").map_or(Ok(30), |n| n.parse::<u32>())? {
        viewer.frame()?;
    }
    value("--screenshot").map_or(Ok(()), |file| Ok(viewer.read_back()?.save(file)?))
}
