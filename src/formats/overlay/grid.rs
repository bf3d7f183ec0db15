//! [`TileGrid`]: the tiles of a map server, level by level, and which of them cover an area. Arithmetic; any thread.
//!
//! Units are metres of EPSG:3857 for Web Mercator and degrees for geographic tiles. Rows count from the north.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};
use std::sync::Arc;

/// The radius of Web Mercator's sphere in metres: the semi-major axis of WGS84.
const RADIUS_M: f64 = 6_378_137.0;
/// The latitude at which the square world of Web Mercator ends, in radians (85.0511 degrees).
const MAX_MERCATOR_LATITUDE: f64 = 1.484_422_229_745_332_2;
/// A tile that an area covers by less than this part of its side is left out, so that rounded edges request no neighbours.
const EDGE_SLACK: f64 = 1.0 / 512.0;
/// The maximum number of tiles of one overlay that are composed for one area.
pub(super) const MAX_TILES: u64 = 64;

/// A rectangle of longitudes and latitudes in radians. East is beyond pi for a rectangle across the antimeridian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeoRectangle {
    /// Western edge, -pi to pi.
    pub west: f64,
    /// Southern edge, at least -pi/2.
    pub south: f64,
    /// Eastern edge, from `west` to `west` + 2 pi.
    pub east: f64,
    /// Northern edge, at most pi/2.
    pub north: f64,
}

impl GeoRectangle {
    /// The whole earth.
    pub const WORLD: Self = Self { west: -PI, south: -FRAC_PI_2, east: PI, north: FRAC_PI_2 };

    /// Creates a rectangle from degrees. East may be less than west across the antimeridian. Returns `None` if a value is
    /// out of range, or the rectangle is empty.
    pub fn from_degrees([west, south, east, north]: [f64; 4]) -> Option<Self> {
        let east = if east < west { east + 360.0 } else { east };
        let is_valid = west.abs() <= 360.0 && south >= -90.0 && north <= 90.0 && south < north;
        let rectangle = Self {
            west: west.to_radians(),
            south: south.to_radians(),
            east: east.to_radians(),
            north: north.to_radians(),
        };
        // One step of rounding more than the whole earth is the whole earth.
        (is_valid && west < east && east - west <= 360.0 + 1e-9).then_some(rectangle)
    }

    /// Returns the smallest rectangle around points, given as longitude and latitude. Longitudes are taken on the side of the
    /// earth around `middle`, so that points across the antimeridian stay together. Returns `None` without points.
    pub(crate) fn around(middle: f64, points: impl IntoIterator<Item = [f64; 2]>) -> Option<Self> {
        let mut found: Option<Self> = None;
        for [longitude, latitude] in points {
            let longitude = near(longitude, middle);
            let known =
                found.get_or_insert(Self { west: longitude, south: latitude, east: longitude, north: latitude });
            known.west = known.west.min(longitude);
            known.east = known.east.max(longitude);
            known.south = known.south.min(latitude);
            known.north = known.north.max(latitude);
        }
        found
    }

    /// Returns the extent in longitude, radians.
    pub fn width(&self) -> f64 {
        self.east - self.west
    }

    /// Returns the extent in latitude, radians.
    pub fn height(&self) -> f64 {
        self.north - self.south
    }

    /// Returns the latitude of the rectangle that is closest to the equator.
    fn latitude_near_equator(&self) -> f64 {
        0.0f64.clamp(self.south, self.north.max(self.south))
    }
}

/// Returns the longitude that is at most pi from `middle`.
pub(crate) fn near(longitude: f64, middle: f64) -> f64 {
    longitude + ((middle - longitude) / TAU).round() * TAU
}

/// How a map server projects its tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tiling {
    /// Web Mercator (EPSG:3857): one tile at level 0, up to 85.05 degrees north and south.
    #[default]
    WebMercator,
    /// Longitude and latitude (EPSG:4326): two tiles side by side at level 0.
    Geographic,
}

impl Tiling {
    /// Returns the coordinate of a longitude in units.
    pub fn x(self, longitude: f64) -> f64 {
        match self {
            Self::WebMercator => longitude * RADIUS_M,
            Self::Geographic => longitude.to_degrees(),
        }
    }

