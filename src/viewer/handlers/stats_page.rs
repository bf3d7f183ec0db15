//! The pages of the stats, laid out with egui so that they fit into the picture: with smaller text, more columns and a
//! lower chart where there is less room. Main thread, event phase.

use egui::{Color32, FontId, RichText, Ui, Vec2};

use super::stats::RECENT;
use super::{GuiActionAdapter, StatsPage};
use crate::viewer::{FrameStats, Samples};

/// Between the picture's edges and the page, and around what is in the page, points.
const MARGIN: f32 = 3.0;
/// Points between names, values and columns.
const COLUMN_GAP: f32 = 10.0;
/// No wider than this, points.
const MOST_WIDE: f32 = 460.0;
/// Text that is tried, from the best: size and height of the chart, points.
const TEXTS: [(f32, f32); 7] =
    [(13.0, 70.0), (12.0, 60.0), (11.0, 45.0), (10.0, 36.0), (9.0, 28.0), (8.0, 14.0), (7.5, 0.0)];
/// Columns of names and values that are tried, from the best.
const COLUMNS: [usize; 3] = [2, 3, 4];

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

/// A name and a value.
type Cell = (&'static str, String);

/// How a page is laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Layout {
    text: f32,
    chart: f32,
    columns: usize,
}

pub(super) fn lay_out(ui: &egui::Context, viewer: &GuiActionAdapter<'_>, page: StatsPage) {
    let recent: Vec<&FrameStats> = viewer.stats().iter().rev().filter(|s| s.drawn).take(RECENT).collect();
    let mut tables: Vec<Vec<Cell>> = Vec::new();
    if matches!(page, StatsPage::Drawing | StatsPage::Pager) {
        tables.extend(drawing(&recent));
    }
    if page == StatsPage::Pager {
        tables.extend(images(viewer));
        tables.extend(pager(viewer));
    }
    show(ui, &recent, page != StatsPage::FrameRate, &tables);
}

/// Where the page is, and whether all of it is seen.
fn show(ui: &egui::Context, recent: &[&FrameStats], has_phases: bool, tables: &[Vec<Cell>]) -> (egui::Rect, bool) {
    let room = ui.content_rect().size() - Vec2::splat(4.0 * MARGIN + 2.0);
    let room = Vec2::new(room.x.min(MOST_WIDE), room.y);
    let sizes: Vec<Vec<Vec2>> = tables.iter().map(|cells| widths(ui, cells)).collect();
    let layout = layout(room, has_phases, &sizes, |text| line_height(ui, text));
    let frame = egui::Frame::window(&ui.global_style()).inner_margin(MARGIN).shadow(egui::Shadow::NONE);
    let place = ui.content_rect().min + Vec2::splat(MARGIN);
    let shown = egui::Area::new(egui::Id::unique("stats")).default_pos(place).movable(true).show(ui, |ui| {
        let shown = frame.show(ui, |ui| {
            ui.spacing_mut().item_spacing = Vec2::new(COLUMN_GAP, 0.0);
            ui.spacing_mut().interact_size.y = 0.0;
            // What is still too much for a very small picture is scrolled.
            let high = room.y.max(20.0);
            let shown = egui::ScrollArea::vertical().max_height(high).min_scrolled_height(high).show(ui, |ui| {
                ui.set_max_width(room.x.max(20.0));
                frame_rate(ui, recent, layout);
                if has_phases {
                    phases(ui, recent, layout, room.x);
                }
                for (place, cells) in tables.iter().enumerate() {
                    ui.add(egui::Separator::default().spacing(3.0));
                    grid(ui, place, cells, layout);
                }
            });
            let cut = shown.content_size - shown.inner_rect.size();
            cut.max_elem() < 1.0
        });
        shown.inner
    });
    (shown.response.rect, shown.inner)
}

