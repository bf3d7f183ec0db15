//! [`ReadOptions`] and [`Content`]: the input of all decoders. And [`ContentReader`], for formats of an application's own.
//! Shared by all decode threads.

use std::sync::Arc;

use glam::DAffine3;

use super::ignored::IgnoredLog;
use super::image::ImageFiles;
use super::osg::ReadAhead;
use super::overlay::OverlaySet;
use super::style::Style;
use super::tile::{TileVolume, UpAxis};
use crate::fetch::{IoError, Limits, RootScope, resolve, shown};
use crate::math::{Ellipsoid, WGS84};
use crate::scene::{BlockFormats, Node, ReaderData, SharedStateManager};

/// The maximum number of times that a loader asks for further dependencies of a content: an i3dm refers to a model, and the
/// model to its buffers.
/// An overlay may have a document, and asks for a few coarser levels where images are missing.
pub(crate) const MAX_DEPENDENCY_ROUNDS: usize = 10;

/// Options that all reads of a tile set share. More than 16 fields: one for each option.
#[derive(Clone, Debug)]
pub struct ReadOptions {
    /// The URIs that references may lead to.
    pub root: RootScope,
    /// Upper limits on the data.
    pub limits: Limits,
    /// URIs of the tilesets above, root first. A tileset that refers to one of them would be a cycle.
    pub chain: Arc<[Arc<str>]>,
    /// Maps the content to the frame of the whole set: the product of the transforms of all tiles above. It is needed for
    /// regions, which transforms do not move.
    pub set_from_content: DAffine3,
    /// The ellipsoid that regions and heights refer to: WGS84 by default. A root tileset with 3DTILES_ellipsoid has its own, and
    /// so has what it refers to.
    pub ellipsoid: Ellipsoid,
    /// Builds a [`KdTree`](crate::scene::KdTree) for each drawable, so that lines and volumes can be intersected with it after
    /// its payload has moved to the GPU. Off by default, since it costs memory and time of the decode workers.
    pub build_kd_trees: bool,
    /// Names of additional glTF attributes that meshes keep for [`Program`](crate::state::Program)s, such as `TANGENT`,
    /// `TEXCOORD_1`, `_HEAT`. None by default, since they take memory. The columns of a matrix `_BASIS` are kept as `_BASIS_0`,
    /// `_BASIS_1` and so on. A glTF with a mesh of more than [`MAX_ATTRIBUTES`](crate::scene::MAX_ATTRIBUTES) fails.
    pub vertex_attributes: Arc<[Arc<str>]>,
    /// The URL that relative references of the content are resolved against: where redirects led. `None` is its own URI.
    pub base: Option<Arc<str>>,
    /// The companions of the content that redirects led elsewhere, by their URI, and the URL that relative references of each
    /// are resolved against.
    pub companion_bases: Arc<[(Arc<str>, Arc<str>)]>,
    /// The axis of glTF contents that points up. Decoders set it by the tileset that a content belongs to.
    pub gltf_up_axis: UpAxis,
    /// Keeps the feature ids of glTF, b3dm and i3dm with their property tables, for
    /// [`Page::features`](crate::scene::Page::features), and the metadata of tilesets, tiles, contents and groups, for
    /// [`Scene::metadata`](crate::scene::Scene::metadata). Off by default, since they take memory.
    pub keep_features: bool,
    /// The compressed formats that the adapter samples; none by default. KTX2 images are transcoded to one of them, or to
    /// RGBA8 without any. A pager sets those that all of its contexts have
    /// ([`CompileContext::block_formats`](crate::pager::CompileContext::block_formats)).
    pub block_formats: BlockFormats,
    /// Colours, hides and sizes the features of contents while they are read; `None` by default. Contents that were read keep
    /// their style; see the guide for a change at run time.
    pub style: Option<Arc<Style>>,
    /// Computes the [`NormalCone`](crate::scene::NormalCone) of single-sided meshes, by which culls leave out those that show
    /// only their backs. On by default; it reads each triangle twice, some 30 ns.
    pub cluster_culling: bool,
    /// Readers of an application's own formats. Each content is offered to them in their order before the built-in readers.
    pub readers: Arc<[Arc<dyn ContentReader>]>,
    /// Attributions that belong to every content, beside those that contents name themselves: those of a service.
    pub credits: Arc<[Arc<str>]>,
    /// Shares equal images, meshes and states between contents; `None` by default. A pager sets its own.
    pub sharing: Option<Arc<SharedStateManager>>,
    /// Overlays that are draped over contents of tiles on the earth; `None` by default. They need [`Self::tile`].
    pub overlays: Option<Arc<OverlaySet>>,
    /// The volume of the tile that a content is for, which overlays need. Pagers set it.
    pub tile: Option<TileVolume>,
    /// Keeps the files of the images that are decoded; `None` by default.
    pub image_files: Option<ImageFiles>,
    /// Keeps what [`dependencies`](super::dependencies) has parsed of a content until it is decoded. A loader that loads
    /// several contents at a time gives each a new one.
    pub read_ahead: ReadAhead,
    /// Collects what contents ask for and their readers leave out. Copies of these options share it.
    pub ignored: IgnoredLog,
}

