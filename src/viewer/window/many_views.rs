//! [`run_views`]: several views in several windows. winit's event loop feeds the event queue of the view that an event belongs
//! to, and calls the frames of the viewer. Main thread.

use std::path::PathBuf;
use std::sync::Arc;

use winit::application::ApplicationHandler;
use winit::event::{StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow};
use winit::window::{Window, WindowId};

use super::input_routes::InputRoutes;
use super::overlay_input::OverlayInput;
use super::pacing::Pacing;
use super::{events as window_events, open as window_open};
use crate::gpu::GraphicsContext;
use crate::viewer::ViewerError;
use crate::viewer::arranged_views::ArrangedViews;
use crate::viewer::composite::CompositeViewer;
use crate::viewer::config::{Arrangement, Screen, ViewsSetup};
use crate::viewer::display;
use crate::viewer::frame::ViewerConfig;
use crate::viewer::handlers::{self, StatsPage};
use crate::viewer::ids::{ContextId, ViewId};
use crate::viewer::input::WindowCommand;
use crate::viewer::manipulators::{self, SceneGround};
use crate::viewer::paging::LoadedRoot;
use crate::viewer::view::View;

/// A callback that runs once, after windows and views were created.
pub type OnViewsOpen = Box<dyn FnOnce(&mut ArrangedViews) -> Result<(), ViewerError>>;
/// A callback before or after each frame; returning false closes the windows.
pub type EachFrame = Box<dyn FnMut(&mut CompositeViewer) -> Result<bool, ViewerError>>;

/// Settings of [`run_views`]: what the views show, and callbacks around their frames.
pub struct ViewsOptions {
    /// The title of windows whose setup names none.
    pub title: String,
    /// Shows the statistics from the start.
    pub overlay: bool,
    /// The folder for screenshots and recorded camera paths.
    pub output_dir: PathBuf,
    /// The root of the scene of views that name none; without it, [`Self::on_open`] fills the scene.
    pub root: Option<LoadedRoot>,
    /// Runs once the views exist.
    pub on_open: OnViewsOpen,
    /// Lets the user move the cameras, with the manipulators that [`Self::on_open`] has set or the
    /// [usual](manipulators::usual) ones.
    pub manipulated: bool,
    /// Draws only frames that [`CompositeViewer::check_need_to_do_frame`] asks for.
    pub on_demand: bool,
    /// The largest frame rate, per second; the pagers use the remaining time.
    pub max_frame_rate: Option<f64>,
    /// Runs before each frame; returning false closes the windows.
    pub before_frame: EachFrame,
    /// Runs after each frame; returning false closes the windows.
    pub after_frame: EachFrame,
}

impl Default for ViewsOptions {
    fn default() -> Self {
        Self {
            title: "Terrane".to_owned(),
            overlay: false,
            output_dir: PathBuf::from("."),
            root: None,
            on_open: Box::new(|_| Ok(())),
            manipulated: true,
            on_demand: false,
            max_frame_rate: None,
            before_frame: Box::new(|_| Ok(true)),
            after_frame: Box::new(|_| Ok(true)),
        }
    }
}

/// Opens the windows of several views and runs them until the last window is closed or a view asks to end. Closing a window
/// removes its cameras, and the views whose master cameras are in it. Returns the viewer. Main thread only.
///
/// Pointer events go to the view under the pointer; while a button is held, to the view in which it was pressed. Keys go to
/// the view under the pointer too. Overlays of a view's handlers are drawn over that view, in the window of its master
/// camera.
pub fn run_views(
    config: ViewerConfig,
    setup: ViewsSetup,
    options: ViewsOptions,
) -> Result<Option<CompositeViewer>, ViewerError> {
    // Errors in the roots show before a window opens.
    let roots = setup.read_roots(&config.pager)?;
    let event_loop = display::event_loop(false)?;
    event_loop.set_control_flow(ControlFlow::Poll);
    let mut app = App { config, setup, options, roots, open: None, closed: None, error: None };
    event_loop.run_app(&mut app).map_err(|e| ViewerError::Window(e.to_string()))?;
    match app.error {
        Some(error) => Err(error),
        None => Ok(app.closed),
    }
}

