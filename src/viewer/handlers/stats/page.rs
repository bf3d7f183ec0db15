//! The pages of statistics, laid out with egui. Main thread, event phase.
//!
//! A page fits its image: smaller images get smaller text, more columns and a lower chart.

use egui::{Color32, FontId, RichText, Ui, Vec2};

use super::fit::{COLUMN_GAP, Layout, layout};
use super::phases::PHASES;
use super::selection::{RECENT_FRAMES, StatsPage};
use super::tables::{Cell, drawing, images, left_out, pager};
use crate::viewer::{FrameStats, GuiActionAdapter, Samples};

/// The margin around the page and inside its frame, points.
const MARGIN: f32 = 3.0;
/// The maximum width of a page, points.
const MAX_WIDTH: f32 = 460.0;
/// Lays out a page.
pub(super) fn lay_out(ui: &egui::Context, viewer: &GuiActionAdapter<'_>, page: StatsPage) {
    let recent: Vec<&FrameStats> = viewer.stats().iter().rev().filter(|s| s.drawn).take(RECENT_FRAMES).collect();
    let mut tables: Vec<Vec<Cell>> = Vec::new();
    if matches!(page, StatsPage::Drawing | StatsPage::Pager) {
        tables.extend(drawing(&recent));
    }
    let mut lines = Vec::new();
    if page == StatsPage::Pager {
        tables.extend(images(viewer));
        tables.extend(pager(viewer));
        lines.extend(viewer.pager().map(|pager| left_out(pager.ignored().iter())).into_iter().flatten());
    }
    show(ui, &recent, page != StatsPage::FrameRate, (&tables, &lines));
}

/// Shows a page of tables, and lines below them that are cut at the width of the page; returns its rectangle, and whether all of it is visible without scrolling.
fn show(
    ui: &egui::Context,
    recent: &[&FrameStats],
    has_phases: bool,
    (tables, lines): (&[Vec<Cell>], &[String]),
) -> (egui::Rect, bool) {
    let room = ui.content_rect().size() - Vec2::splat(4.0 * MARGIN + 2.0);
    let room = Vec2::new(room.x.min(MAX_WIDTH), room.y);
    let sizes: Vec<Vec<Vec2>> = tables.iter().map(|cells| widths(ui, cells)).collect();
    let layout = layout(room, has_phases, (&sizes, lines.len()), |text| line_height(ui, text));
    let frame = egui::Frame::window(&ui.global_style()).inner_margin(MARGIN).shadow(egui::Shadow::NONE);
    let corner = ui.content_rect().min + Vec2::splat(MARGIN);
    let shown = egui::Area::new(egui::Id::unique("stats")).default_pos(corner).movable(true).show(ui, |ui| {
        let shown = frame.show(ui, |ui| {
            ui.spacing_mut().item_spacing = Vec2::new(COLUMN_GAP, 0.0);
            ui.spacing_mut().interact_size.y = 0.0;
            // A page that does not fit a very small image scrolls.
            let high = room.y.max(20.0);
            let shown = egui::ScrollArea::vertical().max_height(high).min_scrolled_height(high).show(ui, |ui| {
                ui.set_max_width(room.x.max(20.0));
                frame_rate(ui, recent, layout);
                if has_phases {
                    phases(ui, recent, layout, room.x);
                }
                for (index, cells) in tables.iter().enumerate() {
                    ui.add(egui::Separator::default().spacing(3.0));
                    grid(ui, index, cells, layout);
                }
                for line in lines {
                    ui.add(egui::Label::new(plain(line, layout)).truncate());
                }
            });
            let cut = shown.content_size - shown.inner_rect.size();
            cut.max_elem() < 1.0
        });
        shown.inner
    });
    (shown.response.rect, shown.inner)
}

/// Returns the widths of names and values per point of text size.
fn widths(ui: &egui::Context, cells: &[Cell]) -> Vec<Vec2> {
    // Widths are rounded to pixels at each size: 3 % and a point of margin cover that.
    const MEASURED_AT: f32 = 20.0;
    let width = |text: &str, font: FontId| {
        let galley = ui.fonts_mut(|fonts| fonts.layout_no_wrap(text.to_owned(), font, Color32::WHITE));
        (galley.size().x + 1.0) / MEASURED_AT * 1.03
    };
    let of = |(name, value): &Cell| {
        Vec2::new(width(name, FontId::proportional(MEASURED_AT)), width(value, FontId::monospace(MEASURED_AT)))
    };
    cells.iter().map(of).collect()
}

/// Returns the height of a line of text, the larger of both fonts.
fn line_height(ui: &egui::Context, text: f32) -> f32 {
    let [a, b] =
        [FontId::proportional(text), FontId::monospace(text)].map(|font| ui.fonts_mut(|f| f.row_height(&font)));
    a.max(b).ceil()
}

fn plain(text: impl Into<String>, layout: Layout) -> RichText {
    RichText::new(text).font(FontId::proportional(layout.text))
}

