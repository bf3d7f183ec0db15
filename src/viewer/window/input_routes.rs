//! [`InputRoutes`]: the view that each event of a window with several views goes to. Main thread.
//!
//! Events go to the view under the pointer. What was pressed there is released there, wherever the pointer has moved
//! meanwhile.

use glam::DVec2;
use winit::event::{TouchPhase, WindowEvent};
use winit::keyboard::PhysicalKey;

use crate::viewer::ids::ViewId;

/// The pointer of a window, and the buttons, fingers and keys that are down, with the views in which they were pressed.
#[derive(Debug, Default)]
pub(super) struct InputRoutes {
    pointer_px: DVec2,
    /// The view that gets the pointer while buttons are pressed, and the number of pressed buttons.
    grabbed: Option<(ViewId, u32)>,
    fingers: Vec<(u64, ViewId)>,
    keys: Vec<(PhysicalKey, ViewId)>,
}

impl InputRoutes {
    /// Returns the view that an event goes to. `at` returns the view at a position in pixels. `first` is the first view of the
    /// window, which gets keys while the pointer is outside of all views.
    pub fn view_of(
        &mut self,
        event: &WindowEvent,
        at: impl Fn(DVec2) -> Option<ViewId>,
        first: Option<ViewId>,
    ) -> Option<ViewId> {
        match event {
            WindowEvent::CursorMoved { position, .. } => {
                self.pointer_px = DVec2::new(position.x, position.y);
                self.grabbed.map(|(view, _)| view).or_else(|| at(self.pointer_px))
            }
            WindowEvent::MouseInput { state, .. } => self.button(state.is_pressed(), at(self.pointer_px)),
            WindowEvent::Touch(touch) => {
                self.finger(touch.id, touch.phase, at(DVec2::new(touch.location.x, touch.location.y)))
            }
            WindowEvent::KeyboardInput { event, .. } => {
                self.key(event.physical_key, event.state.is_pressed(), at(self.pointer_px).or(first))
            }
            _ => at(self.pointer_px).or(first),
        }
    }

    fn button(&mut self, is_pressed: bool, here: Option<ViewId>) -> Option<ViewId> {
        let view = self.grabbed.map(|(view, _)| view).or(here);
        let down = self.grabbed.map_or(0, |(_, down)| down);
        let down = if is_pressed { down + 1 } else { down.saturating_sub(1) };
        self.grabbed = view.filter(|_| down > 0).map(|view| (view, down));
        view
    }

    fn finger(&mut self, finger: u64, phase: TouchPhase, here: Option<ViewId>) -> Option<ViewId> {
        // A finger that is put down again had lost its release.
        let is_same = |id: u64| id == finger && phase != TouchPhase::Started;
        let view = self.fingers.iter().find(|(id, _)| is_same(*id)).map(|(_, view)| *view).or(here);
        self.fingers.retain(|(id, _)| *id != finger);
        if matches!(phase, TouchPhase::Started | TouchPhase::Moved) {
            self.fingers.extend(view.map(|view| (finger, view)));
        }
        view
    }

    fn key(&mut self, key: PhysicalKey, is_pressed: bool, here: Option<ViewId>) -> Option<ViewId> {
        let view = self.keys.iter().find(|(of, _)| *of == key).map(|(_, view)| *view).or(here);
        self.keys.retain(|(of, _)| *of != key);
        if is_pressed {
            self.keys.extend(view.map(|view| (key, view)));
        }
        view
    }

    /// Forgets what is pressed: the window has lost the focus, and the releases may go to another one.
    pub fn clear(&mut self) {
        self.grabbed = None;
        self.fingers.clear();
        self.keys.clear();
    }

    /// Forgets what is pressed in views that are gone.
    pub fn retain(&mut self, is_there: impl Fn(ViewId) -> bool) {
        self.grabbed = self.grabbed.filter(|(view, _)| is_there(*view));
        self.fingers.retain(|(_, view)| is_there(*view));
        self.keys.retain(|(_, view)| is_there(*view));
    }
}

#[cfg(test)]
mod tests {
    use winit::keyboard::KeyCode;

    use super::*;
    use crate::viewer::ids::KeyedList;

    fn views() -> [Option<ViewId>; 2] {
        let mut list: KeyedList<ViewId, ()> = KeyedList::new();
        [(); 2].map(|()| Some(list.push(())))
    }

    #[test]
    fn buttons_are_released_where_the_first_was_pressed() {
        let ([left, right], mut routes) = (views(), InputRoutes::default());
        assert_eq!(routes.button(true, left), left);
        assert_eq!(routes.button(true, right), left);
        assert_eq!(routes.button(false, right), left);
        assert_eq!(routes.button(false, right), left);
        assert_eq!(routes.button(true, right), right, "no button was down");
    }

    #[test]
    fn fingers_and_keys_stay_with_their_views() {
        let ([left, right], mut routes) = (views(), InputRoutes::default());
        assert_eq!(routes.finger(7, TouchPhase::Started, left), left);
        assert_eq!(routes.finger(7, TouchPhase::Moved, right), left);
        assert_eq!(routes.finger(8, TouchPhase::Moved, right), right);
        assert_eq!(routes.finger(7, TouchPhase::Started, right), right, "its release was lost");
        let key = PhysicalKey::Code(KeyCode::KeyA);
        assert_eq!(routes.key(key, true, left), left);
        assert_eq!(routes.key(key, false, right), left);
        assert_eq!(routes.key(key, false, right), right);
    }

    #[test]
    fn views_that_are_gone_get_no_releases() {
        let ([left, right], mut routes) = (views(), InputRoutes::default());
        routes.button(true, left);
        routes.finger(1, TouchPhase::Started, left);
        routes.finger(2, TouchPhase::Started, right);
        routes.retain(|view| Some(view) != left);
        assert_eq!(routes.button(false, right), right);
        assert_eq!(routes.finger(1, TouchPhase::Moved, None), None);
        assert_eq!(routes.finger(2, TouchPhase::Moved, left), right);
        routes.clear();
        assert_eq!(routes.finger(2, TouchPhase::Moved, left), left);
    }
}
