//! [`TileColors`]: the colouring of tile boxes.

/// The colouring of tile boxes in the debug view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TileColors {
    /// Tiles are not shown.
    #[default]
    None,
    /// Tiles are coloured by level.
    Level,
    /// Tiles are coloured by [`TileState`](super::TileState).
    State,
}
