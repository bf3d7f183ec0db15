//! Summarizes a tile set, for `terrane info`. Reads every tileset and the sizes of local contents. Blocking.

use std::sync::Arc;

use super::info::{BoundsInfo, Info};
use super::metadata::MetadataInfo;
use super::model::ModelInfo;
use super::overlay::inspect_overlay;
use super::report::too_many;
use super::terrain::inspect_terrain;
use super::tree::{Known, load, read_companions, read_subtree};
#[cfg(feature = "http")]
use crate::fetch::HttpConfig;
use crate::fetch::markup::text_and_first_byte;
use crate::fetch::{IoError, Limits, Loaded, Source, encoding, is_remote, path_of, printable, root_uri_within};
use crate::formats::height::{self, SetExtras};
use crate::formats::options::{Content, Fetched, ReadOptions};
use crate::formats::osg;
use crate::formats::overlay;
use crate::formats::read::{companions, decode_node};
use crate::formats::terrain;
use crate::formats::tile::{Body, Tile, TileContent};
use crate::formats::tileset::{self, may_be_tileset, read_tiles};
use crate::math::WGS84;
use crate::scene::Page;

/// Summarizes a tile set. Fails only if the root cannot be read; other failures are listed in [`Info::errors`].
pub fn inspect(source: &str, limits: &Limits) -> Result<Info, IoError> {
    let root = root_uri_within(source, limits.file_timeout)?;
    inspect_from(&root, limits, Source::new(*limits, &root), true)
}

/// Like [`inspect`], with a configuration for servers.
#[cfg(feature = "http")]
pub fn inspect_with(source: &str, limits: &Limits, http: HttpConfig) -> Result<Info, IoError> {
    let root = root_uri_within(source, limits.file_timeout)?;
    inspect_from(&root, limits, Source::new(*limits, &root).with_http(http), true)
}

/// Like [`inspect_with`], but reads the root alone and no tileset that it refers to, for sets that no one reads as a whole.
#[cfg(feature = "http")]
pub fn inspect_root_with(source: &str, limits: &Limits, http: HttpConfig) -> Result<Info, IoError> {
    let root = root_uri_within(source, limits.file_timeout)?;
    inspect_from(&root, limits, Source::new(*limits, &root).with_http(http), false)
}

fn inspect_from(root: &Arc<str>, limits: &Limits, from: Source, follows: bool) -> Result<Info, IoError> {
    let options = ReadOptions::for_root(root, *limits);
    let mut info = Info { format: "3D Tiles".to_owned(), ..Info::default() };
    let Loaded { bytes, location, .. } = from.load(root)?;
    // Metadata is described, and that which is invalid is named.
    let mut options = ReadOptions { base: location, keep_features: true, ..options };
    if let Some(document) = overlay::describe(&bytes) {
        return inspect_overlay(root, bytes.len(), document);
    }
    if terrain::is_layer(root, &bytes, limits) {
        return inspect_terrain(root, &bytes, &options, &from);
    }
    if (may_be_model(&bytes) || terrain::is_tile_name(root)) && !tileset::is_tileset(root, &bytes, limits) {
        return inspect_model(root, bytes, &options, &from);
    }
    let json = tileset::parse(root, &bytes, limits)?;
    info.version = printable(json.asset.version()).into_owned();
    if json.asset.extras.0.as_ref().is_some_and(SetExtras::is_height) {
        info.format = "3D Tiles with heights".to_owned();
    }
    info.bounds.region = json.root.bounding_volume.region.as_ref().map(|region| region.0.clone());
    info.bytes += bytes.len() as u64;
    info.extensions.extend(json.extensions_used.iter().map(|name| printable(name).into_owned()));
    info.body = json.body().and_then(Result::ok);
    options.ellipsoid = info.body.as_ref().map_or(WGS84, Body::ellipsoid);
    info.metadata = MetadataInfo::read(&bytes);
    info.bounds.set_heights(info.metadata.as_ref().and_then(MetadataInfo::terrain_heights_m));
    drop(json);
    let companions = tileset_files(&mut info, &from, root, &bytes, &options);
    let tile = match read_tiles(root, &bytes, &companions, &options) {
        Ok(tile) => tile,
        Err(error) => {
            info.fail(&error);
            return Ok(info);
        }
    };
    let sphere = tile.bounds.bounding_sphere();
    (info.bounds.center, info.bounds.radius_m) = (sphere.center.to_array(), sphere.radius_m);
    let limit = limits.max_elements as u64;
    let mut walk = Walk { info, from: &from, follows, unread: 0, visited: 0, limit };
    if !walk.tile(&tile, 0, &At { tileset: root, options: &options }) {
        walk.info.fail(&too_many(root, limit));
    }
    if walk.unread > 0 {
        walk.info.describe("below", format!("{} further tilesets, which were not read", walk.unread));
    }
    let ignored = options.ignored.snapshot();
    walk.info.ignored = ignored.iter().map(|(kind, count)| (kind.to_owned(), count)).collect();
    Ok(walk.info)
}

