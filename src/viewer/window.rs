//! A window to move in: winit's event loop feeds the viewer's event queue and calls its frames. Runs on the main
//! thread.

use std::path::PathBuf;
use std::sync::Arc;

use glam::{DAffine3, DMat4, DVec2};
use winit::application::ApplicationHandler;
use winit::event::{StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow};
use winit::window::{Window, WindowId};

use super::ViewerError;
use super::camera_path::AnimationPath;
use super::config::{Arrangement, ArrangementError};
use super::display;
use super::handlers::{self, StatsPage};
use super::input::WindowCommand;
use super::manipulators::{self, SceneGround};
use super::overlay::OverlayInput;
use super::pace::Pace;
use super::parent::{Followed, ParentChange, ParentWindow};
use super::view::ContextId;
use super::viewer::{Viewer, ViewerConfig};
use super::{window_events, window_open};

/// Called once, when the window is there.
pub type OnOpen = Box<dyn FnOnce(&mut Viewer) -> Result<(), ViewerError>>;
/// Called before each frame; false closes the window.
pub type BeforeFrame = Box<dyn FnMut(&mut Viewer) -> Result<bool, ViewerError>>;
/// Called after each frame.
pub type AfterFrame = Box<dyn FnMut(&mut Viewer) -> Result<(), ViewerError>>;

/// Another window, all of which a slave camera has. Closed, it takes its camera along and the rest goes on.
#[derive(Clone, Debug, PartialEq)]
pub struct SlaveWindow {
    /// Its title.
    pub title: String,
    /// Width and height.
    pub size_px: [u32; 2],
    /// Its upper left corner on the screen; `None`: where the system puts it.
    pub position_px: Option<[i32; 2]>,
    /// It has the first window's device: see [`Viewer::open_window_on`].
    pub shares_device: bool,
    /// Of its camera; see [`Slave::projection_offset`](super::Slave::projection_offset).
    pub projection_offset: DMat4,
    /// Of its camera; see [`Slave::view_offset`](super::Slave::view_offset).
    pub view_offset: DAffine3,
}

/// What a window shows and when it closes.
pub struct WindowOptions {
    /// Title of the window.
    pub title: String,
    /// Key 7 plays it.
    pub path: Option<AnimationPath>,
    /// Show the stats from the start.
    pub overlay: bool,
    /// Where pictures and recorded paths go.
    pub output_dir: PathBuf,
    /// Which windows open. Where the application has slaves of its own, what the environment says does not count.
    pub arrangement: Arrangement,
    /// The window opens in one of another toolkit or program and ends with it, whatever is arranged. Under X11 it fills it.
    pub parent: Option<ParentWindow>,
    /// More windows, each with a context of its own.
    pub slaves: Vec<SlaveWindow>,
    /// Called once the viewer exists, to load a set and to add handlers; the viewer has no root before.
    pub on_open: OnOpen,
    /// The user moves the camera, by what [`Self::on_open`] has set or the [usual](manipulators::usual) manipulators;
    /// otherwise [`Self::before_frame`] places it.
    pub manipulated: bool,
    /// Draw only what [`Viewer::check_need_to_do_frame`] asks for.
    pub on_demand: bool,
    /// Frames a second at most; the time that is left goes to what the pager has.
    pub max_frame_rate: Option<f64>,
    /// Called before each frame; returning false closes the window. Where nobody moves the camera, a hidden window has a
    /// frame a second too, also where its window system asks for none.
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
            arrangement: Arrangement::Usual,
            parent: None,
            slaves: Vec::new(),
            on_open: Box::new(|_| Ok(())),
            manipulated: true,
            on_demand: false,
            max_frame_rate: None,
            before_frame: Box::new(|_| Ok(true)),
            after_frame: Box::new(|_| Ok(())),
        }
    }
}

/// Opens a window and runs it until it is closed; returns the viewer for its report. Main thread only.
pub fn run_window(config: ViewerConfig, mut options: WindowOptions) -> Result<Option<Viewer>, ViewerError> {
    if options.arrangement == Arrangement::Usual
        && options.parent.is_none()
        && options.slaves.is_empty()
        && let Some(said) = Arrangement::from_environment()?
    {
        options.arrangement = said;
    }
    if let Arrangement::Views(_) = options.arrangement {
        return Err(ViewerError::Arrangement(ArrangementError {
            source_name: "the arrangement of the windows".to_owned(),
            field: "views".to_owned(),
            reason: "this program shows one view, in windows with cameras of their own".to_owned(),
        }));
    }
    let event_loop = display::event_loop(options.parent.is_some())?;
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
    overlay: OverlayInput,
    pace: Pace,
    window: Arc<Window>,
    slaves: Vec<(Arc<Window>, ContextId)>,
    /// The window that the first one fills.
    parent: Option<Followed>,
}

