//! Settings and counters of sharing. Plain values.

/// What is shared; OSG's `ShareMode`, and geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShareModes {
    /// Images of materials and height tiles, and textures of state sets that hold texels.
    pub textures: bool,
    /// State sets whose data variance is static.
    pub static_state_sets: bool,
    /// State sets that are said to change. They are replaced page by page, so that no page sees another's change;
    /// but what changes soon is seldom equal for long.
    pub dynamic_state_sets: bool,
    /// Meshes, index lists and height tiles.
    pub geometry: bool,
}

impl ShareModes {
    /// Nothing.
    pub const NONE: Self =
        Self { textures: false, static_state_sets: false, dynamic_state_sets: false, geometry: false };
    /// Everything that does not change: the default.
    pub const STATIC: Self =
        Self { textures: true, static_state_sets: true, dynamic_state_sets: false, geometry: true };
    /// Everything.
    pub const ALL: Self = Self { dynamic_state_sets: true, ..Self::STATIC };

    /// Something is shared.
    pub fn any(&self) -> bool {
        *self != Self::NONE
    }
}

impl Default for ShareModes {
    fn default() -> Self {
        Self::STATIC
    }
}

/// What sharing did, counted where it happens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SharingStats {
    /// Images and textures that another content had already.
    pub texture_hits: u64,
    /// Meshes and height tiles that another content had already.
    pub geometry_hits: u64,
    /// State sets that another content had already.
    pub state_set_hits: u64,
    /// Images that were not decoded, because the decoded one was at hand.
    pub decodes_spared: u64,
    /// Bytes of payloads of which another copy was at hand, dropped at once or never made.
    pub payload_bytes_spared: u64,
    /// Shared contents now in the tables.
    pub entries: u64,
    /// Entries that were taken out of the tables because nobody shares them any more.
    pub pruned: u64,
}
