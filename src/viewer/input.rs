//! The event phase: what is in the queue goes to handlers, manipulator and event callbacks; what the user sees of it
//! lies over the picture. Main thread.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use glam::{DAffine3, DVec2, DVec3};
use image::RgbaImage;

use super::ViewerError;
use super::base::ViewerBase;
use super::events::{EventKind, EventQueue, GuiEventAdapter, GuiEventHandler, Key, Usage, UserEvents, YOrientation};
use super::home::SetBounds;
use super::manipulators::{CameraManipulator, GroundHeight, ManipulatorView};
#[cfg(feature = "window")]
use super::overlay::Overlay;
use super::paged_scene::PagedScene;
use super::rendering::ThreadingModel;
use super::stats::StatsHistory;
use super::view::View;
use super::viewer::FrameStamp;
use super::window_matrix::{WindowMatrix, WindowRay};
use crate::math::BoundingSphere;
use crate::pager::{DatabasePager, ImagePager};
use crate::scene::{EventCallback, NodeId, Scene, Traverse};
use crate::state::StateSet;

/// How long a notice is shown, seconds.
const NOTICE_S: f64 = 2.5;

/// What rests has so many seconds in a frame without events, to look around: for the ground below it, say.
const LOOKS_AROUND_S: f64 = 1.0 / 240.0;

/// What the window is asked to do; done by whoever runs the window, before the next frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindowCommand {
    /// Fill the screen, or no longer.
    ToggleFullScreen,
    /// A size in pixels.
    Resize([u32; 2]),
}

/// What is done with a picture that was asked for: it and its frame.
pub type OnPicture = Box<dyn FnOnce(u32, RgbaImage)>;

/// Everything of a view that has to do with input.
pub(super) struct Input {
    pub queue: EventQueue,
    /// One that is being called is out of its place.
    handlers: Vec<Option<Box<dyn GuiEventHandler>>>,
    manipulator: Option<Box<dyn CameraManipulator>>,
    ground: Option<Box<dyn GroundHeight>>,
    /// The manipulator was moving when the last frame ended.
    was_moving: bool,
    /// Seconds for which the manipulator moves in this frame at most: what rested moves from the first event on.
    moves_s: f64,
    events: Vec<GuiEventAdapter>,
    quit_keys: Vec<Key>,
    done: bool,
    /// Handlers are being called.
    in_phase: bool,
    window_commands: Vec<WindowCommand>,
    notice: Option<(String, f64)>,
    /// Something happened since the last frame that may change the picture.
    redraw: bool,
    /// Over all roots.
    pub state_set: Option<Arc<StateSet>>,
    #[cfg(feature = "window")]
    pub overlay: Overlay,
    #[cfg(feature = "window")]
    overlay_input: Option<(egui::RawInput, f32)>,
}

impl Input {
    pub fn new(size_px: [u32; 2]) -> Self {
        let mut queue = EventQueue::default();
        queue.set_input_range(DVec2::ZERO, DVec2::new(f64::from(size_px[0].max(1)), f64::from(size_px[1].max(1))));
        Self {
            queue,
            handlers: Vec::new(),
            manipulator: None,
            ground: None,
            was_moving: false,
            moves_s: f64::INFINITY,
            events: Vec::new(),
            quit_keys: vec![Key::Escape],
            done: false,
            in_phase: false,
            window_commands: Vec::new(),
            notice: None,
            redraw: true,
            state_set: None,
            #[cfg(feature = "window")]
            overlay: Overlay::default(),
            #[cfg(feature = "window")]
            overlay_input: None,
        }
    }

    /// The picture has another size.
    pub fn resized(&mut self, size_px: [u32; 2]) {
        let time_s = self.queue.time_s();
        self.queue.window_resize(size_px, time_s);
    }
}

/// An event callback of a node, for [`Node::event_callback`](crate::scene::Node::event_callback).
pub fn event_callback(
    mut call: impl FnMut(&mut Scene, NodeId, &GuiEventAdapter) -> Traverse + Send + 'static,
) -> EventCallback {
    EventCallback::new(move |scene, node, event| {
        event.downcast_ref().map_or(Traverse::Below, |event| call(scene, node, event))
    })
}

