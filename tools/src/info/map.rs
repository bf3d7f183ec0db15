//! `terrane info --map`: a picture of the tiles of a set from above, as PNG with a legend.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use image::{Rgb, RgbImage};
use terrane::formats::{MapFrame, SurveyedTile};

use crate::args::MapOf;

/// The longer side of the map in pixels.
const SIDE_PX: u32 = 1024;
/// The height of the legend in pixels.
const LEGEND_PX: u32 = 34;
/// The maximum number of tiles of a map, 48 bytes each.
const MAX_TILES: usize = 5_000_000;
/// Tiles have an outline if they are larger than this, pixels.
const MIN_OUTLINED_PX: f64 = 6.0;
const BACKGROUND: Rgb<u8> = Rgb([24, 26, 30]);
const TEXT: Rgb<u8> = Rgb([235, 235, 235]);

#[derive(Clone, Copy)]
struct Tile {
    rectangle: [f64; 4],
    level: u32,
    value: f32,
}

/// The tiles of a map.
pub struct Map {
    of: MapOf,
    frame: MapFrame,
    tiles: Vec<Tile>,
    is_full: bool,
}

/// A colour of the legend, and what it means.
pub struct Swatch {
    pub color: [u8; 3],
    pub text: String,
}

impl Map {
    pub fn new(of: MapOf) -> Self {
        Self { of, frame: MapFrame::Local, tiles: Vec::new(), is_full: false }
    }

    pub fn add(&mut self, tile: &SurveyedTile) {
        let value = match self.of {
            MapOf::Levels => Some(f64::from(tile.level)).filter(|_| tile.has_content),
            MapOf::Error => tile.measured_m.or(tile.error_m).filter(|error_m| *error_m > 0.0),
            MapOf::Bytes => Some(tile.bytes as f64).filter(|_| tile.has_content),
            MapOf::Problems => Some(f64::from(u8::from(tile.has_problem))),
        };
        let (Some(rectangle), Some(value)) = (tile.rectangle, value) else { return };
        if self.tiles.len() == MAX_TILES {
            self.is_full = true;
            return;
        }
        self.frame = tile.frame;
        // A tile with a problem is seen above those without.
        let level = if self.of == MapOf::Problems && tile.has_problem { u32::MAX } else { tile.level };
        self.tiles.push(Tile { rectangle, level, value: value as f32 });
    }

