//! The contents of tiles: where they are loaded from, where they lie, and which pages are resident.

use std::sync::Arc;

use glam::DAffine3;

use crate::scene::id::NONE;
use crate::scene::nodes::ReaderData;

/// The slot of a tile, as a visit of its content reads it.
#[derive(Clone, Copy, Debug)]
struct TileContent {
    /// The slot of the resident page in the scene's page table, or `NONE`.
    resident: u32,
    /// An index into [`TileContents::transforms`].
    transform: u32,
}

/// Parallel arrays with an entry for each tile.
#[derive(Debug, Default)]
pub(super) struct TileContents {
    contents: Vec<TileContent>,
    /// Tile-from-content maps; consecutive tiles with the same map share one.
    transforms: Vec<DAffine3>,
    /// The generation of the resident page's id.
    generations: Vec<u32>,
    uris: Vec<Option<Arc<str>>>,
    reader_data: Vec<Option<ReaderData>>,
    referenced_bytes: u64,
}

impl TileContents {
    /// The bytes of a tile in all arrays but `transforms`.
    pub const BYTES_PER_TILE: usize =
        size_of::<TileContent>() + 4 + size_of::<Option<Arc<str>>>() + size_of::<Option<ReaderData>>();

    /// Appends an empty slot. A transform that is not finite becomes the identity.
    pub fn push(&mut self, transform: DAffine3, uri: Option<Arc<str>>, reader_data: Option<ReaderData>) {
        let transform = if transform.is_finite() { transform } else { DAffine3::IDENTITY };
        if self.transforms.last() != Some(&transform) {
            self.transforms.push(transform);
        }
        let transform = self.transforms.len() as u32 - 1;
        self.contents.push(TileContent { resident: NONE, transform });
        self.generations.push(0);
        self.referenced_bytes +=
            uri.as_ref().map_or(0, |u| u.len() as u64) + reader_data.as_ref().map_or(0, ReaderData::size_bytes);
        self.uris.push(uri);
        self.reader_data.push(reader_data);
    }

    /// Puts the tiles into another order. All slots must be empty.
    pub fn reorder(&mut self, order: &[u32]) {
        self.contents = taken(&self.contents, order);
        self.uris = taken(&self.uris, order);
        self.reader_data = taken(&self.reader_data, order);
    }

    /// Returns the slot of the resident page in the scene's page table, or `NONE`.
    #[inline(always)]
    pub fn resident(&self, tile: usize) -> u32 {
        self.contents[tile].resident
    }

    /// Returns the generation of the resident page's id.
    pub fn generation(&self, tile: usize) -> u32 {
        self.generations[tile]
    }

    /// Stores which page is resident.
    pub fn set_resident(&mut self, tile: usize, slot: u32, generation: u32) {
        self.contents[tile].resident = slot;
        self.generations[tile] = generation;
    }

    /// Empties the slot of a tile.
    pub fn clear_resident(&mut self, tile: usize) {
        self.contents[tile].resident = NONE;
    }

    /// Returns the map from the content's frame to the tile's.
    #[inline]
    pub fn transform(&self, tile: usize) -> DAffine3 {
        let at = self.contents.get(tile).map(|content| content.transform as usize);
        at.and_then(|at| self.transforms.get(at)).copied().unwrap_or_default()
    }

    /// Returns the URI of a tile's content.
    pub fn uri(&self, tile: usize) -> Option<&Arc<str>> {
        self.uris.get(tile)?.as_ref()
    }

    /// Returns what the reader wants handed back with the URI.
    pub fn reader_data(&self, tile: usize) -> Option<&ReaderData> {
        self.reader_data.get(tile)?.as_ref()
    }

    /// Returns the bytes that are not proportional to the number of tiles.
    pub fn shared_bytes(&self) -> u64 {
        (self.transforms.len() * size_of::<DAffine3>()) as u64 + self.referenced_bytes
    }
}

/// Returns the elements in another order.
pub(super) fn taken<T: Clone>(elements: &[T], order: &[u32]) -> Vec<T> {
    order.iter().map(|index| elements[*index as usize].clone()).collect()
}