/// What manipulators are told.
pub(super) fn manipulator_view<'a>(view: &'a View, paged: &'a PagedScene) -> ManipulatorView<'a> {
    let unit = BoundingSphere::new(DVec3::ZERO, 1.0);
    ManipulatorView {
        scene: paged.scene(),
        camera: &view.camera,
        size_px: view.size_px(),
        bounds: paged.bounds.unwrap_or_else(|| SetBounds::from_sphere(unit)),
        ground: view.input.ground.as_deref(),
    }
}

/// False while another frame would show the same picture.
pub(super) fn needs_frame(base: &ViewerBase, view: &View, scenes: &[PagedScene]) -> bool {
    base.awaits_answers() || changes(base, view, scenes)
}

/// Something but answers of the adapter may change the next picture.
pub(super) fn changes(base: &ViewerBase, view: &View, scenes: &[PagedScene]) -> bool {
    let (input, paged) = (&view.input, &scenes[view.scene]);
    let pager = base.pager_of(paged);
    input.redraw
        || !input.queue.is_empty()
        || view.shows_overlay()
        || input.manipulator.as_ref().is_some_and(|m| m.is_moving())
        || base.stamp.frame == 0
        || base.awaits_picture()
        || !paged.update_callbacks.is_empty()
        || paged.scene().has_update_callbacks()
        || !pager.is_unchanging(scenes)
        || pager.has_due()
        || paged.image_pager.as_ref().is_some_and(|images| images.needs_frame())
}

/// What has to do with input and needs no scene.
impl View {
    /// The queue that a window, a test or another toolkit feeds.
    pub fn event_queue(&mut self) -> &mut EventQueue {
        &mut self.input.queue
    }

    /// Sends the application's own events from any thread.
    pub fn user_events(&self) -> UserEvents {
        self.input.queue.user_events()
    }

    /// Adds a handler after those that are there.
    pub fn add_event_handler(&mut self, handler: impl GuiEventHandler + 'static) {
        self.input.handlers.push(Some(Box::new(handler)));
    }

    /// Takes all handlers out.
    pub fn clear_event_handlers(&mut self) {
        self.input.handlers.clear();
    }

    /// Keys that end the application; Escape at first.
    pub fn set_quit_keys(&mut self, keys: &[Key]) {
        self.input.quit_keys = keys.to_vec();
    }

    /// True once the user or the application wants an end.
    pub fn is_done(&self) -> bool {
        self.input.done
    }

    /// Ends the application's loop, or lets it go on.
    pub fn set_done(&mut self, done: bool) {
        self.input.done = done;
    }

    /// Takes the manipulator out.
    pub fn take_manipulator(&mut self) -> Option<Box<dyn CameraManipulator>> {
        self.input.manipulator.take()
    }

    /// The manipulator.
    pub fn manipulator(&self) -> Option<&(dyn CameraManipulator + 'static)> {
        self.input.manipulator.as_deref()
    }

    /// Where the ground is, for manipulators that stay above it.
    pub fn set_ground(&mut self, ground: Option<Box<dyn GroundHeight>>) {
        self.input.ground = ground;
    }

    /// True when it is known where the ground is.
    pub fn has_ground(&self) -> bool {
        self.input.ground.is_some()
    }

    /// View, projection and window matrices of the master camera.
    pub fn window_matrix(&self) -> WindowMatrix {
        let whole = WindowMatrix::new(&self.camera, self.size_px());
        match self.master.and_then(|place| place.part_px()) {
            Some([x, y, ..]) => WindowMatrix { origin_px: DVec2::new(f64::from(x), f64::from(y)), ..whole },
            None => whole,
        }
    }

    /// What is seen under the pointer of an event.
    pub fn ray_at(&self, event: &GuiEventAdapter) -> Option<WindowRay> {
        let position = event.state.position_in(YOrientation::IncreasingDownwards);
        WindowMatrix::new(&self.camera, self.size_px()).ray(position, self.camera.eye())
    }

