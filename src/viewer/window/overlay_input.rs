//! [`OverlayInput`]: the user's input to a view's overlay, taken from a window's events. Main thread, in the event loop.

use egui_winit::State;
use winit::event::{Touch, WindowEvent};
use winit::window::Window;

use super::events as window_events;
use crate::viewer::view::View;

/// Collects the input to the overlay of a view from the window that shows the view.
#[derive(Default)]
pub(in crate::viewer) struct OverlayInput {
    state: Option<State>,
    /// The last position of the pointer or a finger in the window, points.
    pointer: egui::Pos2,
}

impl OverlayInput {
    /// Takes in an event of the window; returns true when the overlay uses it, so that the view must not.
    ///
    /// It is called for hidden overlays too, so that an overlay that appears later knows the pointer's position.
    pub fn feed(&mut self, view: &View, window: &Window, event: &WindowEvent) -> bool {
        let context = view.overlay_context();
        // A new device has a new overlay with a new context.
        if self.state.as_ref().is_some_and(|state| state.egui_ctx() != context) {
            self.state = None;
        }
        let state = self.state.get_or_insert_with(|| {
            let scale = Some(window.scale_factor() as f32);
            State::new(context.clone(), egui::ViewportId::ROOT, window, scale, None, None)
        });
        if let WindowEvent::CursorMoved { position: at, .. } | WindowEvent::Touch(Touch { location: at, .. }) = event {
            self.pointer = egui::pos2(at.x as f32, at.y as f32) / egui_winit::pixels_per_point(context, window);
        }
        let is_consumed = state.on_window_event(window, event).consumed;
        // egui itself learns the pointer's position only with the next frame.
        let layer = || context.layer_id_at(self.pointer).filter(|layer| layer.order != egui::Order::Background);
        view.shows_overlay() && (is_consumed || window_events::is_press(event) && layer().is_some())
    }

    /// Hands the input since the last frame to the view.
    pub fn hand_over(&mut self, view: &mut View, window: &Window) {
        let scale = window.scale_factor() as f32;
        match &mut self.state {
            Some(state) if view.shows_overlay() => view.set_overlay_input(state.take_egui_input(window), scale),
            Some(state) => state.egui_input_mut().events.clear(),
            None => view.set_overlay_input(egui::RawInput::default(), scale),
        }
    }
}