/// Widths of names and values in text of one point.
fn widths(ui: &egui::Context, cells: &[Cell]) -> Vec<Vec2> {
    // Rounded to pixels in each size; some more than that.
    const MEASURED: f32 = 20.0;
    let width = |text: &str, font: FontId| {
        let galley = ui.fonts_mut(|fonts| fonts.layout_no_wrap(text.to_owned(), font, Color32::WHITE));
        (galley.size().x + 1.0) / MEASURED * 1.03
    };
    let of = |(name, value): &Cell| {
        Vec2::new(width(name, FontId::proportional(MEASURED)), width(value, FontId::monospace(MEASURED)))
    };
    cells.iter().map(of).collect()
}

/// The best that fits; the smallest where nothing does.
fn layout(room: Vec2, has_phases: bool, tables: &[Vec<Vec2>], line: impl Fn(f32) -> f32) -> Layout {
    let fits = |layout: &Layout| {
        let size = size_of(*layout, line(layout.text), room.x, has_phases, tables);
        size.x <= room.x && size.y <= room.y
    };
    let [.., (text, chart)] = TEXTS;
    let smallest = Layout { text, chart, columns: COLUMNS[0] };
    let all = TEXTS.iter().flat_map(|&(text, chart)| COLUMNS.map(|columns| Layout { text, chart, columns }));
    all.clone().find(fits).unwrap_or(smallest)
}

/// Points that a page takes, rather more than less.
fn size_of(layout: Layout, line: f32, width: f32, has_phases: bool, tables: &[Vec<Vec2>]) -> Vec2 {
    let rows_of = |chars: usize, gaps: usize| {
        ((0.5 * layout.text * chars as f32 + COLUMN_GAP * gaps as f32) / width.max(1.0)).ceil()
    };
    let mut size = Vec2::new(0.0, rows_of(60, 2) * line);
    if has_phases {
        let chars: usize = PHASES.iter().map(|(name, ..)| name.len() + 6).sum();
        size.y += layout.chart + rows_of(chars, PHASES.len()) * line;
    }
    for cells in tables {
        let rows = cells.len().div_ceil(layout.columns);
        size.y += 3.0 + rows as f32 * line;
        // Each column is as wide as its widest name and value.
        let column = |at: usize| {
            let of = || cells.iter().skip(at).step_by(layout.columns);
            let name = of().map(|cell| cell.x).fold(0.0, f32::max);
            let value = of().map(|cell| cell.y).fold(0.0, f32::max);
            layout.text * (name + value) + 2.0 * COLUMN_GAP
        };
        let wide: f32 = (0..layout.columns).map(column).sum();
        size.x = size.x.max(wide - COLUMN_GAP);
    }
    size
}

/// Of a line of text in either font.
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

fn drawing(recent: &[&FrameStats]) -> Option<Vec<Cell>> {
    let last = recent.first()?;
    Some(vec![
        ("leaves", last.leaves.to_string()),
        ("draw calls", last.draw_calls.to_string()),
        ("triangles", thousands(last.triangles)),
        ("shadow leaves", last.shadow_leaves.to_string()),
        ("state changes", last.state_changes.to_string()),
        ("tiles drawn", last.tiles_drawn.to_string()),
        ("tiles visited", last.tiles_visited.to_string()),
        ("occluded", last.occluded.to_string()),
        ("gpu", last.gpu_ms.map_or("-".to_owned(), |ms| format!("{ms:.2} ms"))),
    ])
}

fn pager(viewer: &GuiActionAdapter<'_>) -> Option<Vec<Cell>> {
    let pager = viewer.pager().map(|p| p.stats())?;
    let wanted = viewer.stats().last().map_or(0, |s| s.wanted_missing);
    let mean_ms = 1e3 * pager.latency_sum_s / pager.merged.max(1) as f64;
    Some(vec![
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
        ("pages", viewer.scene().page_count().to_string()),
        ("to merge, mean", format!("{mean_ms:.0} ms")),
        ("to merge, most", format!("{:.0} ms", 1e3 * pager.latency_max_s)),
        ("tiles on CPU", mebibytes(pager.cpu_bytes)),
        ("tiles on GPU", mebibytes(pager.gpu_bytes)),
        ("read", mebibytes(pager.bytes_read)),
        ("shared images", pager.sharing.texture_hits.to_string()),
        ("saved on CPU", mebibytes(pager.shared_cpu_bytes_saved)),
        ("saved on GPU", mebibytes(pager.shared_gpu_bytes_saved)),
        ("shared shapes", pager.sharing.geometry_hits.to_string()),
    ])
}

