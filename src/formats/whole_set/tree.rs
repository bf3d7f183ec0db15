//! Reading the parts of tile trees one after another, as the pager does for single tiles. Blocking.

use std::sync::Arc;

use crate::fetch::{IoError, Loaded, Source, encoding};
use crate::formats::implicit::{SubtreePart, SubtreeSource};
use crate::formats::options::{Fetched, MAX_DEPENDENCY_ROUNDS, ReadOptions};
use crate::formats::read::{self, dependencies};
use crate::formats::terrain::{TerrainPage, TerrainTile};
use crate::formats::tile::{ContentBytes, ContentData, Tile, TileContent};
use crate::scene::ReaderData;

/// The kind of a tile's content, before it is read.
pub(super) enum Known<'a> {
    /// Levels of a subtree that was read.
    Part(&'a SubtreePart),
    /// A subtree file.
    Subtree(&'a SubtreeSource),
    /// A part of a terrain tree.
    #[cfg_attr(not(feature = "http"), allow(dead_code, reason = "the page is read to fill a cache"))]
    Terrain(&'a TerrainPage),
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
        if let Some(page) = data.and_then(ReaderData::value) {
            return Self::Terrain(page);
        }
        if data.and_then(ReaderData::value::<TerrainTile>).is_some_and(TerrainTile::is_in_memory) {
            return Self::Embedded;
        }
        match data.and_then(ReaderData::value::<ContentData>).map(|data| &data.bytes) {
            Some(ContentBytes::Refused(error)) => Self::Refused(error),
            Some(ContentBytes::Embedded(_)) => Self::Embedded,
            _ => Self::File,
        }
    }
}

/// Reads the file of a content: at its URI, or where else the server may have it.
pub(in crate::formats) fn load(from: &Source, uri: &str, reader_data: Option<&ReaderData>) -> Result<Loaded, IoError> {
    load_or(from, uri, reader_data.and_then(ReaderData::fallback_uri))
}

fn load_or(from: &Source, uri: &str, fallback: Option<Arc<str>>) -> Result<Loaded, IoError> {
    from.load(uri).or_else(|error| match fallback {
        Some(fallback) if error.may_be_elsewhere() => from.load(&fallback).map(|loaded| loaded.found_at(fallback)),
        _ => Err(error),
    })
}

/// Reads the files that a content needs, and adds the bytes that were read, and to the options where redirects led.
pub(in crate::formats) fn read_companions(
    from: &Source,
    uri: &Arc<str>,
    bytes: &[u8],
    reader_data: Option<&ReaderData>,
    options: &mut ReadOptions,
    bytes_read: &mut u64,
) -> Vec<Fetched> {
    let (mut companions, mut bases): (Vec<Fetched>, Vec<_>) = Default::default();
    for other in read::companions(uri, reader_data) {
        let read = load_or(from, &other, read::companion_fallback(&other, reader_data)).map(|loaded| {
            *bytes_read += loaded.bytes.len() as u64;
            bases.extend(loaded.location.map(|location| (other.clone(), location)));
            loaded.bytes
        });
        companions.push((other, read));
    }
    options.companion_bases = bases.into();
    let of = |read: &Result<Vec<u8>, IoError>| read.as_ref().map_or(0, |bytes| bytes.len() as u64);
    let mut got = bytes.len() as u64 + companions.iter().map(|(_, read)| of(read)).sum::<u64>();
    let limits = options.limits;
    let mut read_all = |others: Vec<Arc<str>>, companions: &mut Vec<Fetched>| {
        for other in others {
            // A file beyond the limit is missing, with its reason.
            let read = limits.check_files_of_content(uri, got).and_then(|()| from.read(&other));
            got += of(&read);
            *bytes_read += of(&read);
            let within = read.and_then(|bytes| limits.check_files_of_content(uri, got).map(|()| bytes));
            companions.push((other, within));
        }
    };
    for _ in 0..MAX_DEPENDENCY_ROUNDS {
        let others = dependencies(uri, bytes, reader_data, &companions, options);
        if others.is_empty() {
            break;
        }
        read_all(others, &mut companions);
    }
    companions
}

/// Reads a subtree file with its external buffers. Returns the root tile of the subtree, and adds the bytes that were read.
pub(super) fn read_subtree(
    from: &Source,
    content: &TileContent,
    source: &SubtreeSource,
    options: &ReadOptions,
    bytes_read: &mut u64,
) -> Result<Vec<Tile>, IoError> {
    let TileContent { uri, reader_data, .. } = content;
    let Loaded { bytes, location, .. } = load(from, uri, reader_data.as_ref())?;
    *bytes_read += bytes.len() as u64;
    let bytes = encoding::gunzip(uri, bytes, &options.limits)?;
    let options = ReadOptions { base: location, ..options.clone() };
    let mut buffers: Vec<Fetched> = Vec::new();
    for buffer in dependencies(uri, &bytes, reader_data.as_ref(), &[], &options) {
        let read = from.read(&buffer).inspect(|read| *bytes_read += read.len() as u64);
        buffers.push((buffer, read));
    }
    source.read(uri, bytes, &buffers, &options)
}
