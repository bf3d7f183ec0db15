//! [`ContentWriter`]: reads the content of an item, and writes what it draws as a glb. Worker threads, one each.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::items::{Item, ItemContent, Split, Splitter};
use super::report::{ConvertError, ConvertOptions, Counts};
use crate::fetch::{IoError, Loaded, Source, guarded};
use crate::formats::ignored::Notes;
use crate::formats::image::ImageFiles;
use crate::formats::options::{Content, ReadOptions};
use crate::formats::read::decode_whole;
use crate::formats::terrain::TerrainPage;
use crate::formats::tile::Body;
use crate::formats::whole_set::{load, read_companions};
use crate::formats::writers::{Leaf, Model, write_model};
use crate::math::Aabb;
use crate::scene::ReaderData;

/// A content farther from the origin of its tile gets an origin of its own, since viewers have positions as `f32`.
const MAX_OFFSET_M: f64 = 1e5;

/// Reads and writes the contents of one set.
pub(super) struct ContentWriter<'a> {
    pub from: Source,
    pub out: &'a Path,
    pub options: &'a ConvertOptions,
}

/// The result of reading an item.
pub(super) struct ReadContent {
    pub split: Split,
    /// Maps what is drawn to the frame of the set.
    pub set_from_model: DAffine3,
    pub files: ImageFiles,
    pub credits: Vec<Arc<str>>,
    /// The body that a root tileset declares.
    pub body: Option<Body>,
    /// The options for the files below.
    pub below: Arc<ReadOptions>,
}

/// A content that was written.
pub(super) struct Written {
    pub set_from_tile: DAffine3,
    /// The box around it in the frame of the tile.
    pub bounds: Aabb,
    /// The name of the file.
    pub file: String,
    pub bytes: u64,
    pub source: Counts,
    pub written: Counts,
}

/// The reason why a content has no file.
pub(super) enum ContentError {
    /// The content is left out.
    Broken(IoError),
    /// The output cannot be written.
    Fatal(ConvertError),
}

impl ContentWriter<'_> {
    /// Reads the content of an item.
    pub fn read(&self, item: &mut Item, options: &Arc<ReadOptions>, notes: &Notes) -> Result<ReadContent, IoError> {
        let set_from_item = item.set_from_item;
        let mut read = ReadContent {
            split: Split::default(),
            set_from_model: set_from_item,
            files: options.image_files.clone().unwrap_or_default(),
            credits: Vec::new(),
            body: None,
            below: options.clone(),
        };
        let (uri, data, item_from_content) = match std::mem::replace(&mut item.content, ItemContent::Nothing) {
            ItemContent::Nothing => return Ok(read),
            ItemContent::Inline(leaves) => {
                read.split.leaves = leaves;
                return Ok(read);
            }
            ItemContent::File { uri, reader_data, item_from_content } => (uri, reader_data, item_from_content),
        };
        let data = data.as_ref();
        let is_endless = data.and_then(ReaderData::value::<TerrainPage>).is_some_and(TerrainPage::is_ellipsoid);
        if is_endless {
            notes.add("terrain without a file: the ellipsoid");
            return Ok(read);
        }
        let is_in_memory = data.is_some_and(ReaderData::is_whole_content);
        let Loaded { bytes, location, is_no_content, .. } =
            if is_in_memory { Loaded::default() } else { load(&self.from, &uri, data)? };
        if is_no_content && !data.is_some_and(ReaderData::needs_content) {
            return Ok(read);
        }
        read.files = ImageFiles::default();
        read.set_from_model = set_from_item * item_from_content;
        let mut options = ReadOptions {
            base: location,
            set_from_content: read.set_from_model,
            image_files: Some(read.files.clone()),
            ..(**options).clone()
        };
        let companions = read_companions(&self.from, &uri, &bytes, data, &mut options, &mut 0);
        let content = Content { uri: uri.clone(), bytes, reader_data: data.cloned(), companions };
        let decoded = guarded(&uri, || decode_whole(content, &options))?;
        let splitter = Splitter { px_per_radian: self.options.px_per_radian, notes };
        read.split = splitter.split(decoded.node, read.set_from_model, &item.name, item.children.len());
        read.credits = decoded.credits;
        if let Some(body) = decoded.body {
            options.ellipsoid = body.ellipsoid();
            read.body = Some(body);
        }
        let is_same_tree = data.is_some_and(ReaderData::continues_tileset);
        read.below = Arc::new(if is_same_tree { options } else { options.below(&uri) });
        Ok(read)
    }

    /// Writes what a content draws as the file of an item.
    pub fn write(
        &self,
        name: &str,
        uri: &str,
        mut leaves: Vec<Leaf>,
        read: &ReadContent,
        notes: &Notes,
    ) -> Result<Written, ContentError> {
        let mut set_from_tile = read.set_from_model;
        let first = leaves.first().map_or(DVec3::ZERO, |leaf| leaf.model_from_drawable.translation);
        if first.length() > MAX_OFFSET_M {
            set_from_tile *= DAffine3::from_translation(first);
            leaves.iter_mut().for_each(|leaf| leaf.model_from_drawable.translation -= first);
        }
        let boxes = leaves.iter().map(|leaf| leaf.shape.bounds().transformed(&leaf.model_from_drawable));
        let bounds = boxes.fold(Aabb::EMPTY, |all, one| all.union(&one));
        let is_finite = bounds.min.is_finite() && bounds.max.is_finite();
        let broken = |reason: String| ContentError::Broken(IoError::invalid(uri, reason));
        if !is_finite || !set_from_tile.is_finite() {
            return Err(broken("positions that are not finite".to_owned()));
        }
        let mut source = Counts::default();
        source.add(&leaves);
        let model = Model {
            leaves: &leaves,
            files: read.files.clone(),
            credits: &read.credits,
            is_compressed: self.options.meshopt,
        };
        let bytes = write_model(&model, notes).map_err(broken)?;
        let file = format!("{name}.glb");
        let size = bytes.len() as u64;
        self.write_file(&file, &bytes).map_err(ContentError::Fatal)?;
        let mut written = Counts::default();
        if self.options.check {
            let of = self.decode(&file, bytes).map_err(ContentError::Broken)?;
            written.add(&of);
        }
        Ok(Written { set_from_tile, bounds, file, bytes: size, source, written })
    }

    /// Decodes a file that was written.
    fn decode(&self, file: &str, bytes: Vec<u8>) -> Result<Vec<Leaf>, IoError> {
        let options = ReadOptions { cluster_culling: false, ..ReadOptions::for_root(file, self.options.limits) };
        let content = Content { uri: file.into(), bytes, reader_data: None, companions: Vec::new() };
        let node = guarded(file, || decode_whole(content, &options))?.node;
        let splitter = Splitter { px_per_radian: self.options.px_per_radian, notes: &Notes::default() };
        Ok(splitter.split(node, DAffine3::IDENTITY, "", 0).leaves)
    }

    /// Writes a file of the output.
    pub fn write_file(&self, name: &str, bytes: &[u8]) -> Result<(), ConvertError> {
        write_file(&self.out.join(name), bytes)
    }
}

/// Writes a file, and creates its folder.
pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), ConvertError> {
    let failed = |path: &Path| {
        let path: PathBuf = path.into();
        |reason| ConvertError::Write { path, reason }
    };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed(folder))?;
    }
    std::fs::write(path, bytes).map_err(failed(path))
}