fn images(viewer: &GuiActionAdapter<'_>) -> Option<Vec<Cell>> {
    let images = viewer.image_pager().map(|p| p.stats())?;
    Some(vec![
        ("images loaded", images.loaded.to_string()),
        ("kept", images.images.to_string()),
        ("late", images.late.to_string()),
        ("failed", images.failed.to_string()),
        ("paged out", images.paged_out.to_string()),
        ("bytes", mebibytes(images.bytes)),
    ])
}

fn grid(ui: &mut Ui, place: usize, cells: &[Cell], layout: Layout) {
    let columns = 2 * layout.columns;
    egui::Grid::new(("stats", place)).num_columns(columns).spacing([COLUMN_GAP, 0.0]).min_row_height(0.0).show(
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

/// Stacked bars, newest at the right, with a line at 16.7 ms.
fn chart(ui: &mut Ui, recent: &[&FrameStats], size: Vec2) {
    let (response, painter) = ui.allocate_painter(size, egui::Sense::hover());
    let rect = response.rect;
    painter.rect_filled(rect, 2.0, Color32::from_black_alpha(120));
    let total = |s: &FrameStats| PHASES.iter().map(|(_, _, value)| value(s)).sum::<f64>();
    let highest_ms = Samples::new(recent.iter().map(|s| total(s))).percentile(0.98).max(20.0);
    let (bar_width, scale) = (rect.width() / RECENT as f32, size.y / highest_ms as f32);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Tables as long and as wide as they get.
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
        let recent = vec![&stats; RECENT];
        let tables = tables(lengths);
        let mut result = None;
        // Sizes are known from the second frame on.
        for _ in 0..3 {
            let rect = egui::Rect::from_min_size(egui::Pos2::ZERO, screen.into());
            let input = egui::RawInput { screen_rect: Some(rect), ..egui::RawInput::default() };
            let mut output = context.run_ui(input, |ui| result = Some(show(ui.ctx(), &recent, true, &tables)));
            output.textures_delta.clear();
        }
        result.unwrap()
    }

    #[test]
    fn a_page_fits_into_pictures_down_to_320_by_240() {
        for screen in [[320.0, 240.0], [640.0, 240.0], [320.0, 480.0], [480.0, 300.0], [560.0, 560.0], [1280.0, 720.0]]
        {
            for lengths in [&[][..], &[9], &[9, 21], &[9, 6, 21]] {
                let (rect, is_whole) = shown(screen, lengths);
                assert!(is_whole, "{screen:?} {lengths:?}: {rect:?}");
                assert!(rect.max.x <= screen[0] && rect.max.y <= screen[1], "{screen:?} {lengths:?}: {rect:?}");
            }
        }
    }

    #[test]
    fn text_is_as_large_as_there_is_room_for() {
        let sizes = [9, 21].map(|cells| vec![Vec2::new(7.0, 5.0); cells]);
        let of = |x: f32, y: f32| layout(Vec2::new(x, y), true, &sizes, |text| 1.25 * text);
        assert_eq!(of(460.0, 700.0), Layout { text: 13.0, chart: 70.0, columns: 2 });
        assert!(of(460.0, 300.0).text > of(290.0, 220.0).text);
        // Where nothing fits it is scrolled.
        assert_eq!(of(50.0, 50.0), Layout { text: 7.5, chart: 0.0, columns: 2 });
        let (rect, is_whole) = shown([200.0, 100.0], &[9, 21]);
        assert!(!is_whole && rect.max.y <= 100.0, "{rect:?}");
    }
}
