//! [`run_window`]: one view in a window, and slaves in further ones. winit's event loop feeds the viewer's event queue and
//! calls its frames. Main thread.

use std::path::PathBuf;
use std::sync::Arc;

use winit::application::ApplicationHandler;
use winit::event::{StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow};
use winit::window::WindowId;

use super::open::WindowOfContext;
use super::overlay_input::OverlayInput;
use super::pacing::Pacing;
use super::parent::{Followed, ParentChange, ParentWindow};
use super::slave_window::SlaveWindow;
use super::{events as window_events, open as window_open};
use crate::gpu::GraphicsContext;
use crate::viewer::camera_path::AnimationPath;
use crate::viewer::config::{Arrangement, Screen};
use crate::viewer::display;
use crate::viewer::frame::ViewerConfig;
use crate::viewer::handlers::{self, StatsPage};
use crate::viewer::ids::ContextId;
use crate::viewer::input::WindowCommand;
use crate::viewer::manipulators::{self, SceneGround};
use crate::viewer::viewer::Viewer;
use crate::viewer::{ArrangementError, ViewerError};

/// A callback that runs once, after the first window has opened.
pub type OnOpen = Box<dyn FnOnce(&mut Viewer) -> Result<(), ViewerError>>;
/// A callback before each frame; returning false closes the window.
pub type BeforeFrame = Box<dyn FnMut(&mut Viewer) -> Result<bool, ViewerError>>;
/// A callback after each frame.
pub type AfterFrame = Box<dyn FnMut(&mut Viewer) -> Result<(), ViewerError>>;

