//! [`Layout`]: chooses text size, chart height and columns so that a page fits the image.

use egui::Vec2;

use super::phases::PHASES;

/// The gap between names, values and columns, points.
pub(super) const COLUMN_GAP: f32 = 10.0;
/// Text sizes and chart heights to try, best first, points.
const TEXTS: [(f32, f32); 7] =
    [(13.0, 70.0), (12.0, 60.0), (11.0, 45.0), (10.0, 36.0), (9.0, 28.0), (8.0, 14.0), (7.5, 0.0)];
/// Numbers of columns to try, best first.
const COLUMNS: [usize; 3] = [2, 3, 4];

/// The layout of a page: text size and chart height in points, and columns of names and values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Layout {
    pub text: f32,
    pub chart: f32,
    pub columns: usize,
}

/// Returns the best layout that fits; the smallest when none fits. `tables` holds the widths of names and values per point of
/// text size, `lines` is the number of lines below them, `line_height` gives the height of a line for a text size.
pub(super) fn layout(
    room: Vec2,
    has_phases: bool,
    (tables, lines): (&[Vec<Vec2>], usize),
    line_height: impl Fn(f32) -> f32,
) -> Layout {
    let fits = |layout: &Layout| {
        let line = line_height(layout.text);
        let size = size_of(*layout, line, room.x, has_phases, tables) + Vec2::new(0.0, lines as f32 * line);
        size.x <= room.x && size.y <= room.y
    };
    let [.., (text, chart)] = TEXTS;
    let smallest = Layout { text, chart, columns: COLUMNS[0] };
    let all = TEXTS.iter().flat_map(|&(text, chart)| COLUMNS.map(|columns| Layout { text, chart, columns }));
    all.clone().find(fits).unwrap_or(smallest)
}

/// Returns an upper estimate of the page's size, points.
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
