//! [`TileContent`] and its reader data: what the reader of a tileset knows about a content beside its URI. Immutable; decode
//! threads.

use std::sync::Arc;

use super::up_axis::UpAxis;
use crate::fetch::IoError;
use crate::math::BoundingVolume;
use crate::scene::{ReaderData, ReaderValue, TileMetadata};

/// A content of a tile.
#[derive(Clone, Debug)]
pub(in crate::formats) struct TileContent {
    /// The absolute URI; only a name if the content is in memory.
    pub uri: Arc<str>,
    /// Data for the decoder of the content.
    pub reader_data: Option<ReaderData>,
    /// A volume around the content in the tileset's frame, if it has one that differs from the tile's.
    pub bounds: Option<BoundingVolume>,
    /// The metadata of the content and of its group, if it is kept.
    pub metadata: Option<Arc<TileMetadata>>,
}

impl TileContent {
    /// Returns a content that has neither bounds nor metadata.
    pub fn new(uri: Arc<str>, reader_data: Option<ReaderData>) -> Self {
        Self { uri, reader_data, bounds: None, metadata: None }
    }

    /// Returns true if nothing is fetched for the content.
    pub fn is_in_memory(&self) -> bool {
        self.reader_data.as_ref().is_some_and(ReaderData::is_whole_content)
    }

    /// Returns true if the content is a part of the tile's own tree.
    pub fn continues_tileset(&self) -> bool {
        self.reader_data.as_ref().is_some_and(ReaderData::continues_tileset)
    }

    /// Returns a content that fails with an error.
    pub fn refused(uri: Arc<str>, error: IoError) -> Self {
        let data = ContentData { bytes: ContentBytes::Refused(error), ..ContentData::default() };
        Self::new(uri, Some(ReaderData::of(data)))
    }
}

/// The location of the bytes of a content.
#[derive(Clone, Debug, Default)]
pub(in crate::formats) enum ContentBytes {
    /// At its URI.
    #[default]
    Fetched,
    /// In this `data:` URI.
    Embedded(Arc<str>),
    /// Nowhere: the tile was refused for this reason.
    Refused(IoError),
    /// At the URIs of several contents, which are drawn and replaced together.
    Several(Arc<[TileContent]>),
}

/// Reader data of a content that needs more than its URI.
#[derive(Clone, Debug, Default)]
pub(in crate::formats) struct ContentData {
    pub bytes: ContentBytes,
    pub up_axis: UpAxis,
    /// The URI at which the content is looked for if its own has none.
    pub fallback: Option<Arc<str>>,
    /// A volume around the content that is smaller than the tile's, for a tile with others below.
    pub bounds: Option<Box<BoundingVolume>>,
    /// The region of the tile, kept for raster overlays: west, south, east and north in radians.
    pub region: Option<[f64; 4]>,
}

/// Returns reader data with the region of its tile. That of other readers is returned as it is.
pub(in crate::formats) fn with_region(data: Option<ReaderData>, region: [f64; 4]) -> Option<ReaderData> {
    changed(data, |known| ContentData { region: Some(region), ..known })
}

/// Returns reader data with the volume of its content. That of other readers is returned as it is.
pub(super) fn with_bounds(data: Option<ReaderData>, bounds: BoundingVolume) -> Option<ReaderData> {
    changed(data, |known| ContentData { bounds: Some(Box::new(bounds)), ..known })
}

fn changed(data: Option<ReaderData>, change: impl FnOnce(ContentData) -> ContentData) -> Option<ReaderData> {
    let known = match &data {
        None => ContentData::default(),
        Some(of_reader) => match of_reader.value::<ContentData>() {
            Some(known) => known.clone(),
            None => return data,
        },
    };
    Some(ReaderData::of(change(known)))
}

impl ReaderValue for ContentData {
    fn is_whole_content(&self) -> bool {
        match &self.bytes {
            ContentBytes::Fetched => false,
            ContentBytes::Embedded(_) | ContentBytes::Refused(_) => true,
            ContentBytes::Several(contents) => contents.iter().all(TileContent::is_in_memory),
        }
    }

    fn fallback_uri(&self) -> Option<Arc<str>> {
        self.fallback.clone()
    }

    fn region(&self) -> Option<[f64; 4]> {
        self.region
    }

    fn content_bounds(&self) -> Option<&BoundingVolume> {
        self.bounds.as_deref()
    }

    fn size_bytes(&self) -> u64 {
        let bounds = self.bounds.as_ref().map_or(0, |_| size_of::<BoundingVolume>());
        let own = match &self.bytes {
            ContentBytes::Fetched => 0,
            ContentBytes::Embedded(text) => text.len() as u64,
            ContentBytes::Refused(error) => error.uri().len() as u64,
            ContentBytes::Several(contents) => contents.iter().map(|content| content.uri.len() as u64 + 40).sum(),
        };
        (size_of::<Self>() + bounds) as u64 + own
    }
}

/// Returns one content that is made of several.
pub(super) fn joined(contents: Vec<TileContent>) -> TileContent {
    // The content is fetched at the URI of the first that is not in memory, the others are its companions.
    let first = contents.iter().find(|content| !content.is_in_memory()).or(contents.first());
    let uri = first.map(|content| content.uri.clone()).unwrap_or_default();
    let fallback = first.and_then(|content| content.reader_data.as_ref()?.fallback_uri());
    let data = ContentData { bytes: ContentBytes::Several(contents.into()), fallback, ..ContentData::default() };
    TileContent::new(uri, Some(ReaderData::of(data)))
}
