//! Converts the JSON of a tileset to [`Tile`]s.
//!
//! Transforms are multiplied from the root down, so the volume and the content transform of each tile are in the tileset's
//! frame. The scale of the transform scales the geometric error, as the specification requires.
//!
//! A tile that violates the specification fails alone, as a content that cannot be loaded: where it would replace its
//! parent, the parent stays. Only the root tile and the limits refuse the tileset.

use std::sync::Arc;

use glam::DAffine3;

use super::json::{self, ContentJson, TileJson, TilesetJson, VolumeJson};
use super::set_metadata::SetMetadata;
use super::volume::{affine, bounding_volume, inverse, root_volume};
use crate::fetch::{IoError, path_of, resolve};
use crate::formats::embedded::is_data_uri;
use crate::formats::external_files::ExternalFiles;
use crate::formats::height::{HeightSet, HeightTileJson, PlacedErrors};
use crate::formats::ignored::Notes;
use crate::formats::implicit::{
    ContentTemplate, HeightTemplate, ImplicitRoot, ImplicitTiling, ImplicitTilingJson, SubtreeSource,
};
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::properties::{self, Schema};
use crate::formats::tile::{ALWAYS_REFINED_M, ContentBytes, ContentData, Tile, TileContent, UpAxis};
use crate::math::{BoundingVolume, Ellipsoid};
use crate::scene::{ReaderData, Refine};

/// Properties that a tile inherits from its ancestors.
#[derive(Clone, Copy)]
struct Inherited {
    /// The refinement of the parent, which applies to tiles without their own.
    refine: Refine,
    /// True if a content above is replaced by the tiles below.
    is_replaced: bool,
    level: u32,
    /// The geometric error of the parent, metres before its scale.
    geometric_error: f64,
    /// The volume of the parent; `None` for the root.
    bounds: Option<BoundingVolume>,
    /// The errors of the parent, if it is a height tile.
    heights: Option<PlacedErrors>,
}

/// Parses a tileset and returns its root tile. `companions` are the files that it refers to: its schema.
pub(in crate::formats) fn read_tiles(
    uri: &Arc<str>,
    bytes: &[u8],
    companions: &[Fetched],
    options: &ReadOptions,
) -> Result<Tile, IoError> {
    let notes = Notes::default();
    let root = read_noting(uri, bytes, companions, options, &notes);
    options.ignored.add(&notes.into_ignored());
    root
}