    /// Returns the coordinate of a latitude in units; that of the last row beyond the limit of the projection.
    pub fn y(self, latitude: f64) -> f64 {
        match self {
            Self::WebMercator => {
                let latitude = latitude.clamp(-MAX_MERCATOR_LATITUDE, MAX_MERCATOR_LATITUDE);
                RADIUS_M * (FRAC_PI_4 + 0.5 * latitude).tan().ln()
            }
            Self::Geographic => latitude.to_degrees(),
        }
    }

    /// Returns the length of a unit in metres: of latitude if it differs. Web Mercator stretches with the latitude.
    fn metres_per_unit(self, latitude: f64) -> f64 {
        match self {
            Self::WebMercator => latitude.abs().min(MAX_MERCATOR_LATITUDE).cos(),
            Self::Geographic => RADIUS_M.to_radians(),
        }
    }

    /// Returns the width of the earth in units.
    pub(super) fn world_width(self) -> f64 {
        self.x(TAU)
    }

    /// Returns the coordinates of the north-western corner of the earth.
    pub(super) fn world_corner(self) -> [f64; 2] {
        [self.x(-PI), self.y(FRAC_PI_2)]
    }
}

/// A rectangle in units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Area {
    pub left: f64,
    pub bottom: f64,
    pub right: f64,
    pub top: f64,
}

impl Area {
    /// Returns the rectangle of a tiling.
    pub fn of(tiling: Tiling, rectangle: &GeoRectangle) -> Self {
        Self {
            left: tiling.x(rectangle.west),
            bottom: tiling.y(rectangle.south),
            right: tiling.x(rectangle.east),
            top: tiling.y(rectangle.north),
        }
    }

    fn shifted(self, x: f64) -> Self {
        Self { left: self.left + x, right: self.right + x, ..self }
    }

    fn intersection(self, other: &Self) -> Self {
        Self {
            left: self.left.max(other.left),
            bottom: self.bottom.max(other.bottom),
            right: self.right.min(other.right),
            top: self.top.min(other.top),
        }
    }

    fn center(&self) -> [f64; 2] {
        [0.5 * (self.left + self.right), 0.5 * (self.bottom + self.top)]
    }
}

/// A level of a grid.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GridLevel {
    /// The name of the level in URLs.
    pub name: Arc<str>,
    /// The north-western corner of the first tile.
    pub corner: [f64; 2],
    /// Width and height of a tile in units.
    pub tile: [f64; 2],
    /// Width and height of a tile in pixels; `None` for a single image, whose size is not known before it is read.
    pub tile_px: Option<[u32; 2]>,
    pub columns: u32,
    pub rows: u32,
}

impl GridLevel {
    /// Returns the larger side of a pixel in units; 0 if it is unknown.
    fn pixel(&self) -> f64 {
        let [width, height] = self.tile_px.unwrap_or([0; 2]);
        if width == 0 || height == 0 {
            return 0.0;
        }
        (self.tile[0] / f64::from(width)).max(self.tile[1] / f64::from(height))
    }

    fn area(&self) -> Area {
        Area {
            left: self.corner[0],
            bottom: self.corner[1] - f64::from(self.rows) * self.tile[1],
            right: self.corner[0] + f64::from(self.columns) * self.tile[0],
            top: self.corner[1],
        }
    }
}

/// A tile of a grid: the index of its level, its column and its row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct TileIndex {
    pub level: usize,
    pub column: u32,
    pub row: u32,
}

/// The tiles of a level that cover an area. Columns beyond the last one continue with the first: they are across the
/// antimeridian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cover {
    pub level: usize,
    pub first_column: i64,
    pub first_row: u32,
    pub columns: u32,
    pub rows: u32,
    /// Added to the x of a longitude of the rectangle to get that of the cover.
    pub shift: f64,
    /// The part of the rectangle that the overlay has pixels for.
    pub area: Area,
}

impl Cover {
    pub fn tiles(&self) -> u64 {
        u64::from(self.columns) * u64::from(self.rows)
    }
}

