//! A window to fly in: winit's event loop turned into the viewer's events. Runs on the main thread.
//!
//! [`KEYS`] lists the keys. The stats overlay is on Tab and Shift+S: S alone, OSG's key for it, moves backward here.

use std::path::PathBuf;
use std::sync::Arc;

use winit::application::ApplicationHandler;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{Window, WindowId};

use super::ViewerError;
use super::camera_path::{AnimationPath, ControlPoint};
use super::manipulator::{Event, FlyManipulator, MoveKey};
use super::overlay::Overlay;
use super::viewer::{Viewer, ViewerConfig};

/// What the keys do, a line each; printed by programs that open a window.
pub const KEYS: &str = "W A S D or arrows move, Q E or page keys down and up, drag looks, wheel changes the speed\n\
     Tab or Shift+S stats, C or F12 picture, Z record the path (again: save), P play it, Home first view, Esc quit";

/// Called once, when the window is there.
pub type OnOpen = Box<dyn FnOnce(&mut Viewer) -> Result<(), ViewerError>>;
/// Called before each frame; false closes the window.
pub type BeforeFrame = Box<dyn FnMut(&mut Viewer) -> Result<bool, ViewerError>>;
/// Called after each frame.
pub type AfterFrame = Box<dyn FnMut(&mut Viewer) -> Result<(), ViewerError>>;

/// What a window shows and when it closes.
pub struct WindowOptions {
    /// Title of the window.
    pub title: String,
    /// P plays it in its own time and stops it.
    pub path: Option<AnimationPath>,
    /// Show the stats overlay from the start.
    pub overlay: bool,
    /// Where pictures and recorded paths go.
    pub output_dir: PathBuf,
    /// Called once the viewer exists, to load a set; the viewer has no root before.
    pub on_open: OnOpen,
    /// The user moves the camera; otherwise [`Self::before_frame`] places it.
    pub manipulated: bool,
    /// Called before each frame; returning false closes the window.
    pub before_frame: BeforeFrame,
    /// Called after each frame.
    pub after_frame: AfterFrame,
}

impl Default for WindowOptions {
    fn default() -> Self {
        Self {
            title: "Terrane".to_owned(),
            path: None,
            overlay: false,
            output_dir: PathBuf::from("."),
            on_open: Box::new(|_| Ok(())),
            manipulated: true,
            before_frame: Box::new(|_| Ok(true)),
            after_frame: Box::new(|_| Ok(())),
        }
    }
}

/// True when there is a display that a window could open on.
pub fn has_display() -> bool {
    if cfg!(any(target_os = "linux", target_os = "freebsd", target_os = "openbsd", target_os = "netbsd")) {
        ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"]
            .iter()
            .any(|name| std::env::var_os(name).is_some_and(|value| !value.is_empty()))
    } else {
        true
    }
}

/// Opens a window and runs it until it is closed; returns the viewer for its report. Main thread only.
pub fn run_window(config: ViewerConfig, options: WindowOptions) -> Result<Option<Viewer>, ViewerError> {
    // winit panics where a library that it loads at run time is missing.
    let event_loop = std::panic::catch_unwind(EventLoop::new)
        .map_err(|_| ViewerError::Window("a window library is missing (Debian: libxkbcommon-x11-0)".to_owned()))?
        .map_err(|e| ViewerError::Window(e.to_string()))?;
    event_loop.set_control_flow(ControlFlow::Poll);
    let mut app = App { config, options, open: None, closed: None, error: None };
    event_loop.run_app(&mut app).map_err(|e| ViewerError::Window(e.to_string()))?;
    match app.error {
        Some(error) => Err(error),
        None => Ok(app.closed),
    }
}

struct App {
    config: ViewerConfig,
    options: WindowOptions,
    open: Option<Open>,
    closed: Option<Viewer>,
    error: Option<ViewerError>,
}

/// Everything that exists while the window does. The viewer is dropped before the window.
struct Open {
    viewer: Viewer,
    overlay: Overlay,
    overlay_shown: bool,
    egui: egui_winit::State,
    dragging: bool,
    shift: bool,
    pointer_px: Option<[f64; 2]>,
    playing: bool,
    play_start_s: f64,
    recording: Option<Vec<ControlPoint>>,
    pictures_taken: u32,
    window: Arc<Window>,
}

