//! Parts of an implicit tree as tiles of pages. Decode threads.
//!
//! A subtree file becomes a page of its first levels. Below its last tiles hang further parts: a [`SubtreePart`] is made
//! from the same subtree in memory when a cull wants it, without a fetch; a [`SubtreeSource`] is another subtree file. All
//! are contents with pages of their own, so they expire like others, and memory follows what was looked at.

use std::sync::Arc;

use glam::DAffine3;

use super::coordinates::{LocalTile, TileCoordinates};
use super::semantics::VolumeOverrides;
use super::subtree::{Subtree, external_buffers};
use super::tiling::ImplicitTiling;
use crate::fetch::{ContentTooLarge, IoError, about_to_allocate};
use crate::formats::height::PlacedErrors;
use crate::formats::ignored::Notes;
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::properties::MetadataBudget;
use crate::formats::tile::{ALWAYS_REFINED_M, Continuation, Tile, TileContent};
use crate::scene::{Metadata, ReaderData, ReaderValue, Refine, TileMetadata};

/// The maximum of tiles of a page: about 2 ms of a decode thread, since the first tiles are waited for. A page has at least
/// one level.
const MAX_TILES: u64 = 1024;
/// About the bytes of a tile, and of each of its contents, with names and until the page is built.
const TILE_BYTES: u64 = 1024;

/// A subtree file that is not read yet. The reader data of a tile whose content it is.
#[derive(Clone, Debug)]
pub(in crate::formats) struct SubtreeSource {
    tiling: Arc<ImplicitTiling>,
    root: TileCoordinates,
    /// `None` above the root of the tree.
    above: Option<Above>,
}

/// The levels of a subtree in memory below one of its tiles. The reader data of a tile that they become the content of.
#[derive(Clone, Debug)]
pub(in crate::formats) struct SubtreePart {
    subtree: Arc<LoadedSubtree>,
    /// The tile above.
    parent: LocalTile,
    above: Above,
    /// True for one part of each file, which counts the memory of the subtree.
    counts_subtree: bool,
}

/// The properties that a tile inherits from the tiles above it.
#[derive(Clone, Copy, Debug)]
struct Above {
    /// Maps from the tile above to the tileset's frame.
    transform: DAffine3,
    /// True if a content above is replaced by the tiles below.
    is_replaced: bool,
    /// The errors of the tile above, if it is a height tile.
    heights: Option<PlacedErrors>,
}

/// A subtree in memory, shared by the parts of its tree.
#[derive(Debug)]
struct LoadedSubtree {
    tiling: Arc<ImplicitTiling>,
    uri: Arc<str>,
    subtree: Subtree,
}

impl SubtreeSource {
    /// Returns the subtree that has the root of an implicit tree.
    pub fn root(tiling: Arc<ImplicitTiling>) -> Self {
        Self { tiling, root: TileCoordinates::default(), above: None }
    }

    /// Returns the URI of the file.
    pub fn uri(&self) -> Arc<str> {
        self.tiling.subtree_uri(self.root)
    }

    /// Reads the file and returns the root tile of the subtree with its first levels.
    pub fn read(
        &self,
        uri: &Arc<str>,
        bytes: Vec<u8>,
        companions: &[Fetched],
        options: &ReadOptions,
    ) -> Result<Vec<Tile>, IoError> {
        let subtree = Subtree::parse(uri, bytes, companions, self.tiling.shape, self.tiling.schema(), options)?;
        let subtree = LoadedSubtree { tiling: self.tiling.clone(), uri: uri.clone(), subtree };
        let mut reader = PartReader::new(Arc::new(subtree), true, options);
        let root = LocalTile::root(self.root);
        reader.choose_levels(vec![root], MAX_TILES);
        reader.ask(&[root]).map_err(|error| error.at(uri))?;
        Ok(vec![reader.tile(root, self.above)])
    }

    /// Returns the references of the external buffers that a subtree file needs.
    pub(super) fn external_buffers(&self, bytes: &[u8], options: &ReadOptions) -> Vec<String> {
        external_buffers(bytes, self.tiling.schema(), options)
    }

    /// Returns the content of a tile that stands for the subtree.
    pub fn content(self) -> TileContent {
        TileContent::new(self.uri(), Some(ReaderData::of(self)))
    }
}

impl SubtreePart {
    /// Returns the tiles below the parent with some of their levels.
    pub fn read(&self, options: &ReadOptions) -> Result<Vec<Tile>, IoError> {
        let mut reader = PartReader::new(self.subtree.clone(), false, options);
        let tiles = reader.children(self.parent);
        reader.choose_levels(tiles.clone(), MAX_TILES);
        reader.ask(&tiles).map_err(|error| error.at(&self.subtree.uri))?;
        Ok(tiles.into_iter().map(|tile| reader.tile(tile, Some(self.above))).collect())
    }

    fn content(self) -> TileContent {
        // The URI is only a name: nothing is fetched.
        let TileCoordinates { level, x, y, z } = self.parent.coordinates;
        let uri = format!("{}#{level}/{x}/{y}/{z}", self.subtree.uri);
        TileContent::new(uri.into(), Some(ReaderData::of(self)))
    }
}

