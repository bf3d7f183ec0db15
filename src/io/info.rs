//! What a tile set holds: for `terrane info`. Blocking; reads every tileset, and of contents the sizes (files only).

use std::collections::BTreeSet;
use std::sync::Arc;

use serde::Serialize;

use super::height::SetExtras;
use super::tileset::{self, TileJson};
use super::uri::path_of;
use super::{IoError, Limits, ReadOptions, Source, is_remote, resolve, root_uri, shown};
use crate::scene::Page;

/// Failures that are told one by one.
pub(super) const TOLD: usize = 1000;

/// Summary of a tile set.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Info {
    /// "3D Tiles", or "3D Tiles with heights".
    pub format: String,
    /// The asset's version.
    pub version: String,
    /// Tiles, external tilesets included.
    pub tiles: u64,
    /// Contents that tiles name, tilesets not counted.
    pub contents: u64,
    /// By level, root first.
    pub levels: Vec<LevelInfo>,
    /// Bytes of contents, of height tiles' imagery and of tilesets; contents on servers are not fetched and count 0.
    pub bytes: u64,
    /// Extensions that the tilesets use.
    pub extensions: BTreeSet<String>,
    /// Around everything.
    pub bounds: BoundsInfo,
    /// How often something is missing or wrong.
    pub failed: u64,
    /// The first thousand of that.
    pub errors: Vec<InfoError>,
}

/// One level of the tree.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct LevelInfo {
    /// Root 0; an external tileset's root is one below the tile that names it.
    pub level: u32,
    /// Tiles.
    pub tiles: u64,
    /// Contents.
    pub contents: u64,
    /// Bytes of the contents, and of height tiles' imagery.
    pub bytes: u64,
}

/// A sphere, and the region where the root has one.
#[derive(Clone, Debug, Default, Serialize)]
pub struct BoundsInfo {
    /// Metres in the set's frame.
    pub center: [f64; 3],
    /// Metres.
    pub radius_m: f64,
    /// West, south, east, north in radians, lowest and highest height in metres.
    pub region: Option<Vec<f64>>,
}

/// A failure.
#[derive(Clone, Debug, Serialize)]
pub struct InfoError {
    /// What failed.
    pub uri: String,
    /// Why.
    pub reason: String,
}

/// Walks a tile set. Fails only when the root cannot be read; everything below goes into `errors`.
pub fn inspect(source: &str, limits: &Limits) -> Result<Info, IoError> {
    inspect_from(source, limits, Source::new(*limits))
}

/// [`inspect`], for a source on a server that is talked to in a certain way.
#[cfg(feature = "http")]
pub fn inspect_with(source: &str, limits: &Limits, http: super::HttpConfig) -> Result<Info, IoError> {
    inspect_from(source, limits, Source::with_http(*limits, http))
}

fn inspect_from(source: &str, limits: &Limits, from: Source) -> Result<Info, IoError> {
    let root = root_uri(source)?;
    let options = ReadOptions::for_root(&root, *limits);
    let mut info = Info { format: "3D Tiles".to_owned(), ..Info::default() };
    let bytes = from.read(&root)?;
    let json = tileset::parse(&root, &bytes)?;
    info.version.clone_from(&json.asset.version);
    if json.asset.extras.0.as_ref().is_some_and(SetExtras::is_height) {
        info.format = "3D Tiles with heights".to_owned();
    }
    info.bounds.region.clone_from(&json.root.bounding_volume.region);
    info.bytes += bytes.len() as u64;
    info.extensions.extend(json.extensions_used.iter().cloned());
    match tileset::read(&root, &bytes, &options)
        .and_then(|node| Page::from_node(node).map_err(|e| IoError::invalid(&root, e.to_string())))
    {
        Ok(page) => {
            let sphere = page.bounding_sphere();
            info.bounds.center = sphere.center.to_array();
            info.bounds.radius_m = sphere.radius_m;
        }
        Err(e) => info.fail(&e),
    }
    let limit = limits.max_elements as u64;
    let mut walk = Walk { info, from: &from, met: 0, limit };
    if !walk.tile(&root, &json.root, (0, 0), &options) {
        walk.info.fail(&too_many(&root, limit));
    }
    Ok(walk.info)
}

/// Few files that name each other often enough make a tree that nobody reads to its end.
pub(super) fn too_many(root: &str, limit: u64) -> IoError {
    IoError::TooLarge { uri: root.to_owned(), what: "tiles and tilesets together", got: limit + 1, limit }
}

