//! The methods of [`View`] on input that need no scene: queue, handlers, manipulator, notices and overlay. Main thread.

use std::sync::Arc;

use glam::DVec2;

use super::handler::GuiEventHandler;
use super::state::{ViewEvent, ViewUpdate, WindowCommand};
use super::window_matrix::{WindowMatrix, WindowRay};
use crate::state::StateSet;
use crate::viewer::clock::FrameStamp;
use crate::viewer::config::{Arrangement, WindowSetup};
use crate::viewer::events::{EventQueue, GuiEventAdapter, Key, Usage, UserEvents, YOrientation};
use crate::viewer::manipulators::{CameraManipulator, GroundHeight};
use crate::viewer::view::View;

impl View {
    /// Returns the event queue, which a window, a test or another toolkit feeds.
    pub fn event_queue(&mut self) -> &mut EventQueue {
        &mut self.input.queue
    }

    /// Returns a sender through which any thread queues events of the application.
    pub fn user_events(&self) -> UserEvents {
        self.input.queue.user_events()
    }

    /// Appends an event handler.
    pub fn add_event_handler(&mut self, handler: impl GuiEventHandler + 'static) {
        self.input.handlers.add(Box::new(handler));
    }

    /// Removes all event handlers.
    pub fn clear_event_handlers(&mut self) {
        self.input.handlers.clear();
    }

    /// Sets a callback of the view's cameras; OSG's update callback of a camera. It is called once a frame, after the callbacks
    /// of the scene and before the manipulator moves the camera, and may change camera and slaves.
    pub fn set_update_callback(&mut self, callback: Option<ViewUpdate>) {
        self.input.on_update = callback;
        self.request_redraw();
    }

    /// Returns true if the cameras have an update callback.
    pub fn has_update_callback(&self) -> bool {
        self.input.on_update.is_some()
    }

    /// Sets a callback of the view's cameras for events; OSG's event callback of a camera. It is called for each event, after the
    /// handlers, the manipulator and the event callbacks of the scene.
    pub fn set_event_callback(&mut self, callback: Option<ViewEvent>) {
        self.input.on_event = callback;
    }

    /// Calls the update callback.
    pub(super) fn call_update(&mut self, stamp: &FrameStamp) {
        if let Some(mut call) = self.input.on_update.take() {
            call(self, stamp);
            // Unless the callback has set another one.
            self.input.on_update.get_or_insert(call);
        }
    }

    /// Calls the event callback.
    pub(super) fn call_event(&mut self, event: &GuiEventAdapter) {
        if let Some(mut call) = self.input.on_event.take() {
            call(self, event);
            self.input.on_event.get_or_insert(call);
        }
    }

    /// Sets the keys that end the application; Escape by default.
    pub fn set_quit_keys(&mut self, keys: &[Key]) {
        self.input.quit_keys = keys.to_vec();
    }

    /// Returns true once the user or the application has asked to end the application's loop.
    pub fn is_done(&self) -> bool {
        self.input.is_done
    }

    /// Asks to end the application's loop, or withdraws that.
    pub fn set_done(&mut self, done: bool) {
        self.input.is_done = done;
    }

    /// Removes the manipulator and returns it.
    pub fn take_manipulator(&mut self) -> Option<Box<dyn CameraManipulator>> {
        self.input.camera_motion.take_manipulator()
    }

    /// Returns the manipulator.
    pub fn manipulator(&self) -> Option<&(dyn CameraManipulator + 'static)> {
        self.input.camera_motion.manipulator()
    }

    /// Sets the source of ground heights, for manipulators that stay above the ground.
    pub fn set_ground(&mut self, ground: Option<Box<dyn GroundHeight>>) {
        self.input.camera_motion.set_ground(ground);
    }

    /// Returns true when there is a source of ground heights.
    pub fn has_ground(&self) -> bool {
        self.input.camera_motion.ground().is_some()
    }

    /// Returns the product of the master camera's view, projection and window matrices.
    pub fn window_matrix(&self) -> WindowMatrix {
        let whole = WindowMatrix::new(&self.camera, self.size_px());
        match self.master.and_then(|place| place.part_px()) {
            Some([x, y, ..]) => WindowMatrix { origin_px: DVec2::new(f64::from(x), f64::from(y)), ..whole },
            None => whole,
        }
    }

    /// Returns the ray from the eye through the pointer of an event.
    pub fn ray_at(&self, event: &GuiEventAdapter) -> Option<WindowRay> {
        let position = event.state.position_in(YOrientation::IncreasingDownwards);
        WindowMatrix::new(&self.camera, self.size_px()).ray(position, self.camera.eye())
    }

