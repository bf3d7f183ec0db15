//! Settings and counters of sharing. Plain values.

/// The kinds of contents that are shared; OSG's `ShareMode`, and geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShareModes {
    /// Images of materials and height tiles, and textures of state sets with texels.
    pub textures: bool,
    /// State sets with static data variance.
    pub static_state_sets: bool,
    /// State sets with dynamic data variance. They are replaced page by page, so that no page sees another's change. Sharing
    /// them seldom helps, since sets that change do not stay equal for long.
    pub dynamic_state_sets: bool,
    /// Meshes, index lists and height tiles.
    pub geometry: bool,
}

impl ShareModes {
    /// Shares nothing.
    pub const NONE: Self =
        Self { textures: false, static_state_sets: false, dynamic_state_sets: false, geometry: false };
    /// Shares everything that does not change: the default.
    pub const STATIC: Self =
        Self { textures: true, static_state_sets: true, dynamic_state_sets: false, geometry: true };
    /// Shares everything.
    pub const ALL: Self = Self { dynamic_state_sets: true, ..Self::STATIC };

    /// Returns true if something is shared.
    pub fn any(&self) -> bool {
        *self != Self::NONE
    }
}

impl Default for ShareModes {
    fn default() -> Self {
        Self::STATIC
    }
}

/// Counters of sharing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SharingStats {
    /// The number of images and textures that another content had already.
    pub texture_hits: u64,
    /// The number of meshes and height tiles that another content had already.
    pub geometry_hits: u64,
    /// The number of state sets that another content had already.
    pub state_set_hits: u64,
    /// The number of images that were not decoded, because the decoded image was in memory.
    pub decodes_spared: u64,
    /// The bytes of payload copies that were dropped at once or never made, because another copy was in memory.
    pub payload_bytes_spared: u64,
    /// The number of shared contents in the tables now.
    pub entries: u64,
    /// The number of entries that were removed because no page uses them any more.
    pub pruned: u64,
}
