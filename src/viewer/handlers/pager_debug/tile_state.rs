//! [`TileState`]: the state of a tile, from its slot in the scene and its request in the pager.
//!
//! Main thread; takes no lock and waits for no other thread.

use crate::pager::{DatabasePager, RequestState};
use crate::scene::{SlotState, TileInfo};

/// The state of a tile with content.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TileState {
    /// Resident and visited by the last cull: drawn, or an ancestor of a drawn tile.
    InUse,
    /// Resident and not visited by the last cull.
    Unused,
    /// Requested: in flight, to be retried, or failed.
    Requested(RequestState),
    /// Visited by the last cull and not requested yet.
    Wanted,
    /// Neither resident nor wanted.
    Unwanted,
}

impl TileState {
    /// All states in the order of the legend.
    pub const ALL: [Self; 12] = [
        Self::InUse,
        Self::Unused,
        Self::Wanted,
        Self::Requested(RequestState::Waiting),
        Self::Requested(RequestState::ReadingFile),
        Self::Requested(RequestState::ReadingHttp),
        Self::Requested(RequestState::Decoding),
        Self::Requested(RequestState::Compiling),
        Self::Requested(RequestState::Merging),
        Self::Requested(RequestState::Retrying),
        Self::Requested(RequestState::Failed),
        Self::Unwanted,
    ];

    /// Returns the state of a tile after a frame was culled; `None` for a tile without content.
    pub fn of(tile: &TileInfo, pager: Option<&DatabasePager>, culled_frame: u32) -> Option<Self> {
        // A later frame number marks a prefetch, which looks ahead.
        let is_visited = tile.last_used_frame == culled_frame && culled_frame > 0;
        let request = || pager.and_then(|pager| pager.request_state(tile.node));
        Some(match tile.state? {
            SlotState::Resident(_) if is_visited => Self::InUse,
            SlotState::Resident(_) => Self::Unused,
            SlotState::Failed => Self::Requested(request().unwrap_or(RequestState::Failed)),
            SlotState::Empty => match request() {
                Some(request) => Self::Requested(request),
                None if is_visited => Self::Wanted,
                None => Self::Unwanted,
            },
        })
    }

    /// Returns the state in a word or two.
    pub fn name(self) -> &'static str {
        match self {
            Self::InUse => "in use",
            Self::Unused => "not in use",
            Self::Wanted => "wanted",
            Self::Requested(RequestState::Waiting) => "waiting",
            Self::Requested(RequestState::ReadingFile) => "reading file",
            Self::Requested(RequestState::ReadingHttp) => "reading HTTP",
            Self::Requested(RequestState::Decoding) => "decoding",
            Self::Requested(RequestState::Compiling) => "uploading",
            Self::Requested(RequestState::Merging) => "merging",
            Self::Requested(RequestState::Retrying) => "to be retried",
            Self::Requested(RequestState::Failed) => "failed",
            Self::Unwanted => "not wanted",
        }
    }

    /// Returns the sRGB colour of the state in the debug view.
    pub fn color(self) -> [u8; 3] {
        match self {
            Self::InUse => [90, 220, 110],
            Self::Unused => [80, 120, 200],
            Self::Wanted => [255, 255, 255],
            Self::Requested(RequestState::Waiting) => [250, 230, 70],
            Self::Requested(RequestState::ReadingFile) => [250, 160, 40],
            Self::Requested(RequestState::ReadingHttp) => [240, 110, 200],
            Self::Requested(RequestState::Decoding) => [170, 110, 250],
            Self::Requested(RequestState::Compiling) => [60, 210, 240],
            Self::Requested(RequestState::Merging) => [170, 250, 220],
            Self::Requested(RequestState::Retrying) => [200, 120, 80],
            Self::Requested(RequestState::Failed) => [255, 50, 50],
            Self::Unwanted => [120, 120, 120],
        }
    }

    /// Returns true when the tile is resident or not wanted, so that nothing is in flight.
    pub fn is_settled(self) -> bool {
        matches!(self, Self::InUse | Self::Unused | Self::Unwanted)
    }
}
