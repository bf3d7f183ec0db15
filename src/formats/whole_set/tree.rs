//! Reading the parts of tile trees one after another, as the pager does for single tiles. Blocking.

use std::sync::Arc;

use crate::fetch::{IoError, encoding};
use crate::formats::implicit::{SubtreePart, SubtreeSource};
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::read::dependencies;
use crate::formats::tile::{ContentBytes, ContentData, Tile, TileContent};
use crate::scene::ReaderData;

/// What a content of a tile is, before it is read.
pub(super) enum Known<'a> {
    /// Levels of a subtree that was read.
    Part(&'a SubtreePart),
    /// A subtree file.
    Subtree(&'a SubtreeSource),
    /// A content that cannot be loaded.
    Refused(&'a IoError),
    /// A content in the tileset itself.
    Embedded,
    /// A file.
    File,
}

impl<'a> Known<'a> {
    pub fn of(content: &'a TileContent) -> Self {
        let data = content.reader_data.as_ref();
        if let Some(part) = data.and_then(ReaderData::value) {
            return Self::Part(part);
        }
        if let Some(source) = data.and_then(ReaderData::value) {
            return Self::Subtree(source);
        }
        match data.and_then(ReaderData::value::<ContentData>).map(|data| &data.bytes) {
            Some(ContentBytes::Refused(error)) => Self::Refused(error),
            Some(ContentBytes::Embedded(_)) => Self::Embedded,
            _ => Self::File,
        }
    }
}

/// Reads a subtree file with its external buffers. `read` returns the bytes of a URI. Returns the root tile of the subtree.
pub(super) fn read_subtree(
    content: &TileContent,
    source: &SubtreeSource,
    options: &ReadOptions,
    mut read: impl FnMut(&Arc<str>) -> Result<Vec<u8>, IoError>,
) -> Result<Vec<Tile>, IoError> {
    let bytes = encoding::gunzip(&content.uri, read(&content.uri)?, &options.limits)?;
    let buffers = dependencies(&content.uri, &bytes, content.reader_data.as_ref(), options);
    let buffers: Vec<Fetched> = buffers.into_iter().map(|uri| (uri.clone(), read(&uri))).collect();
    source.read(&content.uri, bytes, buffers)
}