impl ReaderValue for SubtreeSource {
    fn continues_tileset(&self) -> bool {
        true
    }

    fn has_heights(&self) -> bool {
        self.tiling.has_heights()
    }

    fn fallback_uri(&self) -> Option<Arc<str>> {
        self.tiling.subtree_fallback(self.root)
    }

    fn size_bytes(&self) -> u64 {
        let is_root = self.root == TileCoordinates::default();
        size_of::<Self>() as u64 + if is_root { self.tiling.size_bytes() } else { 0 }
    }
}

impl ReaderValue for SubtreePart {
    fn is_whole_content(&self) -> bool {
        true
    }

    fn continues_tileset(&self) -> bool {
        true
    }

    fn size_bytes(&self) -> u64 {
        size_of::<Self>() as u64 + if self.counts_subtree { self.subtree.subtree.size_bytes() } else { 0 }
    }
}

/// Makes tiles from the bits of a subtree.
struct PartReader {
    subtree: Arc<LoadedSubtree>,
    /// The last level, in the subtree, whose tiles become tiles of the page.
    last_level: u32,
    /// The next part counts the memory of the subtree.
    counts_subtree: bool,
    /// The options of the tileset, with which references in metadata are resolved.
    options: ReadOptions,
    budget: MetadataBudget,
}

impl PartReader {
    fn new(subtree: Arc<LoadedSubtree>, counts_subtree: bool, options: &ReadOptions) -> Self {
        let options = ReadOptions { base: subtree.tiling.base().cloned(), ..options.clone() };
        Self { subtree, last_level: 0, counts_subtree, options, budget: MetadataBudget::default() }
    }

    /// Returns the tiles of the subtree below one of its tiles.
    fn children(&self, tile: LocalTile) -> Vec<LocalTile> {
        let LoadedSubtree { tiling, subtree, .. } = &*self.subtree;
        let level = tile.coordinates.level + 1;
        if tile.level + 1 >= tiling.shape.levels || level >= tiling.available_levels {
            return Vec::new();
        }
        let subdivision = tiling.shape.subdivision;
        let children = (0..subdivision.child_count()).map(|child| tile.child(subdivision, child));
        children.filter(|child| subtree.has_tile(*child)).collect()
    }

    /// Returns the roots of the subtrees below one of the last tiles of this subtree.
    fn child_subtrees(&self, tile: LocalTile) -> Vec<TileCoordinates> {
        let LoadedSubtree { tiling, subtree, .. } = &*self.subtree;
        let level = tile.coordinates.level + 1;
        if tile.level + 1 != tiling.shape.levels || level >= tiling.available_levels {
            return Vec::new();
        }
        let subdivision = tiling.shape.subdivision;
        let roots = (0..subdivision.child_count()).map(|child| tile.child(subdivision, child));
        roots.filter(|root| subtree.has_child_subtree(*root)).map(|root| root.coordinates).collect()
    }

    /// Chooses the levels of the page, from that of `tiles` on: all of the subtree if they have at most `max_tiles`. Otherwise
    /// the page and those below it get about equally many levels, so that no page is tiny.
    fn choose_levels(&mut self, tiles: Vec<LocalTile>, max_tiles: u64) {
        let first = tiles.first().map_or(0, |tile| tile.level);
        let (fitting, is_whole) = self.fitting_levels(tiles, max_tiles);
        let left = self.subtree.tiling.shape.levels - first;
        let pages = if is_whole { 1 } else { left.div_ceil(fitting) };
        self.last_level = first + left.div_ceil(pages) - 1;
    }

    /// Returns how many levels from that of `tiles` on have at most `max_tiles` together, at least 1, and whether those are
    /// all of the subtree.
    fn fitting_levels(&self, mut tiles: Vec<LocalTile>, max_tiles: u64) -> (u32, bool) {
        let (mut levels, mut count) = (1, tiles.len() as u64);
        loop {
            let mut below = Vec::new();
            for tile in &tiles {
                below.extend(self.children(*tile));
                if count + below.len() as u64 > max_tiles {
                    return (levels, false);
                }
            }
            if below.is_empty() {
                return (levels, true);
            }
            count += below.len() as u64;
            levels += 1;
            tiles = below;
        }
    }

    /// Asks for the memory of tiles with their contents and the levels below them down to the last one. A small file can name
    /// thousands of contents for each tile.
    fn ask(&self, tiles: &[LocalTile]) -> Result<(), ContentTooLarge> {
        for tile in tiles {
            let numbers = 0..self.subtree.tiling.shape.contents;
            let contents = numbers.filter(|number| self.subtree.subtree.has_content(*tile, *number)).count() as u64;
            about_to_allocate(TILE_BYTES * (1 + contents))?;
            if tile.level < self.last_level {
                self.ask(&self.children(*tile))?;
            }
        }
        Ok(())
    }