impl ReadOptions {
    /// Returns options for a tile set whose root is `root_uri`, as [`root_uri`](crate::fetch::root_uri) returned it.
    pub fn for_root(root_uri: &str, limits: Limits) -> Self {
        Self {
            root: RootScope::of_set(root_uri, &limits),
            limits,
            chain: Arc::new([]),
            set_from_content: DAffine3::IDENTITY,
            ellipsoid: WGS84,
            build_kd_trees: false,
            vertex_attributes: Arc::default(),
            base: None,
            companion_bases: Arc::default(),
            gltf_up_axis: UpAxis::Y,
            keep_features: false,
            block_formats: BlockFormats::NONE,
            style: None,
            cluster_culling: true,
            readers: Arc::new([]),
            credits: Arc::new([]),
            sharing: None,
            overlays: None,
            tile: None,
            image_files: None,
            read_ahead: ReadAhead::default(),
            ignored: IgnoredLog::default(),
        }
    }

    /// Returns the options for the files that a tileset refers to.
    pub fn below(&self, tileset_uri: &Arc<str>) -> Self {
        let chain: Vec<Arc<str>> = self.chain.iter().cloned().chain([tileset_uri.clone()]).collect();
        Self { chain: chain.into(), base: None, companion_bases: Arc::default(), ..self.clone() }
    }
}

impl ReadOptions {
    /// Returns the URL that relative references of a companion are resolved against, if redirects led to another one.
    pub(super) fn companion_base(&self, uri: &str) -> Option<&Arc<str>> {
        self.companion_bases.iter().find(|(companion, _)| **companion == *uri).map(|(_, base)| base)
    }

    /// Resolves a reference in the file `uri`: against where redirects led, if they did. The second value is what the
    /// reference means relative to `uri` itself, if that is another file: servers that redirect to signed URLs expect it.
    pub(crate) fn resolve(&self, uri: &str, reference: &str) -> Result<(Arc<str>, Option<Arc<str>>), IoError> {
        let plain = resolve(uri, reference, &self.root);
        // The reference alone does not tell which file has it.
        let named = |error: IoError| IoError::Uri {
            uri: error.uri().to_owned(),
            reason: format!("{} (a reference in {})", error.reason(), shown(uri)),
        };
        match &self.base {
            None => Ok((plain.map_err(named)?, None)),
            Some(base) => {
                let moved = resolve(base, reference, &self.root).map_err(named)?;
                let fallback = plain.ok().filter(|plain| *plain != moved);
                Ok((moved, fallback))
            }
        }
    }
}