/// Returns true for bytes that may be a content of a tile. Others get the errors of the tileset's parser.
fn may_be_model(bytes: &[u8]) -> bool {
    const MAGICS: [&[u8]; 8] =
        [b"glTF", b"b3dm", b"i3dm", b"cmpt", b"pnts", &[0x76, 0x2f, 0x31, 0x01], &[0x1f, 0x8b], &[4, 3, 2, 1]];
    let is_model = MAGICS.iter().any(|magic| bytes.starts_with(magic));
    // A file that is no JSON gets the error of the readers of contents, which know more formats.
    let is_json = text_and_first_byte(bytes).1 == Some(b'{');
    is_model || !is_json || osg::is_metadata(bytes) || has_asset(bytes)
}

/// Returns true for JSON with an asset, as glTF and tilesets have it.
fn has_asset(bytes: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Probe {
        #[serde(rename = "asset")]
        _asset: serde::de::IgnoredAny,
    }
    serde_json::from_slice::<Probe>(bytes).is_ok()
}

/// Reads a content that is no tileset.
fn inspect_model(uri: &Arc<str>, bytes: Vec<u8>, options: &ReadOptions, from: &Source) -> Result<Info, IoError> {
    let bytes = encoding::gunzip(uri, bytes, &options.limits)?;
    let mut info = Info { format: format_name(uri, &bytes, options), contents: 1, ..Info::default() };
    info.bytes = bytes.len() as u64;
    if osg::is_metadata(&bytes)
        && let Some((srs, [x, y, z])) = osg::reference_system(&bytes)
    {
        info.describe("srs", if srs.is_empty() { "none (its own frame)".to_owned() } else { srs });
        info.describe("origin", format!("{x}, {y}, {z}"));
    }
    let mut options = options.clone();
    let companions = read_companions(from, uri, &bytes, None, &mut options, &mut info.bytes);
    let node = decode_node(Content { uri: uri.clone(), bytes, reader_data: None, companions }, &options)?;
    let model = ModelInfo::of(&node, &options);
    let page = Page::from_node(node).map_err(|e| IoError::invalid(uri, e.to_string()))?;
    let sphere = page.bounding_sphere();
    info.bounds = BoundsInfo { center: sphere.center.to_array(), radius_m: sphere.radius_m, region: None };
    info.model = Some(model);
    let ignored = options.ignored.snapshot();
    info.ignored = ignored.iter().map(|(kind, count)| (kind.to_owned(), count)).collect();
    Ok(info)
}