    /// Writes the picture. Returns its size and the legend.
    pub fn write(mut self, file: &Path) -> Result<([u32; 2], Vec<Swatch>)> {
        ensure!(!self.is_full, "a map of more than {MAX_TILES} tiles; make one of a part of the set");
        ensure!(!self.tiles.is_empty(), "no tiles to draw a map of");
        let extent = self.extent();
        let [west, south, east, north] = extent;
        let shape = match self.frame {
            MapFrame::Globe(_) => (0.5 * (south + north)).cos().max(0.05),
            MapFrame::Local => 1.0,
        };
        let (width, height) = (((east - west) * shape).max(1e-12), (north - south).max(1e-12));
        let longer = f64::from(SIDE_PX) / width.max(height);
        let size_px = [width, height].map(|side| ((side * longer).round() as u32).clamp(8, SIDE_PX));
        let finest = self.finest(extent, size_px);
        let scale = Scale::new(self.of, &self.tiles, &finest);
        let [w, h] = size_px;
        let mut picture = RgbImage::from_pixel(w.max(240), h + LEGEND_PX, BACKGROUND);
        let number = |x: u32, y: u32| finest[(y * w + x) as usize];
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            let Some(tile) = number(x, y).map(|i| self.tiles[i as usize]) else { continue };
            let mut color = scale.color(f64::from(tile.value));
            let is_outlined = {
                let [w0, s0, e0, n0] = tile.rectangle;
                let side = ((e0 - w0) * shape).min(n0 - s0) * longer;
                side > MIN_OUTLINED_PX
            };
            let is_first = (x > 0 && number(x - 1, y) != number(x, y)) || (y > 0 && number(x, y - 1) != number(x, y));
            if is_outlined && is_first {
                color = color.map(|c| (f32::from(c) * 0.6) as u8);
            }
            picture.put_pixel(x, y, Rgb(color));
        }
        let legend = scale.legend();
        draw_legend(&mut picture, h, &legend);
        picture.save_with_format(file, image::ImageFormat::Png).with_context(|| format!("{}", file.display()))?;
        Ok(([picture.width(), picture.height()], legend))
    }

    /// Returns the rectangle around all tiles. Tiles on both sides of the antimeridian are moved beside each other.
    fn extent(&mut self) -> [f64; 4] {
        let around = |tiles: &[Tile]| {
            tiles.iter().fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |all, tile| {
                let ([a, b, c, d], [west, south, east, north]) = (all, tile.rectangle);
                [a.min(west), b.min(south), c.max(east), d.max(north)]
            })
        };
        let extent = around(&self.tiles);
        if self.frame == MapFrame::Local || extent[2] - extent[0] <= PI {
            return extent;
        }
        let moved = |tile: &Tile| {
            let [west, south, east, north] = tile.rectangle;
            let turn = if west < 0.0 { TAU } else { 0.0 };
            Tile { rectangle: [west + turn, south, east + turn, north], ..*tile }
        };
        let shifted: Vec<Tile> = self.tiles.iter().map(moved).collect();
        let other = around(&shifted);
        if other[2] - other[0] < (extent[2] - extent[0]).min(TAU - 1e-6) {
            self.tiles = shifted;
            return other;
        }
        extent
    }

    /// Returns the number of the finest tile at each pixel, northern row first.
    fn finest(&self, [west, south, east, north]: [f64; 4], [w, h]: [u32; 2]) -> Vec<Option<u32>> {
        let mut finest: Vec<Option<u32>> = vec![None; (w * h) as usize];
        let pixels = |low: f64, high: f64, from: f64, to: f64, size: u32| {
            let at = |value: f64| (value - from) / (to - from) * f64::from(size);
            let first = (at(low) + 1e-6).floor().clamp(0.0, f64::from(size - 1)) as u32;
            let last = (at(high) - 1e-6).ceil().clamp(0.0, f64::from(size)) as u32;
            first..last.max(first + 1)
        };
        for (number, tile) in (0..).zip(&self.tiles) {
            let [w0, s0, e0, n0] = tile.rectangle;
            let columns = pixels(w0, e0, west, east, w);
            for y in pixels(-n0, -s0, -north, -south, h) {
                for x in columns.clone() {
                    let known = &mut finest[(y * w + x) as usize];
                    if known.is_none_or(|other| self.tiles[other as usize].level <= tile.level) {
                        *known = Some(number);
                    }
                }
            }
        }
        finest
    }
}

/// The colours of values.
struct Scale {
    of: MapOf,
    /// The smallest and the largest value on the map.
    range: [f64; 2],
}

impl Scale {
    fn new(of: MapOf, tiles: &[Tile], finest: &[Option<u32>]) -> Self {
        let values = finest.iter().flatten().map(|number| f64::from(tiles[*number as usize].value));
        let range = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)]);
        Self { of, range }
    }

    fn color(&self, value: f64) -> [u8; 3] {
        let [low, high] = self.range;
        match self.of {
            // Neighbouring levels differ in hue and brightness.
            MapOf::Levels => hue(value * 0.142, if (value as u32).is_multiple_of(2) { 0.95 } else { 0.75 }),
            MapOf::Problems => {
                if value > 0.0 {
                    [225, 45, 40]
                } else {
                    [88, 110, 120]
                }
            }
            MapOf::Error | MapOf::Bytes => {
                let (low, high) = (low.max(1e-6).ln(), high.max(1e-6).ln());
                let share = if high > low { (value.max(1e-6).ln() - low) / (high - low) } else { 0.0 };
                ramp(share)
            }
        }
    }

    fn legend(&self) -> Vec<Swatch> {
        let [low, high] = self.range;
        let swatch = |value: f64, text: String| Swatch { color: self.color(value), text };
        match self.of {
            MapOf::Levels => {
                (low as u32..=high as u32).map(|level| swatch(f64::from(level), level.to_string())).collect()
            }
            MapOf::Problems => vec![swatch(0.0, "ok".to_owned()), swatch(1.0, "problem".to_owned())],
            MapOf::Error | MapOf::Bytes => {
                let (low, high) = (low.max(1e-6), high.max(1e-6));
                let steps = if high > low * 1.001 { 5 } else { 0 };
                let value = |step: u32| low * (high / low).powf(f64::from(step) / f64::from(steps.max(1)));
                let text = |value: f64| match self.of {
                    MapOf::Error => format!("{}m", short(value)),
                    _ => format!("{}B", short(value)),
                };
                (0..=steps).map(|step| swatch(value(step), text(value(step)))).collect()
            }
        }
    }
}

