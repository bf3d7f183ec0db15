//! Summary of a tile set, for `terrane info`. Reads every tileset and the sizes of local contents. Blocking.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use serde::Serialize;

use super::measure::LevelMeasures;
use super::metadata::MetadataInfo;
use super::model::{ModelInfo, inspect_model};
use super::overlay::inspect_overlay;
use super::report::{InfoError, record, too_many};
use super::terrain::inspect_terrain;
use super::tree::{Known, load, read_companions, read_subtree};
#[cfg(feature = "http")]
use crate::fetch::HttpConfig;
use crate::fetch::markup::text_and_first_byte;
use crate::fetch::{IoError, Limits, Loaded, Source, is_remote, path_of, printable, root_uri_within};
use crate::formats::height::SetExtras;
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::osg;
use crate::formats::overlay;
use crate::formats::read::companions;
use crate::formats::terrain;
use crate::formats::tile::{Tile, TileContent};
use crate::formats::tileset::{self, Body, may_be_tileset, read_tiles};
use crate::math::WGS84;

/// Summary of a tile set.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Info {
    /// "3D Tiles", "3D Tiles with heights", "quantized-mesh terrain", "raster overlay (WMTS)", or the format of a single
    /// content.
    pub format: String,
    /// The version of the asset.
    pub version: String,
    /// Number of tiles, those of external tilesets included.
    pub tiles: u64,
    /// Number of contents, external tilesets excluded.
    pub contents: u64,
    /// Number of subtrees of implicit tiling.
    pub subtrees: u64,
    /// Statistics by level, root first.
    pub levels: Vec<LevelInfo>,
    /// Bytes of tilesets, local contents and local imagery. Contents on servers are not fetched and count 0.
    pub bytes: u64,
    /// Extensions that the tilesets declare as used.
    pub extensions: BTreeSet<String>,
    /// The counts of a single content; `None` for a tile set.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelInfo>,
    /// The metadata of the root tileset, if it has any.
    pub metadata: Option<MetadataInfo>,
    /// Number of tiles that have metadata, or whose contents have metadata or belong to a group.
    pub tiles_with_metadata: u64,
    /// The body that the root declares by 3DTILES_ellipsoid.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub body: Option<Body>,
    /// The bounds of the whole set.
    pub bounds: BoundsInfo,
    /// What is particular to the format, by name: its projection, reference system, layers.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub details: BTreeMap<String, String>,
    /// The credit that a terrain service or a map server asks for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attribution: Option<String>,
    /// Properties of the tilesets that their reader leaves out, counted by kind.
    pub ignored: BTreeMap<String, u64>,
    /// Number of failures.
    pub failed: u64,
    /// The first thousand failures.
    pub errors: Vec<InfoError>,
}

/// Statistics of one level of the tree.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct LevelInfo {
    /// The level: 0 for the root. The root of an external tileset is one level below the tile that refers to it.
    pub level: u32,
    /// Number of tiles.
    pub tiles: u64,
    /// Number of contents.
    pub contents: u64,
    /// Bytes of local contents and imagery.
    pub bytes: u64,
}

/// Bounds of a tile set: a sphere, and the region of the root if it has one.
#[derive(Clone, Debug, Default, Serialize)]
pub struct BoundsInfo {
    /// Centre in metres in the frame of the set.
    pub center: [f64; 3],
    /// Radius in metres.
    pub radius_m: f64,
    /// West, south, east and north in radians, then lowest and highest height in metres if they are known: those of the terrain if
    /// the metadata of the set says them, else those of the root's volume, which holds skirts too.
    pub region: Option<Vec<f64>>,
}