impl App {
    fn open(&mut self, event_loop: &ActiveEventLoop) -> Result<Open, ViewerError> {
        let slaves = std::mem::take(&mut self.options.slaves);
        let setups = window_open::windows(event_loop, &self.options.arrangement, slaves, self.config.stereo.as_ref());
        let Some((first, beside)) = setups.split_first() else {
            return Err(ViewerError::Window("an arrangement without windows".to_owned()));
        };
        let (title, size_px) = (self.options.title.clone(), self.config.size_px);
        let title = &title;
        let followed = |parent| Followed::new(&parent, size_px).map(|of| (parent, of));
        let parent = self.options.parent.take().map(followed).transpose()?;
        let window = match &parent {
            Some((parent, followed)) => window_open::create_in(event_loop, parent, title, followed.size_px)?,
            None => window_open::create(event_loop, first, 0, title, size_px)?,
        };
        self.config.size_px = window_open::size_of(&window);
        self.config.samples = first.samples.unwrap_or(self.config.samples);
        self.config.vsync = first.vsync.unwrap_or(self.config.vsync);
        self.config.max_contexts = self.config.max_contexts.max(setups.len());
        let mut viewer = Viewer::new_window(Arc::clone(&window), &self.config)?;
        let on_open = std::mem::replace(&mut self.options.on_open, Box::new(|_| Ok(())));
        on_open(&mut viewer)?;
        let (master, others) = first.cameras.split_first().map_or((None, &[][..]), |(m, o)| (Some(m), o));
        if let Some(master) = master {
            window_open::set_master(&mut viewer, master, self.config.size_px);
        }
        if let Some(context) = viewer.context() {
            window_open::add_slaves(&mut viewer, context, others)?;
        }
        let mut slaves = Vec::new();
        for (place, setup) in (1..).zip(beside) {
            let window = window_open::create(event_loop, setup, place, title, size_px)?;
            let context = window_open::add_beside(&mut viewer, &self.config, setup, &window)?;
            slaves.push((window, context));
        }
        let stats = if self.options.overlay { StatsPage::Pager } else { StatsPage::None };
        handlers::add_usual(&mut viewer, &self.options.output_dir, stats);
        if self.config.pager.build_kd_trees && !viewer.has_ground() {
            viewer.set_ground(Some(Box::new(SceneGround::default())));
        }
        if self.options.manipulated && viewer.manipulator().is_none() {
            viewer.set_manipulator(Some(Box::new(manipulators::usual(self.options.path.take()))));
            viewer.notify("H shows the keys");
        }
        let parent = parent.map(|(_, followed)| followed);
        let pace = Pace::new(self.options.on_demand, self.options.max_frame_rate);
        Ok(Open { viewer, overlay: OverlayInput::default(), pace, window, slaves, parent })
    }

    fn fail(&mut self, event_loop: &ActiveEventLoop, error: ViewerError) {
        // What goes wrong because the window went with its parent is the end, and no error.
        let is_end = self.open.as_ref().and_then(|open| open.parent.as_ref()).is_some_and(Followed::is_gone);
        if is_end {
            log::info!("the window that it was in is gone: {error}");
        } else {
            self.error.get_or_insert(error);
        }
        event_loop.exit();
    }

    /// A frame, and what comes after it.
    fn draw(&mut self, event_loop: &ActiveEventLoop) -> Result<(), ViewerError> {
        let Some(open) = &mut self.open else { return Ok(()) };
        if open.frame(&mut self.options)? {
            open.plan_next(event_loop);
        } else {
            event_loop.exit();
        }
        Ok(())
    }

