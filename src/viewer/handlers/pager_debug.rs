//! The pager's tiles, over the picture.

use super::GuiActionAdapter;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, GuiEventHandler, Key, Usage};

const KEYS: Bindings<()> = Bindings(&[(&[Key::Char('g')], (), "tiles of the pager by level, by state, none")]);

/// How tiles are coloured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TileColors {
    /// They are not shown.
    #[default]
    None,
    /// By their level.
    Level,
    /// By what the pager has of them.
    State,
}

/// Shows the bounds of the tiles that the last frame wanted, and counts what the pager has.
#[derive(Clone, Copy, Debug, Default)]
pub struct PagerDebugHandler {
    /// How tiles are coloured.
    pub colors: TileColors,
}

impl GuiEventHandler for PagerDebugHandler {
    fn handle(&mut self, event: &GuiEventAdapter, _: &mut GuiActionAdapter<'_>) -> bool {
        if KEYS.action(event).is_none() {
            return false;
        }
        self.colors = match self.colors {
            TileColors::None => TileColors::Level,
            TileColors::Level => TileColors::State,
            TileColors::State => TileColors::None,
        };
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }

    fn shows_overlay(&self) -> bool {
        self.colors != TileColors::None
    }

    #[cfg(feature = "window")]
    fn lay_out(&mut self, ui: &egui::Context, viewer: &GuiActionAdapter<'_>) {
        show::tiles(ui, viewer, self.colors);
    }
}

#[cfg(feature = "window")]
mod show {
    //! The tiles' boxes as lines, projected here: no part of the scene.

    use egui::{Color32, RichText};
    use glam::{DVec3, DVec4};

    use super::{GuiActionAdapter, TileColors};
    use crate::scene::{SlotState, TileInfo};
    use crate::viewer::window_matrix::WindowMatrix;

    /// Boxes that are shown at most; the rest is counted.
    const MOST_BOXES: usize = 4000;

    /// What the pager has of a tile.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    enum State {
        Drawn,
        Kept,
        Wanted,
        Failed,
        Unknown,
    }

    const STATES: [(State, &str, Color32); 5] = [
        (State::Drawn, "loaded, in use", Color32::from_rgb(90, 220, 110)),
        (State::Kept, "loaded, not in use", Color32::from_rgb(90, 140, 230)),
        (State::Wanted, "wanted, not there", Color32::from_rgb(250, 190, 60)),
        (State::Failed, "failed", Color32::from_rgb(240, 70, 70)),
        (State::Unknown, "not wanted", Color32::from_rgb(120, 120, 120)),
    ];

    /// Levels go through these colours again and again.
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

    pub fn tiles(ui: &egui::Context, viewer: &GuiActionAdapter<'_>, colors: TileColors) {
        // Cull has stamped the frame before this one.
        let last_frame = viewer.frame_stamp().frame.saturating_sub(1);
        let state = |tile: &TileInfo| {
            let is_used = tile.last_used_frame >= last_frame && last_frame > 0;
            match tile.state {
                Some(SlotState::Resident(_)) if is_used => State::Drawn,
                Some(SlotState::Resident(_)) => State::Kept,
                Some(SlotState::Failed) => State::Failed,
                Some(SlotState::Empty) if is_used => State::Wanted,
                _ => State::Unknown,
            }
        };
        let painter = ui.layer_painter(egui::LayerId::background());
        let matrix = viewer.window_matrix();
        let scale = 1.0 / f64::from(ui.pixels_per_point());
        let (mut of_state, mut of_level) = ([0usize; STATES.len()], Vec::<usize>::new());
        let mut shown = 0;
        for tile in viewer.scene().tiles().filter(|tile| tile.state.is_some()) {
            let state = state(&tile);
            let place = STATES.iter().position(|(s, ..)| *s == state).unwrap_or(0);
            of_state[place] += 1;
            let level = tile.depth as usize;
            if state == State::Drawn {
                of_level.resize(of_level.len().max(level + 1), 0);
                of_level[level] += 1;
            }
            if state == State::Unknown || state == State::Kept || shown >= MOST_BOXES {
                continue;
            }
            let color = match colors {
                TileColors::State => STATES[place].2,
                _ => LEVELS[level % LEVELS.len()],
            };
            shown += usize::from(show_box(&painter, &matrix, &tile, color, scale));
        }
        egui::Window::new("Tiles").anchor(egui::Align2::RIGHT_TOP, [-10.0, 10.0]).resizable(false).show(ui, |ui| {
            for ((_, name, color), count) in STATES.iter().zip(of_state) {
                let color = if colors == TileColors::State { *color } else { Color32::LIGHT_GRAY };
                ui.label(RichText::new(format!("{count:6}  {name}")).monospace().color(color));
            }
            ui.separator();
            for (level, count) in of_level.iter().enumerate() {
                let color =
                    if colors == TileColors::Level { LEVELS[level % LEVELS.len()] } else { Color32::LIGHT_GRAY };
                ui.label(RichText::new(format!("{count:6}  level {level}")).monospace().color(color));
            }
            if shown >= MOST_BOXES {
                ui.label(format!("the first {MOST_BOXES} boxes"));
            }
        });
    }

    /// Draws the edges of a box; false when none shows.
    fn show_box(painter: &egui::Painter, matrix: &WindowMatrix, tile: &TileInfo, color: Color32, scale: f64) -> bool {
        let m = &tile.bounds.half_axes;
        let clip = [0u32, 1, 2, 3, 4, 5, 6, 7].map(|corner| {
            let sign = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
            let point = tile.bounds.center + *m * DVec3::new(sign(0), sign(1), sign(2));
            matrix.clip_from_world * point.extend(1.0)
        });
        let mut any = false;
        for from in 0..8usize {
            for bit in [1usize, 2, 4] {
                let to = from | bit;
                if to == from {
                    continue;
                }
                if let Some([a, b]) = in_front(clip[from], clip[to]) {
                    let at = |p: DVec4| {
                        let ndc = p.truncate() / p.w;
                        let px = 0.5 * glam::DVec2::new(1.0 + ndc.x, 1.0 - ndc.y) * matrix.size_px * scale;
                        let px = px.clamp(glam::DVec2::splat(-1e5), glam::DVec2::splat(1e5));
                        egui::pos2(px.x as f32, px.y as f32)
                    };
                    let (a, b) = (at(a), at(b));
                    any |= painter.clip_rect().intersects(egui::Rect::from_two_pos(a, b));
                    painter.line_segment([a, b], egui::Stroke::new(1.0, color));
                }
            }
        }
        any
    }

    /// The part of an edge that is in front of the eye.
    fn in_front(a: DVec4, b: DVec4) -> Option<[DVec4; 2]> {
        const LEAST_W: f64 = 1e-3;
        if !(a.is_finite() && b.is_finite()) {
            return None;
        }
        let cut = |inside: DVec4, outside: DVec4| inside.lerp(outside, (inside.w - LEAST_W) / (inside.w - outside.w));
        match (a.w >= LEAST_W, b.w >= LEAST_W) {
            (true, true) => Some([a, b]),
            (true, false) => Some([a, cut(a, b)]),
            (false, true) => Some([cut(b, a), b]),
            (false, false) => None,
        }
    }
}
