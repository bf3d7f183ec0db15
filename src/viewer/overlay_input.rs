//! What the user does in a window, for egui: the input of a view's overlay. Main thread, in the event loop.

use egui_winit::State;
use winit::event::{Touch, WindowEvent};
use winit::window::Window;

use super::view::View;
use super::window_events;

/// The input of the overlay of a view, from the window that the view is in.
#[derive(Default)]
pub(super) struct OverlayInput {
    state: Option<State>,
    /// Where the pointer, or the last finger, is in the window, points.
    pointer: egui::Pos2,
}

impl OverlayInput {
    /// Takes an event of the window in, shown or not: what is shown later knows where the pointer is. True where something
    /// that lies over the view has it for its own.
    pub fn feed(&mut self, view: &View, window: &Window, event: &WindowEvent) -> bool {
        let context = view.overlay_context();
        // One that lies on a new device starts anew.
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
        // egui itself learns of the pointer's place with the next frame.
        let layer = || context.layer_id_at(self.pointer).filter(|layer| layer.order != egui::Order::Background);
        view.shows_overlay() && (is_consumed || window_events::is_press(event) && layer().is_some())
    }

    /// Hands over what came since the last frame.
    pub fn hand_over(&mut self, view: &mut View, window: &Window) {
        let scale = window.scale_factor() as f32;
        match &mut self.state {
            Some(state) if view.shows_overlay() => view.set_overlay_input(state.take_egui_input(window), scale),
            Some(state) => state.egui_input_mut().events.clear(),
            None => view.set_overlay_input(egui::RawInput::default(), scale),
        }
    }
}