/// Reads contents of an application's own format; the counterpart of a `ReaderWriter` plugin of OSG's `osgDB`. Decode threads
/// call it, several at the same time. If it panics, only that content fails.
///
/// A tile set's root may be such a content, and its nodes may be [`PagedLod`](crate::scene::PagedLod)s that refer to others.
pub trait ContentReader: std::fmt::Debug + Send + Sync {
    /// Returns true if this reader reads a content. `bytes` are as received, but decompressed if they were a gzip file.
    fn accepts(&self, uri: &str, bytes: &[u8]) -> bool;

    /// Returns references to other files that the content needs, such as images, relative to its address. They are fetched
    /// before [`Self::read`] is called. None by default.
    fn references(&self, uri: &str, bytes: &[u8]) -> Vec<String> {
        let _ = (uri, bytes);
        Vec::new()
    }

    /// Returns the bytes of memory that [`Self::read`] is about to allocate, as far as the content tells, such as by its header. A
    /// content that needs more than is free waits until it is its turn: one such content at a time is read and held until its page
    /// is in use. One that needs more than [`Limits::max_content_bytes`] fails before it is read. The default is 0: what the reader
    /// allocates is not counted then.
    fn decoded_bytes(&self, uri: &str, bytes: &[u8]) -> u64 {
        let _ = (uri, bytes);
        0
    }

    /// Reads a content. `files` are the files of its references, by their URI. Positions are in the frame of the tile.
    ///
    /// # Errors
    /// The reason why the content is invalid. It is reported with the URI, and the tile counts as failed.
    fn read(&self, uri: &str, bytes: &[u8], files: &[Fetched], options: &ReadOptions) -> Result<Node, String>;
}

impl ReadOptions {
    /// Returns the application's reader of a content, if one accepts it.
    pub(super) fn reader_of(&self, uri: &str, bytes: &[u8]) -> Option<&dyn ContentReader> {
        self.readers.iter().find(|reader| reader.accepts(uri, bytes)).map(|reader| &**reader)
    }
}

/// A URI and its bytes, or the reason why they could not be read.
pub type Fetched = crate::fetch::Fetched;

/// The bytes of one content and of its companions.
#[derive(Clone, Debug)]
pub struct Content {
    /// The URI of the bytes.
    pub uri: Arc<str>,
    /// The bytes as read. The decoder decompresses gzip.
    pub bytes: Vec<u8>,
    /// Data that the reader of the tileset attached to the tile for the decoder of its content.
    pub reader_data: Option<ReaderData>,
    /// The files that [`companions`](super::companions) returned, then those that [`dependencies`](super::dependencies)
    /// returned.
    pub companions: Vec<Fetched>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fetch::{ByteBudget, LargeContents, Limits};
    use crate::formats::read::decode;

    /// Reads nothing from contents whose first byte is the number of bytes that they take.
    #[derive(Debug)]
    struct Sized;

    impl ContentReader for Sized {
        fn accepts(&self, uri: &str, _bytes: &[u8]) -> bool {
            uri.ends_with(".sized")
        }

        fn decoded_bytes(&self, _uri: &str, bytes: &[u8]) -> u64 {
            bytes[0].into()
        }

        fn read(&self, _uri: &str, _bytes: &[u8], _files: &[Fetched], _options: &ReadOptions) -> Result<Node, String> {
            Ok(Node::group(Vec::new()))
        }
    }

    /// Regression: what the readers of an application allocate did not count in the budget of loads.
    #[test]
    fn memory_of_own_readers_counts_in_the_budget() {
        let (budget, large) = (ByteBudget::new(1000), LargeContents::default());
        let options = ReadOptions {
            readers: Arc::new([Arc::new(Sized)]),
            ..ReadOptions::for_root("/set/root.sized", Limits::default())
        };
        let content =
            Content { uri: "/set/tile.sized".into(), bytes: vec![200], reader_data: None, companions: Vec::new() };
        let (page, memory) = large.decode(budget.hold(10), || decode(content, &options));
        assert!(page.is_ok(), "{page:?}");
        assert!((200..=210).contains(&budget.total().bytes), "{}", budget.total().bytes);
        drop(memory);
        assert_eq!(budget.total().bytes, 0);
    }
}