/// Returns the name of a format, by its magic bytes or, for a format without them, by its name.
fn format_name(uri: &str, bytes: &[u8], options: &ReadOptions) -> String {
    if osg::is_native(bytes) {
        return osg::format_name(bytes, options);
    }
    let name = match bytes.get(..4) {
        Some(b"glTF") => "glTF (glb)",
        Some(b"b3dm") => "3D Tiles content (b3dm)",
        Some(b"i3dm") => "3D Tiles content (i3dm)",
        Some(b"cmpt") => "3D Tiles content (cmpt)",
        Some(b"pnts") => "3D Tiles content (pnts)",
        Some(&[0x76, 0x2f, 0x31, 0x01]) => "height tile (EXR)",
        Some(bytes) if bytes == height::PACKED_MAGIC => "height tile (packed)",
        _ if osg::is_metadata(bytes) => "oblique photogrammetry (metadata.xml)",
        _ if text_and_first_byte(bytes).1 == Some(b'{') => "glTF (JSON)",
        _ if terrain::is_tile_name(uri) => "quantized-mesh tile",
        _ => "unknown",
    };
    name.to_owned()
}

/// Reads the files that a tileset refers to, and lists those that cannot be read.
fn tileset_files(info: &mut Info, from: &Source, uri: &Arc<str>, bytes: &[u8], options: &ReadOptions) -> Vec<Fetched> {
    let files = read_companions(from, uri, bytes, None, &mut options.clone(), &mut info.bytes);
    files.iter().filter_map(|(_, read)| read.as_ref().err()).for_each(|error| info.fail(error));
    files
}

/// The state of a walk over a tile set.
struct Walk<'a> {
    info: Info,
    from: &'a Source,
    /// Reads external tilesets.
    follows: bool,
    /// Number of external tilesets that were not read.
    unread: u64,
    /// Number of tiles and tilesets so far.
    visited: u64,
    /// The maximum of `visited`.
    limit: u64,
}

/// The tileset that a tile belongs to.
#[derive(Clone, Copy)]
struct At<'a> {
    tileset: &'a Arc<str>,
    options: &'a ReadOptions,
}

