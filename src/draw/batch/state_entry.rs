//! The states of a stage as the batch needs them. Draw thread; plain values.

use crate::cull::{DrawnPart, FadeBand};
use crate::draw::pipelines::key::StateKey;
use crate::draw::uniforms::frame::{BAND_OF_BACKDROP, BAND_OF_VOLUME, BAND_SHIFT, FLAG_UNLIT, FLAG_UNTEXTURED};
use crate::gpu::{DrawableEntry, Shape};
use crate::scene::Topology;
use crate::state::ResolvedState;

/// A state of a stage: pipeline key, bound state, and the values that its leaves get.
#[derive(Clone, Copy, Debug)]
pub(in crate::draw) struct StateEntry {
    pub(super) key: StateKey,
    /// Index of the bound state.
    pub(super) bound: u32,
    /// Equal for states that draw alike.
    pub(super) class: u32,
    pub(super) color: [f32; 4],
    /// Flags of leaves with a lit material, and with an unlit one.
    flags: [u32; 2],
    /// True if the leaves are not drawn: those that cannot fade switch in the middle of a fade, and those that blend have no
    /// backdrop.
    is_hidden: bool,
    /// True if all leaves are drawn, whatever their shape; mostly so.
    shows_all: bool,
    /// Index of the pixel grid between whose centres small meshes are skipped.
    pub(super) grid: Option<u32>,
}

impl StateEntry {
    pub(in crate::draw) fn new(key: StateKey, bound: u32, state: &ResolvedState, part: DrawnPart) -> Self {
        // Leaves that cannot be cut are drawn whole: a stand-in with too much is better than a hole.
        let (band, is_cut) = match part {
            DrawnPart::Band(band) => (band, false),
            DrawnPart::Within(_) | DrawnPart::Backdrop(_) => (FadeBand::FULL, true),
        };
        // Only surfaces that can be cut and that hide what is behind them have a backdrop.
        let is_backdrop = matches!(part, DrawnPart::Backdrop(_));
        let has_none = is_backdrop && !(key.can_fade && key.order_is_free);
        let is_whole = (band.is_full() && !is_cut) || !key.can_fade;
        let hides_customs = is_backdrop || !(band.from..band.to).contains(&(u8::MAX / 2));
        let is_hidden = has_none || (!key.can_fade && hides_customs);
        let key = if is_whole { key } else { key.fading() };
        let shows_all = !is_hidden && !hides_customs && !key.casts;
        let band = match part {
            _ if is_whole => 0,
            DrawnPart::Band(band) => (u32::from(band.from) | u32::from(band.to) << 8) << BAND_SHIFT,
            DrawnPart::Within(_) => BAND_OF_VOLUME << BAND_SHIFT,
            DrawnPart::Backdrop(_) => BAND_OF_BACKDROP << BAND_SHIFT,
        };
        let common = band | if state.has_own_textures() { 0 } else { FLAG_UNTEXTURED };
        let flags = [false, true].map(|unlit| if state.is_lit(unlit) { common } else { common | FLAG_UNLIT });
        Self { key, bound, class: 0, color: state.color, flags, is_hidden, shows_all, grid: None }
    }

    /// Returns the same state where small meshes between the pixel centres of a grid of
    /// [`Batch::grid`](super::Batch::grid) are skipped.
    pub(in crate::draw) fn without_unsampled(self, grid: u32) -> Self {
        Self { grid: Some(grid), ..self }
    }

    /// Returns the flags of a leaf.
    #[inline]
    pub(super) fn flags(&self, is_unlit: bool) -> u32 {
        self.flags[usize::from(is_unlit)]
    }

    /// Returns whether a drawable is drawn under the state. In shadow maps, lines, points, splats and custom drawables are not.
    #[inline]
    pub(super) fn draws(&self, entry: &DrawableEntry) -> bool {
        if self.shows_all || self.is_hidden {
            return self.shows_all;
        }
        match &entry.shape {
            Shape::Custom(_) => false,
            Shape::Splats { .. } => !self.key.casts,
            Shape::Mesh { topology: Topology::Lines | Topology::Points | Topology::Squares, .. } => !self.key.casts,
            _ => true,
        }
    }
}
