//! [`CullCounters`]: what a cull did, for statistics and tests.

/// Counts of one cull.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CullCounters {
    /// Nodes that were tested; nodes of subtrees wholly inside the frustum are not visited.
    pub nodes_visited: u32,
    /// Drawables that were tested, or taken without a test.
    pub drawables_tested: u32,
    /// Leaves that were emitted.
    pub leaves: u32,
    /// Leaves below a state set with [`DataVariance::Dynamic`](crate::state::DataVariance::Dynamic), counted once for each
    /// stage; OSG's number of dynamic render leaves.
    pub dynamic_leaves: u32,
    /// Tiles that were tested.
    pub tiles_visited: u32,
    /// Tiles whose content is drawn.
    pub tiles_drawn: u32,
    /// Contents that are drawn once more, cut to the volume of a tile whose load failed.
    pub stand_ins: u32,
    /// Tiles that the view lacks and that can be loaded; 0 once the view has all the detail that it wants.
    pub wanted_missing: u32,
    /// Nodes, drawables and tiles that were hidden by occluders.
    pub occluded: u32,
    /// Leaves that cast shadows, counted once per cascade.
    pub shadow_leaves: u32,
    /// Cameras in the graph that got no shadows because the limit was reached.
    pub shadows_refused: u32,
    /// Tiles and Lods that fade between two levels of detail.
    pub fading: u32,
    /// Age in frames of the oldest result in use: of an occlusion query since it was asked, or of an image that is read
    /// back since it was drawn. 0 without any; `u32::MAX` where a node has just been hidden or shown.
    pub answers_age: u32,
}

impl CullCounters {
    /// Adds the counts of another cull.
    pub(crate) fn add(&mut self, other: &Self) {
        self.nodes_visited += other.nodes_visited;
        self.drawables_tested += other.drawables_tested;
        self.leaves += other.leaves;
        self.dynamic_leaves += other.dynamic_leaves;
        self.tiles_visited += other.tiles_visited;
        self.tiles_drawn += other.tiles_drawn;
        self.stand_ins += other.stand_ins;
        self.wanted_missing += other.wanted_missing;
        self.occluded += other.occluded;
        self.shadow_leaves += other.shadow_leaves;
        self.shadows_refused += other.shadows_refused;
        self.fading += other.fading;
        self.answers_age = self.answers_age.max(other.answers_age);
    }
}