/// Each method returns false if the limit is exceeded.
impl Walk<'_> {
    /// Counts a tile or tileset.
    fn visit(&mut self) -> bool {
        self.visited += 1;
        self.visited <= self.limit
    }

    /// Adds a tile and its descendants.
    fn tile(&mut self, tile: &Tile, level: u32, at: &At<'_>) -> bool {
        if let [content] = &tile.contents[..]
            && content.continues_tileset()
        {
            // The tile only stands for the root of an implicit tree.
            return self.content(content, level, at);
        }
        if !self.visit() {
            return false;
        }
        self.info.tiles += 1;
        let mut contents = tile.contents.iter().chain(&tile.external_tilesets);
        let has_metadata = tile.metadata.is_some() || contents.any(|content| content.metadata.is_some());
        self.info.tiles_with_metadata += u64::from(has_metadata);
        self.info.level(level).tiles += 1;
        tile.contents.iter().all(|content| self.content(content, level, at))
            && (tile.external_tilesets.iter()).all(|TileContent { uri, .. }| {
                if !self.follows {
                    self.unread += 1;
                    return true;
                }
                self.visit() && self.external_or_fail(uri, self.from.load(uri), level, at)
            })
            && tile.continuations.iter().all(|below| self.content(&below.content, level + 1, at))
            && tile.children.iter().all(|child| self.tile(child, level + 1, at))
    }

    /// Adds a content of a tile, or the tiles of a part of the tree whose first level is `level`.
    fn content(&mut self, content: &TileContent, level: u32, at: &At<'_>) -> bool {
        let read = match Known::of(content) {
            Known::Part(part) => part.read(at.options),
            Known::Subtree(source) => {
                let tiles = read_subtree(self.from, content, source, at.options, &mut self.info.bytes);
                self.info.subtrees += 1;
                tiles
            }
            Known::Refused(error) => {
                self.info.fail(error);
                return true;
            }
            // A terrain service has a separate summary.
            Known::Embedded | Known::Terrain(_) => {
                self.info.contents += 1;
                self.info.level(level).contents += 1;
                return true;
            }
            Known::File => return self.file(content, level, at),
        };
        let tiles = read.unwrap_or_else(|error| {
            self.info.fail(&error);
            Vec::new()
        });
        tiles.iter().all(|tile| self.tile(tile, level, at))
    }

    /// Adds a content in a file, with its imagery.
    fn file(&mut self, content: &TileContent, level: u32, at: &At<'_>) -> bool {
        // The name of an external tileset may have any file extension. Other contents on servers are not fetched.
        let may_be_tileset = match is_remote(&content.uri) {
            true => path_of(&content.uri).ends_with(".json"),
            false => may_be_tileset(&content.uri),
        };
        if may_be_tileset && !self.follows {
            self.unread += 1;
            return true;
        }
        if may_be_tileset {
            let loaded = load(self.from, &content.uri, content.reader_data.as_ref());
            let is_tileset = |loaded: &Loaded| tileset::is_tileset(&content.uri, &loaded.bytes, &at.options.limits);
            if let Ok(loaded) = loaded
                && is_tileset(&loaded)
            {
                return self.visit() && self.external_or_fail(&content.uri, Ok(loaded), level, at);
            }
        }
        self.info.contents += 1;
        self.info.level(level).contents += 1;
        for uri in companions(&content.uri, content.reader_data.as_ref()).iter().chain([&content.uri]) {
            if is_remote(uri) {
                continue;
            }
            match self.from.size(uri) {
                Ok(bytes) => {
                    self.info.bytes += bytes;
                    self.info.level(level).bytes += bytes;
                }
                Err(error) => self.info.fail(&error),
            }
        }
        true
    }

    fn external_or_fail(&mut self, uri: &Arc<str>, loaded: Result<Loaded, IoError>, level: u32, at: &At<'_>) -> bool {
        self.external(uri, loaded, level, at).unwrap_or_else(|error| {
            self.info.fail(&error);
            true
        })
    }

    /// Adds an external tileset that a tile of a level refers to.
    fn external(
        &mut self,
        uri: &Arc<str>,
        loaded: Result<Loaded, IoError>,
        level: u32,
        at: &At<'_>,
    ) -> Result<bool, IoError> {
        if uri == at.tileset || at.options.chain.contains(uri) {
            return Err(IoError::unsupported(uri, "the tileset contains itself"));
        }
        if at.options.chain.len() >= at.options.limits.max_external_depth {
            return Err(IoError::invalid(uri, "external tilesets are nested too deep"));
        }
        let Loaded { bytes, location, .. } = loaded?;
        let json = tileset::parse(uri, &bytes, &at.options.limits)?;
        self.info.bytes += bytes.len() as u64;
        self.info.extensions.extend(json.extensions_used.iter().map(|name| printable(name).into_owned()));
        drop(json);
        let below = ReadOptions { base: location, ..at.options.below(at.tileset) };
        let companions = tileset_files(&mut self.info, self.from, uri, &bytes, &below);
        let tile = read_tiles(uri, &bytes, &companions, &below)?;
        Ok(self.tile(&tile, level + 1, &At { tileset: uri, options: &below }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The path used to be cut at the character, so that external tilesets counted as contents.
    #[test]
    fn folders_may_contain_question_marks_and_hashes() {
        let tile = |uri: &str| {
            format!(
                r#"{{"asset":{{"version":"1.1"}},"geometricError":1,"root":{{"geometricError":0,
                "boundingVolume":{{"sphere":[0,0,0,1]}},"content":{{"uri":"{uri}"}}}}}}"#
            )
        };
        for name in ["c#", "what?"] {
            let folder = tempfile::tempdir().unwrap();
            let set = folder.path().join(name);
            std::fs::create_dir(&set).unwrap();
            for (file, content) in [("tileset.json", "below.json"), ("below.json", "a.glb"), ("a.glb", "")] {
                std::fs::write(set.join(file), tile(content)).unwrap();
            }
            let info = inspect(set.to_str().unwrap(), &Limits::default()).unwrap();
            assert_eq!((info.tiles, info.contents, info.failed), (2, 1, 0), "{name}: {:?}", info.errors);
        }
    }
}
