//! Converts the JSON of a tileset to [`Tile`]s.
//!
//! Transforms are multiplied from the root down, so the volume and the content transform of each tile are in the tileset's
//! frame. The scale of the transform scales the geometric error, as the specification requires.

use std::sync::Arc;

use glam::DAffine3;

use super::json::{self, TileJson};
use super::tile::{ALWAYS_REFINED_M, Tile};
use super::volume::{affine, bounding_volume};
use crate::fetch::{IoError, path_of, resolve};
use crate::formats::height::HeightSet;
use crate::formats::options::ReadOptions;
use crate::scene::Refine;

/// Properties that a tile inherits from its ancestors.
#[derive(Clone, Copy)]
struct Inherited {
    /// The refinement of the parent, which applies to tiles without their own.
    refine: Refine,
    /// True if a content above is replaced by the tiles below.
    is_replaced: bool,
    level: u32,
}

/// Parses a tileset and returns its root tile.
pub(in crate::formats) fn read_tiles(uri: &Arc<str>, bytes: &[u8], options: &ReadOptions) -> Result<Tile, IoError> {
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
    let tileset = json::parse(uri, bytes)?;
    let heights = HeightSet::from_extras(uri, tileset.asset.extras.0)?;
    let mut reader = Reader { uri, options, heights, tiles: 0 };
    // An external tileset does not know the tiles above it, so it assumes that it replaces a content.
    let inherited = Inherited { refine: Refine::Replace, is_replaced: !options.chain.is_empty(), level: 0 };
    reader.tile(tileset.root, DAffine3::IDENTITY, inherited)
}

struct Reader<'a> {
    uri: &'a Arc<str>,
    options: &'a ReadOptions,
    heights: Option<HeightSet>,
    /// Number of tiles so far.
    tiles: usize,
}

impl Reader<'_> {
    fn tile(&mut self, json: TileJson, parent: DAffine3, inherited: Inherited) -> Result<Tile, IoError> {
        let level = inherited.level;
        self.check(&json, level)?;
        let content_transform = match &json.transform {
            Some(m) => parent * affine(self.uri, m)?,
            None => parent,
        };
        let refine = match json.refine.as_deref() {
            Some(r) if r.eq_ignore_ascii_case("add") => Refine::Add,
            Some(r) if r.eq_ignore_ascii_case("replace") => Refine::Replace,
            _ => inherited.refine,
        };
        let volume = |v| bounding_volume(self.uri, v, &content_transform, &self.options.set_from_content);
        let bounds = volume(&json.bounding_volume)?;
        let request_volume = json.viewer_request_volume.as_ref().map(volume).transpose()?;
        if !(json.geometric_error.is_finite() && json.geometric_error >= 0.0) {
            return Err(IoError::invalid(
                self.uri,
                format!("geometricError {} of a tile is negative or not finite", json.geometric_error),
            ));
        }
        let mut geometric_error_m = json.geometric_error * crate::math::max_scale(&content_transform.matrix3);
        let mut reader_data = None;
        if let Some(heights) = &self.heights {
            geometric_error_m = heights.level_error_m(level).unwrap_or(geometric_error_m);
            reader_data = heights.tile_data(self.uri, level, &bounds, json.extras.0.as_ref(), &self.options.root)?;
        }
        let References { contents, external_tilesets } = self.references(&json)?;
        // A tile without content draws nothing where its error is small. That would be a hole below a replaced content, and
        // would hide external tilesets.
        if contents.is_empty() && (inherited.is_replaced || !external_tilesets.is_empty()) {
            geometric_error_m = ALWAYS_REFINED_M;
        }
        let replaces = !contents.is_empty() && refine == Refine::Replace;
        let below = Inherited { refine, is_replaced: inherited.is_replaced || replaces, level: level + 1 };
        let mut children = Vec::with_capacity(json.children.len());
        for child in json.children {
            children.push(self.tile(child, content_transform, below)?);
        }
        let is_leaf = children.is_empty() && external_tilesets.is_empty();
        if contents.len() > 1 && !is_leaf && refine == Refine::Replace {
            return Err(IoError::unsupported(self.uri, "several contents in a tile that its children replace"));
        }
        Ok(Tile {
            bounds,
            request_volume,
            refine,
            geometric_error_m,
            content_transform,
            reader_data,
            contents,
            external_tilesets,
            children,
        })
    }

    /// Counts a tile. Fails beyond the limits, and for implicit tiling.
    fn check(&mut self, json: &TileJson, level: u32) -> Result<(), IoError> {
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
        if json.has_implicit_tiling() {
            return Err(IoError::unsupported(self.uri, "implicit tiling"));
        }
        Ok(())
    }

    /// Returns the absolute URIs of a tile's contents and of its external tilesets.
    fn references(&self, json: &TileJson) -> Result<References, IoError> {
        let References { mut contents, mut external_tilesets } = References::default();
        for content in json.content.iter().chain(&json.contents) {
            let reference = content.uri().ok_or_else(|| IoError::invalid(self.uri, "content without a uri"))?;
            let uri = resolve(self.uri, reference, &self.options.root)?;
            let list = if path_of(&uri).ends_with(".json") { &mut external_tilesets } else { &mut contents };
            list.push(uri);
        }
        Ok(References { contents, external_tilesets })
    }
}

/// The absolute URIs that a tile refers to.
#[derive(Default)]
struct References {
    contents: Vec<Arc<str>>,
    external_tilesets: Vec<Arc<str>>,
}
