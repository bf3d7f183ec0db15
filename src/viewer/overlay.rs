//! What lies over the picture of a view, painted with egui: whatever handlers lay out, and notices.
//!
//! Each view has an [`Overlay`], which lies over its master camera's part of the window. The layout runs on the main thread
//! in the event phase ([`Overlay::lay_out`]); what it gives is a list of triangles that goes to the draw thread with the
//! frame ([`OverlayPainter::paint`]).

use std::sync::{Arc, Weak};

/// Triangles and texture changes of one overlay picture; used once, in order.
pub struct OverlayPaint {
    /// The overlay that it is a picture of.
    of: Weak<()>,
    primitives: Vec<egui::ClippedPrimitive>,
    textures: egui::TexturesDelta,
    screen: egui_wgpu::ScreenDescriptor,
}

impl OverlayPaint {
    /// True where both are pictures of one overlay.
    pub(super) fn is_same_overlay(&self, other: &Self) -> bool {
        self.of.ptr_eq(&other.of)
    }

    /// Takes over the texture changes of a picture that was never painted.
    pub(super) fn after(mut self, unpainted: Option<Self>) -> Self {
        if let Some(mut earlier) = unpainted {
            let mut textures = std::mem::take(&mut earlier.textures);
            textures.append(std::mem::take(&mut self.textures));
            self.textures = textures;
        }
        self
    }
}

impl Drop for OverlayPaint {
    fn drop(&mut self) {
        // egui objects to changes that nobody applied; a viewer that stops applies none.
        self.textures.clear();
    }
}

/// Lays overlays out; clones share what egui keeps. Its textures are numbered on their own and uploaded once: one that is
/// to be painted on another device is made anew.
#[derive(Clone)]
pub struct Overlay {
    context: egui::Context,
    /// Alive as long as there is anything to paint for.
    life: Arc<()>,
}

impl Default for Overlay {
    fn default() -> Self {
        let context = egui::Context::default();
        // A drag on text moves what it is in.
        context.all_styles_mut(|style| style.interaction.selectable_labels = false);
        Self { context, life: Arc::default() }
    }
}

impl Overlay {
    /// The egui context, for the window's input.
    pub fn context(&self) -> &egui::Context {
        &self.context
    }

    /// Lays one picture out in a part (x, y, width and height, pixels) of a window of a size. Places are the window's.
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
            of: Arc::downgrade(&self.life),
            primitives: self.context.tessellate(output.shapes, output.pixels_per_point),
            textures: output.textures_delta,
            screen: egui_wgpu::ScreenDescriptor { size_in_pixels: size_px, pixels_per_point },
        }
    }
}

/// A line at the lower edge, for a short while.
pub(super) fn notice(ui: &egui::Context, text: &str) {
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

/// Paints one overlay on the thread that owns the context; keeps egui's textures and buffers.
pub struct OverlayPainter {
    of: Weak<()>,
    renderer: egui_wgpu::Renderer,
}

impl OverlayPainter {
    /// The painter of a picture's overlay for targets of a format; those of overlays that are gone are dropped.
    pub fn of<'a>(
        painters: &'a mut Vec<Self>,
        paint: &OverlayPaint,
        device: &wgpu::Device,
        format: wgpu::TextureFormat,
    ) -> &'a mut Self {
        painters.retain(|painter| painter.of.strong_count() > 0 || painter.of.ptr_eq(&paint.of));
        let known = painters.iter().position(|painter| painter.of.ptr_eq(&paint.of));
        let place = known.unwrap_or_else(|| {
            let renderer = egui_wgpu::Renderer::new(device, format, egui_wgpu::RendererOptions::default());
            painters.push(Self { of: paint.of.clone(), renderer });
            painters.len() - 1
        });
        &mut painters[place]
    }

    /// Paints over a picture and submits; without a picture (a hidden window) only keeps the textures.
    pub fn paint(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        target: Option<&wgpu::TextureView>,
        paint: &mut OverlayPaint,
    ) {
        let mut textures = std::mem::take(&mut paint.textures);
        for (id, deltas) in textures.set.drain() {
            for delta in deltas {
                self.renderer.update_texture(device, queue, id, &delta);
            }
        }
        if let Some(target) = target {
            self.paint_over(device, queue, target, paint);
        }
        for id in textures.free.drain() {
            self.renderer.free_texture(&id);
        }
    }

    fn paint_over(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        target: &wgpu::TextureView,
        paint: &OverlayPaint,
    ) {
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("overlay") });
        let mut commands = self.renderer.update_buffers(device, queue, &mut encoder, &paint.primitives, &paint.screen);
        {
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("overlay"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
                })],
                ..Default::default()
            });
            self.renderer.render(&mut pass.forget_lifetime(), &paint.primitives, &paint.screen);
        }
        commands.push(encoder.finish());
        queue.submit(commands);
    }
}
