//! Cross-fades between levels of detail: one is dissolved into the other. Culling thread.
//!
//! When a tile is replaced by its children, or replaces them, both are drawn for a short time. Each is drawn in its part
//! of a dither pattern of the screen, so that every pixel shows exactly one of them. Each part is a [`FadeBand`]: a range of
//! the pattern's values. A tile's band is split between its own content and its children. Where children refine in turn,
//! their part is split again, so that the parts neither overlap nor leave a gap.

mod band;
mod history;

pub use band::FadeBand;
pub(super) use band::{Fade, WHOLE};
pub(super) use history::{FadeConditions, FadeStep, FadeTarget, LodFades, LodIndex, LodShares, TileMark, TilePart};