/// The tiles of a map server.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TileGrid {
    pub tiling: Tiling,
    /// Coarse levels first; at least one.
    pub levels: Vec<GridLevel>,
    /// The rectangle that has images; `None` for the whole grid.
    pub rectangle: Option<GeoRectangle>,
}

impl TileGrid {
    /// Returns the usual quadtree of tiles around the earth.
    pub fn world(tiling: Tiling, levels: std::ops::RangeInclusive<u32>, tile_px: u32) -> Self {
        let level = |level: u32| {
            let rows = 1u32 << level.min(30);
            let columns = if tiling == Tiling::WebMercator { rows } else { 2 * rows };
            let side = tiling.world_width() / f64::from(columns);
            GridLevel {
                name: level.to_string().into(),
                corner: tiling.world_corner(),
                tile: [side; 2],
                tile_px: Some([tile_px; 2]),
                columns,
                rows,
            }
        };
        Self { tiling, levels: levels.map(level).collect(), rectangle: None }
    }

    /// Returns a grid of one image that covers a rectangle.
    pub fn image(tiling: Tiling, rectangle: GeoRectangle) -> Self {
        let area = Area::of(tiling, &rectangle);
        let level = GridLevel {
            name: Arc::from("0"),
            corner: [area.left, area.top],
            tile: [area.right - area.left, area.top - area.bottom],
            tile_px: None,
            columns: 1,
            rows: 1,
        };
        Self { tiling, levels: vec![level], rectangle: Some(rectangle) }
    }

    /// Returns true if the columns of a level go around the earth.
    fn is_around(&self, level: &GridLevel) -> bool {
        let width = f64::from(level.columns) * level.tile[0];
        (width / self.tiling.world_width() - 1.0).abs() < 1e-6 && level.columns > 0
    }

    /// Returns the coarsest level whose pixels are at most the square root of two times `texel_m`, metres on the ground; the
    /// finest level if all are coarser.
    pub fn level_of(&self, texel_m: f64, rectangle: &GeoRectangle) -> usize {
        let metres = self.tiling.metres_per_unit(rectangle.latitude_near_equator());
        let is_fine = |level: &GridLevel| level.pixel() * metres <= texel_m * std::f64::consts::SQRT_2;
        self.levels.iter().position(is_fine).unwrap_or(self.levels.len().saturating_sub(1))
    }

    /// Returns the tiles of a level that cover a rectangle; `None` if the overlay has nothing there.
    pub fn cover(&self, level_index: usize, rectangle: &GeoRectangle) -> Option<Cover> {
        let level = self.levels.get(level_index)?;
        let wanted = Area::of(self.tiling, rectangle);
        let world = self.tiling.world_width();
        let mut limits = level.area();
        if self.is_around(level) {
            (limits.left, limits.right) = (f64::NEG_INFINITY, f64::INFINITY);
        }
        let mut best: Option<(f64, f64, Area)> = None;
        for turn in [0.0, 1.0, -1.0] {
            let shift = turn * world;
            let mut found = wanted.shifted(shift).intersection(&limits);
            if let Some(rectangle) = &self.rectangle {
                found = found.intersection(&Area::of(self.tiling, rectangle));
            }
            // A rectangle beyond the last latitude of Web Mercator has the last row.
            let is_there = found.right > found.left && (found.top > found.bottom || wanted.top <= wanted.bottom);
            let width = found.right - found.left;
            if is_there && best.as_ref().is_none_or(|(known, ..)| width > *known) {
                best = Some((width, shift, found));
            }
        }
        let (_, shift, area) = best?;
        let [left, top] = level.corner;
        let span = |from: f64, to: f64, side: f64| {
            let slack = EDGE_SLACK.min(0.25 * (to - from) / side);
            let first = (from / side + slack).floor();
            (first, ((to / side - slack).ceil() - first).max(1.0))
        };
        let (first_column, columns) = span(area.left - left, area.right - left, level.tile[0]);
        let (first_row, rows) = span(top - area.top, top - area.bottom, level.tile[1]);
        if !(columns <= 1e6 && rows <= 1e6 && first_column.abs() < 1e12) {
            return None;
        }
        let last_row = level.rows.saturating_sub(1);
        let first_row = (first_row.max(0.0) as u32).min(last_row);
        let rows = (rows as u32).min(level.rows.saturating_sub(first_row)).max(1);
        let (mut first_column, mut columns) = (first_column as i64, columns as u32);
        if self.is_around(level) {
            columns = columns.min(level.columns);
        } else {
            first_column = first_column.clamp(0, i64::from(level.columns.saturating_sub(1)));
            columns = columns.min(level.columns.saturating_sub(first_column as u32)).max(1);
        }
        Some(Cover { level: level_index, first_column, first_row, columns, rows, shift, area })
    }

