//! [`HelpHandler`]: shows the keys over the image.

use crate::viewer::GuiActionAdapter;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, Key, Usage};
use crate::viewer::input::GuiEventHandler;

const KEYS: Bindings<()> = Bindings(&[(&[Key::Char('h'), Key::F(1)], (), "help")]);

/// Shows the keys and their actions; OSG's `HelpHandler`.
#[derive(Clone, Copy, Debug, Default)]
pub struct HelpHandler {
    is_shown: bool,
}

impl GuiEventHandler for HelpHandler {
    fn handle(&mut self, event: &GuiEventAdapter, _: &mut GuiActionAdapter<'_>) -> bool {
        let pressed = KEYS.action(event).is_some();
        self.is_shown ^= pressed;
        pressed
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }

    fn shows_overlay(&self) -> bool {
        self.is_shown
    }

    #[cfg(feature = "window")]
    fn lay_out(&mut self, ui: &egui::Context, viewer: &GuiActionAdapter<'_>) {
        let lines = viewer.usage();
        let keys = |ui: &mut egui::Ui| {
            egui::Grid::new("keys").num_columns(2).spacing([18.0, 3.0]).show(ui, |ui| {
                for line in lines.iter().chain(&KEYS.usage()) {
                    ui.label(egui::RichText::new(&line.keys).monospace().strong());
                    ui.label(line.does);
                    ui.end_row();
                }
            });
        };
        let max_height = 0.8 * ui.content_rect().height();
        egui::Window::new("Keys")
            .anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0])
            .resizable(false)
            .collapsible(false)
            .show(ui, |ui| egui::ScrollArea::vertical().max_height(max_height).show(ui, keys));
    }
}
