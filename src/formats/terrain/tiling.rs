//! [`Tiling`]: how a terrain set divides its body, and the errors of its levels. Plain values.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::formats::implicit::TileCoordinates;
use crate::math::{Ellipsoid, Region};

/// The number of samples along a side of a tile that the errors of levels assume.
const SAMPLES: f64 = 65.0;
/// The share of the distance between two samples that the errors of levels assume.
const SHARE_OF_SAMPLE: f64 = 0.25;
/// The ratio of the usual limits on the screen: 16 pixels for tilesets, and 2 pixels for the terrain of CesiumJS.
const ERROR_SCALE: f64 = 8.0;
/// Tiles narrower than this share of their height, as a reciprocal, have smaller errors.
const NARROW_SHARE: f64 = 2.0;
/// The latitude at which the square of Web Mercator ends: `atan(sinh(PI))`.
const MERCATOR_LATITUDE: f64 = 1.484_422_229_745_332_4;
/// The number of tiles around a pole that Web Mercator does not reach.
const CAP_TILES: u32 = 8;

/// A part of an ellipsoid between two meridians and two parallels, radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rectangle {
    pub west: f64,
    pub south: f64,
    pub east: f64,
    pub north: f64,
}

impl Rectangle {
    /// Returns the ratio of a step of longitude to an equal step of latitude, at the edge that is nearer to the equator.
    fn width_share(&self) -> f64 {
        let nearest = if self.south * self.north <= 0.0 { 0.0 } else { self.south.abs().min(self.north.abs()) };
        nearest.cos()
    }

    /// Returns the part between two heights.
    pub fn region(&self, ellipsoid: Ellipsoid, [min_height_m, max_height_m]: [f64; 2]) -> Region {
        let Self { west, south, east, north } = *self;
        Region { west, south, east, north, min_height_m, max_height_m, ellipsoid }
    }
}

/// The division of an ellipsoid, or of a part of it, into tiles. Rows are counted from the south.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tiling {
    /// EPSG:4326: two root tiles.
    Geographic,
    /// EPSG:3857: one root tile, between 85.05 degrees south and north.
    Mercator,
    /// The part around the north pole that [`Self::Mercator`] does not reach.
    NorthCap,
    /// The part around the south pole.
    SouthCap,
}

impl Tiling {
    /// Returns the number of columns of level 0, which has one row.
    pub const fn root_columns(self) -> u32 {
        match self {
            Self::Geographic => 2,
            Self::Mercator => 1,
            Self::NorthCap | Self::SouthCap => CAP_TILES,
        }
    }

    /// Returns the number of columns and rows of a level.
    pub fn size(self, level: u32) -> [u64; 2] {
        [u64::from(self.root_columns()) << level, 1 << level]
    }

    /// Returns the rectangle of a tile.
    pub fn rectangle(self, tile: TileCoordinates) -> Rectangle {
        let [columns, _] = self.size(tile.level).map(|count| count as f64);
        let longitude = |x: f64| x / columns * TAU - PI;
        let (x, y) = (f64::from(tile.x), f64::from(tile.y));
        Rectangle {
            west: longitude(x),
            east: longitude(x + 1.0),
            south: self.latitude(tile.level, y),
            north: self.latitude(tile.level, y + 1.0),
        }
    }

    /// Returns the latitude of the southern edge of a row.
    fn latitude(self, level: u32, y: f64) -> f64 {
        let share = y / f64::from(level).exp2();
        match self {
            Self::Geographic => (share - 0.5) * PI,
            Self::Mercator => ((2.0 * share - 1.0) * PI).sinh().atan(),
            Self::NorthCap => MERCATOR_LATITUDE + share * (FRAC_PI_2 - MERCATOR_LATITUDE),
            Self::SouthCap => -FRAC_PI_2 + share * (FRAC_PI_2 - MERCATOR_LATITUDE),
        }
    }

    /// Returns the column and row, as real numbers, of a point in a level.
    pub fn position(self, level: u32, longitude: f64, latitude: f64) -> [f64; 2] {
        let [columns, rows] = self.size(level).map(|count| count as f64);
        let y = match self {
            Self::Mercator => 0.5 + latitude.clamp(-MERCATOR_LATITUDE, MERCATOR_LATITUDE).tan().asinh() / TAU,
            _ => latitude / PI + 0.5,
        };
        [(longitude + PI) / TAU * columns, y * rows]
    }

    /// Returns the error that CesiumJS assumes for a level of a heightmap and for all its terrain, metres: a quarter of the
    /// distance between two of 65 samples at the equator (`getEstimatedLevelZeroGeometricErrorForAHeightmap`).
    pub fn level_error_m(self, ellipsoid: &Ellipsoid, level: u32) -> f64 {
        let at_level_0 = match self {
            Self::NorthCap | Self::SouthCap => {
                let height = FRAC_PI_2 - MERCATOR_LATITUDE;
                ellipsoid.semi_major_m * height * SHARE_OF_SAMPLE / SAMPLES
            }
            _ => ellipsoid.semi_major_m * TAU * SHARE_OF_SAMPLE / (SAMPLES * f64::from(self.root_columns())),
        };
        at_level_0 / f64::from(level).exp2()
    }

    /// Returns the geometric error of a tile, metres. With the usual limit of 16 pixels a view has the tiles that CesiumJS shows
    /// with the usual limit of its terrain, which is 2 pixels. Beyond 60 degrees, where tiles are much narrower than high, it
    /// is less: all columns of a level meet at the pole.
    pub fn geometric_error_m(self, ellipsoid: &Ellipsoid, tile: TileCoordinates) -> f64 {
        ERROR_SCALE * self.narrowed_error_m(ellipsoid, tile)
    }

