//! The event phase, and the manipulator's step in the update phase.

use super::action_adapter::GuiActionAdapter;
use super::handler::GuiEventHandler;
use super::state::WindowCommand;
use crate::viewer::events::{EventKind, GuiEventAdapter, Key};

impl GuiActionAdapter<'_> {
    /// Runs the event phase: hands the queued events to handlers, manipulator and event callbacks.
    pub(in crate::viewer) fn event_traversal(&mut self) {
        let input = &mut self.view.input;
        let time_s = input.queue.time_s();
        let mut events = std::mem::take(&mut input.events);
        input.queue.take_frame(&mut events, time_s);
        let first = events.first().filter(|first| !matches!(first.kind, EventKind::Frame));
        input.camera_motion.begin_frame(first.map(|first| time_s - first.time_s));
        if std::mem::take(&mut input.needs_redraw) {
            self.view.shown.note_request();
        }
        input.is_in_event_phase = true;
        for event in &mut events {
            self.handle_event(event);
        }
        let input = &mut self.view.input;
        input.is_in_event_phase = false;
        events.clear();
        input.events = events;
        input.expire_notice(time_s);
    }

    fn handle_event(&mut self, event: &mut GuiEventAdapter) {
        let mask = event.mask();
        // A handler that is added meanwhile is called from the next event on.
        for index in 0..self.view.input.handlers.len() {
            self.with_handler(index, |handler, viewer| {
                let ignores = event.handled && handler.ignore_handled_mask().intersects(mask);
                if handler.event_mask().intersects(mask) && !ignores {
                    event.handled |= handler.handle(event, viewer);
                }
            });
        }
        if !event.handled {
            let result = self.with_manipulator(|manipulator, view| {
                let is_handled = manipulator.handle(event, view);
                (is_handled, manipulator.take_notice())
            });
            if let Some((is_handled, notice)) = result {
                event.handled |= is_handled;
                notice.into_iter().for_each(|text| self.notify(text));
            }
        }
        if let Some(scene) = self.paged.changeable().filter(|scene| scene.has_event_callbacks()) {
            scene.event_traversal(event);
        }
        self.view.call_event(event);
        if !event.handled {
            self.apply_default_action(event);
        }
    }

    /// Closes a window, ends the application or returns the camera to its home pose, on an event that was not handled.
    fn apply_default_action(&mut self, event: &mut GuiEventAdapter) {
        match event.kind {
            // Closing the last window ends the application.
            EventKind::CloseWindow => match event.source.context {
                Some(context) if self.base.rendering.context_ids().any(|of| of != context.0) => {
                    self.view.request_window(WindowCommand::Close(context));
                }
                _ => self.view.input.is_done = true,
            },
            EventKind::QuitApplication => self.view.input.is_done = true,
            EventKind::KeyDown { .. } => match event.key_pressed() {
                Some(key) if self.view.input.quit_keys.contains(&key) => self.view.input.is_done = true,
                Some(Key::SPACE | Key::Home) => {
                    self.home();
                    event.handled = true;
                }
                _ => {}
            },
            _ => {}
        }
    }

    /// Calls a function with a handler, which may change the list of handlers.
    fn with_handler(&mut self, index: usize, call: impl FnOnce(&mut dyn GuiEventHandler, &mut Self)) {
        if let Some(mut handler) = self.view.input.handlers.take(index) {
            call(&mut *handler, self);
            self.view.input.handlers.put_back(index, handler);
        }
    }

    /// Calls the view's update callback, and moves the camera by the manipulator. Runs in the update phase after the update
    /// callbacks of the scene, because the manipulator may follow a node that they move.
    pub(in crate::viewer) fn update_camera(&mut self, dt_s: f64) {
        let stamp = self.frame_stamp();
        self.view.call_update(&stamp);
        let step_s = self.view.input.camera_motion.step_s(dt_s);
        if let Some(pose) = self.with_manipulator(|manipulator, view| manipulator.advance(step_s, view)) {
            if pose.is_finite() {
                self.view.camera.world_from_eye = pose;
            } else {
                log::warn!("the manipulator returned a pose that is not finite; the camera keeps its pose");
            }
        }
        self.view.input.camera_motion.end_frame();
    }

    /// Lays out the overlay over the master camera's image, after the events of the frame.
    #[cfg(feature = "window")]
    pub(in crate::viewer) fn lay_out_overlay(&mut self) {
        let input = self.view.input.overlay_input.take();
        let Some(place) = self.view.master.filter(|_| self.shows_overlay()) else { return };
        let Some(size_px @ [width, height]) = self.base.rendering.size_px(place.context) else { return };
        let [x, y, part_width, part_height] = place.viewport.part_px(size_px).unwrap_or([0, 0, width, height]);
        // The viewport may extend beyond the window.
        let visible_px = [x, y, part_width.min(width.saturating_sub(x)), part_height.min(height.saturating_sub(y))];
        if visible_px[2] == 0 || visible_px[3] == 0 {
            return;
        }
        let (input, pixels_per_point) = input.unwrap_or((egui::RawInput::default(), 1.0));
        let mut overlay = self.view.input.overlay.clone();
        let paint = overlay.lay_out(input, visible_px, size_px, pixels_per_point, |ui| {
            for index in 0..self.view.input.handlers.len() {
                self.with_handler(index, |handler, viewer| {
                    if handler.shows_overlay() {
                        handler.lay_out(ui, viewer);
                    }
                });
            }
            if let Some(text) = self.notice() {
                crate::viewer::overlay::notice(ui, text);
            }
        });
        self.base.set_overlay(place.context, paint);
    }
}