impl BoundsInfo {
    /// Replaces the heights of the region by those that [`survey`](super::survey) has measured.
    pub fn measure(&mut self, levels: &[LevelMeasures]) {
        let measured = levels.iter().filter_map(|level| level.heights_m);
        let both = |a: [f64; 2], b: [f64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        self.set_heights(measured.reduce(both));
    }

    fn set_heights(&mut self, heights_m: Option<[f64; 2]>) {
        if let (Some([_, _, _, _, low, high]), Some([lowest, highest])) = (self.region.as_deref_mut(), heights_m)
            && lowest <= highest
        {
            (*low, *high) = (lowest, highest);
        }
    }
}

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
    let companions = info.tileset_files(&from, root, &bytes, &options);
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

impl Info {
    pub(super) fn fail(&mut self, error: &IoError) {
        record(error, &mut self.failed, &mut self.errors);
    }

    /// Adds a detail. What comes from a file is cut at some length.
    pub(super) fn describe(&mut self, name: &str, text: impl Into<String>) {
        const MAX_CHARS: usize = 400;
        let text: String = text.into();
        self.details.insert(name.to_owned(), printable(&text).chars().take(MAX_CHARS).collect());
    }

    /// Reads the files that a tileset refers to, and lists those that cannot be read.
    fn tileset_files(&mut self, from: &Source, uri: &Arc<str>, bytes: &[u8], options: &ReadOptions) -> Vec<Fetched> {
        let files = read_companions(from, uri, bytes, None, &mut options.clone(), &mut self.bytes);
        files.iter().filter_map(|(_, read)| read.as_ref().err()).for_each(|error| self.fail(error));
        files
    }

    fn level(&mut self, level: u32) -> &mut LevelInfo {
        while self.levels.len() <= level as usize {
            self.levels.push(LevelInfo { level: self.levels.len() as u32, ..LevelInfo::default() });
        }
        &mut self.levels[level as usize]
    }
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
        let tiles = match Known::of(content) {
            Known::Part(part) => part.read(at.options),
            Known::Subtree(source) => {
                let tiles = read_subtree(self.from, content, source, at.options, &mut self.info.bytes);
                self.info.subtrees += 1;
                tiles.unwrap_or_else(|error| {
                    self.info.fail(&error);
                    Vec::new()
                })
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
        let companions = self.info.tileset_files(self.from, uri, &bytes, &below);
        let tile = read_tiles(uri, &bytes, &companions, &below)?;
        Ok(self.tile(&tile, level + 1, &At { tileset: uri, options: &below }))
    }
}

impl std::fmt::Display for Info {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mb = |b: u64| b as f64 / 1e6;
        writeln!(
            f,
            "{} {}: {} tiles, {} contents, {:.2} MB",
            self.format,
            self.version,
            self.tiles,
            self.contents,
            mb(self.bytes)
        )?;
        if let Some(body) = &self.body {
            writeln!(f, "body: {body}")?;
        }
        let [x, y, z] = self.bounds.center;
        writeln!(f, "bounds: centre {x:.1} {y:.1} {z:.1}, radius {:.1} m", self.bounds.radius_m)?;
        if let Some([west, south, east, north, heights @ ..]) = self.bounds.region.as_deref() {
            let d = |a: &f64| a.to_degrees();
            let (w, s, e, n) = (d(west), d(south), d(east), d(north));
            write!(f, "region: {w:.5} {s:.5} to {e:.5} {n:.5} degrees")?;
            match heights {
                [low, high] => writeln!(f, ", {low:.1} to {high:.1} m")?,
                _ => writeln!(f)?,
            }
        }
        for l in &self.levels {
            writeln!(
                f,
                "level {:2}: {:6} tiles, {:6} contents, {:10.2} MB",
                l.level,
                l.tiles,
                l.contents,
                mb(l.bytes)
            )?;
        }
        if !self.extensions.is_empty() {
            let list: Vec<&str> = self.extensions.iter().map(String::as_str).collect();
            writeln!(f, "extensions: {}", list.join(", "))?;
        }
        for (name, text) in &self.details {
            writeln!(f, "{name}: {text}")?;
        }
        if let Some(attribution) = &self.attribution {
            writeln!(f, "attribution: {attribution}")?;
        }
        write!(f, "errors: {}", self.failed)?;
        for e in &self.errors {
            write!(f, "\n  {}: {}", e.uri, e.reason)?;
        }
        Ok(())
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
