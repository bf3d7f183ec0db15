//! The record of a tile, which the tile walk of a cull reads. Plain values.

/// Flags of a [`TileRecord`].
pub(crate) mod flag {
    /// The tile has content.
    pub const CONTENT: u16 = 1;
    /// The tile is a ProxyNode.
    pub const PROXY: u16 = 2;
    /// The children are drawn besides the tile instead of replacing it.
    pub const ADD: u16 = 4;
    /// The range mode is `RangeMode::PixelSize`: the metric is metres for each pixel. Set together with [`DISTANCE`].
    pub const PIXEL_SIZE: u16 = 8;
    /// The range mode is `RangeMode::Distance`: the distance to a point that a separate table holds.
    pub const DISTANCE: u16 = 16;
    /// The proxy is loaded only if the application asks.
    pub const NEVER: u16 = 32;
    /// A page is in the slot.
    pub const RESIDENT: u16 = 64;
    /// The last load failed, and is not repeated yet.
    pub const FAILED: u16 = 128;
    /// The resident page is a tile tree itself.
    pub const EXTERNAL: u16 = 256;
    /// The tile is only for eyes inside a volume that a separate table holds.
    pub const REQUEST_VOLUME: u16 = 512;
    /// The state path differs from that of the tree's top tile; a separate table holds it.
    pub const OWN_PATH: u16 = 1024;
    /// Something that would replace the tile has failed: level skipping does not skip this tile any more.
    pub const FAILED_BELOW: u16 = 2048;
    /// Some tile below has content, as far as this page knows.
    pub const CONTENT_BELOW: u16 = 4096;
    /// Some of the children that replace the content, or of the tilesets that were attached to them, are only for eyes
    /// inside volumes.
    pub const VOLUMES_BELOW: u16 = 8192;
    /// A load failed and none has succeeded since, whether or not it is repeated. Within the tile's volume the content of an
    /// ancestor is drawn instead, so that the siblings can be drawn.
    pub const UNAVAILABLE: u16 = 16384;
    /// The content has a smaller volume than the tile; a separate table holds it.
    pub const CONTENT_VOLUME: u16 = 32768;
}

/// A tile as the tile walk reads it, 16 bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileRecord {
    /// The first child; the others follow it.
    pub first_child: u32,
    pub child_count: u32,
    /// The number of children that the tile waits for; 0 means that the children can replace the tile. Unavailable ones
    /// count only if no child is ready, since replacing the tile would show nothing new then.
    pub not_ready_children: u32,
    pub flags: u16,
    /// The depth below the page's top tiles.
    pub depth: u16,
}

impl TileRecord {
    /// Returns true if some of the flags are set.
    #[inline(always)]
    pub fn has(&self, flags: u16) -> bool {
        self.flags & flags != 0
    }

    #[inline(always)]
    pub fn has_children(&self) -> bool {
        self.child_count != 0
    }

    /// Returns the index behind the last child.
    #[inline(always)]
    pub fn end_of_children(&self) -> u32 {
        self.first_child + self.child_count
    }

    /// Returns true if content can be loaded into the tile.
    pub fn has_slot(&self) -> bool {
        self.has(flag::CONTENT | flag::PROXY)
    }

    /// Sets or clears flags.
    pub fn set(&mut self, flags: u16, is_set: bool) {
        self.flags = if is_set { self.flags | flags } else { self.flags & !flags };
    }
}
