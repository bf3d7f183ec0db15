//! [`Info`]: the summary of a tile set, for `terrane info`. Plain values.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::measure::LevelMeasures;
use super::metadata::MetadataInfo;
use super::model::ModelInfo;
use super::report::{InfoError, record};
use crate::fetch::{IoError, printable};
use crate::formats::tile::Body;

/// Summary of a tile set. Its many fields are the keys of the JSON document.
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
    /// Properties of the format alone, by name: its projection, reference system, layers.
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
    /// West, south, east and north in radians, then lowest and highest height in metres if they are known: those of the terrain
    /// if the metadata of the set says them, else those of the root's volume, which holds skirts too.
    pub region: Option<Vec<f64>>,
}

impl BoundsInfo {
    /// Replaces the heights of the region by those that [`survey`](super::survey) has measured.
    pub fn measure(&mut self, levels: &[LevelMeasures]) {
        let measured = levels.iter().filter_map(|level| level.heights_m);
        let both = |a: [f64; 2], b: [f64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        self.set_heights(measured.reduce(both));
    }

    pub(super) fn set_heights(&mut self, heights_m: Option<[f64; 2]>) {
        if let (Some([_, _, _, _, low, high]), Some([lowest, highest])) = (self.region.as_deref_mut(), heights_m)
            && lowest <= highest
        {
            (*low, *high) = (lowest, highest);
        }
    }
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

    pub(super) fn level(&mut self, level: u32) -> &mut LevelInfo {
        while self.levels.len() <= level as usize {
            self.levels.push(LevelInfo { level: self.levels.len() as u32, ..LevelInfo::default() });
        }
        &mut self.levels[level as usize]
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
