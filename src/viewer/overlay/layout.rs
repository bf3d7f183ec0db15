//! [`Overlay`]: lays out the pages of handlers with egui. Main thread.

use std::sync::Arc;

use super::paint::OverlayPaint;

/// Lays out the overlay of a view. Clones share egui's state.
///
/// Each overlay has its own texture ids, and each texture is uploaded once. An overlay that moves to another device must
/// therefore be replaced by a new one.
#[derive(Clone)]
pub struct Overlay {
    context: egui::Context,
    /// Lets painters notice that the overlay was dropped.
    life: Arc<()>,
}

impl Default for Overlay {
    fn default() -> Self {
        let context = egui::Context::default();
        // A drag on text moves the window that contains it.
        context.all_styles_mut(|style| style.interaction.selectable_labels = false);
        Self { context, life: Arc::default() }
    }
}

impl Overlay {
    /// Returns the egui context, for the window's input.
    pub fn context(&self) -> &egui::Context {
        &self.context
    }

    /// Lays out one image in a part of a window: `part_px` is x, y, width and height in pixels, `size_px` the window's
    /// size. Coordinates in `show` are the window's, in points.
    pub fn lay_out(
        &mut self,
        mut input: egui::RawInput,
        part_px: [u32; 4],
        size_px: [u32; 2],
        pixels_per_point: f32,
        mut show: impl FnMut(&egui::Context),
    ) -> OverlayPaint {
        let [x, y, width, height] = part_px.map(|v| v as f32 / pixels_per_point);
        input.screen_rect = Some(egui::Rect::from_min_size(egui::pos2(x, y), egui::vec2(width, height)));
        self.context.set_pixels_per_point(pixels_per_point);
        let output = self.context.run_ui(input, |ui| show(ui.ctx()));
        OverlayPaint {
            overlay: Arc::downgrade(&self.life),
            primitives: self.context.tessellate(output.shapes, output.pixels_per_point),
            textures: output.textures_delta,
            screen: egui_wgpu::ScreenDescriptor { size_in_pixels: size_px, pixels_per_point },
        }
    }
}

/// Shows a line of text at the lower edge of the overlay.
pub(in crate::viewer) fn notice(ui: &egui::Context, text: &str) {
    egui::Area::new(egui::Id::unique("notice"))
        .anchor(egui::Align2::CENTER_BOTTOM, [0.0, -24.0])
        .interactable(false)
        .show(ui, |ui| {
            egui::Frame::popup(ui.style()).show(ui, |ui| {
                ui.set_max_width(600.0);
                ui.label(text);
            });
        });
}
