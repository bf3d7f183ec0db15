//! Terrane inside another toolkit: the host owns the window and the event loop, and decides when to draw. The viewer gets
//! the window's handle, and the host's events in its queue. The host here is winit; others work the same way.
//!
//! ```text
//! cargo run --release --example embedding -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a ball; drags turn it and the wheel zooms. Offscreen the host gets an image.

mod shared;

use std::{sync::Arc, time::Duration};

use anyhow::Result;
use glam::{DVec2, DVec3};
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::viewer::manipulators::TrackballManipulator;
use terrane::viewer::{MouseButton::Left, Viewer, ViewerConfig};
use winit::event::{MouseScrollDelta::LineDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::{application::ApplicationHandler, window::Window, window::WindowId};

fn fill(viewer: &mut Viewer) -> Result<()> {
    let material = Material { base_color: [0.8, 0.5, 0.1, 1.0], ..Material::default() };
    let ball = Drawable::new(Mesh::sphere(DVec3::ZERO, 1.0, 12).into(), material);
    viewer.add_root(Page::from_node(Node::geode(vec![ball]))?)?;
    viewer.set_manipulator(Some(Box::new(TrackballManipulator::default())));
    Ok(())
}

struct Host(Option<(Viewer, Arc<Window>)>);

impl ApplicationHandler for Host {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        let window = Arc::new(event_loop.create_window(Window::default_attributes()).expect("a window"));
        // Any type with a window handle and a display handle works.
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
            WindowEvent::MouseInput { state, .. } if state.is_pressed() => queue.mouse_button_press(Left, now_s),
            WindowEvent::MouseInput { .. } => queue.mouse_button_release(Left, now_s),
            WindowEvent::MouseWheel { delta: LineDelta(_, y), .. } => {
                queue.mouse_scroll(DVec2::Y * f64::from(y), now_s)
            }
            WindowEvent::RedrawRequested => viewer.frame().expect("a frame"),
            _ => {}
        }
    }

    /// Draws when there is something new; otherwise sleeps, and asks again for retries of failed requests.
    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let Some((viewer, window)) = &self.0 else { return };
        event_loop.set_control_flow(ControlFlow::wait_duration(Duration::from_millis(250)));
        if viewer.check_need_to_do_frame() {
            window.request_redraw();
        }
    }
}

fn main() -> Result<()> {
    let args = shared::Args::parse()?;
    if args.opens_window() {
        return Ok(EventLoop::new()?.run_app(&mut Host(None))?);
    }
    let mut viewer = Viewer::new_offscreen(&ViewerConfig::default())?;
    fill(&mut viewer)?;
    viewer.actions().home();
    shared::draw(&args, &mut viewer)?;
    args.save(&mut viewer)
}