    /// State above all roots, such as a wireframe that overrides; OSG's state set of the camera.
    pub fn set_state_set(&mut self, state_set: Option<Arc<StateSet>>) {
        self.input.state_set = state_set;
        self.request_redraw();
    }

    /// State above all roots.
    pub fn state_set(&self) -> Option<&Arc<StateSet>> {
        self.input.state_set.as_ref()
    }

    /// Asks the window for something.
    pub fn request_window(&mut self, command: WindowCommand) {
        self.input.window_commands.push(command);
    }

    /// What the window is asked for; for whoever runs it.
    pub fn take_window_commands(&mut self) -> Vec<WindowCommand> {
        std::mem::take(&mut self.input.window_commands)
    }

    /// Shows the user a line for a short while.
    pub fn notify(&mut self, text: impl Into<String>) {
        let text = text.into();
        log::debug!("{text}");
        self.input.notice = Some((text, self.input.queue.time_s() + NOTICE_S));
    }

    /// The line that is shown to the user now.
    pub fn notice(&self) -> Option<&str> {
        self.input.notice.as_ref().map(|(text, _)| &**text)
    }

    /// The keys and gestures of handlers and manipulator.
    pub fn usage(&self) -> Vec<Usage> {
        let handlers = self.input.handlers.iter().flatten().flat_map(|handler| handler.usage());
        let manipulator = self.input.manipulator.iter().flat_map(|manipulator| manipulator.usage());
        let home = self.input.manipulator.iter().map(|_| Usage { keys: "Space".to_owned(), does: "home" });
        let quit = self.input.quit_keys.iter().map(|key| Usage { keys: key.to_string(), does: "quit" });
        manipulator.chain(home).chain(handlers).chain(quit).collect()
    }

    /// The next frame is to be drawn even where nothing moves; see [`super::Viewer::check_need_to_do_frame`].
    pub fn request_redraw(&mut self) {
        self.input.redraw = true;
    }

    /// True when something lies over the picture: over the master camera's part of its window, in each view that has
    /// something to show.
    pub fn shows_overlay(&self) -> bool {
        self.input.notice.is_some() || self.input.handlers.iter().flatten().any(|handler| handler.shows_overlay())
    }

    /// The egui context of the overlay, for a window's input; another one once a lost device was replaced. Places are those
    /// of the window, in points.
    #[cfg(feature = "window")]
    pub fn overlay_context(&self) -> &egui::Context {
        self.input.overlay.context()
    }

    /// What the user did, for the overlay of the next frame, and the pixels of a point.
    #[cfg(feature = "window")]
    pub fn set_overlay_input(&mut self, input: egui::RawInput, pixels_per_point: f32) {
        self.input.overlay_input = Some((input, pixels_per_point));
    }
}

/// A view with its scene and its viewer: what handlers are given, and may use and change; OSG's `GUIActionAdapter`. It
/// is the [`View`] too.
pub struct GuiActionAdapter<'a> {
    pub(super) base: &'a mut ViewerBase,
    pub(super) view: &'a mut View,
    pub(super) paged: &'a mut PagedScene,
}

impl Deref for GuiActionAdapter<'_> {
    type Target = View;

    fn deref(&self) -> &View {
        self.view
    }
}

impl DerefMut for GuiActionAdapter<'_> {
    fn deref_mut(&mut self) -> &mut View {
        self.view
    }
}