/// Settings of [`run_window`]: what the window shows, and callbacks around its frames.
pub struct WindowOptions {
    /// The title of the window.
    pub title: String,
    /// A camera path that key 7 plays.
    pub path: Option<AnimationPath>,
    /// Shows the statistics from the start.
    pub overlay: bool,
    /// The folder for screenshots and recorded camera paths.
    pub output_dir: PathBuf,
    /// The windows to open. If [`Self::slaves`] has entries, the environment variables are ignored.
    pub arrangement: Arrangement,
    /// A window of another toolkit or program in which the first window opens and with which it closes; the arrangement is
    /// ignored. Under X11 the window fills it.
    pub parent: Option<ParentWindow>,
    /// Further windows with slave cameras, each a context of the viewer.
    pub slaves: Vec<SlaveWindow>,
    /// Runs once the viewer exists, to load a set and to add handlers. The viewer has no root before.
    pub on_open: OnOpen,
    /// Lets the user move the camera, with the manipulator that [`Self::on_open`] has set or the
    /// [usual](manipulators::usual) ones. Otherwise [`Self::before_frame`] moves it.
    pub manipulated: bool,
    /// Draws only frames that [`Viewer::check_need_to_do_frame`] asks for.
    pub on_demand: bool,
    /// The largest frame rate, per second; the pager uses the remaining time.
    pub max_frame_rate: Option<f64>,
    /// Runs before each frame; returning false closes the window. Unless the user moves the camera, a hidden window draws
    /// one frame per second, even if its window system requests none.
    pub before_frame: BeforeFrame,
    /// Runs after each frame.
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

/// Opens a window and runs it until its last window is closed or the view asks to end; returns the viewer for its report. Main
/// thread only.
///
/// More than one window on the view: [`WindowOptions::slaves`], or an [`Arrangement`].
pub fn run_window(config: ViewerConfig, mut options: WindowOptions) -> Result<Option<Viewer>, ViewerError> {
    if options.arrangement == Arrangement::Usual
        && options.parent.is_none()
        && options.slaves.is_empty()
        && let Some(arrangement) = Arrangement::from_environment()?
    {
        options.arrangement = arrangement;
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

/// The objects that exist while windows are open. Fields are dropped in order: the viewer before its windows.
struct Open {
    viewer: Viewer,
    /// The input to the overlay, which lies over the image of the master camera.
    overlay: OverlayInput,
    pacing: Pacing,
    /// The windows; redraws of the first one run the frames. Empty once all are closed.
    windows: Vec<WindowOfContext>,
    /// The window of another toolkit that contains the first one.
    parent: Option<Followed>,
}

impl App {
    fn open(&mut self, event_loop: &ActiveEventLoop) -> Result<Open, ViewerError> {
        let slaves = std::mem::take(&mut self.options.slaves);
        let setups = window_open::windows(event_loop, &self.options.arrangement, slaves, self.config.stereo.as_ref());
        let Some((first, beside)) = setups.split_first() else {
            return Err(ViewerError::Window("the arrangement has no windows".to_owned()));
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
        let traits = window_open::traits_of(&self.config, first, &window);
        let mut viewer = Viewer::new(GraphicsContext::new_window(Arc::clone(&window), &traits)?, &self.config)?;
        viewer.composite_mut().frame.screens = Screen::all(event_loop);
        let on_open = std::mem::replace(&mut self.options.on_open, Box::new(|_| Ok(())));
        on_open(&mut viewer)?;
        let (master, others) = first.cameras.split_first().map_or((None, &[][..]), |(m, o)| (Some(m), o));
        if let Some(master) = master {
            window_open::set_master(viewer.view_mut(), master, self.config.size_px);
        }
        if let Some(context) = viewer.view().context() {
            let view = viewer.view_id();
            window_open::add_slaves(viewer.composite_mut(), view, context, others)?;
        }
        let mut windows = vec![(window, viewer.context())];
        for (place, setup) in (1..).zip(beside) {
            let window = window_open::create(event_loop, setup, place, title, size_px)?;
            let context = window_open::add_beside(&mut viewer, &self.config, setup, &window)?;
            windows.push((window, context));
        }
        let stats = if self.options.overlay { StatsPage::Pager } else { StatsPage::None };
        handlers::add_usual(viewer.view_mut(), &self.options.output_dir, stats);
        if self.config.pager.build_kd_trees && !viewer.view().has_ground() {
            viewer.view_mut().set_ground(Some(Box::new(SceneGround::default())));
        }
        if self.options.manipulated && viewer.view().manipulator().is_none() {
            viewer.set_manipulator(Some(Box::new(manipulators::usual(self.options.path.take()))));
            viewer.view_mut().notify("H shows the keys");
        }
        let parent = parent.map(|(_, followed)| followed);
        let pacing = Pacing::new(self.options.on_demand, self.options.max_frame_rate);
        Ok(Open { viewer, overlay: OverlayInput::default(), pacing, windows, parent })
    }

    fn fail(&mut self, event_loop: &ActiveEventLoop, error: ViewerError) {
        // An error after the parent window was closed is the regular end.
        let is_end = self.open.as_ref().and_then(|open| open.parent.as_ref()).is_some_and(Followed::is_gone);
        if is_end {
            log::info!("the parent window was closed: {error}");
        } else {
            self.error.get_or_insert(error);
        }
        event_loop.exit();
    }

    /// Draws a frame and plans the next one.
    fn draw(&mut self, event_loop: &ActiveEventLoop) -> Result<(), ViewerError> {
        let Some(open) = &mut self.open else { return Ok(()) };
        if open.frame(event_loop, &self.config, &mut self.options)? {
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
        let Some(place) = open.windows.iter().position(|(of, _)| of.id() == window) else {
            return Ok(()); // events of a window that was closed
        };
        let (window, context) = open.windows[place].clone();
        match event {
            WindowEvent::RedrawRequested => return if place == 0 { self.draw(event_loop) } else { Ok(()) },
            WindowEvent::Resized(size) => open.viewer.resize_context(context, [size.width, size.height])?,
            WindowEvent::Destroyed => {
                open.close(context)?;
                if open.windows.is_empty() {
                    event_loop.exit();
                }
                return Ok(());
            }
            WindowEvent::MouseInput { state, .. } if place == 0 && state.is_pressed() => {
                if let Some(parent) = &open.parent {
                    parent.focus(&ParentWindow::of(Arc::clone(&window))?);
                }
            }
            _ => {}
        }
        let has_overlay = open.viewer.view().context() == Some(context);
        let taken = has_overlay && open.overlay.feed(open.viewer.view(), &window, event);
        // Presses that the overlay takes do not reach the scene. Releases always do, since the press may have been there.
        if !(taken && window_events::is_press(event)) {
            window_events::feed(open.viewer.view_mut(), context, event);
        }
        if open.pacing.is_on_demand() {
            open.request_redraw();
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
                open.request_redraw();
                self.open = Some(open);
            }
            Err(error) => self.fail(event_loop, error),
        }
    }

    fn new_events(&mut self, _: &ActiveEventLoop, cause: StartCause) {
        if let Some(open) = &self.open
            && open.pacing.wakes_for_frame(cause, || open.viewer.check_need_to_do_frame())
        {
            open.request_redraw();
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        if let Some(open) = &mut self.open {
            match open.parent.as_mut().and_then(Followed::look) {
                Some(ParentChange::Resized(size_px)) => open.obey(WindowCommand::Resize(size_px)),
                Some(ParentChange::Gone) => event_loop.exit(),
                None => {}
            }
            open.pacing.rest(event_loop);
            // A flight must end in a hidden window too.
            let is_overdue = !self.options.manipulated && open.pacing.is_overdue() && !event_loop.exiting();
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
            // Images of the last frames may still be in flight.
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
    fn request_redraw(&self) {
        if let Some((window, _)) = self.windows.first() {
            window.request_redraw();
        }
    }

    /// Returns the window of the master camera, or the first one.
    fn main_window(&self) -> Option<&WindowOfContext> {
        let context = self.viewer.view().context();
        self.windows.iter().find(|(_, of)| Some(*of) == context).or(self.windows.first())
    }

    /// Closes a window with its context and the cameras in it.
    fn close(&mut self, context: ContextId) -> Result<(), ViewerError> {
        self.viewer.composite_mut().close_context(context)?;
        self.windows.retain(|(_, of)| *of != context);
        self.request_redraw();
        Ok(())
    }

    /// Draws one frame; returns false when it was the last.
    fn frame(
        &mut self,
        event_loop: &ActiveEventLoop,
        config: &ViewerConfig,
        options: &mut WindowOptions,
    ) -> Result<bool, ViewerError> {
        self.pacing.begin_frame();
        if !(options.before_frame)(&mut self.viewer)? {
            return Ok(false);
        }
        if let Some((window, _)) = self.main_window().cloned() {
            self.overlay.hand_over(self.viewer.view_mut(), &window);
        }
        self.viewer.frame()?;
        (options.after_frame)(&mut self.viewer)?;
        for command in self.viewer.view_mut().take_window_commands() {
            match command {
                WindowCommand::Close(context) => self.close(context)?,
                WindowCommand::SetUp(arrangement) => self.set_up(event_loop, config, &options.title, &arrangement)?,
                command => self.obey(command),
            }
        }
        Ok(!self.viewer.view().is_done() && !self.windows.is_empty())
    }

    /// Replaces the windows.
    fn set_up(
        &mut self,
        event_loop: &ActiveEventLoop,
        config: &ViewerConfig,
        title: &str,
        arrangement: &Arrangement,
    ) -> Result<(), ViewerError> {
        let view = self.viewer.view_id();
        let composite = self.viewer.composite_mut();
        composite.frame.screens = Screen::all(event_loop);
        let opened = match window_open::set_up(event_loop, composite, (view, config, title), arrangement) {
            Ok(opened) => opened,
            Err(error) => {
                log::error!("the windows stay as they are: {error}");
                return Ok(());
            }
        };
        for (_, context) in std::mem::replace(&mut self.windows, opened) {
            self.viewer.composite_mut().close_context(context)?;
        }
        if let Some((_, first)) = self.windows.first() {
            self.viewer.set_context(*first);
        }
        // Its state belongs to a window.
        self.overlay = OverlayInput::default();
        self.request_redraw();
        Ok(())
    }

    fn obey(&mut self, command: WindowCommand) {
        let Some((window, context)) = self.main_window().cloned() else { return };
        if let Some(size_px) = window_open::obey(&window, command)
            && let Err(error) = self.viewer.resize_context(context, size_px)
        {
            log::error!("{error}");
        }
    }

    /// Works for the pager until the next frame is due, and requests it.
    fn plan_next(&mut self, event_loop: &ActiveEventLoop) {
        if let Some(due) = self.pacing.next_frame_at() {
            self.viewer.work_until(due);
        }
        if self.pacing.plan_next(event_loop, self.viewer.check_need_to_do_frame()) {
            self.request_redraw();
        }
    }
}