struct App {
    config: ViewerConfig,
    setup: ViewsSetup,
    options: ViewsOptions,
    roots: Vec<LoadedRoot>,
    open: Option<Open>,
    closed: Option<CompositeViewer>,
    error: Option<ViewerError>,
}

/// A window and the input to its views.
struct OpenWindow {
    window: Arc<Window>,
    context: ContextId,
    routes: InputRoutes,
    /// The overlay input of its views.
    overlays: Vec<(ViewId, OverlayInput)>,
}

impl OpenWindow {
    fn new(window: Arc<Window>, context: ContextId) -> Self {
        Self { window, context, routes: InputRoutes::default(), overlays: Vec::new() }
    }

    /// Gives an event to a view of the window, and to its overlay, which lies over the image of its master camera.
    fn feed(&mut self, id: ViewId, view: &mut View, event: &WindowEvent) {
        let has_overlay = view.context() == Some(self.context);
        let is_taken = has_overlay && overlay_of(&mut self.overlays, id).feed(view, &self.window, event);
        // Presses that the overlay takes do not reach the view. Releases always do, since the press may have been there.
        if !(is_taken && window_events::is_press(event)) {
            window_events::feed(view, self.context, event);
        }
    }
}

/// The objects that exist while the windows are open. Fields are dropped in order: the viewer before its windows.
struct Open {
    viewer: CompositeViewer,
    pacing: Pacing,
    /// The windows; redraws of the first one run the frames.
    windows: Vec<OpenWindow>,
}

impl App {
    fn open(&mut self, event_loop: &ActiveEventLoop) -> Result<Open, ViewerError> {
        let (setup, title, size_px) = (&self.setup, &self.options.title, self.config.size_px);
        let (roots, own) = (std::mem::take(&mut self.roots), self.options.root.take());
        let config = self.config.clone();
        let mut windows: Vec<OpenWindow> = Vec::new();
        let mut arranged = ArrangedViews::new(setup, &config, roots, own, |viewer, place, of| {
            let window = window_open::create(event_loop, of, place, title, size_px)?;
            let traits = window_open::traits_of(&config, of, &window);
            let context = match windows.first().filter(|_| of.shares_device) {
                Some(first) => viewer.open_window_on(first.context, Arc::clone(&window), &traits)?,
                None => viewer.open_context(GraphicsContext::new_window(Arc::clone(&window), &traits)?)?,
            };
            windows.push(OpenWindow::new(window, context));
            Ok(context)
        })?;
        let on_open = std::mem::replace(&mut self.options.on_open, Box::new(|_| Ok(())));
        on_open(&mut arranged)?;
        let ArrangedViews { mut viewer, views, .. } = arranged;
        viewer.frame.screens = Screen::all(event_loop);
        let mut stats = if self.options.overlay { StatsPage::Pager } else { StatsPage::None };
        for (place, id) in views.into_iter().enumerate() {
            let folder = if place == 0 {
                self.options.output_dir.clone()
            } else {
                self.options.output_dir.join(format!("view{}", place + 1))
            };
            let mut view = viewer.actions(id)?;
            handlers::add_usual(&mut view, &folder, std::mem::take(&mut stats));
            if config.pager.build_kd_trees && !view.has_ground() {
                view.set_ground(Some(Box::new(SceneGround::default())));
            }
            if self.options.manipulated && view.manipulator().is_none() {
                view.set_manipulator(Some(Box::new(manipulators::usual(None))));
            }
        }
        if windows.is_empty() {
            return Err(ViewerError::Window("the arrangement has no windows".to_owned()));
        }
        let pacing = Pacing::new(self.options.on_demand, self.options.max_frame_rate);
        Ok(Open { viewer, pacing, windows })
    }

