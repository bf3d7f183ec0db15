//! [`Subtree`]: which tiles, contents and child subtrees a subtree file has. Decode threads.
//!
//! The bits and the metadata stay as they are in the file, and a lookup costs one byte. A subtree of 12 levels has 5.6
//! million tiles, and few are ever looked at.

use std::sync::Arc;

use super::availability::Availability;
use super::coordinates::{LocalTile, Subdivision};
use super::json::{AvailabilityJson, SubtreeJson};
use super::metadata::{MetadataRows, SemanticNamed};
use super::semantics::{CONTENT_GROUP_ID, CONTENT_URI, Overrides, Semantic, VolumeOverrides, is_without_effect};
use crate::fetch::{IoError, about_to_allocate};
use crate::formats::embedded;
use crate::formats::ignored::Notes;
use crate::formats::lenient::from_json;
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::properties::{ClassProperty, Entities, Schema, SharedBytes, TableJson, TableSource};
use crate::scene::Metadata;

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

/// The metadata of a tile's content, and the properties that have an effect.
#[derive(Clone, Debug, Default)]
pub(super) struct ContentRow {
    /// All values, if they are kept.
    pub metadata: Option<Arc<Metadata>>,
    /// The reference of the content, relative to the tileset.
    pub uri: Option<String>,
    /// The index of the group.
    pub group: Option<usize>,
    pub volume: VolumeOverrides,
    /// True if a value of the volume was invalid.
    pub has_invalid: bool,
}

/// A subtree with the bits of its tiles.
#[derive(Debug)]
pub(super) struct Subtree {
    subdivision: Subdivision,
    tiles: Availability,
    contents: Vec<Availability>,
    children: Availability,
    /// The metadata of the tiles, or only what replaces volumes and errors.
    tile_rows: Option<MetadataRows>,
    /// The metadata of the contents, by the number of the content.
    content_rows: Vec<Option<MetadataRows>>,
    /// All metadata is wanted.
    keeps_metadata: bool,
    metadata: Option<Arc<Metadata>>,
    /// The bytes of the file and of the external buffers.
    buffer_bytes: u64,
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
        options.limits.check_json(uri, chunks.json)?;
        let json: SubtreeJson = parse_json(chunks.json).map_err(&bad)?;
        let binary = chunks.binary.map(|binary| (HEADER_BYTES + chunks.json.len(), binary.len()));
        let keeps_metadata = options.keep_features;
        let needed = needed_buffers(&json, schema, keeps_metadata);
        // Metadata that replaces nothing may be missing.
        let required = needed_buffers(&json, schema, false);
        let notes = Notes::default();
        let file = Arc::new(bytes);
        let mut buffer_bytes = file.capacity() as u64;
        // The bytes of each buffer that is needed.
        let mut buffers: Vec<Option<SharedBytes>> = vec![None; json.buffers.len()];
        for (i, (buffer, place)) in json.buffers.iter().zip(&mut buffers).enumerate().filter(|(i, _)| needed[*i]) {
            let Some(reference) = buffer.uri.0.as_deref() else {
                *place = binary.and_then(|(start, length)| SharedBytes::part(&file, start..start + length));
                continue;
            };
            match external_buffer(uri, reference, companions, options) {
                Ok(bytes) => {
                    buffer_bytes += bytes.capacity() as u64;
                    *place = Some(bytes.into());
                }
                Err(error) if required[i] || error.is_transient() => return Err(error),
                Err(_) => notes.add("metadata: a buffer of a subtree that is missing"),
            }
        }
        let availability = |of: Option<&AvailabilityJson>, what: &str, count: u64| -> Result<Availability, String> {
            let Some(of) = of else { return Ok(Availability::Constant(false)) };
            let Some(view) = of.view() else {
                let constant = of.constant().ok_or_else(|| format!("{what} has neither bitstream nor constant"))?;
                return Ok(Availability::Constant(constant));
            };
            let view = json.buffer_views.get(view).ok_or_else(|| format!("{what}: there is no bufferView {view}"))?;
            let buffer = buffers.get(view.buffer).and_then(Option::as_ref);
            let buffer = buffer.ok_or_else(|| format!("{what}: there is no buffer {}", view.buffer))?;
            let needed = count.div_ceil(8);
            if view.byte_length < needed {
                return Err(format!("{what} has {} bytes, expected {needed}", view.byte_length));
            }
            let bits = buffer.range(view.byte_offset, needed);
            bits.map(Availability::Bits)
                .ok_or_else(|| format!("{what} reaches beyond its buffer of {} bytes", buffer.len()))
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
        if !tiles.has(0) {
            return Err(bad("its root tile is not available".to_owned()));
        }
        let mut subtree = Self {
            subdivision,
            tiles,
            contents,
            children,
            tile_rows: None,
            content_rows: Vec::new(),
            keeps_metadata,
            metadata: None,
            buffer_bytes,
        };
        let view = |view: usize| {
            let view = json.buffer_views.get(view)?;
            buffers.get(view.buffer)?.as_ref()?.range(view.byte_offset, view.byte_length)
        };
        if json.has_metadata_of_1_0() {
            notes.add("metadata of a subtree by the extension 3DTILES_metadata");
        }
        match schema {
            Some(schema) => subtree.read_metadata(&json, schema, &view, &notes),
            None if json.property_tables.is_empty() => {}
            None => notes.add("metadata: property tables of a subtree without a schema"),
        }
        options.ignored.add(&notes.into_ignored());
        Ok(subtree)
    }