    fn narrowed_error_m(self, ellipsoid: &Ellipsoid, tile: TileCoordinates) -> f64 {
        self.level_error_m(ellipsoid, tile.level) * (NARROW_SHARE * self.rectangle(tile).width_share()).min(1.0)
    }

    /// Returns the numbers of parts of the width and of the height of a tile of the ellipsoid, powers of two. The ellipsoid
    /// bulges over a part by at most a 32nd of the error: a sixteenth of a pixel with the usual limit, since a step at the
    /// horizon is seen.
    pub fn ellipsoid_segments(self, ellipsoid: &Ellipsoid, tile: TileCoordinates) -> [u32; 2] {
        const MAX_SEGMENTS: u32 = 64;
        let rectangle = self.rectangle(tile);
        let Rectangle { west, south, east, north } = rectangle;
        [(east - west) * rectangle.width_share(), north - south].map(|angle| {
            let bulge_m = ellipsoid.semi_major_m * angle * angle / 8.0;
            let parts = (32.0 * bulge_m / self.narrowed_error_m(ellipsoid, tile)).sqrt().ceil() as u32;
            parts.next_power_of_two().clamp(2, MAX_SEGMENTS)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::WGS84;

    fn tile(level: u32, x: u32, y: u32) -> TileCoordinates {
        TileCoordinates { level, x, y, z: 0 }
    }

    #[test]
    fn tiles_cover_the_earth_without_a_gap() {
        for tiling in [Tiling::Geographic, Tiling::Mercator] {
            for level in 0..5 {
                let [columns, rows] = tiling.size(level).map(|count| count as u32);
                for (x, y) in (0..columns).flat_map(|x| (0..rows).map(move |y| (x, y))) {
                    let own = tiling.rectangle(tile(level, x, y));
                    assert!(own.west < own.east && own.south < own.north);
                    if x + 1 < columns {
                        assert_eq!(own.east, tiling.rectangle(tile(level, x + 1, y)).west);
                    }
                    if y + 1 < rows {
                        assert_eq!(own.north, tiling.rectangle(tile(level, x, y + 1)).south);
                    }
                    // Children end where their parent ends, to the last bit.
                    assert_eq!(tiling.rectangle(tile(level + 1, 2 * x, 2 * y)).west, own.west);
                    assert_eq!(tiling.rectangle(tile(level + 1, 2 * x + 1, 2 * y + 1)).north, own.north);
                    let middle = tiling.position(level, 0.5 * (own.west + own.east), 0.5 * (own.south + own.north));
                    assert_eq!(middle.map(f64::floor), [f64::from(x), f64::from(y)]);
                }
                assert_eq!(tiling.rectangle(tile(level, 0, 0)).west, -PI);
                assert_eq!(tiling.rectangle(tile(level, columns - 1, 0)).east, PI);
            }
        }
        assert_eq!(Tiling::Geographic.rectangle(tile(3, 0, 7)).north, FRAC_PI_2);
        let north = Tiling::Mercator.rectangle(tile(0, 0, 0)).north;
        assert!((north - Tiling::NorthCap.rectangle(tile(0, 0, 0)).south).abs() < 1e-12);
        assert!((north.to_degrees() - 85.051_128_78).abs() < 1e-8);
        assert_eq!(Tiling::NorthCap.rectangle(tile(2, 0, 3)).north, FRAC_PI_2);
        assert_eq!(Tiling::SouthCap.rectangle(tile(2, 0, 0)).south, -FRAC_PI_2);
    }

    #[test]
    fn errors_are_those_of_cesium() {
        assert!((Tiling::Geographic.level_error_m(&WGS84, 0) - 77_067.339_967_041).abs() < 0.01);
        assert!((Tiling::Mercator.level_error_m(&WGS84, 1) - Tiling::Geographic.level_error_m(&WGS84, 0)).abs() < 1e-9);
        let at = |level: u32, y: u32| Tiling::Geographic.geometric_error_m(&WGS84, tile(level, 0, y));
        assert!((at(20, 1 << 19) - 0.588).abs() < 0.001);
        // 60 degrees north is two thirds of the way from the equator to the pole.
        assert_eq!(at(10, 851), at(10, 512));
        assert!((at(10, 1023) / at(10, 512) - 2.0 * PI / 1024.0).abs() < 1e-6, "the row at the pole");
    }

    #[test]
    fn ellipsoid_is_smooth_at_each_level() {
        for tiling in [Tiling::Geographic, Tiling::NorthCap, Tiling::SouthCap] {
            for level in 0..22 {
                for y in [0, (1 << level) / 2, (1 << level) - 1] {
                    let at = tile(level, 0, y);
                    let rectangle = tiling.rectangle(at);
                    let angles = [rectangle.east - rectangle.west, rectangle.north - rectangle.south];
                    let [width, height] = tiling.ellipsoid_segments(&WGS84, at).map(f64::from);
                    for part in [angles[0] * rectangle.width_share() / width, angles[1] / height] {
                        let bulge_m = WGS84.semi_major_m * part * part / 8.0;
                        let error_m = tiling.geometric_error_m(&WGS84, at);
                        assert!(bulge_m <= 1.01 * error_m / 256.0, "{tiling:?} {level} {y}: {bulge_m} {error_m}");
                    }
                }
            }
        }
    }
}