    fn handle(
        &mut self,
        event_loop: &ActiveEventLoop,
        window: WindowId,
        event: &WindowEvent,
    ) -> Result<(), ViewerError> {
        let Some(open) = &mut self.open else { return Ok(()) };
        let Some(place) = open.windows.iter().position(|of| of.window.id() == window) else {
            return Ok(()); // events of a window that was closed
        };
        match event {
            WindowEvent::RedrawRequested if place == 0 => {
                if open.frame(event_loop, &self.config, &mut self.options)? {
                    open.plan_next(event_loop);
                } else {
                    event_loop.exit();
                }
                return Ok(());
            }
            WindowEvent::Resized(size) => {
                open.viewer.resize_context(open.windows[place].context, [size.width, size.height])?;
            }
            // Without a camera of a view in the window, no view would get the event.
            WindowEvent::Destroyed => open.close(open.windows[place].context)?,
            WindowEvent::CloseRequested if !open.has_view(place) => open.close(open.windows[place].context)?,
            event => open.feed(place, event)?,
        }
        if open.windows.is_empty() {
            event_loop.exit();
        } else if open.pacing.is_on_demand() {
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
                open.windows.iter().for_each(|of| of.window.request_redraw());
                self.open = Some(open);
            }
            Err(error) => {
                self.error = Some(error);
                event_loop.exit();
            }
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
        if let Some(open) = &self.open {
            open.pacing.rest(event_loop);
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, window: WindowId, event: WindowEvent) {
        if let Err(error) = self.handle(event_loop, window, &event) {
            self.error.get_or_insert(error);
            event_loop.exit();
        }
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        if let Some(mut open) = self.open.take() {
            let ended = open.viewer.finish().and_then(|()| (self.options.after_frame)(&mut open.viewer));
            if let Err(error) = ended {
                self.error.get_or_insert(error);
            }
            self.closed = Some(open.viewer);
        }
    }
}

fn overlay_of(overlays: &mut Vec<(ViewId, OverlayInput)>, view: ViewId) -> &mut OverlayInput {
    let known = overlays.iter().position(|(of, _)| *of == view);
    let place = known.unwrap_or_else(|| {
        overlays.push((view, OverlayInput::default()));
        overlays.len() - 1
    });
    &mut overlays[place].1
}

impl Open {
    fn request_redraw(&self) {
        if let Some(first) = self.windows.first() {
            first.window.request_redraw();
        }
    }

    /// Returns true when a camera of some view is in a window.
    fn has_view(&self, place: usize) -> bool {
        let context = self.windows[place].context;
        self.viewer.views().any(|(_, view)| view.contexts().any(|of| of == context))
    }

    /// Closes a window with its context, and removes the views whose master cameras are in it.
    fn close(&mut self, context: ContextId) -> Result<(), ViewerError> {
        self.windows.retain(|of| of.context != context);
        let gone: Vec<ViewId> =
            self.viewer.views().filter(|(_, v)| v.context() == Some(context)).map(|(id, _)| id).collect();
        self.viewer.close_context(context)?;
        for view in gone {
            self.viewer.remove_view(view)?;
        }
        // Removed views get no more events.
        let is_there = |view: ViewId| self.viewer.views().any(|(id, _)| id == view);
        for window in &mut self.windows {
            window.routes.retain(is_there);
            window.overlays.retain(|(view, _)| is_there(*view));
        }
        self.request_redraw();
        Ok(())
    }