    /// Reads the tables of tiles and contents, and the metadata of the subtree.
    fn read_metadata(
        &mut self,
        json: &SubtreeJson,
        schema: &Schema,
        view: &dyn Fn(usize) -> Option<SharedBytes>,
        notes: &Notes,
    ) {
        let note = |kind: &'static str| notes.add(kind);
        let source = TableSource::new(schema, view, &note);
        let keeps_all = self.keeps_metadata;
        let rows = |table: Option<&TableJson>, of: &Availability, is_wanted: IsWanted, named: SemanticNamed| {
            let table = table?;
            let semantics = table.known(schema).filter_map(|(of, _)| of.semantic.0.as_deref());
            for semantic in semantics.filter(|semantic| is_without_effect(semantic)) {
                notes.add(format!("metadata semantic {semantic}"));
            }
            let read = source.table(table, &|property| keeps_all || is_wanted(property));
            MetadataRows::new(read, of, named)
        };
        self.tile_rows = rows(json.tile_table(), &self.tiles, replaces_tile, Semantic::of_tile);
        let contents = self.contents.iter().enumerate();
        let of_content = |(i, of)| rows(json.content_table(i), of, replaces_content, Semantic::of_content);
        self.content_rows = contents.map(of_content).collect();
        if let Some(metadata) = json.subtree_metadata.as_ref().filter(|_| keeps_all) {
            self.metadata = Entities::new(schema).read(metadata, &note);
        }
    }

    /// Returns the metadata of the subtree itself, if it is kept.
    pub fn metadata(&self) -> Option<&Arc<Metadata>> {
        self.metadata.as_ref()
    }

    /// Returns true if a tile of the subtree is available.
    pub fn has_tile(&self, tile: LocalTile) -> bool {
        self.tiles.has(tile.index(self.subdivision))
    }

    /// Returns true if a tile has its content with this number.
    pub fn has_content(&self, tile: LocalTile, content: usize) -> bool {
        self.contents.get(content).is_some_and(|of| of.has(tile.index(self.subdivision)))
    }

    /// Returns true if the subtree whose root is the tile `root`, one level below the last of this subtree, is available.
    pub fn has_child_subtree(&self, root: LocalTile) -> bool {
        self.children.has(root.morton)
    }

    /// Returns what an available tile has instead of what follows from its position, and its metadata if that is kept.
    pub fn tile_row(&self, tile: LocalTile) -> (Overrides, Option<Arc<Metadata>>) {
        let Some(rows) = &self.tile_rows else { return Default::default() };
        let row = rows.row(&self.tiles, tile.index(self.subdivision));
        (rows.overrides(row), self.keeps_metadata.then(|| rows.metadata(row)).flatten())
    }