    /// Returns the tiles for texels of `texel_m` metres: of a coarser level if they would be more than [`MAX_TILES`] or more
    /// than `max_px` pixels wide or high.
    pub fn cover_for(&self, texel_m: f64, rectangle: &GeoRectangle, max_px: u32) -> Option<Cover> {
        let mut level = self.level_of(texel_m, rectangle);
        loop {
            let cover = self.cover(level, rectangle)?;
            let [width, height] = self.size_px(&cover, rectangle, 0.0);
            let limit = f64::from(max_px) * std::f64::consts::SQRT_2;
            if level == 0 || (cover.tiles() <= MAX_TILES && width.max(height) <= limit) {
                return (cover.tiles() <= MAX_TILES).then_some(cover);
            }
            level -= 1;
        }
    }

    /// Returns the size of a rectangle in pixels of a cover, or in texels of `texel_m` metres if those are larger.
    pub fn size_px(&self, cover: &Cover, rectangle: &GeoRectangle, texel_m: f64) -> [f64; 2] {
        let area = Area::of(self.tiling, rectangle);
        let texel = texel_m / self.tiling.metres_per_unit(rectangle.latitude_near_equator());
        let pixel = self.levels.get(cover.level).map_or(0.0, GridLevel::pixel).max(texel).max(1e-9);
        [(area.right - area.left) / pixel, (area.top - area.bottom) / pixel]
    }

    /// Returns the tile at a column and a row of a cover.
    pub fn tile_at(&self, cover: &Cover, column: u32, row: u32) -> TileIndex {
        let columns = self.levels.get(cover.level).map_or(1, |level| i64::from(level.columns.max(1)));
        let column = (cover.first_column + i64::from(column)).rem_euclid(columns) as u32;
        TileIndex { level: cover.level, column, row: cover.first_row + row }
    }

    /// Returns the area of a tile.
    pub fn area_of(&self, tile: TileIndex) -> Option<Area> {
        let level = self.levels.get(tile.level)?;
        let left = level.corner[0] + f64::from(tile.column) * level.tile[0];
        let top = level.corner[1] - f64::from(tile.row) * level.tile[1];
        Some(Area { left, bottom: top - level.tile[1], right: left + level.tile[0], top })
    }

    /// Returns the area of the tile at a column and a row of a cover; beyond the antimeridian where its cover is.
    pub fn continuous_area(&self, cover: &Cover, column: u32, row: u32) -> Option<Area> {
        let level = self.levels.get(cover.level)?;
        let left = level.corner[0] + (cover.first_column + i64::from(column)) as f64 * level.tile[0];
        let top = level.corner[1] - f64::from(cover.first_row + row) * level.tile[1];
        Some(Area { left, bottom: top - level.tile[1], right: left + level.tile[0], top })
    }

    /// Returns the area of all tiles of a cover.
    pub fn area_of_cover(&self, cover: &Cover) -> Option<Area> {
        let first = self.continuous_area(cover, 0, 0)?;
        let last = self.continuous_area(cover, cover.columns.saturating_sub(1), cover.rows.saturating_sub(1))?;
        Some(Area { right: last.right, bottom: last.bottom, ..first })
    }