    /// Returns a tile with the levels below it down to the last one. `above` is `None` for the root of the tree.
    fn tile(&mut self, tile: LocalTile, above: Option<Above>) -> Tile {
        let tiling = self.subtree.tiling.clone();
        let coordinates = tile.coordinates;
        let (overrides, metadata) = self.subtree.subtree.tile_row(tile);
        let metadata = self.keep(metadata, overrides.has_invalid);
        let transform =
            tiling.tile_transform(above.as_ref().map(|above| &above.transform), overrides.transform.as_ref());
        let above_heights = above.as_ref().and_then(|above| above.heights.as_ref());
        let height_data = tiling.height_data(coordinates, &overrides, &transform, above_heights);
        let heights = height_data.as_ref().and_then(|data| data.as_ref().ok()).map(|(errors, _)| *errors);
        let mut height_data = height_data.map(|data| data.map(|(_, data)| data));
        let mut contents = Vec::new();
        for number in 0..tiling.shape.contents {
            if self.subtree.subtree.has_content(tile, number) {
                // The first content of a height tile has its heights.
                let height_data = height_data.take().filter(|_| number == 0);
                contents.extend(self.content(tile, number, &overrides.volume, &transform, height_data));
            }
        }
        let subtree = self.subtree.subtree.metadata().filter(|_| tile.level == 0).cloned();
        // A tile without content draws nothing where its error is small, which would be a hole below a replaced content.
        let is_replaced = above.map_or(tiling.is_replaced, |above| above.is_replaced);
        let bounds = tiling.bounds(coordinates, &overrides.volume, &transform);
        let mut geometric_error_m = match &heights {
            Some(errors) => errors.geometric_error_m(),
            None => tiling.geometric_error_m(coordinates.level, &overrides, &transform),
        };
        if contents.is_empty() && is_replaced {
            geometric_error_m = ALWAYS_REFINED_M;
        }
        let refine = overrides.refine.unwrap_or(tiling.refine);
        let replaces = !contents.is_empty() && refine == Refine::Replace;
        let above = Above { transform, is_replaced: is_replaced || replaces, heights };
        let (mut children, mut continuations) = (Vec::new(), Vec::new());
        if tile.level < self.last_level {
            children = self.children(tile).into_iter().map(|child| self.tile(child, Some(above))).collect();
        } else if !self.children(tile).is_empty() {
            let counts_subtree = std::mem::take(&mut self.counts_subtree);
            let part = SubtreePart { subtree: self.subtree.clone(), parent: tile, above, counts_subtree };
            continuations.push(Continuation { bounds, content: part.content() });
        }
        for root in self.child_subtrees(tile) {
            // The metadata of its root is not known yet.
            let bounds = tiling.bounds(root, &VolumeOverrides::default(), &transform);
            let source = SubtreeSource { tiling: tiling.clone(), root, above: Some(above) };
            continuations.push(Continuation { bounds, content: source.content() });
        }
        Tile {
            bounds,
            request_volume: None,
            refine,
            geometric_error_m,
            content_transform: transform,
            contents,
            external_tilesets: Vec::new(),
            continuations,
            metadata: TileMetadata { tile: metadata, subtree, ..TileMetadata::default() }.shared(),
            children,
        }
    }

    /// Returns a content of a tile: that of its template, or that which its metadata refers to. `volume` and `transform` are
    /// those of the tile, and `height_data` its reader data if the content is a height tile.
    fn content(
        &mut self,
        tile: LocalTile,
        number: usize,
        volume: &VolumeOverrides,
        transform: &DAffine3,
        height_data: Option<Result<Arc<str>, IoError>>,
    ) -> Option<TileContent> {
        let row = self.subtree.subtree.content_row(tile, number);
        let metadata = self.keep(row.metadata, row.has_invalid);
        let tiling = &self.subtree.tiling;
        let mut content = tiling.content(tile.coordinates, number)?;
        if let Some(reference) = &row.uri {
            content = match self.options.resolve(tiling.uri(), reference) {
                Ok((uri, fallback)) => TileContent::new(uri, tiling.content_data(fallback)),
                Err(error) => TileContent::refused(content.uri, error),
            };
        }
        let own = volume.of_content(&row.volume);
        content.bounds = own.map(|own| tiling.bounds(tile.coordinates, &own, transform));
        match height_data {
            Some(Ok(data)) => content.reader_data = Some(data.into()),
            Some(Err(error)) => content = TileContent::refused(content.uri, error),
            None => {}
        }
        content.metadata = tiling.content_metadata(number, row.group, metadata);
        Some(content)
    }

    /// Returns metadata if the budget has room for it. Notes values with an effect that are invalid.
    fn keep(&mut self, metadata: Option<Arc<Metadata>>, has_invalid: bool) -> Option<Arc<Metadata>> {
        let notes = Notes::default();
        if has_invalid {
            notes.add("metadata: an invalid value of a volume, error, refinement or transform");
        }
        let kept = metadata.and_then(|metadata| self.budget.keep(metadata, &|kind| notes.add(kind)));
        self.options.ignored.add(&notes.into_ignored());
        kept
    }
}
