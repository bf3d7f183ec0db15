//! What frames cost, over the picture.

use super::GuiActionAdapter;
#[cfg(feature = "window")]
use crate::viewer::FrameStats;
use crate::viewer::Samples;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, GuiEventHandler, Key, Usage};

#[derive(Clone, Copy, Debug)]
enum Action {
    Cycle,
    Print,
}

const KEYS: Bindings<Action> = Bindings(&[
    (&[Key::Char('s'), Key::Tab], Action::Cycle, "next page of the stats: frame rate, frame, drawing, pager, none"),
    (&[Key::Char('S')], Action::Print, "print the stats"),
]);

/// What is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StatsPage {
    /// Nothing.
    #[default]
    None,
    /// Frames a second.
    FrameRate,
    /// The phases of the last frames as bars.
    Frame,
    /// That, and what is drawn.
    Drawing,
    /// That, and what the pager does.
    Pager,
}

/// Shows statistics, a page more each time; OSG's `StatsHandler`.
#[derive(Clone, Copy, Debug, Default)]
pub struct StatsHandler {
    /// What is shown.
    pub page: StatsPage,
}

/// Frames that medians and bars are of.
const RECENT: usize = 120;

impl GuiEventHandler for StatsHandler {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        match KEYS.action(event) {
            Some(Action::Cycle) => {
                self.page = match self.page {
                    StatsPage::None => StatsPage::FrameRate,
                    StatsPage::FrameRate => StatsPage::Frame,
                    StatsPage::Frame => StatsPage::Drawing,
                    StatsPage::Drawing => StatsPage::Pager,
                    StatsPage::Pager => StatsPage::None,
                };
            }
            Some(Action::Print) => print(viewer),
            None => return false,
        }
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }

    fn shows_overlay(&self) -> bool {
        self.page != StatsPage::None
    }

    #[cfg(feature = "window")]
    fn lay_out(&mut self, ui: &egui::Context, viewer: &GuiActionAdapter<'_>) {
        egui::Window::new("Terrane").default_pos([10.0, 10.0]).resizable(false).show(ui, |ui| {
            let recent: Vec<&FrameStats> = viewer.stats().iter().rev().filter(|s| s.drawn).take(RECENT).collect();
            page::frame_rate(ui, &recent);
            if self.page != StatsPage::FrameRate {
                page::phases(ui, &recent);
            }
            if matches!(self.page, StatsPage::Drawing | StatsPage::Pager) {
                page::drawing(ui, &recent);
            }
            if self.page == StatsPage::Pager {
                page::pager(ui, viewer);
            }
        });
    }
}

/// The medians, into the log.
fn print(viewer: &mut GuiActionAdapter<'_>) {
    let median = |value: fn(&crate::viewer::FrameStats) -> f64| {
        Samples::new(viewer.stats().iter().rev().filter(|s| s.drawn).take(RECENT).map(value)).median()
    };
    let text = format!(
        "frame {:.2} ms: event {:.2}, update {:.2}, merge {:.2}, cull {:.2}, draw {:.2}, compile {:.2}; \
         {:.0} leaves, {:.0} draw calls, {:.0} triangles",
        median(|s| s.frame_ms),
        median(|s| s.event_ms),
        median(|s| s.update_ms),
        median(|s| s.merge_ms),
        median(|s| s.cull_ms),
        median(|s| s.draw_ms),
        median(|s| s.compile_ms),
        median(|s| f64::from(s.leaves)),
        median(|s| f64::from(s.draw_calls)),
        median(|s| s.triangles as f64),
    );
    log::info!("{text}");
    viewer.notify(text);
}

#[cfg(feature = "window")]
mod page {
    //! The pages, laid out with egui.

    use egui::{Color32, RichText, Ui};

    use super::{GuiActionAdapter, RECENT};
    use crate::viewer::{FrameStats, Samples};

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

    pub fn frame_rate(ui: &mut Ui, recent: &[&FrameStats]) {
        let frame_ms = Samples::new(recent.iter().map(|s| s.frame_ms));
        let median_ms = frame_ms.median();
        ui.label(RichText::new(format!("{:.0} frames a second", 1e3 / median_ms.max(1e-3))).strong());
        ui.label(format!(
            "{median_ms:.1} ms median  {:.1} ms p95  {:.1} ms max",
            frame_ms.percentile(0.95),
            frame_ms.max()
        ));
    }