    /// Returns the tile of the next coarser level that contains the centre of a tile.
    pub fn coarser(&self, tile: TileIndex) -> Option<TileIndex> {
        let level_index = tile.level.checked_sub(1)?;
        let level = self.levels.get(level_index)?;
        let [x, y] = self.area_of(tile)?.center();
        let column = ((x - level.corner[0]) / level.tile[0]).floor();
        let row = ((level.corner[1] - y) / level.tile[1]).floor();
        let is_inside =
            (0.0..f64::from(level.columns)).contains(&column) && (0.0..f64::from(level.rows)).contains(&row);
        is_inside.then_some(TileIndex { level: level_index, column: column as u32, row: row as u32 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn degrees(edges: [f64; 4]) -> GeoRectangle {
        GeoRectangle::from_degrees(edges).unwrap()
    }

    /// Returns the columns and rows of a cover.
    fn tiles(grid: &TileGrid, level: usize, rectangle: &GeoRectangle) -> Vec<[u32; 2]> {
        let Some(cover) = grid.cover(level, rectangle) else { return Vec::new() };
        let all = (0..cover.rows).flat_map(|row| (0..cover.columns).map(move |column| (column, row)));
        all.map(|(column, row)| grid.tile_at(&cover, column, row)).map(|tile| [tile.column, tile.row]).collect()
    }

    /// The numbers are those of the usual formula of "slippy map" tiles.
    #[test]
    fn tiles_of_web_mercator_are_those_of_the_usual_formula() {
        let grid = TileGrid::world(Tiling::WebMercator, 0..=18, 256);
        for (longitude, latitude) in [(8.54f64, 47.37f64), (-122.4, 37.8), (151.2, -33.9), (0.1, 84.9)] {
            for level in [0usize, 1, 5, 12, 18] {
                let n = f64::from(1u32 << level);
                let x = ((longitude + 180.0) / 360.0 * n) as u32;
                let lat = latitude.to_radians();
                let y = ((1.0 - (lat.tan() + 1.0 / lat.cos()).ln() / PI) / 2.0 * n) as u32;
                let around = degrees([longitude - 1e-7, latitude - 1e-7, longitude + 1e-7, latitude + 1e-7]);
                assert_eq!(tiles(&grid, level, &around), [[x, y]], "{longitude} {latitude} {level}");
            }
        }
    }

    #[test]
    fn aligned_rectangle_has_its_own_tile_alone() {
        let grid = TileGrid::world(Tiling::Geographic, 0..=10, 256);
        assert_eq!(tiles(&grid, 0, &GeoRectangle::WORLD), [[0, 0], [1, 0]]);
        let quarter = degrees([0.0, 0.0, 90.0, 90.0]);
        assert_eq!(tiles(&grid, 1, &quarter), [[2, 0]]);
        assert_eq!(tiles(&grid, 2, &quarter), [[4, 0], [5, 0], [4, 1], [5, 1]]);
        // Edges that are rounded differently request no neighbours.
        let rounded = degrees([-1e-6, -1e-6, 90.000_001, 89.999_999]);
        assert_eq!(tiles(&grid, 1, &rounded), [[2, 0]]);
    }

    #[test]
    fn rectangle_across_the_antimeridian_wraps() {
        for tiling in [Tiling::WebMercator, Tiling::Geographic] {
            let grid = TileGrid::world(tiling, 0..=10, 256);
            let columns = if tiling == Tiling::WebMercator { 8 } else { 16 };
            let wide = if tiling == Tiling::WebMercator { 45.0 } else { 22.5 };
            let rectangle = degrees([180.0 - wide, 1.0, wide - 180.0, 2.0]);
            let found = tiles(&grid, 3, &rectangle);
            assert_eq!(found.iter().map(|tile| tile[0]).collect::<Vec<_>>(), [columns - 1, 0], "{tiling:?}");
            // The same area, with longitudes from the other side of the antimeridian.
            let other = GeoRectangle { west: rectangle.west - TAU, east: rectangle.east - TAU, ..rectangle };
            assert_eq!(tiles(&grid, 3, &other), found);
        }
    }

    #[test]
    fn poles_have_the_last_rows_of_web_mercator() {
        let grid = TileGrid::world(Tiling::WebMercator, 0..=10, 256);
        assert_eq!(tiles(&grid, 2, &degrees([0.0, 86.0, 89.0, 90.0])), [[2, 0]]);
        assert_eq!(tiles(&grid, 2, &degrees([0.0, -90.0, 89.0, -88.0])), [[2, 3]]);
        let north = degrees([0.0, 60.0, 10.0, 90.0]);
        assert_eq!(tiles(&grid, 2, &north), [[2, 0], [2, 1]]);
    }

    #[test]
    fn overlay_covers_its_rectangle_alone() {
        let rectangle = degrees([170.0, -50.0, -170.0, -30.0]);
        let grid = TileGrid { rectangle: Some(rectangle), ..TileGrid::world(Tiling::Geographic, 0..=10, 256) };
        assert!(grid.cover(4, &degrees([100.0, -45.0, 110.0, -40.0])).is_none());
        assert!(grid.cover(4, &degrees([-175.0, 45.0, -172.0, 50.0])).is_none());
        let found = grid.cover(4, &degrees([-179.0, -41.0, -160.0, -40.0])).unwrap();
        assert!((found.area.right - 190.0).abs() < 1e-9, "{found:?}");
        let image = TileGrid::image(Tiling::Geographic, rectangle);
        let found = image.cover(0, &degrees([-179.0, -41.0, -160.0, -40.0])).unwrap();
        assert_eq!((found.columns, found.rows), (1, 1));
        assert!((found.area.left - 181.0).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn level_follows_texel_size_and_latitude() {
        let grid = TileGrid::world(Tiling::WebMercator, 0..=20, 256);
        let spacing = |level: usize| TAU * RADIUS_M / (256.0 * f64::from(1u32 << level));
        let equator = degrees([-1.0, -1.0, 1.0, 1.0]);
        for level in [0usize, 3, 10, 20] {
            for factor in [0.75, 1.0, 1.4] {
                assert_eq!(grid.level_of(spacing(level) * factor, &equator), level, "{factor}");
            }
        }
        assert_eq!(grid.level_of(0.0, &equator), 20);
        assert_eq!(grid.level_of(f64::INFINITY, &equator), 0);
        // At 60 degrees a pixel is half as large, so that a coarser level is fine enough.
        assert_eq!(grid.level_of(spacing(10), &degrees([0.0, 60.0, 1.0, 61.0])), 9);
        let shallow = TileGrid::world(Tiling::WebMercator, 4..=6, 256);
        assert_eq!((shallow.level_of(1e9, &equator), shallow.level_of(1e-9, &equator)), (0, 2));
        assert_eq!(&*shallow.levels[2].name, "6");
    }

    #[test]
    fn size_of_texture_limits_the_level() {
        let grid = TileGrid::world(Tiling::WebMercator, 0..=20, 256);
        let tile = degrees([0.0, 0.0, 90.0, 60.0]);
        let cover = grid.cover_for(0.0, &tile, 1024).unwrap();
        let [width, height] = grid.size_px(&cover, &tile, 0.0);
        assert!(width.max(height) <= 1449.0 && width.max(height) > 700.0, "{width} {height}");
        assert!(grid.cover_for(1.0, &GeoRectangle::WORLD, 1 << 20).unwrap().tiles() <= MAX_TILES);
        // The coarsest level is already too fine.
        let fine = TileGrid::world(Tiling::WebMercator, 9..=12, 256);
        assert_eq!(fine.cover_for(1.0, &GeoRectangle::WORLD, 1024), None);
    }

    #[test]
    fn coarser_tile_contains_the_finer_one() {
        for tiling in [Tiling::WebMercator, Tiling::Geographic] {
            let grid = TileGrid::world(tiling, 0..=6, 256);
            let tile = TileIndex { level: 5, column: 19, row: 6 };
            assert_eq!(grid.coarser(tile), Some(TileIndex { level: 4, column: 9, row: 3 }));
            assert_eq!(grid.coarser(TileIndex { level: 0, column: 0, row: 0 }), None);
        }
    }

    #[test]
    fn longitudes_stay_on_the_side_of_the_middle() {
        let around = GeoRectangle::around(PI, [[PI - 0.1, 0.1], [0.2 - PI, 0.0]]).unwrap();
        assert!((around.width() - 0.3).abs() < 1e-12 && around.height() == 0.1, "{around:?}");
        assert_eq!(GeoRectangle::around(0.0, []), None);
        assert_eq!(GeoRectangle::from_degrees([0.0, 10.0, 10.0, 5.0]), None);
        assert_eq!(GeoRectangle::from_degrees([f64::NAN, 0.0, 1.0, 1.0]), None);
    }
}
