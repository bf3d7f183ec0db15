//! [`Subtree`]: which tiles, contents and child subtrees a subtree file has. Decode threads.
//!
//! The bits stay as they are in the file, and a lookup costs one byte: a subtree of 12 levels has 5.6 million of them, and
//! few are ever looked at.

use super::coordinates::{LocalTile, Subdivision};
use super::json::{AvailabilityJson, SubtreeJson};
use super::semantics::{self, Overrides, Semantic};
use crate::fetch::IoError;
use crate::formats::embedded;
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::properties::{NumberColumn, Schema};

/// The number of tiles of a block whose available ones are counted ahead.
const RANK_BLOCK_TILES: u64 = 512;
/// Header of a binary subtree: magic, version, and the lengths of JSON and binary chunk.
const HEADER_BYTES: usize = 24;

/// The numbers of an implicit tree that the lengths of bitstreams follow from.
#[derive(Clone, Copy, Debug)]
pub(super) struct SubtreeShape {
    pub subdivision: Subdivision,
    /// The number of levels of each subtree.
    pub levels: u32,
    /// The number of contents that a tile may have.
    pub contents: usize,
}

/// Whether each element of a set is available.
#[derive(Clone, Copy, Debug)]
enum Availability {
    /// All are, or none is.
    Constant(bool),
    /// A bit for each, lowest first.
    Bits {
        /// An index into [`Subtree::buffers`].
        buffer: usize,
        /// The byte of the first bit.
        start: usize,
    },
}

/// A subtree with the bits of its tiles.
#[derive(Debug)]
pub(super) struct Subtree {
    subdivision: Subdivision,
    /// The whole file, then the external buffers that were needed.
    buffers: Vec<Vec<u8>>,
    tiles: Availability,
    contents: Vec<Availability>,
    children: Availability,
    /// Columns of the tiles' metadata that replace volumes and errors; usually none.
    metadata: Vec<(Semantic, NumberColumn)>,
    /// The number of available tiles before each block of tiles; only with metadata.
    ranks: Vec<u32>,
}

impl Subtree {
    /// Parses a subtree file, binary or JSON. `companions` are the external buffers that [`external_buffers`] returned.
    pub fn parse(
        uri: &str,
        bytes: Vec<u8>,
        companions: &[Fetched],
        shape: SubtreeShape,
        schema: Option<&Schema>,
        options: &ReadOptions,
    ) -> Result<Self, IoError> {
        let bad = |reason: String| IoError::invalid(uri, format!("subtree: {reason}"));
        let chunks = Chunks::of(&bytes).map_err(&bad)?;
        let json: SubtreeJson = parse_json(chunks.json).map_err(&bad)?;
        let binary = chunks.binary.map(|binary| (HEADER_BYTES + chunks.json.len(), binary.len()));
        let needed = needed_buffers(&json, schema);
        let mut buffers = vec![bytes];
        // Index into `buffers`, first byte and length of each buffer that is needed.
        let mut places: Vec<Option<(usize, usize, usize)>> = vec![None; json.buffers.len()];
        for (buffer, place) in
            json.buffers.iter().zip(&mut places).enumerate().filter_map(|(i, of)| needed[i].then_some(of))
        {
            let external = match buffer.uri.0.as_deref() {
                None => {
                    *place = binary.map(|(start, length)| (0, start, length));
                    continue;
                }
                Some(reference) if reference.starts_with("data:") => embedded::data_uri(uri, reference)?,
                Some(reference) => {
                    let (address, _) = options.resolve(uri, reference)?;
                    let found = companions.iter().find(|(fetched, _)| *fetched == address);
                    let missing = || bad(format!("the external buffer {reference:.60} was not read"));
                    found.ok_or_else(missing)?.1.clone()?
                }
            };
            *place = Some((buffers.len(), 0, external.len()));
            buffers.push(external);
        }
        let availability = |of: Option<&AvailabilityJson>, what: &str, count: u64| -> Result<Availability, String> {
            let Some(of) = of else { return Ok(Availability::Constant(false)) };
            let Some(view) = of.view() else {
                let constant = of.constant().ok_or_else(|| format!("{what} has neither bitstream nor constant"))?;
                return Ok(Availability::Constant(constant));
            };
            let view = json.buffer_views.get(view).ok_or_else(|| format!("{what}: there is no bufferView {view}"))?;
            let place = places.get(view.buffer).copied().flatten();
            let (buffer, start, length) = place.ok_or_else(|| format!("{what}: there is no buffer {}", view.buffer))?;
            let needed = count.div_ceil(8);
            if view.byte_length < needed {
                return Err(format!("{what} has {} bytes, expected {needed}", view.byte_length));
            }
            let end = view.byte_offset.checked_add(needed).filter(|end| *end <= length as u64);
            end.ok_or_else(|| format!("{what} reaches beyond its buffer of {length} bytes"))?;
            Ok(Availability::Bits { buffer, start: start + view.byte_offset as usize })
        };
        let SubtreeShape { subdivision, levels, contents } = shape;
        let count = subdivision.tiles_above(levels);
        let tiles = availability(json.tile_availability.as_ref(), "tileAvailability", count).map_err(&bad)?;
        let content = json.content_availability().iter().take(contents);
        let contents = content.map(|of| availability(Some(of), "contentAvailability", count));
        let contents = contents.collect::<Result<Vec<_>, _>>().map_err(&bad)?;
        let below = subdivision.tiles_in(levels);
        let children = json.child_subtree_availability.as_ref();
        let children = availability(children, "childSubtreeAvailability", below).map_err(&bad)?;
        let table = schema.zip(json.tile_table());
        let properties = table.into_iter().flat_map(|(schema, table)| semantics::properties(table, schema));
        let metadata = properties.filter_map(|property| {
            let view = json.buffer_views.get(property.view)?;
            let (buffer, start, _) = places.get(view.buffer).copied().flatten()?;
            let start = start.checked_add(usize::try_from(view.byte_offset).ok()?)?;
            Some((property.semantic, semantics::column(&property, buffer, start)?))
        });
        let metadata: Vec<(Semantic, NumberColumn)> = metadata.collect();
        let mut subtree = Self { subdivision, buffers, tiles, contents, children, metadata, ranks: Vec::new() };
        if !subtree.metadata.is_empty() {
            subtree.ranks = subtree.count_ranks(count);
        }
        if !subtree.get(subtree.tiles, 0) {
            return Err(bad("its root tile is not available".to_owned()));
        }
        Ok(subtree)
    }