/// Does the same as [`read_tiles`], and adds what is left out, and the attribution, to notes.
pub(super) fn read_noting(
    uri: &Arc<str>,
    bytes: &[u8],
    companions: &[Fetched],
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Tile, IoError> {
    if options.chain.iter().any(|above| above == uri) {
        return Err(IoError::unsupported(uri, "the tileset contains itself"));
    }
    if options.chain.len() >= options.limits.max_external_depth {
        return Err(IoError::TooLarge {
            uri: uri.to_string(),
            what: "depth of external tilesets",
            got: options.chain.len() as u64 + 1,
            limit: options.limits.max_external_depth as u64,
        });
    }
    let tileset = json::parse(uri, bytes, &options.limits)?;
    if std::str::from_utf8(bytes).is_err() {
        notes.add("tileset: text that is not UTF-8");
    }
    note_ignored(&tileset, notes);
    let ellipsoid = ellipsoid_of(&tileset, options, notes);
    let options = &ReadOptions { ellipsoid, ..options.clone() };
    let files = ExternalFiles::new(options.base.as_ref().unwrap_or(uri), &options.root, &options.limits, companions);
    let (json, reference) = tileset.schema();
    let schema = properties::read_schema(uri, json, reference, &files).unwrap_or_else(|error| {
        // The jobs about whole sets list the error of the file. The tiles are drawn without their metadata.
        notes.add_missing("metadata: a schema that cannot be read", &error);
        None
    });
    let schema = schema.map(Arc::new);
    let no_schema = Schema::default();
    let known = schema.as_deref().unwrap_or(&no_schema);
    let metadata = options.keep_features.then(|| SetMetadata::new(&tileset, known, notes));
    let up_axis = tileset.asset.gltf_up_axis.0.as_deref().and_then(UpAxis::named).unwrap_or_default();
    let heights = HeightSet::from_extras(uri, tileset.asset.extras.0)?;
    let schema = schema.clone();
    let mut reader = Reader { uri, options, heights, up_axis, schema, metadata, notes, tiles: 0, contents: 0 };
    // An external tileset does not know the tiles above it, so it assumes that it replaces a content.
    let inherited = Inherited {
        refine: Refine::Replace,
        is_replaced: !options.chain.is_empty(),
        level: 0,
        geometric_error: tileset.geometric_error.map_or(0.0, |error| error.0),
        bounds: None,
        heights: None,
    };
    reader.tile(tileset.root, DAffine3::IDENTITY, inherited)
}

/// Lists what the tileset asks for and this reader leaves out.
fn note_ignored(tileset: &TilesetJson, notes: &Notes) {
    if !tileset.asset.is_known() {
        notes.add("tileset: asset.version that is missing or unknown (read as 1.1)");
    }
    // Extensions of glTF are listed by its reader.
    let of_gltf = |name: &str| ["KHR_", "EXT_", "CESIUM_"].iter().any(|prefix| name.starts_with(prefix));
    for name in tileset.extensions_used.iter().filter(|name| !of_gltf(name)) {
        if !tileset.reads(name) {
            notes.add(format!("tileset extension {name}"));
        }
    }
    if let Some(copyright) = &tileset.asset.copyright.0 {
        notes.add_credit(copyright);
    }
    if let Some(axis) = tileset.asset.gltf_up_axis.0.as_deref().filter(|axis| UpAxis::named(axis).is_none()) {
        notes.add(format!("asset.gltfUpAxis {axis}"));
    }
}

/// Returns the ellipsoid of a tileset, and notes the body that a root declares. An external tileset has the ellipsoid of the
/// root tileset, with which the tiles around it are placed; another one is noted.
fn ellipsoid_of(tileset: &TilesetJson, options: &ReadOptions, notes: &Notes) -> Ellipsoid {
    let Some(Ok(body)) = tileset.body() else { return options.ellipsoid };
    if options.chain.is_empty() {
        if body.is_triaxial() {
            notes.add("3DTILES_ellipsoid with three different radii: the mean of the equatorial ones is used");
        }
        let ellipsoid = body.ellipsoid();
        notes.set_body(body);
        return ellipsoid;
    }
    if body.ellipsoid() != options.ellipsoid {
        notes.add("3DTILES_ellipsoid of an external tileset, which differs from that of its root");
    }
    options.ellipsoid
}

struct Reader<'a> {
    uri: &'a Arc<str>,
    options: &'a ReadOptions,
    heights: Option<HeightSet>,
    up_axis: UpAxis,
    schema: Option<Arc<Schema>>,
    /// `None` if metadata is not kept.
    metadata: Option<SetMetadata<'a>>,
    notes: &'a Notes,
    /// Number of tiles so far.
    tiles: usize,
    /// Number of contents without a URI of their own so far.
    contents: usize,
}