    /// Shows a view in other windows, and closes those in which no camera is left.
    fn set_up(
        &mut self,
        event_loop: &ActiveEventLoop,
        of: (ViewId, &ViewerConfig, &str),
        arrangement: &Arrangement,
    ) -> Result<(), ViewerError> {
        self.viewer.frame.screens = Screen::all(event_loop);
        match window_open::set_up(event_loop, &mut self.viewer, of, arrangement) {
            Ok(opened) => {
                let opened = opened.into_iter().map(|(window, context)| OpenWindow::new(window, context));
                self.windows.extend(opened);
            }
            Err(error) => log::error!("the windows stay as they are: {error}"),
        }
        let is_unused = |place: &usize| !self.has_view(*place);
        let unused: Vec<ContextId> =
            (0..self.windows.len()).filter(is_unused).map(|place| self.windows[place].context).collect();
        unused.into_iter().try_for_each(|context| self.close(context))
    }

    /// Gives an event to the view that it belongs to.
    fn feed(&mut self, place: usize, event: &WindowEvent) -> Result<(), ViewerError> {
        let Open { viewer, windows, .. } = self;
        let window = &mut windows[place];
        let context = window.context;
        let here = || viewer.views().filter(|(_, view)| view.contexts().any(|of| of == context)).map(|(id, _)| id);
        let ids: Vec<ViewId> = match event {
            WindowEvent::CloseRequested | WindowEvent::Focused(_) | WindowEvent::ModifiersChanged(_) => {
                here().collect()
            }
            _ => {
                let at = |position_px| viewer.view_at(context, position_px).map(|(view, _)| view);
                window.routes.view_of(event, at, here().next()).into_iter().collect()
            }
        };
        if let WindowEvent::Focused(false) = event {
            // Views treat everything as released when the focus is lost.
            window.routes.clear();
        }
        for id in ids {
            window.feed(id, viewer.view_mut(id)?, event);
        }
        Ok(())
    }

    /// Draws one frame; returns false when it was the last.
    fn frame(
        &mut self,
        event_loop: &ActiveEventLoop,
        config: &ViewerConfig,
        options: &mut ViewsOptions,
    ) -> Result<bool, ViewerError> {
        self.pacing.begin_frame();
        if self.viewer.views().next().is_none() || !(options.before_frame)(&mut self.viewer)? {
            return Ok(false);
        }
        let ids: Vec<ViewId> = self.viewer.views().map(|(id, _)| id).collect();
        for id in ids {
            let view = self.viewer.view_mut(id)?;
            if let Some(window) = self.windows.iter_mut().find(|of| Some(of.context) == view.context()) {
                overlay_of(&mut window.overlays, id).hand_over(view, &window.window);
            }
        }
        self.viewer.frame()?;
        if !(options.after_frame)(&mut self.viewer)? {
            return Ok(false);
        }
        let ids: Vec<ViewId> = self.viewer.views().map(|(id, _)| id).collect();
        for id in ids {
            // A command of another view may have closed the window of this one, and removed it.
            let Ok(view) = self.viewer.view_mut(id) else { continue };
            let (commands, context) = (view.take_window_commands(), view.context());
            for command in commands {
                match command {
                    WindowCommand::Close(context) => self.close(context)?,
                    WindowCommand::SetUp(arrangement) => {
                        self.set_up(event_loop, (id, config, &options.title), &arrangement)?;
                    }
                    command => {
                        if let Some(place) = self.windows.iter().position(|of| Some(of.context) == context) {
                            self.obey(place, command)?;
                        }
                    }
                }
            }
        }
        Ok(!self.viewer.is_done() && !self.windows.is_empty())
    }

    /// Works for the pagers until the next frame is due, and requests it.
    fn plan_next(&mut self, event_loop: &ActiveEventLoop) {
        if let Some(due) = self.pacing.next_frame_at() {
            self.viewer.work_until(due);
        }
        if self.pacing.plan_next(event_loop, self.viewer.check_need_to_do_frame()) {
            self.request_redraw();
        }
    }

    fn obey(&mut self, place: usize, command: WindowCommand) -> Result<(), ViewerError> {
        let OpenWindow { window, context, .. } = &self.windows[place];
        match window_open::obey(window, command) {
            Some(size_px) => self.viewer.resize_context(*context, size_px),
            None => Ok(()),
        }
    }
}
