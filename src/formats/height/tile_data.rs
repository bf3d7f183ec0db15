//! The properties of height tiles in a tileset, and their transport to the decoder of the content. Decode threads.
//!
//! `asset.extras.terrane` of the tileset has the properties that all tiles share. Each tile has a region (or
//! `extras.terrane.plane`: smallest x and y, largest x and y in metres, for sets that are not on the earth) and
//! `extras.terrane.imagery`. The reader of the tileset passes both to the decoder as `reader_data`, JSON of [`TileData`].

use std::f64::consts::TAU;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::layout::Placement;
use crate::fetch::IoError;
use crate::math::BoundingVolume;

/// The JSON of `asset.extras.terrane`.
#[derive(Debug, Deserialize)]
pub(in crate::formats) struct SetExtras {
    content: Option<String>,
    side: Option<u32>,
    border: Option<u32>,
    level_errors_m: Option<Vec<f64>>,
    /// The level of the tileset's root in the set; 0 if it is missing. External tilesets continue the levels of others.
    level: Option<u32>,
}

impl SetExtras {
    /// Returns true if the contents are height tiles.
    pub fn is_height(&self) -> bool {
        self.content.as_deref() == Some("height")
    }
}

/// The JSON of `extras.terrane` of a tile.
#[derive(Debug, Deserialize)]
pub(in crate::formats) struct TileExtras {
    /// The rectangle in the frame of the set: the smallest x and y, then the largest; metres.
    pub plane: Option<[f64; 4]>,
    /// A reference to the image that covers the tile.
    pub imagery: Option<String>,
}

/// The checked properties that all tiles of a height tile set share.
#[derive(Clone, Debug)]
pub(in crate::formats) struct HeightSet {
    /// Samples along a side.
    side: u32,
    /// Additional samples beyond each edge.
    border: u32,
    /// Geometric errors by level of the whole set, in metres.
    level_errors_m: Vec<f64>,
    /// The level of the tileset's root in the whole set: above 0 in external tilesets.
    root_level: u32,
}

/// The properties of one height tile that its decoder needs beside the EXR.
#[derive(Serialize, Deserialize)]
pub(super) struct TileData {
    #[serde(flatten)]
    pub placement: Placement,
    /// Samples along a side.
    pub side: u32,
    /// Additional samples beyond each edge.
    pub border: u32,
    pub level: u32,
    /// Geometric errors in metres: of the tile's own level, then of the coarser levels, nearest first.
    pub errors_m: Vec<f64>,
    /// URI of the image that covers the tile.
    pub imagery: Option<Arc<str>>,
}

impl TileData {
    /// Returns the name of the first invalid property as an error. Data from tilesets is valid; data that an application wrote
    /// may not be.
    pub fn check(&self) -> Result<(), &'static str> {
        let parts = [
            (self.placement.is_valid(), "region or plane"),
            (is_side(self.side), "side"),
            (self.border == 1, "border"),
            (are_errors(&self.errors_m), "errors_m"),
        ];
        parts.into_iter().find(|(is_valid, _)| !is_valid).map_or(Ok(()), |(_, part)| Err(part))
    }
}

/// Returns true for a valid number of samples along a side: a power of two plus one.
fn is_side(side: u32) -> bool {
    (3..=257).contains(&side) && (side - 1).is_power_of_two()
}

/// The highest level of a tileset's root.
const MAX_LEVEL: u32 = 63;

fn are_errors(errors_m: &[f64]) -> bool {
    errors_m.len() <= 64 && errors_m.iter().all(|e| e.is_finite() && *e >= 0.0)
}

impl HeightSet {
    #[cfg(test)]
    pub(super) fn for_tests(side: u32, error_m: f64) -> Self {
        Self { side, border: 1, level_errors_m: vec![error_m], root_level: 0 }
    }

    /// Checks the extras of a tileset. Returns `None` if its contents are not height tiles.
    pub fn from_extras(uri: &str, extras: Option<SetExtras>) -> Result<Option<Self>, IoError> {
        let Some(extras) = extras.filter(SetExtras::is_height) else { return Ok(None) };
        let bad = |what: &str| IoError::invalid(uri, format!("asset.extras.terrane.{what} is missing or invalid"));
        Ok(Some(Self {
            side: extras.side.filter(|side| is_side(*side)).ok_or_else(|| bad("side"))?,
            border: extras.border.filter(|border| *border == 1).ok_or_else(|| bad("border"))?,
            level_errors_m: extras.level_errors_m.filter(|e| are_errors(e)).ok_or_else(|| bad("level_errors_m"))?,
            root_level: extras
                .level
                .map_or(Ok(0), |level| if level <= MAX_LEVEL { Ok(level) } else { Err(bad("level")) })?,
        }))
    }