    /// Returns true if a tile of the subtree is available.
    pub fn has_tile(&self, tile: LocalTile) -> bool {
        self.get(self.tiles, tile.index(self.subdivision))
    }

    /// Returns true if a tile has its content with this number.
    pub fn has_content(&self, tile: LocalTile, content: usize) -> bool {
        let availability = self.contents.get(content).copied();
        availability.is_some_and(|of| self.get(of, tile.index(self.subdivision)))
    }

    /// Returns true if the subtree whose root is the tile `root`, one level below the last of this subtree, is available.
    pub fn has_child_subtree(&self, root: LocalTile) -> bool {
        self.get(self.children, root.morton)
    }

    /// Returns the values that an available tile has instead of those that follow from its position.
    pub fn overrides(&self, tile: LocalTile) -> Overrides {
        let mut overrides = Overrides::default();
        if !self.metadata.is_empty() {
            let row = self.rank(tile.index(self.subdivision));
            for (semantic, column) in &self.metadata {
                if let Some(value) = column.value(&self.buffers[column.buffer()], row) {
                    overrides.set(*semantic, &value);
                }
            }
        }
        overrides
    }

    /// Counts the available tiles before each block of [`RANK_BLOCK_TILES`], of `count` tiles in all.
    fn count_ranks(&self, count: u64) -> Vec<u32> {
        let Availability::Bits { buffer, start } = self.tiles else { return Vec::new() };
        let bits = self.buffers[buffer].get(start..).unwrap_or_default();
        let bits = &bits[..bits.len().min(count.div_ceil(8) as usize)];
        let mut before = 0;
        let mut ranks = Vec::with_capacity(bits.len().div_ceil((RANK_BLOCK_TILES / 8) as usize));
        for block in bits.chunks((RANK_BLOCK_TILES / 8) as usize) {
            ranks.push(before);
            before += ones(block);
        }
        ranks
    }