    /// Sets the state set above all roots, such as a wireframe override; OSG's state set of the camera.
    pub fn set_state_set(&mut self, state_set: Option<Arc<StateSet>>) {
        self.input.state_set = state_set;
        self.request_redraw();
    }

    /// Returns the state set above all roots.
    pub fn state_set(&self) -> Option<&Arc<StateSet>> {
        self.input.state_set.as_ref()
    }

    /// Queues a request to the window.
    pub fn request_window(&mut self, command: WindowCommand) {
        self.input.window_commands.push(command);
    }

    /// Shows the view in a window: its upper left corner on a screen (`None` is the system's first one) and its size, in pixels.
    /// See [`Self::set_up`].
    pub fn set_up_view_in_window(&mut self, position_px: [i32; 2], size_px: [u32; 2], screen: Option<usize>) {
        let (position_px, size_px) = (Some(position_px), Some(size_px));
        let window = WindowSetup { position_px, size_px, screen, ..WindowSetup::default() };
        self.set_up(Arrangement::Windows(vec![window]));
    }

    /// Fills a screen with the view, by its number counted from 0. See [`Self::set_up`].
    pub fn set_up_view_on_single_screen(&mut self, screen: usize) {
        let window = WindowSetup { screen: Some(screen), full_screen: true, ..WindowSetup::default() };
        self.set_up(Arrangement::Windows(vec![window]));
    }

    /// Fills all screens with the view; see [`Arrangement::AllScreens`] and [`Self::set_up`].
    pub fn set_up_view_across_all_screens(&mut self) {
        self.set_up(Arrangement::AllScreens);
    }

    /// Asks [`run_window`](crate::viewer::run_window) or [`run_views`](crate::viewer::run_views) for other windows, after the
    /// current frame or the first one. They share the device of the present ones, so that nothing is loaded again. The first
    /// camera of the arrangement is the view's master, the others replace its slaves. Windows in which no camera is left are
    /// closed. Where a window cannot be opened, an error is logged and the present windows stay.
    pub fn set_up(&mut self, arrangement: Arrangement) {
        self.request_window(WindowCommand::SetUp(arrangement));
    }

    /// Takes the queued requests; called by the code that runs the window.
    pub fn take_window_commands(&mut self) -> Vec<WindowCommand> {
        std::mem::take(&mut self.input.window_commands)
    }

    /// Shows the user a line of text for 2.5 seconds.
    pub fn notify(&mut self, text: impl Into<String>) {
        let text = text.into();
        log::debug!("{text}");
        self.input.set_notice(text);
    }

    /// Returns the line of text that is shown to the user now.
    pub fn notice(&self) -> Option<&str> {
        self.input.notice()
    }

    /// Returns the keys and gestures of the manipulator and the handlers, for the help.
    pub fn usage(&self) -> Vec<Usage> {
        let handlers = self.input.handlers.iter().flat_map(|handler| handler.usage());
        let manipulator = self.manipulator().into_iter().flat_map(|manipulator| manipulator.usage());
        let home = self.manipulator().into_iter().map(|_| Usage { keys: "Space".to_owned(), does: "home" });
        let quit = self.input.quit_keys.iter().map(|key| Usage { keys: key.to_string(), does: "quit" });
        manipulator.chain(home).chain(handlers).chain(quit).collect()
    }

    /// Requests another frame even when nothing moves; see
    /// [`Viewer::check_need_to_do_frame`](crate::viewer::Viewer::check_need_to_do_frame).
    pub fn request_redraw(&mut self) {
        self.input.needs_redraw = true;
    }

    /// Returns true when a notice or a handler's page lies over the master camera's image.
    pub fn shows_overlay(&self) -> bool {
        self.input.notice().is_some() || self.input.handlers.iter().any(|handler| handler.shows_overlay())
    }

    /// Returns the egui context of the overlay, for a window's input. A lost device replaces it. Its coordinates are the
    /// window's, in points.
    #[cfg(feature = "window")]
    pub fn overlay_context(&self) -> &egui::Context {
        self.input.overlay.context()
    }

    /// Sets the user's input for the overlay of the next frame, and the pixels per point.
    #[cfg(feature = "window")]
    pub fn set_overlay_input(&mut self, input: egui::RawInput, pixels_per_point: f32) {
        self.input.overlay_input = Some((input, pixels_per_point));
    }
}
