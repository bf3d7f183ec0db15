//! [`WindowSizeHandler`]: full screen and window sizes.

use crate::viewer::GuiActionAdapter;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, Key, Usage};
use crate::viewer::input::GuiEventHandler;
use crate::viewer::input::WindowCommand;

#[derive(Clone, Copy, Debug)]
enum Action {
    FullScreen,
    Size([u32; 2]),
}

const KEYS: Bindings<Action> = Bindings(&[
    (&[Key::Char('f'), Key::F(11)], Action::FullScreen, "full screen"),
    (&[Key::F(2)], Action::Size([1280, 720]), "window of 1280 x 720"),
    (&[Key::F(3)], Action::Size([1920, 1080]), "window of 1920 x 1080"),
]);

/// Switches between full screen and fixed window sizes; OSG's `WindowSizeHandler`.
#[derive(Clone, Copy, Debug, Default)]
pub struct WindowSizeHandler;

impl GuiEventHandler for WindowSizeHandler {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        let Some(action) = KEYS.action(event) else { return false };
        viewer.request_window(match action {
            Action::FullScreen => WindowCommand::ToggleFullScreen,
            Action::Size(size_px) => WindowCommand::Resize(size_px),
        });
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }
}
