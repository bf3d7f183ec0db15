//! The properties of height tiles in a tileset, and their transport to the decoder of the content. Decode threads.
//!
//! `asset.extras.terrane` of the tileset has the properties that all tiles share. Each tile has a region (or
//! `extras.terrane.plane`: smallest x and y, largest x and y in metres, for sets that are not on the earth; or
//! `extras.terrane.region`, where its volume is wider than its heights), `extras.terrane.imagery`, and `extras.terrane.corner_errors_m`. Without the last, or if it is invalid, it has the error of its level
//! in `level_errors_m`, or else its `geometricError`. The reader of the tileset passes them to the decoder as `reader_data`,
//! JSON of [`TileData`].

use std::f64::consts::TAU;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::corner_errors::{CornerErrors, LevelErrors, are_valid, largest};
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
    /// The errors of the levels above an external tileset at the corners of its root, nearest first. Without them those of
    /// `level_errors_m` hold.
    above_errors_m: Option<Vec<CornerErrors>>,
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
    /// The rectangle of the heights where the region of the tile is wider: west, south, east and north in radians.
    pub region: Option<[f64; 4]>,
    /// A reference to the image that covers the tile.
    pub imagery: Option<String>,
    /// The geometric errors at the corners of the tile in metres: south-west, south-east, north-west, north-east.
    pub corner_errors_m: Option<CornerErrors>,
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
    /// The errors of the levels above the tileset's root, at the corners of the root.
    above_root: LevelErrors,
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
    /// Geometric errors in metres at the corners of the tile: of its level, then of the coarser levels, nearest first.
    pub errors_m: Vec<CornerErrors>,
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
            (are_corner_errors(&self.errors_m), "errors_m"),
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

fn are_corner_errors(errors_m: &[CornerErrors]) -> bool {
    errors_m.len() <= 64 && errors_m.iter().all(are_valid)
}

/// The description of a height tile in a tileset.
pub(in crate::formats) struct HeightTileJson<'a> {
    /// The level, which counts from the tileset's root.
    pub level: u32,
    pub bounds: &'a BoundingVolume,
    /// [`TileExtras::plane`].
    pub plane: Option<[f64; 4]>,
    /// [`TileExtras::region`].
    pub region: Option<[f64; 4]>,
    /// The URI of the image that covers the tile.
    pub imagery: Option<Arc<str>>,
    /// [`TileExtras::corner_errors_m`].
    pub corner_errors_m: Option<CornerErrors>,
    /// The geometric error in metres, which holds if neither the tile nor the tileset has others.
    pub geometric_error_m: f64,
}

/// The errors of a height tile and of the levels above it, and the rectangle at whose corners they hold. Tiles below it
/// interpolate between them.
#[derive(Clone, Copy, Debug)]
pub(in crate::formats) struct PlacedErrors {
    placement: Placement,
    errors: LevelErrors,
}

impl PlacedErrors {
    /// Returns the geometric error of the tile in metres, by which it is refined.
    pub fn geometric_error_m(&self) -> f64 {
        self.errors.levels().first().map_or(0.0, largest)
    }

    /// Returns the errors at the corners of a tile below.
    fn at(&self, below: Placement) -> LevelErrors {
        let (([west, south, east, north], turn), [own_west, own_south, own_east, own_north]) =
            match (self.placement, below) {
                (Placement::Region(whole), Placement::Region(part)) => ((whole, TAU), part),
                (Placement::Plane(whole), Placement::Plane(part)) => ((whole, 0.0), part),
                _ => return self.errors,
            };
        // A tile west of the antimeridian may lie in one that begins east of it.
        let turn = if 0.5 * (own_west + own_east) < west { turn } else { 0.0 };
        // Tiles divide the one above in halves; coordinates are rounded in JSON.
        let share =
            |at: f64, first: f64, last: f64| (2.0 * (at - first) / (last - first)).round().clamp(0.0, 2.0) / 2.0;
        self.errors.of_part(
            [share(own_west + turn, west, east), share(own_south, south, north)],
            [share(own_east + turn, west, east), share(own_north, south, north)],
        )
    }
}

impl HeightSet {
    #[cfg(test)]
    pub(super) fn for_tests(side: u32, error_m: f64) -> Self {
        Self { side, border: 1, level_errors_m: vec![error_m], root_level: 0, above_root: LevelErrors::default() }
    }