impl App {
    fn open(&mut self, event_loop: &ActiveEventLoop) -> Result<Open, ViewerError> {
        let window_error = |e: winit::error::OsError| ViewerError::Window(e.to_string());
        let [width, height] = self.config.size_px;
        let attributes = Window::default_attributes()
            .with_title(self.options.title.clone())
            .with_inner_size(winit::dpi::PhysicalSize::new(width, height));
        let window = Arc::new(event_loop.create_window(attributes).map_err(window_error)?);
        let size = window.inner_size();
        self.config.size_px = [size.width.max(1), size.height.max(1)];
        let mut viewer = Viewer::new_window(Arc::clone(&window), &self.config)?;
        let on_open = std::mem::replace(&mut self.options.on_open, Box::new(|_| Ok(())));
        on_open(&mut viewer)?;
        if let (true, Some(bounds)) = (self.options.manipulated, viewer.bounds().copied()) {
            let manipulator = FlyManipulator::new(bounds, &viewer.camera.world_from_eye);
            viewer.set_manipulator(Some(Box::new(manipulator)));
        }
        let overlay = Overlay::default();
        let egui = egui_winit::State::new(
            overlay.context().clone(),
            egui::ViewportId::ROOT,
            &window,
            Some(window.scale_factor() as f32),
            None,
            None,
        );
        Ok(Open {
            viewer,
            overlay,
            overlay_shown: self.options.overlay,
            egui,
            dragging: false,
            shift: false,
            pointer_px: None,
            playing: false,
            play_start_s: 0.0,
            recording: None,
            pictures_taken: 0,
            window,
        })
    }

    fn fail(&mut self, event_loop: &ActiveEventLoop, error: ViewerError) {
        self.error.get_or_insert(error);
        event_loop.exit();
    }

    fn handle(&mut self, event_loop: &ActiveEventLoop, event: &WindowEvent) -> Result<(), ViewerError> {
        let Some(open) = &mut self.open else { return Ok(()) };
        let taken = open.overlay_shown && open.egui.on_window_event(&open.window, event).consumed;
        match event {
            WindowEvent::CloseRequested => event_loop.exit(),
            WindowEvent::Resized(size) => open.viewer.resize([size.width, size.height])?,
            WindowEvent::Focused(false) => open.viewer.push_event(Event::FocusLost),
            WindowEvent::KeyboardInput { event: key, .. } => {
                let PhysicalKey::Code(code) = key.physical_key else { return Ok(()) };
                let pressed = key.state == ElementState::Pressed;
                if open.shift && code == KeyCode::KeyS {
                    open.overlay_shown ^= pressed && !key.repeat;
                } else if let Some(key) = move_key(code) {
                    open.viewer.push_event(Event::Key { key, pressed });
                } else if pressed && !key.repeat {
                    if code == KeyCode::Escape {
                        event_loop.exit();
                    } else {
                        open.command(code, &self.options);
                    }
                }
            }
            WindowEvent::ModifiersChanged(modifiers) => open.shift = modifiers.state().shift_key(),
            WindowEvent::MouseInput { state, button: MouseButton::Left | MouseButton::Right, .. } => {
                open.dragging = *state == ElementState::Pressed && !taken;
            }
            WindowEvent::CursorMoved { position, .. } => {
                let now = [position.x, position.y];
                if let (true, Some([x, y])) = (open.dragging && !open.playing, open.pointer_px) {
                    open.viewer.push_event(Event::Drag([now[0] - x, now[1] - y]));
                }
                open.pointer_px = Some(now);
            }
            WindowEvent::MouseWheel { delta, .. } if !taken => {
                let notches = match delta {
                    MouseScrollDelta::LineDelta(_, lines) => f64::from(*lines),
                    MouseScrollDelta::PixelDelta(px) => px.y / 50.0,
                };
                open.viewer.push_event(Event::Wheel(notches));
            }
            WindowEvent::RedrawRequested => {
                let go_on = open.frame(&mut self.options)?;
                if go_on {
                    open.window.request_redraw();
                } else {
                    event_loop.exit();
                }
            }
            _ => {}
        }
        Ok(())
    }
}

impl ApplicationHandler for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.open.is_some() || self.error.is_some() {
            return;
        }
        match self.open(event_loop) {
            Ok(open) => {
                open.window.request_redraw();
                self.open = Some(open);
            }
            Err(error) => self.fail(event_loop, error),
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        if let Err(error) = self.handle(event_loop, &event) {
            self.fail(event_loop, error);
        }
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        if let Some(mut open) = self.open.take() {
            // Pictures of the last frames may still be on their way.
            let ended = open.viewer.finish().and_then(|()| open.after_frame(&mut self.options));
            if let Err(error) = ended {
                self.error.get_or_insert(error);
            }
            self.closed = Some(open.viewer);
        }
    }
}

