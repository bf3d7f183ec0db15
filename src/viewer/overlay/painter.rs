//! [`OverlayPainter`]: paints an overlay over a rendered image. Runs on the thread that owns the graphics context.

use std::sync::Weak;

use super::paint::OverlayPaint;

/// Paints one overlay, and keeps egui's textures and buffers between frames.
pub struct OverlayPainter {
    overlay: Weak<()>,
    renderer: egui_wgpu::Renderer,
}

impl OverlayPainter {
    /// Returns the painter of an overlay for render targets of a format; creates it on first use. Drops the painters whose
    /// overlays are gone.
    pub fn of<'a>(
        painters: &'a mut Vec<Self>,
        paint: &OverlayPaint,
        device: &wgpu::Device,
        format: wgpu::TextureFormat,
    ) -> &'a mut Self {
        painters.retain(|painter| painter.overlay.strong_count() > 0 || painter.overlay.ptr_eq(&paint.overlay));
        let known = painters.iter().position(|painter| painter.overlay.ptr_eq(&paint.overlay));
        let index = known.unwrap_or_else(|| {
            let renderer = egui_wgpu::Renderer::new(device, format, egui_wgpu::RendererOptions::default());
            painters.push(Self { overlay: paint.overlay.clone(), renderer });
            painters.len() - 1
        });
        &mut painters[index]
    }

    /// Paints over a render target and submits. Without a target (a hidden window) it only applies the texture changes.
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
