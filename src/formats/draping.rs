//! The overlays of one content: what a loader fetches for it, and their part in its decoding. Decode and loading threads.

use std::sync::Arc;

use super::ignored::Notes;
use super::model_files::begins_like_tileset;
use super::options::{Content, Fetched, ReadOptions};
use super::osg::{self, InlinePart};
use super::overlay::{Draped, Extent, OverlaySet, drape_images, note_regions};
use super::terrain::TerrainTile;
use crate::fetch::markup::text_and_first_byte;
use crate::scene::{Node, ReaderData};

/// A content that is covered, with its overlays.
struct Covered<'a> {
    set: &'a OverlaySet,
    extent: Extent,
}

impl<'a> Covered<'a> {
    /// A file of OpenSceneGraph that is opened alone is where its geometry is.
    /// Returns `None` for contents that are tile trees, empty, or not on the body.
    fn new(bytes: &[u8], reader_data: Option<&ReaderData>, options: &'a ReadOptions) -> Option<Self> {
        let set = options.overlays.as_deref()?;
        let volume = options.tile.or_else(|| osg::own_volume(bytes, options))?;
        let is_in_memory = reader_data.is_some_and(ReaderData::is_whole_content);
        let (text, first) = text_and_first_byte(bytes);
        // The parts of an OSG file continue it, and are drawn.
        let is_part = reader_data.is_some_and(|data| data.value::<InlinePart>().is_some());
        let is_tree = (!is_part && reader_data.is_some_and(ReaderData::continues_tileset))
            || bytes.starts_with(b"subt")
            || (first == Some(b'{') && begins_like_tileset(text));
        if is_tree || (bytes.is_empty() && !is_in_memory) {
            return None;
        }
        let is_height = bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]);
        Some(Self { set, extent: Extent::new(&volume, reader_data, is_height, &options.ellipsoid)? })
    }
}

/// Returns the documents and images that the overlays of a content need next; see [`OverlaySet`].
pub(super) fn needed(
    bytes: &[u8],
    reader_data: Option<&ReaderData>,
    known: &[Fetched],
    options: &ReadOptions,
) -> Vec<Arc<str>> {
    let covered = Covered::new(bytes, reader_data, options);
    covered.map_or(Vec::new(), |of| of.set.needed(&of.extent, known, &options.limits))
}

/// The overlays of a content that is being decoded, with their images.
pub(super) struct Draping {
    /// The extent and the images; `None` for a content that is not covered.
    covered: Option<(Extent, Vec<Fetched>)>,
    /// True if surfaces stay as smooth as they are below images: those of terrain, which has water.
    keeps_reflection: bool,
}

impl Draping {
    /// Takes copies of the images among the companions of a content. Returns `None` without overlays.
    pub fn new(content: &Content, options: &ReadOptions) -> Option<Self> {
        options.overlays.as_ref()?;
        let covered = Covered::new(&content.bytes, content.reader_data.as_ref(), options);
        let covered =
            covered.map(|Covered { set, extent }| (extent, set.fetched(&extent, &content.companions, &options.limits)));
        let data = content.reader_data.as_ref();
        let keeps_reflection = data.is_some_and(|data| data.value::<TerrainTile>().is_some());
        Some(Self { covered, keeps_reflection })
    }

    /// Covers the drawables of the content, and keeps the regions of its tiles.
    pub fn apply(self, node: &mut Node, options: &ReadOptions, notes: &Notes) {
        note_regions(node);
        let Self { covered, keeps_reflection } = self;
        if let (Some((extent, images)), Some(set)) = (covered, &options.overlays) {
            let to =
                Draped { set_from_content: options.set_from_content, ellipsoid: options.ellipsoid, keeps_reflection };
            drape_images(node, set, &extent, &images, to, &options.limits, notes);
        }
    }
}