impl GuiActionAdapter<'_> {
    /// The scene.
    pub fn scene(&self) -> &Scene {
        self.paged.scene()
    }

    /// The scene, to be changed.
    pub fn scene_mut(&mut self) -> &mut Scene {
        self.paged.scene_mut()
    }

    /// The image pager, once a sequence was added.
    pub fn image_pager(&self) -> Option<&ImagePager> {
        self.paged.image_pager.as_ref()
    }

    /// The pager, once a set is loaded.
    pub fn pager(&self) -> Option<&DatabasePager> {
        self.base.pager_of(self.paged).pager()
    }

    /// Extent of the tile set that was loaded; without one, of the first root.
    pub fn bounds(&self) -> Option<&SetBounds> {
        self.paged.bounds.as_ref()
    }

    /// Number and times of the frame.
    pub fn frame_stamp(&self) -> FrameStamp {
        self.base.stamp
    }

    /// Statistics of the frames so far.
    pub fn stats(&self) -> &StatsHistory {
        &self.base.history
    }

    /// The threading model that runs.
    pub fn threading_model(&self) -> ThreadingModel {
        self.base.rendering.model()
    }

    /// Changes the threading model, after all frames are drawn.
    pub fn set_threading_model(&mut self, model: ThreadingModel) -> Result<(), ViewerError> {
        self.base.absorb_all()?;
        self.base.rendering.set_model(model)
    }

    /// What manipulators are told.
    pub fn manipulator_view(&self) -> ManipulatorView<'_> {
        manipulator_view(self.view, self.paged)
    }

    /// Moves the camera from now on, starting from where it is.
    pub fn set_manipulator(&mut self, manipulator: Option<Box<dyn CameraManipulator>>) {
        self.view.input.manipulator = manipulator;
        let pose = self.view.camera.world_from_eye;
        self.with_manipulator(|manipulator, view| manipulator.set_pose(&pose, view));
    }

    /// Does something with the manipulator, which is told what there is; `None` without one.
    pub fn with_manipulator<R>(
        &mut self,
        act: impl FnOnce(&mut dyn CameraManipulator, &ManipulatorView<'_>) -> R,
    ) -> Option<R> {
        let mut manipulator = self.view.input.manipulator.take()?;
        let result = act(&mut *manipulator, &self.manipulator_view());
        self.view.input.manipulator = Some(manipulator);
        Some(result)
    }

    /// Places the camera where the bounds fill the picture; a manipulator goes on from its own home.
    pub fn home(&mut self) {
        if self.with_manipulator(|manipulator, view| manipulator.home(view)).is_none() {
            self.view.camera.world_from_eye = self.manipulator_view().home_pose();
        }
    }

    /// Places the camera; a manipulator goes on from there. What is not finite changes nothing.
    pub fn set_pose(&mut self, world_from_eye: &DAffine3) {
        if world_from_eye.is_finite() {
            self.view.camera.world_from_eye = *world_from_eye;
            self.with_manipulator(|manipulator, view| manipulator.set_pose(world_from_eye, view));
        }
    }

    /// The first sight of what the scene shows; a manipulator goes on from there.
    pub(super) fn first_sight(&mut self) {
        if let Some(bounds) = self.paged.bounds {
            self.view.first_sight(&bounds);
            let pose = self.view.camera.world_from_eye;
            self.with_manipulator(|manipulator, view| manipulator.set_pose(&pose, view));
        }
    }

    /// Reads back the picture of the frame that comes next (in the event phase: of this frame), for `then`. Nothing
    /// where the master camera has no context.
    pub fn capture(&mut self, then: OnPicture) {
        let frame = self.base.stamp.frame + u32::from(!self.view.input.in_phase);
        if let Some(context) = self.view.context() {
            self.base.capture(context, frame, then);
        }
    }

    /// The event phase.
    pub(super) fn event_traversal(&mut self) {
        let time_s = self.view.input.queue.time_s();
        let mut events = std::mem::take(&mut self.view.input.events);
        self.view.input.queue.take_frame(&mut events, time_s);
        let is_moving = self.view.input.was_moving && self.manipulator().is_some_and(|m| m.is_moving());
        self.view.input.moves_s = match events.first() {
            _ if is_moving => f64::INFINITY,
            Some(first) if !matches!(first.kind, EventKind::Frame) => (time_s - first.time_s).max(0.0),
            _ => LOOKS_AROUND_S,
        };
        self.view.input.redraw = false;
        self.view.input.in_phase = true;
        for event in &mut events {
            self.handle_event(event);
        }
        self.view.input.in_phase = false;
        events.clear();
        self.view.input.events = events;
        if self.view.input.notice.as_ref().is_some_and(|(_, until_s)| time_s > *until_s) {
            self.view.input.notice = None;
            // Once more, without it.
            self.view.input.redraw = true;
        }
    }

    fn handle_event(&mut self, event: &mut GuiEventAdapter) {
        let mask = event.mask();
        // What is added meanwhile is called from the next event on.
        for place in 0..self.view.input.handlers.len() {
            self.with_handler(place, |handler, viewer| {
                let ignores = event.handled && handler.ignore_handled_mask().intersects(mask);
                if handler.event_mask().intersects(mask) && !ignores {
                    event.handled |= handler.handle(event, viewer);
                }
            });
        }
        if !event.handled {
            let taken = self.with_manipulator(|manipulator, view| {
                let taken = manipulator.handle(event, view);
                (taken, manipulator.take_notice())
            });
            if let Some((taken, notice)) = taken {
                event.handled |= taken;
                notice.into_iter().for_each(|text| self.notify(text));
            }
        }
        if let Some(scene) = self.paged.changeable().filter(|scene| scene.has_event_callbacks()) {
            scene.event_traversal(event);
        }
        if event.handled {
            return;
        }
        match event.kind {
            EventKind::CloseWindow | EventKind::QuitApplication => self.view.input.done = true,
            EventKind::KeyDown { .. }
                if event.key_pressed().is_some_and(|k| self.view.input.quit_keys.contains(&k)) =>
            {
                self.view.input.done = true;
            }
            EventKind::KeyDown { .. } if matches!(event.key_pressed(), Some(Key::SPACE | Key::Home)) => {
                self.home();
                event.handled = true;
            }
            _ => {}
        }
    }

    /// Calls a handler, which may change the list of handlers.
    fn with_handler(&mut self, place: usize, call: impl FnOnce(&mut dyn GuiEventHandler, &mut Self)) {
        if let Some(mut handler) = self.view.input.handlers.get_mut(place).and_then(Option::take) {
            call(&mut *handler, self);
            if let Some(out) = self.view.input.handlers.get_mut(place).filter(|out| out.is_none()) {
                *out = Some(handler);
            }
        }
    }

    /// The camera where the manipulator has it; in update, after the callbacks, since it may follow what they moved.
    pub(super) fn update_camera(&mut self, dt_s: f64) {
        let dt_s = dt_s.min(self.view.input.moves_s);
        if let Some(pose) = self.with_manipulator(|manipulator, view| manipulator.advance(dt_s, view)) {
            if pose.is_finite() {
                self.view.camera.world_from_eye = pose;
            } else {
                log::warn!("a manipulator gave a pose that is not finite; the camera stays where it was");
            }
        }
        self.view.input.was_moving = self.manipulator().is_some_and(|m| m.is_moving());
    }

    /// After the events: what lies over the master camera's picture.
    #[cfg(feature = "window")]
    pub(super) fn lay_out_overlay(&mut self) {
        let input = self.view.input.overlay_input.take();
        let Some(place) = self.view.master.filter(|_| self.shows_overlay()) else { return };
        let Some(size_px @ [width, height]) = self.base.rendering.size_px(place.context) else { return };
        let [x, y, wide, high] = place.viewport.part_px(size_px).unwrap_or([0, 0, width, height]);
        // What of it is in the window.
        let part_px = [x, y, wide.min(width.saturating_sub(x)), high.min(height.saturating_sub(y))];
        if part_px[2] == 0 || part_px[3] == 0 {
            return;
        }
        let (input, pixels_per_point) = input.unwrap_or((egui::RawInput::default(), 1.0));
        let mut overlay = self.view.input.overlay.clone();
        let paint = overlay.lay_out(input, part_px, size_px, pixels_per_point, |ui| {
            for place in 0..self.view.input.handlers.len() {
                self.with_handler(place, |handler, viewer| {
                    if handler.shows_overlay() {
                        handler.lay_out(ui, viewer);
                    }
                });
            }
            if let Some(text) = self.notice() {
                super::overlay::notice(ui, text);
            }
        });
        self.base.set_overlay(place.context, paint);
    }
}
