//! Draws the bounds of tiles as lines over the image, with a legend. Main thread, event phase.

use egui::{Align2, Color32, FontId, Rect, RichText, Ui};
use glam::{DVec2, DVec3, DVec4};

use super::tile_colors::TileColors;
use super::tile_state::TileState;
use crate::scene::TileInfo;
use crate::viewer::{GuiActionAdapter, WindowMatrix};

/// The most boxes shown of settled tiles, and of tiles in flight; the others are only counted.
const MAX_BOXES: usize = 4000;
/// The size of a box relative to its tile; below 1, so that neighbours do not overlap.
const INSET: f64 = 0.98;
/// The minimum side of a box with a label, points.
const MIN_LABELLED_SIDE: f32 = 44.0;

/// The colours of levels, repeated for deeper levels.
const LEVELS: [Color32; 8] = [
    Color32::from_rgb(230, 230, 230),
    Color32::from_rgb(230, 80, 80),
    Color32::from_rgb(240, 160, 60),
    Color32::from_rgb(235, 225, 80),
    Color32::from_rgb(100, 210, 100),
    Color32::from_rgb(80, 200, 220),
    Color32::from_rgb(90, 120, 240),
    Color32::from_rgb(200, 100, 230),
];

fn color_of(state: TileState) -> Color32 {
    let [r, g, b] = state.color();
    Color32::from_rgb(r, g, b)
}

/// Counts of tiles.
#[derive(Default)]
struct Counts {
    of_state: [usize; TileState::ALL.len()],
    /// Tiles in use, by level.
    of_level: Vec<usize>,
}

impl Counts {
    fn add(&mut self, state: TileState, level: usize) {
        let index = TileState::ALL.iter().position(|s| *s == state);
        if let Some(count) = index.and_then(|index| self.of_state.get_mut(index)) {
            *count += 1;
        }
        if state == TileState::InUse {
            self.of_level.resize(self.of_level.len().max(level + 1), 0);
            self.of_level[level] += 1;
        }
    }
}

/// Lays out the boxes of all tiles and the legend.
pub(super) fn lay_out(ui: &egui::Context, viewer: &GuiActionAdapter<'_>, colors: TileColors) {
    // Cull has marked the tiles of the previous frame.
    let culled = viewer.frame_stamp().frame.saturating_sub(1);
    let matrix = viewer.window_matrix();
    let scale = 1.0 / f64::from(ui.pixels_per_point());
    let point = |px: DVec2| egui::pos2((px.x * scale) as f32, (px.y * scale) as f32);
    let part = Rect::from_min_max(point(matrix.origin_px), point(matrix.origin_px + matrix.size_px));
    let painter = ui.layer_painter(egui::LayerId::background()).with_clip_rect(part);
    let mut counts = Counts::default();
    let mut is_cut = false;
    // Tiles in flight are drawn over the settled ones.
    for is_settled in [true, false] {
        let mut shown = 0;
        for tile in viewer.scene().tiles() {
            let Some(state) = TileState::of(&tile, viewer.pager(), culled) else { continue };
            if state.is_settled() != is_settled {
                continue;
            }
            let level = tile.depth as usize;
            counts.add(state, level);
            let is_hidden = match colors {
                TileColors::State => state == TileState::Unwanted,
                _ => matches!(state, TileState::Unwanted | TileState::Unused),
            };
            is_cut |= !is_hidden && shown >= MAX_BOXES;
            if is_hidden || shown >= MAX_BOXES {
                continue;
            }
            let color = match colors {
                TileColors::State => color_of(state),
                _ => LEVELS[level % LEVELS.len()],
            };
            let Some(rect) = show_box(&painter, &matrix, &tile, color, scale) else { continue };
            shown += 1;
            let visible = rect.intersect(painter.clip_rect());
            if !is_settled && visible.width().min(visible.height()) >= MIN_LABELLED_SIDE {
                let text = format!("{level} {}", state.name());
                painter.text(visible.center(), Align2::CENTER_CENTER, text, FontId::monospace(9.0), color);
            }
        }
    }
    let frame = egui::Frame::window(&ui.global_style()).inner_margin(6.0).fill(Color32::from_black_alpha(225));
    egui::Area::new(egui::Id::unique("tiles")).anchor(Align2::RIGHT_TOP, [-6.0, 6.0]).show(ui, |ui| {
        frame.show(ui, |ui| {
            legend(ui, &counts, colors);
            if is_cut {
                ui.label(format!("the first {MAX_BOXES} boxes"));
            }
        });
    });
}

