//! [`CreditsHandler`]: shows attributions at the lower edge of the image.

use crate::viewer::GuiActionAdapter;
use crate::viewer::events::{EventMask, GuiEventAdapter};
use crate::viewer::input::GuiEventHandler;

/// The number of frames after which the line is made again.
const FRAMES: u32 = 20;

/// Shows the attributions of what is on screen in one line, as the terms of map services ask for.
#[derive(Clone, Debug, Default)]
pub struct CreditsHandler {
    line: String,
    /// The frames until the line is made again.
    frames_left: u32,
}

impl GuiEventHandler for CreditsHandler {
    fn handle(&mut self, _: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        if self.frames_left == 0 {
            self.frames_left = FRAMES;
            self.line = viewer.scene().credits(viewer.frame_stamp().frame).join("  |  ");
        }
        self.frames_left -= 1;
        false
    }

    fn event_mask(&self) -> EventMask {
        EventMask::FRAME
    }

    fn shows_overlay(&self) -> bool {
        !self.line.is_empty()
    }

    #[cfg(feature = "window")]
    fn lay_out(&mut self, ui: &egui::Context, _: &GuiActionAdapter<'_>) {
        let max_width = ui.content_rect().width();
        egui::Area::new(egui::Id::unique("credits"))
            .anchor(egui::Align2::LEFT_BOTTOM, [0.0, 0.0])
            .interactable(false)
            .show(ui, |ui| {
                egui::Frame::popup(ui.style()).show(ui, |ui| {
                    ui.set_max_width(max_width);
                    ui.add(egui::Label::new(egui::RichText::new(&self.line).small()).truncate());
                });
            });
    }
}
