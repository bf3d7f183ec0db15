//! [`PagerDebugHandler`]: shows the pager's tiles over the image.

use super::tile_colors::TileColors;
use crate::viewer::GuiActionAdapter;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, Key, Usage};
use crate::viewer::input::GuiEventHandler;

const KEYS: Bindings<()> = Bindings(&[(
    &[Key::Char('g')],
    (),
    "tiles of the pager: colours by level, by state (waiting, read, decoded, uploaded, failed), none",
)]);

/// Shows the bounds of tiles, labels those in flight with level and state, and counts the tiles by state.
#[derive(Clone, Copy, Debug, Default)]
pub struct PagerDebugHandler {
    /// The colouring of the tile boxes.
    pub colors: TileColors,
}

impl GuiEventHandler for PagerDebugHandler {
    fn handle(&mut self, event: &GuiEventAdapter, _: &mut GuiActionAdapter<'_>) -> bool {
        if KEYS.action(event).is_none() {
            return false;
        }
        self.colors = match self.colors {
            TileColors::None => TileColors::Level,
            TileColors::Level => TileColors::State,
            TileColors::State => TileColors::None,
        };
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }

    fn shows_overlay(&self) -> bool {
        self.colors != TileColors::None
    }

    #[cfg(feature = "window")]
    fn lay_out(&mut self, ui: &egui::Context, viewer: &GuiActionAdapter<'_>) {
        super::boxes::lay_out(ui, viewer, self.colors);
    }
}
