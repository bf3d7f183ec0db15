//! The stats overlay: the last frames' phases as bars, and the counters of pager and draw, painted with egui.
//!
//! The layout runs on the main thread in the event phase ([`Overlay::layout`]); what it gives is a list of
//! triangles that goes to the draw thread with the frame ([`OverlayPainter::paint`]).

use egui::{Color32, RichText};

use super::stats::{FrameStats, Samples, StatsHistory};
use crate::pager::PagerStats;

/// Frames shown as bars.
const BARS: usize = 120;
/// Height of the bars in points.
const CHART_HEIGHT: f32 = 70.0;

/// Name, colour and milliseconds of a phase.
type Phase = (&'static str, Color32, fn(&FrameStats) -> f64);

/// Phases in the order they are stacked.
const PHASES: [Phase; 6] = [
    ("event", Color32::from_rgb(150, 150, 160), |s| s.event_ms),
    ("update", Color32::from_rgb(80, 150, 230), |s| (s.update_ms - s.merge_ms).max(0.0)),
    ("merge", Color32::from_rgb(120, 210, 240), |s| s.merge_ms),
    ("cull", Color32::from_rgb(110, 200, 110), |s| s.cull_ms),
    ("compile", Color32::from_rgb(230, 170, 60), |s| s.compile_ms),
    ("draw", Color32::from_rgb(230, 100, 90), |s| s.draw_ms),
];

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

/// Lays the overlay out.
#[derive(Default)]
pub struct Overlay {
    context: egui::Context,
}

impl Overlay {
    /// The egui context, for the window's input.
    pub fn context(&self) -> &egui::Context {
        &self.context
    }

    /// Lays out one picture of the numbers.
    pub fn layout(
        &mut self,
        mut input: egui::RawInput,
        size_px: [u32; 2],
        pixels_per_point: f32,
        stats: &StatsHistory,
        pager: Option<&PagerStats>,
        line: &str,
    ) -> OverlayPaint {
        let size_points = egui::vec2(size_px[0] as f32, size_px[1] as f32) / pixels_per_point;
        input.screen_rect = Some(egui::Rect::from_min_size(egui::Pos2::ZERO, size_points));
        self.context.set_pixels_per_point(pixels_per_point);
        let output = self.context.run_ui(input, |ui| {
            egui::Window::new("Terrane")
                .default_pos([10.0, 10.0])
                .resizable(false)
                .show(ui.ctx(), |ui| numbers(ui, stats, pager, line));
        });
        OverlayPaint {
            primitives: self.context.tessellate(output.shapes, output.pixels_per_point),
            textures: output.textures_delta,
            screen: egui_wgpu::ScreenDescriptor { size_in_pixels: size_px, pixels_per_point },
        }
    }
}

fn numbers(ui: &mut egui::Ui, stats: &StatsHistory, pager: Option<&PagerStats>, line: &str) {
    let recent: Vec<&FrameStats> = stats.iter().rev().filter(|s| s.drawn).take(BARS).collect();
    let frame_ms = Samples::new(recent.iter().map(|s| s.frame_ms));
    ui.label(
        RichText::new(format!(
            "{:.1} ms median  {:.1} ms p95  {:.1} ms max",
            frame_ms.median(),
            frame_ms.percentile(0.95),
            frame_ms.max()
        ))
        .strong(),
    );
    chart(ui, &recent);
    ui.horizontal(|ui| {
        for (name, color, value) in PHASES {
            let median = Samples::new(recent.iter().map(|s| value(s))).median();
            ui.label(RichText::new(format!("{name} {median:.2}")).color(color).small());
        }
    });
    let Some(last) = recent.first() else { return };
    egui::Grid::new("counters").num_columns(4).spacing([14.0, 2.0]).show(ui, |ui| {
        let mut cells = 0;
        let mut cell = |ui: &mut egui::Ui, name: &str, value: String| {
            ui.label(RichText::new(name).weak());
            ui.label(RichText::new(value).monospace());
            cells += 1;
            if cells % 2 == 0 {
                ui.end_row();
            }
        };
        cell(ui, "leaves", last.leaves.to_string());
        cell(ui, "draw calls", last.draw_calls.to_string());
        cell(ui, "triangles", thousands(last.triangles));
        cell(ui, "state changes", last.state_changes.to_string());
        cell(ui, "tiles drawn", last.tiles_drawn.to_string());
        cell(ui, "wanted", last.wanted_missing.to_string());
        cell(ui, "gpu", last.gpu_ms.map_or("-".to_owned(), |ms| format!("{ms:.2} ms")));
        cell(ui, "frame", last.frame.to_string());
        if let Some(pager) = pager {
            cell(ui, "requested", pager.requested.to_string());
            cell(ui, "merged", pager.merged.to_string());
            cell(ui, "expired", pager.expired.to_string());
            cell(ui, "failed", pager.failed.to_string());
            cell(ui, "tiles on CPU", mebibytes(pager.cpu_bytes));
            cell(ui, "tiles on GPU", mebibytes(pager.gpu_bytes));
            cell(ui, "read", mebibytes(pager.bytes_read));
            cell(ui, "cancelled", pager.cancelled.to_string());
        }
    });
    if !line.is_empty() {
        ui.label(RichText::new(line).weak().small());
    }
}

/// Stacked bars, newest at the right, with a line at 16.7 ms.
fn chart(ui: &mut egui::Ui, recent: &[&FrameStats]) {
    let (response, painter) = ui.allocate_painter(egui::vec2(360.0, CHART_HEIGHT), egui::Sense::hover());
    let rect = response.rect;
    painter.rect_filled(rect, 2.0, Color32::from_black_alpha(120));
    let total = |s: &FrameStats| PHASES.iter().map(|(_, _, value)| value(s)).sum::<f64>();
    let highest_ms = Samples::new(recent.iter().map(|s| total(s))).percentile(0.98).max(20.0);
    let (bar_width, scale) = (rect.width() / BARS as f32, CHART_HEIGHT / highest_ms as f32);
    for (index, stats) in recent.iter().enumerate() {
        let right = rect.right() - index as f32 * bar_width;
        let mut bottom = rect.bottom();
        for (_, color, value) in PHASES {
            let top = (bottom - value(stats) as f32 * scale).max(rect.top());
            let bar = egui::Rect::from_min_max([right - bar_width, top].into(), [right, bottom].into());
            painter.rect_filled(bar, 0.0, color);
            bottom = top;
        }
    }
    let y = rect.bottom() - 16.7 * scale;
    painter.hline(rect.x_range(), y, egui::Stroke::new(1.0, Color32::from_white_alpha(110)));
}

fn mebibytes(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}

fn thousands(count: u64) -> String {
    if count < 10_000 { count.to_string() } else { format!("{} k", count / 1000) }
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