impl Open {
    /// One key that is not a movement.
    fn command(&mut self, code: KeyCode, options: &WindowOptions) {
        match code {
            KeyCode::Tab | KeyCode::F1 => self.overlay_shown = !self.overlay_shown,
            KeyCode::KeyC | KeyCode::F12 => self.viewer.want_picture(),
            KeyCode::KeyZ => match self.recording.take() {
                None => self.recording = Some(Vec::new()),
                Some(points) => save_path(points, options),
            },
            KeyCode::KeyP if options.path.is_some() && options.manipulated => {
                self.playing = !self.playing;
                self.play_start_s = self.viewer.frame_stamp().reference_time_s;
                self.hand_back_to_manipulator();
            }
            KeyCode::Home => {
                if let Some(bounds) = self.viewer.bounds() {
                    self.viewer.camera.world_from_eye = bounds.first_camera(&super::ViewFrom::default());
                    self.hand_back_to_manipulator();
                }
            }
            _ => {}
        }
    }

    /// The manipulator goes on from where the camera is.
    fn hand_back_to_manipulator(&mut self) {
        let pose = self.viewer.camera.world_from_eye;
        if let Some(manipulator) = self.viewer.manipulator_mut() {
            manipulator.set_pose(&pose);
        }
    }

    fn frame(&mut self, options: &mut WindowOptions) -> Result<bool, ViewerError> {
        if !(options.before_frame)(&mut self.viewer)? {
            return Ok(false);
        }
        if let (true, Some(path)) = (self.playing, &options.path) {
            let time_s = self.viewer.frame_stamp().reference_time_s - self.play_start_s;
            self.viewer.camera.world_from_eye = path.world_from_eye(path.first_s() + time_s);
            self.hand_back_to_manipulator();
            self.playing = time_s < path.duration_s();
        }
        if self.overlay_shown {
            let input = self.egui.take_egui_input(&self.window);
            let paint = self.overlay.layout(
                input,
                self.viewer.size_px(),
                self.window.scale_factor() as f32,
                self.viewer.stats(),
                self.viewer.pager().map(|p| p.stats()),
                if self.recording.is_some() { "recording the camera path; Z saves it" } else { "" },
            );
            self.viewer.set_overlay(paint);
        }
        self.viewer.frame()?;
        if let Some(points) = &mut self.recording {
            let time_s = self.viewer.frame_stamp().reference_time_s;
            points.push(ControlPoint::from_pose(time_s, &self.viewer.camera.world_from_eye));
        }
        self.after_frame(options)?;
        Ok(true)
    }

    /// The application first: pictures that it leaves are the user's.
    fn after_frame(&mut self, options: &mut WindowOptions) -> Result<(), ViewerError> {
        (options.after_frame)(&mut self.viewer)?;
        for (_, picture) in self.viewer.take_pictures() {
            self.pictures_taken += 1;
            let file = options.output_dir.join(format!("terrane-{:03}.png", self.pictures_taken));
            match picture.save(&file) {
                Ok(()) => log::info!("wrote {}", file.display()),
                Err(error) => log::error!("{}: {error}", file.display()),
            }
        }
        Ok(())
    }
}

fn save_path(points: Vec<ControlPoint>, options: &WindowOptions) {
    let file = options.output_dir.join("terrane.path");
    match AnimationPath::new(points).and_then(|path| path.write(&file)) {
        Ok(()) => log::info!("wrote {}", file.display()),
        Err(error) => log::error!("camera path: {error}"),
    }
}

fn move_key(code: KeyCode) -> Option<MoveKey> {
    Some(match code {
        KeyCode::KeyW | KeyCode::ArrowUp => MoveKey::Forward,
        KeyCode::KeyS | KeyCode::ArrowDown => MoveKey::Backward,
        KeyCode::KeyA | KeyCode::ArrowLeft => MoveKey::Left,
        KeyCode::KeyD | KeyCode::ArrowRight => MoveKey::Right,
        KeyCode::KeyE | KeyCode::PageUp => MoveKey::Up,
        KeyCode::KeyQ | KeyCode::PageDown => MoveKey::Down,
        _ => return None,
    })
}