impl Info {
    fn fail(&mut self, error: &IoError) {
        self.failed += 1;
        if self.errors.len() < TOLD {
            self.errors.push(InfoError { uri: shown(error.uri()).into_owned(), reason: error.reason() });
        }
    }

    fn level(&mut self, level: u32) -> &mut LevelInfo {
        while self.levels.len() <= level as usize {
            self.levels.push(LevelInfo { level: self.levels.len() as u32, ..LevelInfo::default() });
        }
        &mut self.levels[level as usize]
    }
}

/// A walk over all of a tile set.
struct Walk<'a> {
    info: Info,
    from: &'a Source,
    /// Tiles and tilesets so far, and how many there may be.
    met: u64,
    limit: u64,
}

impl Walk<'_> {
    /// One more tile or tileset; false where that is one too many.
    fn meets(&mut self) -> bool {
        self.met += 1;
        self.met <= self.limit
    }

    /// A tile of a level, which lies so deep in its file, and what is below it. False where the walk ends.
    fn tile(&mut self, base: &Arc<str>, tile: &TileJson, (level, depth): (u32, u32), options: &ReadOptions) -> bool {
        if depth > options.limits.max_depth {
            // As the reader said of the same file.
            return true;
        }
        if !self.meets() {
            return false;
        }
        self.info.tiles += 1;
        self.info.level(level).tiles += 1;
        let imagery = tile.extras.0.as_ref().and_then(|own| own.imagery.as_deref());
        let contents = tile.content.iter().chain(&tile.contents).filter_map(|content| content.uri());
        for (reference, is_content) in contents.map(|uri| (uri, true)).chain(imagery.map(|uri| (uri, false))) {
            let uri = match resolve(base, reference, &options.root) {
                Ok(uri) => uri,
                Err(e) => {
                    self.info.fail(&e);
                    continue;
                }
            };
            if path_of(&uri).ends_with(".json") {
                if !self.meets() {
                    return false;
                }
                match self.external(base, &uri, level, options) {
                    Ok(goes_on) if !goes_on => return false,
                    Ok(_) => {}
                    Err(e) => self.info.fail(&e),
                }
                continue;
            }
            self.info.contents += u64::from(is_content);
            self.info.level(level).contents += u64::from(is_content);
            if is_remote(&uri) {
                continue;
            }
            match self.from.size(&uri) {
                Ok(bytes) => {
                    self.info.bytes += bytes;
                    self.info.level(level).bytes += bytes;
                }
                Err(e) => self.info.fail(&e),
            }
        }
        tile.children.iter().all(|child| self.tile(base, child, (level + 1, depth + 1), options))
    }

    /// A tileset that a tile of a level names, in the file `base`. False where the walk ends.
    fn external(
        &mut self,
        base: &Arc<str>,
        uri: &Arc<str>,
        level: u32,
        options: &ReadOptions,
    ) -> Result<bool, IoError> {
        if uri == base || options.chain.contains(uri) {
            return Err(IoError::unsupported(uri, "the tileset contains itself"));
        }
        if options.chain.len() >= options.limits.max_external_depth {
            return Err(IoError::invalid(uri, "external tilesets are nested too deep"));
        }
        let bytes = self.from.read(uri)?;
        let json = tileset::parse(uri, &bytes)?;
        self.info.bytes += bytes.len() as u64;
        self.info.extensions.extend(json.extensions_used.iter().cloned());
        let below = options.below(base);
        if let Err(e) = tileset::read(uri, &bytes, &below) {
            self.info.fail(&e);
        }
        Ok(self.tile(uri, &json.root, (level + 1, 0), &below))
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
        let [x, y, z] = self.bounds.center;
        writeln!(f, "bounds: centre {x:.1} {y:.1} {z:.1}, radius {:.1} m", self.bounds.radius_m)?;
        if let Some([west, south, east, north, low, high]) = self.bounds.region.as_deref() {
            let d = |a: &f64| a.to_degrees();
            let (w, s, e, n) = (d(west), d(south), d(east), d(north));
            writeln!(f, "region: {w:.5} {s:.5} to {e:.5} {n:.5} degrees, {low:.1} to {high:.1} m")?;
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

    /// Its path was cut at the sign: tilesets below counted as contents.
    #[test]
    fn a_folder_may_have_the_signs_of_a_query() {
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