    /// Returns what the metadata of an available content says.
    pub fn content_row(&self, tile: LocalTile, content: usize) -> ContentRow {
        let rows = self.content_rows.get(content).and_then(Option::as_ref);
        let Some((rows, of)) = rows.zip(self.contents.get(content)) else { return ContentRow::default() };
        let row = rows.row(of, tile.index(self.subdivision));
        let overrides = rows.overrides(row);
        let group = rows.value(CONTENT_GROUP_ID, row).and_then(|group| group.as_f64());
        ContentRow {
            metadata: self.keeps_metadata.then(|| rows.metadata(row)).flatten(),
            uri: rows.value(CONTENT_URI, row).and_then(|uri| uri.as_str().map(str::to_owned)),
            group: group.filter(|group| *group >= 0.0).map(|group| group as usize),
            volume: overrides.volume,
            has_invalid: overrides.has_invalid,
        }
    }

    /// Returns the bytes of CPU memory.
    pub fn size_bytes(&self) -> u64 {
        let rows = self.tile_rows.iter().chain(self.content_rows.iter().flatten());
        self.buffer_bytes + rows.map(MetadataRows::size_bytes).sum::<u64>()
    }
}

/// Returns the bytes of an external buffer, or those in a `data:` URI.
fn external_buffer(
    uri: &str,
    reference: &str,
    companions: &[Fetched],
    options: &ReadOptions,
) -> Result<Vec<u8>, IoError> {
    if reference.starts_with("data:") {
        return embedded::data_uri(uri, reference);
    }
    let (address, _) = options.resolve(uri, reference)?;
    let found = companions.iter().find(|(fetched, _)| *fetched == address);
    let missing = || format!("subtree: the external buffer {reference:.60} was not read");
    let (_, read) = found.ok_or_else(|| IoError::invalid(uri, missing()))?;
    // Each buffer has a copy, and all may refer to one file.
    if let Ok(bytes) = read {
        about_to_allocate(bytes.len() as u64).map_err(|error| error.at(uri))?;
    }
    read.clone()
}

/// Returns true for a property that is read even if metadata is not kept.
type IsWanted = fn(&ClassProperty) -> bool;

/// Returns true for a property of tiles that replaces what follows from their position.
fn replaces_tile(property: &ClassProperty) -> bool {
    property.semantic.0.as_deref().and_then(Semantic::of_tile).is_some()
}

/// Returns true for a property of contents that replaces their reference or volume.
fn replaces_content(property: &ClassProperty) -> bool {
    let semantic = property.semantic.0.as_deref();
    semantic.is_some_and(|semantic| semantic == CONTENT_URI || Semantic::of_content(semantic).is_some())
}

/// Returns the references of the external buffers that a subtree needs, in order. A file that is no subtree has none.
pub(super) fn external_buffers(bytes: &[u8], schema: Option<&Schema>, options: &ReadOptions) -> Vec<String> {
    let text = Chunks::of(bytes).ok().map(|chunks| chunks.json);
    // The decoder returns the error.
    let text = text.filter(|text| options.limits.check_json("", text).is_ok());
    let Some(Ok(json)) = text.map(parse_json) else { return Vec::new() };
    let needed = needed_buffers(&json, schema, options.keep_features);
    let references = json.buffers.into_iter().zip(needed).filter(|(_, needed)| *needed);
    references.filter_map(|(buffer, _)| buffer.uri.0.filter(|uri| !uri.starts_with("data:"))).collect()
}

/// Tells for each buffer whether availability is in it, or metadata that is read.
fn needed_buffers(json: &SubtreeJson, schema: Option<&Schema>, keeps_metadata: bool) -> Vec<bool> {
    let mut needed = vec![false; json.buffers.len()];
    let all = json.tile_availability.iter().chain(&json.child_subtree_availability).chain(json.content_availability());
    let mut views: Vec<usize> = all.filter_map(AvailabilityJson::view).collect();
    let contents =
        (0..json.content_availability().len()).map(|i| (json.content_table(i), replaces_content as IsWanted));
    for (table, is_wanted) in contents.chain([(json.tile_table(), replaces_tile as IsWanted)]) {
        let Some((schema, table)) = schema.zip(table) else { continue };
        let wanted = table.known(schema).filter(|(of, _)| keeps_metadata || is_wanted(of));
        views.extend(wanted.flat_map(|(_, property)| property.views()));
    }
    for view in views.iter().filter_map(|view| json.buffer_views.get(*view)) {
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
    from_json(&json[..end]).map_err(|e| format!("JSON: {e}"))
}