impl Reader<'_> {
    /// Converts a tile and its descendants. A child that is invalid becomes a tile that cannot be loaded.
    fn tile(&mut self, json: TileJson, parent: DAffine3, inherited: Inherited) -> Result<Tile, IoError> {
        self.check(inherited.level)?;
        match (self.valid_tile(json, parent, inherited), inherited.bounds) {
            (Err(error), Some(bounds)) if !matches!(error, IoError::TooLarge { .. }) => {
                Ok(Tile::refused(bounds, inherited.refine, self.name_content(), error))
            }
            (result, _) => result,
        }
    }

    fn valid_tile(&mut self, json: TileJson, parent: DAffine3, inherited: Inherited) -> Result<Tile, IoError> {
        let level = inherited.level;
        let content_transform = match &json.transform {
            Some(m) => parent * affine(self.uri, &m.0)?,
            None => parent,
        };
        let refine = match json.refine.0.as_deref() {
            Some(r) if r.eq_ignore_ascii_case("add") => Refine::Add,
            Some(r) if r.eq_ignore_ascii_case("replace") => Refine::Replace,
            _ => inherited.refine,
        };
        let volume = |json: &VolumeJson| self.bounding_volume(json, &content_transform);
        let bounds = volume(&json.bounding_volume)?;
        let request_volume = json.viewer_request_volume.as_ref().map(volume).transpose()?;
        let geometric_error = self.geometric_error(&json, &inherited)?;
        let mut geometric_error_m = geometric_error * crate::math::max_scale(&content_transform.matrix3);
        let metadata = self.metadata.as_mut().and_then(|set| set.of_tile(&json, level == 0));
        if let Some(tiling) = json.implicit_tiling() {
            let root = Tile {
                bounds,
                request_volume,
                refine,
                geometric_error_m,
                content_transform,
                contents: Vec::new(),
                external_tilesets: Vec::new(),
                continuations: Vec::new(),
                metadata,
                children: Vec::new(),
            };
            return self.implicit_root(tiling, &json, root, parent, inherited);
        }
        let (mut height_data, mut height_errors) = (None, None);
        if let Some(heights) = &self.heights {
            let extras = json.extras.0.as_ref();
            let base = self.options.base.as_ref().unwrap_or(self.uri);
            let imagery = extras.and_then(|own| own.imagery.as_deref());
            let imagery = imagery.map(|reference| resolve(base, reference, &self.options.root)).transpose()?;
            let plane = extras.and_then(|own| own.plane);
            let corner_errors_m = extras.and_then(|own| own.corner_errors_m);
            let region = extras.and_then(|own| own.region);
            let tile =
                HeightTileJson { level, bounds: &bounds, plane, region, imagery, corner_errors_m, geometric_error_m };
            let errors = heights.errors(base, &tile, inherited.heights.as_ref())?;
            geometric_error_m = errors.geometric_error_m();
            height_data = Some(heights.tile_data(base, tile, &errors)?);
            height_errors = Some(errors);
        }
        let References { mut contents, external_tilesets } = self.references(&json, &content_transform);
        if let Some(first) = contents.first_mut()
            && height_data.is_some()
        {
            first.reader_data = height_data.map(ReaderData::from);
        }
        // A tile without content draws nothing where its error is small. That would be a hole below a replaced content, and
        // would hide external tilesets.
        if contents.is_empty() && (inherited.is_replaced || !external_tilesets.is_empty()) {
            geometric_error_m = ALWAYS_REFINED_M;
        }
        let replaces = !contents.is_empty() && refine == Refine::Replace;
        let below = Inherited {
            refine,
            is_replaced: inherited.is_replaced || replaces,
            level: level + 1,
            geometric_error,
            bounds: Some(bounds),
            heights: height_errors,
        };
        let mut children = Vec::with_capacity(json.children.len());
        for child in json.children {
            children.push(self.tile(child, content_transform, below)?);
        }
        Ok(Tile {
            bounds,
            request_volume,
            refine,
            geometric_error_m,
            content_transform,
            contents,
            external_tilesets,
            continuations: Vec::new(),
            metadata,
            children,
        })
    }

    /// Returns the geometric error of a tile, which is its parent's if it has none. A negative one, which some writers give
    /// tiles without children, is 0.
    fn geometric_error(&self, json: &TileJson, inherited: &Inherited) -> Result<f64, IoError> {
        let error = json.geometric_error.map_or(inherited.geometric_error, |error| error.0);
        if !error.is_finite() {
            return Err(IoError::invalid(self.uri, format!("geometricError {error} of a tile is not finite")));
        }
        if error < 0.0 {
            self.notes.add("geometricError that is negative, and taken as 0");
        }
        Ok(error.max(0.0))
    }

    /// Returns a tile that stands for an implicit tree: its content is the subtree of the root.
    fn implicit_root(
        &self,
        tiling: &ImplicitTilingJson,
        json: &TileJson,
        root: Tile,
        parent: DAffine3,
        inherited: Inherited,
    ) -> Result<Tile, IoError> {
        let extras = json.extras.0.as_ref();
        let heights = self.heights.as_ref().map(|set| HeightTemplate {
            set: set.clone(),
            root_level: inherited.level,
            above: inherited.heights,
            plane: extras.and_then(|own| own.plane),
            imagery: extras.and_then(|own| own.imagery.as_deref()),
        });
        let missing = || IoError::invalid(self.uri, "content without a uri");
        let mut contents = Vec::new();
        for content in json.contents() {
            let group = self.metadata.as_ref().and_then(|set| set.group(content));
            contents.push(ContentTemplate { reference: content.uri().ok_or_else(missing)?, group });
        }
        let tiling = ImplicitTiling::new(
            tiling,
            ImplicitRoot {
                uri: self.uri,
                options: self.options,
                volume: root_volume(self.uri, &json.bounding_volume, self.options.ellipsoid)?,
                tileset_from_set: inverse(&self.options.set_from_content),
                geometric_error: self.geometric_error(json, &inherited)?,
                refine: root.refine,
                content_transform: root.content_transform,
                parent_transform: parent,
                is_replaced: inherited.is_replaced,
                contents,
                heights,
                up_axis: self.up_axis,
                schema: self.schema.clone(),
                groups: self.metadata.as_ref().map(SetMetadata::groups).unwrap_or_default(),
            },
        )?;
        let content = SubtreeSource::root(Arc::new(tiling)).content();
        Ok(Tile { contents: vec![content], ..root })
    }

    /// Counts a tile. Fails beyond the limits.
    fn check(&mut self, level: u32) -> Result<(), IoError> {
        let limits = &self.options.limits;
        self.tiles += 1;
        if self.tiles > limits.max_elements || level > limits.max_depth {
            return Err(IoError::TooLarge {
                uri: self.uri.to_string(),
                what: "tile tree",
                got: self.tiles as u64,
                limit: limits.max_elements as u64,
            });
        }
        Ok(())
    }

    /// Returns a tile's contents and its external tilesets. A reference that is invalid becomes a
    /// content that cannot be loaded.
    fn references(&mut self, json: &TileJson, transform: &DAffine3) -> References {
        let References { mut contents, mut external_tilesets } = References::default();
        for content in json.contents() {
            let metadata = self.metadata.as_mut().and_then(|set| set.of_content(content));
            let Some(reference) = content.uri() else {
                let error = IoError::invalid(self.uri, "content without a uri");
                contents.push(TileContent::refused(self.name_content(), error));
                continue;
            };
            let bounds = self.content_bounds(content, transform);
            if is_data_uri(reference) {
                let reader_data = self.content_data(ContentBytes::Embedded(reference.into()), None);
                contents.push(TileContent { bounds, metadata, ..TileContent::new(self.name_content(), reader_data) });
                continue;
            }
            match self.options.resolve(self.uri, reference) {
                Ok((uri, None)) if path_of(&uri).ends_with(".json") => {
                    external_tilesets.push(TileContent { metadata, ..TileContent::new(uri, None) });
                }
                Ok((uri, fallback)) => {
                    let reader_data = self.content_data(ContentBytes::Fetched, fallback);
                    contents.push(TileContent { bounds, metadata, ..TileContent::new(uri, reader_data) });
                }
                Err(error) => contents.push(TileContent::refused(self.name_content(), error)),
            }
        }
        References { contents, external_tilesets }
    }

    /// Returns a volume in the tileset's frame.
    fn bounding_volume(&self, json: &VolumeJson, transform: &DAffine3) -> Result<BoundingVolume, IoError> {
        bounding_volume(self.uri, json, transform, &self.options.set_from_content, self.options.ellipsoid)
    }

    /// Returns the volume of a content that has one. An invalid one is left out, which is noted.
    fn content_bounds(&self, content: &ContentJson, transform: &DAffine3) -> Option<BoundingVolume> {
        let volume = content.bounding_volume.as_ref()?;
        let bounds = self.bounding_volume(volume, transform);
        bounds.inspect_err(|_| self.notes.add("content.boundingVolume that is invalid")).ok()
    }

    /// Returns the reader data of a content; `None` if its URI says everything.
    fn content_data(&self, bytes: ContentBytes, fallback: Option<Arc<str>>) -> Option<ReaderData> {
        if matches!(bytes, ContentBytes::Fetched) && self.up_axis == UpAxis::Y && fallback.is_none() {
            return None;
        }
        Some(ReaderData::of(ContentData { bytes, up_axis: self.up_axis, fallback, ..ContentData::default() }))
    }

    /// Returns a name for a content that has no URI: the tileset's with a number.
    fn name_content(&mut self) -> Arc<str> {
        self.contents += 1;
        format!("{}#content-{}", self.uri, self.contents).into()
    }
}

/// The contents and external tilesets that a tile refers to.
#[derive(Default)]
struct References {
    contents: Vec<TileContent>,
    external_tilesets: Vec<TileContent>,
}
