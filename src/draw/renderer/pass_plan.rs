//! The prepared parts of a stage, one for each pass. Draw thread.

use std::ops::Range;

use crate::draw::passes::background::Background;
use crate::draw::passes::composition::Composition;
use crate::draw::passes::leaves::Leaves;
use crate::draw::passes::water::Water;
use crate::draw::targets::pass_target::PassTarget;

/// A stage that is ready to be recorded.
pub(super) struct PassPlan {
    pub(super) target: PassTarget,
    /// Index of the bound state without any state set.
    pub(super) base_index: u32,
    /// The views of the stage with shadows, in the shadow pass.
    pub(super) shadows: Range<usize>,
    pub(super) restores_samples: bool,
    pub(super) background: Background,
    pub(super) leaves: Leaves,
    /// The boxes of the stage, in the query pass.
    pub(super) queries: Range<usize>,
    pub(super) has_sky: bool,
    pub(super) water: Water,
    pub(super) composition: Option<Composition>,
}