/// Returns a number with three digits, and a prefix for thousands.
fn short(value: f64) -> String {
    let (value, prefix) = match value {
        v if v >= 1e6 => (v / 1e6, "M"),
        v if v >= 1e3 => (v / 1e3, "k"),
        v => (v, ""),
    };
    let digits = if value >= 100.0 {
        0
    } else if value >= 10.0 {
        1
    } else {
        2
    };
    format!("{value:.digits$}{prefix}")
}

/// Returns a saturated colour of a hue of 0 to 1, which repeats.
fn hue(hue: f64, brightness: f64) -> [u8; 3] {
    let channel = |offset: f64| {
        let wave = 0.5 + 0.5 * ((hue + offset) * TAU).cos();
        (255.0 * brightness * (0.25 + 0.75 * wave)) as u8
    };
    [channel(0.0), channel(-1.0 / 3.0), channel(1.0 / 3.0)]
}

/// Returns a colour between dark violet and light yellow.
fn ramp(share: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] =
        [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [253.0, 231.0, 37.0]];
    let at = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let (first, part) = ((at as usize).min(STOPS.len() - 2), at - (at as usize).min(STOPS.len() - 2) as f64);
    [0, 1, 2].map(|c| (STOPS[first][c] + (STOPS[first + 1][c] - STOPS[first][c]) * part) as u8)
}

/// Draws as many colours with their texts as there is room for.
fn draw_legend(picture: &mut RgbImage, top: u32, legend: &[Swatch]) {
    let mut x = 8;
    for Swatch { color, text } in legend {
        let width = 18 + text.chars().count() as u32 * 8;
        if x + width > picture.width() {
            return;
        }
        for (i, j) in (0..14).flat_map(|j| (0..14).map(move |i| (i, j))) {
            picture.put_pixel(x + i, top + 10 + j, Rgb(*color));
        }
        for (number, letter) in (0..).zip(text.chars()) {
            draw_letter(picture, [x + 18 + number * 8, top + 12], letter);
        }
        x += width + 12;
    }
}

/// Draws a letter of 3 x 5 cells of two pixels.
fn draw_letter(picture: &mut RgbImage, [left, top]: [u32; 2], letter: char) {
    let rows: [u8; 5] = match letter {
        '0' => [7, 5, 5, 5, 7],
        '1' => [2, 6, 2, 2, 7],
        '2' => [7, 1, 7, 4, 7],
        '3' => [7, 1, 7, 1, 7],
        '4' => [5, 5, 7, 1, 1],
        '5' => [7, 4, 7, 1, 7],
        '6' => [7, 4, 7, 5, 7],
        '7' => [7, 1, 1, 2, 2],
        '8' => [7, 5, 7, 5, 7],
        '9' => [7, 5, 7, 1, 7],
        '.' => [0, 0, 0, 0, 2],
        'k' => [4, 5, 6, 6, 5],
        'm' => [0, 7, 7, 5, 5],
        'M' => [5, 7, 7, 5, 5],
        'B' => [6, 5, 6, 5, 6],
        'o' => [0, 7, 5, 5, 7],
        'p' => [0, 7, 5, 7, 4],
        'r' => [0, 6, 4, 4, 4],
        'b' => [4, 7, 5, 5, 7],
        'l' => [2, 2, 2, 2, 3],
        'e' => [7, 5, 7, 4, 7],
        _ => [0; 5],
    };
    for (j, row) in (0..).zip(rows) {
        for i in (0..3).filter(|i| row >> (2 - i) & 1 == 1) {
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                picture.put_pixel(left + 2 * i + dx, top + 2 * j + dy, TEXT);
            }
        }
    }
}