/// Lays out the meaning of the colours, with counts.
fn legend(ui: &mut Ui, counts: &Counts, colors: TileColors) {
    ui.spacing_mut().item_spacing.y = 1.0;
    let mut line = |name: &str, count: usize, color: Color32| {
        ui.label(RichText::new(format!("{count:5} {name}")).font(FontId::monospace(9.0)).color(color));
    };
    match colors {
        TileColors::State => {
            for (state, count) in TileState::ALL.into_iter().zip(counts.of_state) {
                line(state.name(), count, color_of(state));
            }
        }
        _ => {
            for (level, count) in counts.of_level.iter().enumerate() {
                line(&format!("level {level}"), *count, LEVELS[level % LEVELS.len()]);
            }
            let missing = TileState::ALL.into_iter().zip(counts.of_state).filter(|(state, _)| !state.is_settled());
            line("not resident", missing.map(|(_, count)| count).sum(), Color32::LIGHT_GRAY);
        }
    }
}

/// Draws the edges of a tile's box; returns the rectangle around them, or `None` when no edge is visible.
fn show_box(
    painter: &egui::Painter,
    matrix: &WindowMatrix,
    tile: &TileInfo,
    color: Color32,
    scale: f64,
) -> Option<Rect> {
    let m = tile.bounds.half_axes * INSET;
    let clip = [0u32, 1, 2, 3, 4, 5, 6, 7].map(|corner| {
        let sign = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let point = tile.bounds.center + m * DVec3::new(sign(0), sign(1), sign(2));
        matrix.clip_from_world * point.extend(1.0)
    });
    let (mut is_visible, mut around) = (false, Rect::NOTHING);
    for from in 0..8usize {
        for bit in [1usize, 2, 4] {
            let to = from | bit;
            if to == from {
                continue;
            }
            if let Some([a, b]) = in_front(clip[from], clip[to]) {
                let at = |p: DVec4| {
                    let ndc = p.truncate() / p.w;
                    let in_part = 0.5 * DVec2::new(1.0 + ndc.x, 1.0 - ndc.y) * matrix.size_px;
                    let px = ((matrix.origin_px + in_part) * scale).clamp(DVec2::splat(-1e5), DVec2::splat(1e5));
                    egui::pos2(px.x as f32, px.y as f32)
                };
                let (a, b) = (at(a), at(b));
                let edge = Rect::from_two_pos(a, b);
                around |= edge;
                is_visible |= painter.clip_rect().intersects(edge);
                painter.line_segment([a, b], egui::Stroke::new(1.0, color));
            }
        }
    }
    is_visible.then_some(around)
}

/// Returns the part of an edge in front of the eye, in clip space.
fn in_front(a: DVec4, b: DVec4) -> Option<[DVec4; 2]> {
    const MIN_W: f64 = 1e-3;
    if !(a.is_finite() && b.is_finite()) {
        return None;
    }
    let cut = |inside: DVec4, outside: DVec4| inside.lerp(outside, (inside.w - MIN_W) / (inside.w - outside.w));
    match (a.w >= MIN_W, b.w >= MIN_W) {
        (true, true) => Some([a, b]),
        (true, false) => Some([a, cut(a, b)]),
        (false, true) => Some([cut(b, a), b]),
        (false, false) => None,
    }
}