    /// Returns the geometric error in metres of all tiles of a level, which counts from the tileset's root. It is the same for
    /// all, so that neighbours morph alike.
    pub fn level_error_m(&self, level: u32) -> Option<f64> {
        self.set_error_m(self.root_level + level)
    }

    /// Returns the geometric error in metres of all tiles of a level of the whole set.
    fn set_error_m(&self, level: u32) -> Option<f64> {
        self.level_errors_m.get(level as usize).copied()
    }

    /// Returns the `reader_data` of a tile, whose level counts from the tileset's root. The rectangle of the tile is that of its
    /// volume, if it is a region and the tile has no plane. `imagery` is the URI of the image that covers the tile.
    ///
    /// # Errors
    /// [`IoError::Invalid`] for a tile that has neither a region nor a plane.
    pub fn tile_data(
        &self,
        tileset_uri: &str,
        level: u32,
        bounds: &BoundingVolume,
        plane: Option<[f64; 4]>,
        imagery: Option<Arc<str>>,
    ) -> Result<Arc<str>, IoError> {
        let placement = match (bounds, plane) {
            (BoundingVolume::Region(r), None) => {
                let east = if r.east < r.west { r.east + TAU } else { r.east };
                Placement::Region([r.west, r.south, east, r.north])
            }
            (_, Some(p)) if Placement::Plane(p).is_valid() => Placement::Plane(p),
            _ => return Err(IoError::invalid(tileset_uri, "a height tile needs a region, or a plane in its extras")),
        };
        let level = self.root_level + level;
        let errors_m = (0..=level).rev().take(7).filter_map(|l| self.set_error_m(l)).collect();
        let data = TileData { placement, side: self.side, border: self.border, level, errors_m, imagery };
        let json = serde_json::to_string(&data).map_err(|e| IoError::invalid(tileset_uri, e.to_string()))?;
        Ok(json.into())
    }
}

/// Returns the region of a height tile on the ellipsoid of its set: west, south, east and north in radians.
pub(in crate::formats) fn region(reader_data: &str) -> Option<[f64; 4]> {
    match serde_json::from_str::<TileData>(reader_data).ok()?.placement {
        Placement::Region(region) => Some(region),
        Placement::Plane(_) => None,
    }
}

/// Returns the URI of the imagery of a height tile.
pub(in crate::formats) fn companions(_uri: &Arc<str>, reader_data: Option<&str>) -> Vec<Arc<str>> {
    let data = reader_data.and_then(|d| serde_json::from_str::<TileData>(d).ok());
    data.and_then(|d| d.imagery).into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Region, WGS84};

    #[test]
    fn levels_of_external_tilesets_count_from_the_root_of_the_set() {
        let extras = |level: &str| {
            let json = format!(r#"{{"content":"height","side":65,"border":1,"level_errors_m":[90,50,20,5]{level}}}"#);
            HeightSet::from_extras("set", Some(serde_json::from_str(&json).unwrap()))
        };
        let of = |set: HeightSet, level: u32| {
            let (south, north) = (0.8, 0.81);
            let bounds =
                Region { west: 0.1, south, east: 0.11, north, min_height_m: 0.0, max_height_m: 9.0, ellipsoid: WGS84 };
            let data = set.tile_data("/set/tileset.json", level, &BoundingVolume::Region(bounds), None, None);
            let data: TileData = serde_json::from_str(&data.unwrap()).unwrap();
            (data.level, data.errors_m, set.level_error_m(level))
        };
        assert_eq!(of(extras("").unwrap().unwrap(), 1), (1, vec![50.0, 90.0], Some(50.0)));
        assert_eq!(of(extras(r#","level":2"#).unwrap().unwrap(), 1), (3, vec![5.0, 20.0, 50.0, 90.0], Some(5.0)));
        assert!(extras(r#","level":64"#).is_err());
    }
}