    /// Returns the number of available tiles before a tile: the row of its metadata.
    fn rank(&self, index: u64) -> u64 {
        let Availability::Bits { buffer, start } = self.tiles else { return index };
        let before = self.ranks.get((index / RANK_BLOCK_TILES) as usize).copied().unwrap_or(0);
        let first = start + (index / RANK_BLOCK_TILES * RANK_BLOCK_TILES / 8) as usize;
        let last = start + (index >> 3) as usize;
        let bytes = self.buffers[buffer].get(first..=last).unwrap_or_default();
        let Some((last, whole)) = bytes.split_last() else { return u64::from(before) };
        u64::from(before + ones(whole) + (last & ((1_u16 << (index & 7)) - 1) as u8).count_ones())
    }

    /// Returns the bytes of CPU memory.
    pub fn size_bytes(&self) -> u64 {
        self.buffers.iter().map(|buffer| buffer.capacity() as u64).sum::<u64>() + 4 * self.ranks.len() as u64
    }

    fn get(&self, of: Availability, index: u64) -> bool {
        match of {
            Availability::Constant(constant) => constant,
            Availability::Bits { buffer, start } => {
                let byte = self.buffers[buffer].get(start + (index >> 3) as usize);
                byte.is_some_and(|byte| byte >> (index & 7) & 1 == 1)
            }
        }
    }
}

/// Returns the number of bits that are set.
fn ones(bytes: &[u8]) -> u32 {
    bytes.iter().map(|byte| byte.count_ones()).sum()
}

/// Returns the references of the external buffers that a subtree needs, in order. A file that is no subtree has none.
pub(super) fn external_buffers(bytes: &[u8], schema: Option<&Schema>) -> Vec<String> {
    let json = Chunks::of(bytes).and_then(|chunks| parse_json(chunks.json));
    let Ok(json) = json else { return Vec::new() };
    let needed = needed_buffers(&json, schema);
    let references = json.buffers.into_iter().zip(needed).filter(|(_, needed)| *needed);
    references.filter_map(|(buffer, _)| buffer.uri.0.filter(|uri| !uri.starts_with("data:"))).collect()
}

/// Tells for each buffer whether availability is in it, or metadata that replaces volumes or errors.
fn needed_buffers(json: &SubtreeJson, schema: Option<&Schema>) -> Vec<bool> {
    let mut needed = vec![false; json.buffers.len()];
    let table = schema.zip(json.tile_table());
    let properties = table.into_iter().flat_map(|(schema, table)| semantics::properties(table, schema));
    let columns = properties.map(|property| property.view);
    let all = json.tile_availability.iter().chain(&json.child_subtree_availability).chain(json.content_availability());
    let views = all.filter_map(AvailabilityJson::view).chain(columns);
    for view in views.filter_map(|view| json.buffer_views.get(view)) {
        if let Some(needed) = needed.get_mut(view.buffer) {
            *needed = true;
        }
    }
    needed
}

/// The chunks of a subtree file.
struct Chunks<'a> {
    json: &'a [u8],
    /// `None` for a file of JSON alone.
    binary: Option<&'a [u8]>,
}

impl<'a> Chunks<'a> {
    fn of(bytes: &'a [u8]) -> Result<Self, String> {
        if !bytes.starts_with(b"subt") {
            let json = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
            return Ok(Self { json, binary: None });
        }
        let truncated = || "truncated header".to_owned();
        let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
        let long = |at: usize| bytes.get(at..at + 8).and_then(|b| b.try_into().ok()).map(u64::from_le_bytes);
        let version = word(4).ok_or_else(truncated)?;
        if version != 1 {
            return Err(format!("version {version}, expected 1"));
        }
        let (json, binary) = long(8).zip(long(16)).ok_or_else(truncated)?;
        let rest = &bytes[HEADER_BYTES..];
        let json_end = usize::try_from(json).ok().filter(|end| *end <= rest.len());
        let json_end = json_end.ok_or_else(|| format!("JSON of {json} bytes in a file of {}", bytes.len()))?;
        let (json, rest) = rest.split_at(json_end);
        let binary_end = usize::try_from(binary).ok().filter(|end| *end <= rest.len());
        let binary_end = binary_end.ok_or_else(|| format!("binary chunk of {binary} bytes, {} follow", rest.len()))?;
        Ok(Self { json, binary: Some(&rest[..binary_end]) })
    }
}

/// Parses JSON that spaces or zeros pad.
fn parse_json(json: &[u8]) -> Result<SubtreeJson, String> {
    let end = json.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    serde_json::from_slice(&json[..end]).map_err(|e| format!("JSON: {e}"))
}