    /// Checks the extras of a tileset. Returns `None` if its contents are not height tiles.
    pub fn from_extras(uri: &str, extras: Option<SetExtras>) -> Result<Option<Self>, IoError> {
        let Some(extras) = extras.filter(SetExtras::is_height) else { return Ok(None) };
        let bad = |what: &str| IoError::invalid(uri, format!("asset.extras.terrane.{what} is missing or invalid"));
        let level_errors_m = extras.level_errors_m.filter(|e| are_errors(e)).ok_or_else(|| bad("level_errors_m"))?;
        let root_level = extras.level.unwrap_or(0);
        if root_level > MAX_LEVEL {
            return Err(bad("level"));
        }
        let above_root = match extras.above_errors_m {
            Some(errors_m) if are_corner_errors(&errors_m) => LevelErrors::new(&errors_m),
            Some(_) => return Err(bad("above_errors_m")),
            None => {
                let above = (0..root_level as usize).rev().filter_map(|level| level_errors_m.get(level));
                LevelErrors::new(&above.map(|error_m| [*error_m; 4]).collect::<Vec<_>>())
            }
        };
        Ok(Some(Self {
            side: extras.side.filter(|side| is_side(*side)).ok_or_else(|| bad("side"))?,
            border: extras.border.filter(|border| *border == 1).ok_or_else(|| bad("border"))?,
            level_errors_m,
            above_root,
            root_level,
        }))
    }

    /// Returns the errors at the corners of a tile: its own, or those of its level if it has none.
    fn own_errors(&self, tile: &HeightTileJson<'_>) -> CornerErrors {
        let of_level = || self.level_errors_m.get((self.root_level + tile.level) as usize);
        let own = tile.corner_errors_m.filter(are_valid);
        own.unwrap_or_else(|| [of_level().copied().unwrap_or(tile.geometric_error_m); 4])
    }

    /// Returns the errors of a tile. `above` are those of the tile that it is a part of; `None` for the tileset's root.
    /// The rectangle of the tile is that of its volume, if it is a region and the tile names no rectangle.
    ///
    /// # Errors
    /// [`IoError::Invalid`] for a tile that has neither a region nor a plane.
    pub fn errors(
        &self,
        tileset_uri: &str,
        tile: &HeightTileJson<'_>,
        above: Option<&PlacedErrors>,
    ) -> Result<PlacedErrors, IoError> {
        let placement = match (tile.bounds, tile.plane) {
            (BoundingVolume::Region(r), None) => {
                let of = |[west, south, east, north]: [f64; 4]| {
                    Placement::Region([west, south, if east < west { east + TAU } else { east }, north])
                };
                let own = tile.region.map(of).filter(|own| own.is_valid());
                own.unwrap_or_else(|| of([r.west, r.south, r.east, r.north]))
            }
            (_, Some(p)) if Placement::Plane(p).is_valid() => Placement::Plane(p),
            _ => return Err(IoError::invalid(tileset_uri, "a height tile needs a region, or a plane in its extras")),
        };
        let above = above.map_or(self.above_root, |above| above.at(placement));
        Ok(PlacedErrors { placement, errors: above.with_own(self.own_errors(tile)) })
    }

    /// Returns the `reader_data` of a tile with its errors.
    pub fn tile_data(
        &self,
        tileset_uri: &str,
        tile: HeightTileJson<'_>,
        errors: &PlacedErrors,
    ) -> Result<Arc<str>, IoError> {
        let data = TileData {
            placement: errors.placement,
            side: self.side,
            border: self.border,
            level: self.root_level + tile.level,
            errors_m: errors.errors.levels().to_vec(),
            imagery: tile.imagery,
        };
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
    use std::f64::consts::PI;

    use super::*;
    use crate::math::{Region, WGS84};

    fn region([west, south, east, north]: [f64; 4]) -> Region {
        Region { west, south, east, north, min_height_m: 0.0, max_height_m: 9.0, ellipsoid: WGS84 }
    }

    fn tile(bounds: &BoundingVolume, corner_errors_m: Option<CornerErrors>) -> HeightTileJson<'_> {
        HeightTileJson {
            level: 0,
            bounds,
            plane: None,
            region: None,
            imagery: None,
            corner_errors_m,
            geometric_error_m: 7.0,
        }
    }