    fn handle(
        &mut self,
        event_loop: &ActiveEventLoop,
        window: WindowId,
        event: &WindowEvent,
    ) -> Result<(), ViewerError> {
        let Some(open) = &mut self.open else { return Ok(()) };
        if let Some(place) = open.slaves.iter().position(|(slave, _)| slave.id() == window) {
            return open.handle_slave(place, event);
        }
        if window != open.window.id() {
            return Ok(()); // the last events of one that was closed
        }
        match event {
            WindowEvent::RedrawRequested => return self.draw(event_loop),
            WindowEvent::Resized(size) => open.viewer.resize([size.width, size.height])?,
            WindowEvent::Destroyed => {
                event_loop.exit();
                return Ok(());
            }
            WindowEvent::MouseInput { state, .. } if state.is_pressed() => {
                if let Some(parent) = &open.parent {
                    parent.focus(&ParentWindow::of(Arc::clone(&open.window))?);
                }
            }
            _ => {}
        }
        let taken = open.overlay.feed(&open.viewer, &open.window, event);
        // What the overlay takes does not reach the scene; what comes up does, since it may have gone down there.
        if !(taken && window_events::is_press(event)) {
            let origin_px = open.viewer.window_matrix().origin_px;
            window_events::feed(open.viewer.event_queue(), event, origin_px);
        }
        if open.pace.is_on_demand() {
            open.window.request_redraw();
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

    fn new_events(&mut self, _: &ActiveEventLoop, cause: StartCause) {
        if let Some(open) = &self.open
            && open.pace.wakes_for_frame(cause, || open.viewer.check_need_to_do_frame())
        {
            open.window.request_redraw();
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        if let Some(open) = &mut self.open {
            match open.parent.as_mut().and_then(Followed::look) {
                Some(ParentChange::Resized(size_px)) => open.obey(WindowCommand::Resize(size_px)),
                Some(ParentChange::Gone) => event_loop.exit(),
                None => {}
            }
            open.pace.rest(event_loop);
            // A flight comes to its end in a hidden window too.
            let is_overdue = !self.options.manipulated && open.pace.is_overdue() && !event_loop.exiting();
            if is_overdue && let Err(error) = self.draw(event_loop) {
                self.fail(event_loop, error);
            }
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, window: WindowId, event: WindowEvent) {
        if let Err(error) = self.handle(event_loop, window, &event) {
            self.fail(event_loop, error);
        }
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        if let Some(mut open) = self.open.take() {
            // Pictures of the last frames may still be on their way.
            let is_gone = open.parent.as_ref().is_some_and(Followed::is_gone);
            let ended = open.viewer.finish().and_then(|()| (self.options.after_frame)(&mut open.viewer));
            if let Some(error) = ended.err().filter(|_| !is_gone) {
                self.error.get_or_insert(error);
            }
            self.closed = Some(open.viewer);
        }
    }
}

impl Open {
    /// Keys of all windows are the viewer's; the pointer is the first window's.
    fn handle_slave(&mut self, place: usize, event: &WindowEvent) -> Result<(), ViewerError> {
        let (_, context) = self.slaves[place];
        match event {
            WindowEvent::CloseRequested => {
                self.viewer.close_context(context)?;
                self.slaves.remove(place);
            }
            WindowEvent::Resized(size) => self.viewer.resize_context(context, [size.width, size.height])?,
            // Keys that are down when the focus goes come up.
            WindowEvent::KeyboardInput { .. } | WindowEvent::ModifiersChanged(_) | WindowEvent::Focused(false) => {
                window_events::feed(self.viewer.event_queue(), event, DVec2::ZERO);
            }
            _ => {}
        }
        self.window.request_redraw();
        Ok(())
    }

    /// One frame; false when it was the last.
    fn frame(&mut self, options: &mut WindowOptions) -> Result<bool, ViewerError> {
        self.pace.begin_frame();
        if !(options.before_frame)(&mut self.viewer)? {
            return Ok(false);
        }
        self.overlay.hand_over(&mut self.viewer, &self.window);
        self.viewer.frame()?;
        (options.after_frame)(&mut self.viewer)?;
        for command in self.viewer.take_window_commands() {
            self.obey(command);
        }
        Ok(!self.viewer.is_done())
    }

    fn obey(&mut self, command: WindowCommand) {
        if let Some(size_px) = window_open::obey(&self.window, command)
            && let Err(error) = self.viewer.resize(size_px)
        {
            log::error!("{error}");
        }
    }

    /// When the next frame comes.
    fn plan_next(&mut self, event_loop: &ActiveEventLoop) {
        if let Some(due) = self.pace.next_frame_at() {
            self.viewer.work_until(due);
        }
        if self.pace.plan_next(event_loop, self.viewer.check_need_to_do_frame()) {
            self.window.request_redraw();
        }
    }
}