    pub fn phases(ui: &mut Ui, recent: &[&FrameStats]) {
        chart(ui, recent);
        ui.horizontal(|ui| {
            for (name, color, value) in PHASES {
                let median = Samples::new(recent.iter().map(|s| value(s))).median();
                ui.label(RichText::new(format!("{name} {median:.2}")).color(color).small());
            }
        });
    }

    pub fn drawing(ui: &mut Ui, recent: &[&FrameStats]) {
        let Some(last) = recent.first() else { return };
        ui.separator();
        grid(
            ui,
            "drawing",
            &[
                ("leaves", last.leaves.to_string()),
                ("draw calls", last.draw_calls.to_string()),
                ("triangles", thousands(last.triangles)),
                ("shadow leaves", last.shadow_leaves.to_string()),
                ("state changes", last.state_changes.to_string()),
                ("tiles drawn", last.tiles_drawn.to_string()),
                ("tiles visited", last.tiles_visited.to_string()),
                ("occluded", last.occluded.to_string()),
                ("gpu", last.gpu_ms.map_or("-".to_owned(), |ms| format!("{ms:.2} ms"))),
            ],
        );
    }

    pub fn pager(ui: &mut Ui, viewer: &GuiActionAdapter<'_>) {
        images(ui, viewer);
        let Some(pager) = viewer.pager().map(|p| p.stats()) else { return };
        let wanted = viewer.stats().last().map_or(0, |s| s.wanted_missing);
        let mean_ms = 1e3 * pager.latency_sum_s / pager.merged.max(1) as f64;
        ui.separator();
        grid(
            ui,
            "pager",
            &[
                ("wanted", wanted.to_string()),
                ("waiting", pager.waiting.to_string()),
                ("in flight", pager.in_flight.to_string()),
                ("of them decoding", pager.decoding.to_string()),
                ("uploading", pager.compiling.to_string()),
                ("requested", pager.requested.to_string()),
                ("merged", pager.merged.to_string()),
                ("merged ahead", pager.merged_ahead.to_string()),
                ("expired", pager.expired.to_string()),
                ("cancelled", pager.cancelled.to_string()),
                ("failed", pager.failed.to_string()),
                ("to merge, mean", format!("{mean_ms:.0} ms")),
                ("to merge, most", format!("{:.0} ms", 1e3 * pager.latency_max_s)),
                ("tiles on CPU", mebibytes(pager.cpu_bytes)),
                ("tiles on GPU", mebibytes(pager.gpu_bytes)),
                ("read", mebibytes(pager.bytes_read)),
                ("pages", viewer.scene().page_count().to_string()),
                ("shared images", pager.sharing.texture_hits.to_string()),
                ("shared shapes", pager.sharing.geometry_hits.to_string()),
                ("saved on CPU", mebibytes(pager.shared_cpu_bytes_saved)),
                ("saved on GPU", mebibytes(pager.shared_gpu_bytes_saved)),
            ],
        );
    }

    fn images(ui: &mut Ui, viewer: &GuiActionAdapter<'_>) {
        let Some(images) = viewer.image_pager().map(|p| p.stats()) else { return };
        ui.separator();
        grid(
            ui,
            "images",
            &[
                ("images loaded", images.loaded.to_string()),
                ("kept", images.images.to_string()),
                ("late", images.late.to_string()),
                ("failed", images.failed.to_string()),
                ("paged out", images.paged_out.to_string()),
                ("bytes", mebibytes(images.bytes)),
            ],
        );
    }

    fn grid(ui: &mut Ui, name: &str, cells: &[(&str, String)]) {
        egui::Grid::new(name).num_columns(4).spacing([14.0, 2.0]).show(ui, |ui| {
            for (index, (name, value)) in cells.iter().enumerate() {
                ui.label(RichText::new(*name).weak());
                ui.label(RichText::new(value).monospace());
                if index % 2 == 1 {
                    ui.end_row();
                }
            }
        });
    }

    /// Stacked bars, newest at the right, with a line at 16.7 ms.
    fn chart(ui: &mut Ui, recent: &[&FrameStats]) {
        let (response, painter) = ui.allocate_painter(egui::vec2(360.0, CHART_HEIGHT), egui::Sense::hover());
        let rect = response.rect;
        painter.rect_filled(rect, 2.0, Color32::from_black_alpha(120));
        let total = |s: &FrameStats| PHASES.iter().map(|(_, _, value)| value(s)).sum::<f64>();
        let highest_ms = Samples::new(recent.iter().map(|s| total(s))).percentile(0.98).max(20.0);
        let (bar_width, scale) = (rect.width() / RECENT as f32, CHART_HEIGHT / highest_ms as f32);
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
}
