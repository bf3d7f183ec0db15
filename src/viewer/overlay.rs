//! What lies over the picture, painted with egui: whatever handlers lay out, and notices.
//!
//! The layout runs on the main thread in the event phase ([`Overlay::lay_out`]); what it gives is a list of
//! triangles that goes to the draw thread with the frame ([`OverlayPainter::paint`]).

/// Triangles and texture changes of one overlay picture; used once, in order.
pub struct OverlayPaint {
    primitives: Vec<egui::ClippedPrimitive>,
    textures: egui::TexturesDelta,
    screen: egui_wgpu::ScreenDescriptor,
}

impl OverlayPaint {
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

/// Lays overlays out; clones share what egui keeps.
#[derive(Clone, Default)]
pub struct Overlay {
    context: egui::Context,
}

impl Overlay {
    /// The egui context, for the window's input.
    pub fn context(&self) -> &egui::Context {
        &self.context
    }

    /// Lays one picture out.
    pub fn lay_out(
        &mut self,
        mut input: egui::RawInput,
        size_px: [u32; 2],
        pixels_per_point: f32,
        mut show: impl FnMut(&egui::Context),
    ) -> OverlayPaint {
        let size_points = egui::vec2(size_px[0] as f32, size_px[1] as f32) / pixels_per_point;
        input.screen_rect = Some(egui::Rect::from_min_size(egui::Pos2::ZERO, size_points));
        self.context.set_pixels_per_point(pixels_per_point);
        let output = self.context.run_ui(input, |ui| show(ui.ctx()));
        OverlayPaint {
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
/// Paints overlays on the thread that owns the context; keeps egui's textures and buffers.
pub struct OverlayPainter {
    renderer: egui_wgpu::Renderer,
}

impl OverlayPainter {
    /// A painter for targets of a format.
    pub fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Self {
        Self { renderer: egui_wgpu::Renderer::new(device, format, egui_wgpu::RendererOptions::default()) }
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