    /// A tile interpolates between the corners of those above it, also across the antimeridian and in external tilesets.
    #[test]
    fn errors_of_coarser_levels_are_interpolated() {
        let json = r#"{"content":"height","side":65,"border":1,"level_errors_m":[90,50],"level":1,
            "above_errors_m":[[80,80,40,40]]}"#;
        let set = HeightSet::from_extras("set", Some(serde_json::from_str(json).unwrap())).unwrap().unwrap();
        let (west, east) = (PI - 0.02, 0.02 - PI);
        let whole = BoundingVolume::Region(region([west, 0.1, east, 0.3]));
        let root = set.errors("set", &tile(&whole, Some([10.0, 30.0, 10.0, 30.0])), None).unwrap();
        assert_eq!(root.errors.levels(), [[10.0, 30.0, 10.0, 30.0], [80.0, 80.0, 40.0, 40.0]]);
        assert_eq!(root.geometric_error_m(), 30.0);
        // The north-eastern quarter begins at the antimeridian, written as -180 degrees.
        let quarter = BoundingVolume::Region(region([-PI, 0.2, east, 0.3]));
        let part = HeightTileJson { level: 5, ..tile(&quarter, None) };
        let part = set.errors("set", &part, Some(&root)).unwrap();
        assert_eq!(part.errors.levels(), [[7.0; 4], [20.0, 30.0, 20.0, 30.0], [60.0, 60.0, 40.0, 40.0]]);
    }

    /// Trees at the edge of a tile reach over its heights, which then need a separate rectangle.
    #[test]
    fn heights_have_their_own_rectangle_in_a_wider_volume() {
        let json = r#"{"content":"height","side":65,"border":1,"level_errors_m":[90]}"#;
        let set = HeightSet::from_extras("set", Some(serde_json::from_str(json).unwrap())).unwrap().unwrap();
        let volume = BoundingVolume::Region(region([0.1, 0.8, 0.11, 0.81]));
        let placed = |region: Option<[f64; 4]>| match set
            .errors("set", &HeightTileJson { region, ..tile(&volume, None) }, None)
            .unwrap()
            .placement
        {
            Placement::Region(region) => region,
            Placement::Plane(plane) => panic!("{plane:?}"),
        };
        assert_eq!(placed(None), [0.1, 0.8, 0.11, 0.81]);
        assert_eq!(placed(Some([0.101, 0.801, 0.109, 0.809])), [0.101, 0.801, 0.109, 0.809]);
        // Across the antimeridian.
        assert_eq!(placed(Some([PI - 0.01, 0.801, 0.01 - PI, 0.809])), [PI - 0.01, 0.801, 0.01 - PI + TAU, 0.809]);
        // An invalid one does not count.
        assert_eq!(placed(Some([0.101, 0.809, 0.109, 0.801])), [0.1, 0.8, 0.11, 0.81]);
    }

    #[test]
    fn levels_of_external_tilesets_count_from_the_root_of_the_set() {
        let extras = |level: &str| {
            let json = format!(r#"{{"content":"height","side":65,"border":1,"level_errors_m":[90,50,20,5]{level}}}"#);
            HeightSet::from_extras("set", Some(serde_json::from_str(&json).unwrap()))
        };
        let of = |set: HeightSet, level: u32| {
            let bounds = BoundingVolume::Region(region([0.1, 0.8, 0.11, 0.81]));
            let tile = HeightTileJson { level, ..tile(&bounds, None) };
            let errors = set.errors("/set/tileset.json", &tile, None).unwrap();
            let data: TileData =
                serde_json::from_str(&set.tile_data("/set/tileset.json", tile, &errors).unwrap()).unwrap();
            (data.level, data.errors_m.iter().map(|corners| corners[0]).collect::<Vec<_>>(), errors.geometric_error_m())
        };
        assert_eq!(of(extras("").unwrap().unwrap(), 0), (0, vec![90.0], 90.0));
        assert_eq!(of(extras(r#","level":2"#).unwrap().unwrap(), 0), (2, vec![20.0, 50.0, 90.0], 20.0));
        assert!(extras(r#","level":64"#).is_err());
    }
}
