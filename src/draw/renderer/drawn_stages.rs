//! The kinds of stages that the last frame has drawn: pipelines are prewarmed for them. Draw thread.

use crate::draw::passes::stage_input::LitStage;
use crate::draw::pipelines::key::AirKind;

/// The properties of a stage that pipelines depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DrawnStage {
    /// Index of the target's formats.
    pub(super) target: u16,
    /// True if a light replaces the sun.
    pub(super) has_own_light: bool,
    pub(super) air: AirKind,
    pub(super) has_shadows: bool,
}

/// The maximum number of kinds that are expected.
const MAX_EXPECTED: usize = 8;

/// The different kinds of stages that the last frame has drawn, and those that the application expects.
#[derive(Debug, Default)]
pub(super) struct DrawnStages {
    drawn: Vec<DrawnStage>,
    /// The kinds among them whose stages had leaves.
    with_leaves: Vec<DrawnStage>,
    /// The kinds with leaves that the frame before has drawn.
    before: Vec<DrawnStage>,
    /// The latest last.
    expected: Vec<DrawnStage>,
}

impl DrawnStages {
    pub(super) fn clear(&mut self) {
        std::mem::swap(&mut self.with_leaves, &mut self.before);
        self.with_leaves.clear();
        self.drawn.clear();
    }

    /// Returns true if the frame before has drawn leaves in a stage of a kind. The first leaves are not left out.
    pub(super) fn was_drawn(&self, stage: &DrawnStage) -> bool {
        self.before.contains(stage)
    }

    /// Returns true if the frame before has drawn shadows into a target of a kind.
    pub(super) fn had_shadows(&self, target: u16) -> bool {
        self.before.iter().any(|stage| stage.target == target && stage.has_shadows)
    }

    /// Notes a stage that is drawn; returns its kind.
    pub(super) fn add(&mut self, lit: &LitStage<'_>, has_own_light: bool, has_casters: bool) -> DrawnStage {
        // An empty stage has no casters yet.
        let will_have_casters = lit.around.shadows.is_some() && lit.input.stage.leaf_count() == 0;
        let drawn = DrawnStage {
            target: lit.input.target.index,
            has_own_light,
            air: lit.view(0).air_kind,
            has_shadows: has_casters || will_have_casters,
        };
        if !self.drawn.contains(&drawn) {
            self.drawn.push(drawn);
        }
        if lit.input.stage.leaf_count() > 0 && !self.with_leaves.contains(&drawn) {
            self.with_leaves.push(drawn);
        }
        drawn
    }

    /// Iterates over the kinds of stages, drawn and expected.
    pub(super) fn iter(&self) -> impl Iterator<Item = &DrawnStage> {
        self.drawn.iter().chain(&self.expected)
    }

    /// Returns true if a kind was drawn.
    pub(super) fn has_drawn(&self, stage: &DrawnStage) -> bool {
        self.drawn.contains(stage)
    }

    /// Returns the number of kinds that were drawn.
    pub(super) fn drawn_count(&self) -> usize {
        self.drawn.len()
    }

    /// Returns the drawn kind of an index below [`Self::drawn_count`].
    pub(super) fn drawn(&self, index: usize) -> DrawnStage {
        self.drawn[index]
    }

    /// Notes a kind that later frames will draw. The earliest of too many is forgotten.
    pub(super) fn expect(&mut self, stage: DrawnStage) {
        if self.iter().any(|known| *known == stage) {
            return;
        }
        if self.expected.len() == MAX_EXPECTED {
            self.expected.remove(0);
        }
        self.expected.push(stage);
    }

    /// Notes a target in which an environment without shadows and lights is expected to be drawn.
    pub(super) fn add_expected(&mut self, target: u16, air: AirKind) {
        self.drawn.push(DrawnStage { target, has_own_light: false, air, has_shadows: false });
    }

    /// Returns the indices of the targets.
    pub(super) fn targets(&self) -> impl Iterator<Item = u16> {
        self.drawn.iter().map(|drawn| drawn.target)
    }
}
