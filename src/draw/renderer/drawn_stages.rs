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

/// The different kinds of stages that the last frame has drawn.
#[derive(Debug, Default)]
pub(super) struct DrawnStages(Vec<DrawnStage>);

impl DrawnStages {
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Notes a stage that is drawn.
    pub(super) fn add(&mut self, lit: &LitStage<'_>, has_own_light: bool, has_casters: bool) {
        // An empty stage has no casters yet.
        let will_have_casters = lit.around.shadows.is_some() && lit.input.stage.leaf_count() == 0;
        let drawn = DrawnStage {
            target: lit.input.target.index,
            has_own_light,
            air: lit.view(0).air_kind,
            has_shadows: has_casters || will_have_casters,
        };
        if !self.0.contains(&drawn) {
            self.0.push(drawn);
        }
    }

    /// Returns the kinds of stages.
    pub(super) fn iter(&self) -> impl Iterator<Item = &DrawnStage> {
        self.0.iter()
    }

    /// Returns the kind of an index below [`Self::len`].
    pub(super) fn get(&self, index: usize) -> DrawnStage {
        self.0[index]
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Notes a target in which an environment without shadows and lights is expected to be drawn.
    pub(super) fn add_expected(&mut self, target: u16, air: AirKind) {
        self.0.push(DrawnStage { target, has_own_light: false, air, has_shadows: false });
    }

    /// Returns the indices of the targets.
    pub(super) fn targets(&self) -> impl Iterator<Item = u16> {
        self.0.iter().map(|drawn| drawn.target)
    }
}