fn frame_rate(ui: &mut Ui, recent: &[&FrameStats], layout: Layout) {
    let frame_ms = Samples::new(recent.iter().map(|s| s.frame_ms));
    let median_ms = frame_ms.median();
    ui.horizontal_wrapped(|ui| {
        ui.label(plain(format!("{:.0} frames a second", 1e3 / median_ms.max(1e-3)), layout).strong());
        let (p95, max) = (frame_ms.percentile(0.95), frame_ms.max());
        ui.label(plain(format!("{median_ms:.1} ms median  {p95:.1} ms p95  {max:.1} ms max"), layout));
    });
}

fn phases(ui: &mut Ui, recent: &[&FrameStats], layout: Layout, width: f32) {
    if layout.chart > 0.0 {
        chart(ui, recent, Vec2::new(width.min(360.0), layout.chart));
    }
    ui.horizontal_wrapped(|ui| {
        for (name, color, value) in PHASES {
            let median = Samples::new(recent.iter().map(|s| value(s))).median();
            ui.label(plain(format!("{name} {median:.2}"), layout).color(color));
        }
    });
}

fn grid(ui: &mut Ui, table: usize, cells: &[Cell], layout: Layout) {
    let columns = 2 * layout.columns;
    egui::Grid::new(("stats", table)).num_columns(columns).spacing([COLUMN_GAP, 0.0]).min_row_height(0.0).show(
        ui,
        |ui| {
            for (index, (name, value)) in cells.iter().enumerate() {
                ui.label(plain(*name, layout).weak());
                ui.label(RichText::new(value).font(FontId::monospace(layout.text)));
                if index % layout.columns == layout.columns - 1 {
                    ui.end_row();
                }
            }
        },
    );
}

/// Shows the frames as stacked bars, newest at the right, with a line at 16.7 ms.
fn chart(ui: &mut Ui, recent: &[&FrameStats], size: Vec2) {
    let (response, painter) = ui.allocate_painter(size, egui::Sense::hover());
    let rect = response.rect;
    painter.rect_filled(rect, 2.0, Color32::from_black_alpha(120));
    let total = |s: &FrameStats| PHASES.iter().map(|(_, _, value)| value(s)).sum::<f64>();
    let highest_ms = Samples::new(recent.iter().map(|s| total(s))).percentile(0.98).max(20.0);
    let (bar_width, scale) = (rect.width() / RECENT_FRAMES as f32, size.y / highest_ms as f32);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns tables with the longest values.
    fn tables(lengths: &[usize]) -> Vec<Vec<Cell>> {
        let cell = |place: usize| match place % 3 {
            0 => ("of them decoding", "1234567".to_owned()),
            1 => ("state changes", "12345".to_owned()),
            _ => ("tiles on CPU", "1234.5 MiB".to_owned()),
        };
        lengths.iter().map(|length| (0..*length).map(cell).collect()).collect()
    }

    fn shown(screen: [f32; 2], lengths: &[usize]) -> (egui::Rect, bool) {
        let context = egui::Context::default();
        let stats = FrameStats { frame_ms: 1234.5, draw_ms: 456.78, update_ms: 123.45, ..FrameStats::default() };
        let recent = vec![&stats; RECENT_FRAMES];
        let tables = tables(lengths);
        // The longest page of a large image names what was left out.
        let lines = if screen[1] > 400.0 { vec!["left out 1 x a kind ".repeat(20); 5] } else { Vec::new() };
        let mut result = None;
        // egui knows sizes from the second frame on.
        for _ in 0..3 {
            let rect = egui::Rect::from_min_size(egui::Pos2::ZERO, screen.into());
            let input = egui::RawInput { screen_rect: Some(rect), ..egui::RawInput::default() };
            let mut output =
                context.run_ui(input, |ui| result = Some(show(ui.ctx(), &recent, true, (&tables, &lines))));
            output.textures_delta.clear();
        }
        result.unwrap()
    }

    #[test]
    fn page_fits_images_down_to_320_by_240() {
        for screen in [[320.0, 240.0], [640.0, 240.0], [320.0, 480.0], [480.0, 300.0], [560.0, 560.0], [1280.0, 720.0]]
        {
            for lengths in [&[][..], &[9], &[9, 24], &[9, 6, 24]] {
                let (rect, is_whole) = shown(screen, lengths);
                assert!(is_whole, "{screen:?} {lengths:?}: {rect:?}");
                assert!(rect.max.x <= screen[0] && rect.max.y <= screen[1], "{screen:?} {lengths:?}: {rect:?}");
            }
        }
    }

    #[test]
    fn text_is_as_large_as_fits() {
        let sizes = [9, 24].map(|cells| vec![Vec2::new(7.0, 5.0); cells]);
        let of = |x: f32, y: f32| layout(Vec2::new(x, y), true, (&sizes, 0), |text| 1.25 * text);
        assert_eq!(of(460.0, 700.0), Layout { text: 13.0, chart: 70.0, columns: 2 });
        assert!(of(460.0, 300.0).text > of(290.0, 220.0).text);
        // When nothing fits, the page scrolls.
        assert_eq!(of(50.0, 50.0), Layout { text: 7.5, chart: 0.0, columns: 2 });
        let (rect, is_whole) = shown([200.0, 100.0], &[9, 24]);
        assert!(!is_whole && rect.max.y <= 100.0, "{rect:?}");
    }
}
