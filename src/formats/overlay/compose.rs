//! [`Canvas`]: the texture of a tile, onto which overlays are composed one after the other. CPU only; decode threads.
//!
//! Each row and column of texels has its own latitude and longitude, so that Web Mercator is projected exactly and not
//! stretched. The first and the last texels lie on the edges of the rectangle, so that neighbours have equal texels there.

use super::grid::{Area, Cover, GeoRectangle, Tiling};
use crate::scene::Texture;

/// Texels that overlays are composed onto: sRGB with straight alpha, northern row first.
#[derive(Clone, Debug)]
pub(super) struct Canvas {
    rectangle: GeoRectangle,
    width: u32,
    height: u32,
    texels: Vec<[u8; 4]>,
}

/// An image with the area that it covers.
#[derive(Clone, Copy)]
pub(super) struct PlacedImage<'a> {
    pub image: &'a Texture,
    pub area: Area,
}

/// The position of a row or a column of texels: the row or column of tiles that it is in, and its coordinate. It is `None`
/// outside.
type Place = Option<(u32, f64)>;

impl Canvas {
    /// Creates a transparent canvas of at least two by two texels.
    pub fn new(rectangle: GeoRectangle, [width, height]: [u32; 2]) -> Self {
        let (width, height) = (width.max(2), height.max(2));
        Self { rectangle, width, height, texels: vec![[0; 4]; width as usize * height as usize] }
    }

    /// Fills the canvas with a texture that covers its rectangle, northern row first.
    pub fn fill(&mut self, image: &Texture) {
        let area = Area { left: 0.0, bottom: 0.0, right: 1.0, top: 1.0 };
        let source = Some(PlacedImage { image, area });
        let place = |i: u32, count: u32| Some((0, f64::from(i) / f64::from(count - 1)));
        let columns: Vec<Place> = (0..self.width).map(|i| place(i, self.width)).collect();
        let rows: Vec<Place> = (0..self.height).map(|j| place(self.height - 1 - j, self.height)).collect();
        self.paint(1.0, 1, &columns, &rows, &[source]);
    }

    /// Composes the tiles of a cover over what is on the canvas. `sources` are their images, row by row.
    pub fn draw(
        &mut self,
        tiling: Tiling,
        cover: &Cover,
        tiles: Area,
        opacity: f32,
        sources: &[Option<PlacedImage<'_>>],
    ) {
        let GeoRectangle { west, south, .. } = self.rectangle;
        let tile_width = (tiles.right - tiles.left) / f64::from(cover.columns.max(1));
        let tile_height = (tiles.top - tiles.bottom) / f64::from(cover.rows.max(1));
        let fraction = |i: u32, count: u32| f64::from(i) / f64::from(count - 1);
        // An edge that is rounded differently is not outside.
        let slack_x = 1e-6 * (cover.area.right - cover.area.left);
        let slack_y = 1e-6 * (cover.area.top - cover.area.bottom).max(tile_height);
        let tile_of =
            |offset: f64, side: f64, count: u32| ((offset / side).floor().max(0.0) as u32).min(count.saturating_sub(1));
        let columns: Vec<Place> = (0..self.width)
            .map(|i| {
                let x = tiling.x(west + self.rectangle.width() * fraction(i, self.width)) + cover.shift;
                let is_inside = x >= cover.area.left - slack_x && x <= cover.area.right + slack_x;
                is_inside.then(|| (tile_of(x - tiles.left, tile_width, cover.columns), x))
            })
            .collect();
        let rows: Vec<Place> = (0..self.height)
            .map(|j| {
                let y = tiling.y(south + self.rectangle.height() * fraction(self.height - 1 - j, self.height));
                let is_inside = y >= cover.area.bottom - slack_y && y <= cover.area.top + slack_y;
                is_inside.then(|| (tile_of(tiles.top - y, tile_height, cover.rows), y))
            })
            .collect();
        self.paint(opacity, cover.columns, &columns, &rows, sources);
    }

    fn paint(
        &mut self,
        opacity: f32,
        tile_columns: u32,
        columns: &[Place],
        rows: &[Place],
        sources: &[Option<PlacedImage<'_>>],
    ) {
        let samplers: Vec<Option<Sampler<'_>>> =
            sources.iter().map(|source| Sampler::new(source.as_ref()?, spacing(columns), spacing(rows))).collect();
        for (row, line) in rows.iter().zip(self.texels.chunks_exact_mut(self.width as usize)) {
            let Some((tile_row, y)) = *row else { continue };
            for (column, texel) in columns.iter().zip(line) {
                let Some((tile_column, x)) = *column else { continue };
                let sampler = samplers.get((tile_row * tile_columns + tile_column) as usize);
                if let Some(Some(sampler)) = sampler {
                    *texel = over(sampler.texel(x, y), opacity, *texel);
                }
            }
        }
    }

    /// Returns true if no texel is transparent.
    pub fn is_opaque(&self) -> bool {
        self.texels.iter().all(|texel| texel[3] == 255)
    }

    /// Returns true if nothing was drawn.
    pub fn is_empty(&self) -> bool {
        self.texels.iter().all(|texel| texel[3] == 0)
    }

    /// Returns width and height in texels, and the texels.
    pub fn into_texels(self) -> (u32, u32, Vec<u8>) {
        (self.width, self.height, self.texels.into_flattened())
    }
}

/// Returns the largest distance between neighbours.
fn spacing(places: &[Place]) -> f64 {
    let steps = places.windows(2).filter_map(|two| Some(((two[1]?).1 - (two[0]?).1).abs()));
    steps.fold(0.0, f64::max)
}

/// Samples an image at coordinates, linearly between its pixels, and at its edge beyond them.
struct Sampler<'a> {
    pixels: &'a [[u8; 4]],
    width: usize,
    height: usize,
    /// The pixel at the coordinate 0, and pixels per unit.
    x: [f64; 2],
    y: [f64; 2],
}

impl<'a> Sampler<'a> {
    /// Chooses the level of the image whose pixels are not smaller than the given distances, if it has one.
    fn new(placed: &PlacedImage<'a>, step_x: f64, step_y: f64) -> Option<Self> {
        let PlacedImage { image, area } = placed;
        let (wide, high) = (area.right - area.left, area.top - area.bottom);
        if !(wide > 0.0 && high > 0.0) {
            return None;
        }
        let pixels_per_texel =
            (step_x * f64::from(image.width) / wide).max(step_y * f64::from(image.height) / high).max(1.0);
        let level = (pixels_per_texel.log2() as usize).min(image.mips.len().checked_sub(1)?);
        let side = |of: u32| (of as usize >> level).max(1);
        let (width, height) = (side(image.width), side(image.height));
        let pixels = image.mips.get(level)?.as_chunks::<4>().0;
        if pixels.len() < width * height {
            return None;
        }
        let (per_x, per_y) = (width as f64 / wide, height as f64 / high);
        Some(Self { pixels, width, height, x: [-area.left * per_x, per_x], y: [area.top * per_y, -per_y] })
    }

    fn texel(&self, x: f64, y: f64) -> [f32; 4] {
        let place = |[start, per_unit]: [f64; 2], at: f64, count: usize| {
            // Centres of pixels are at halves.
            let at = (start + at * per_unit - 0.5).clamp(0.0, (count - 1) as f64);
            let first = at as usize;
            (first, (first + 1).min(count - 1), (at - first as f64) as f32)
        };
        let (left, right, to_right) = place(self.x, x, self.width);
        let (upper, lower, to_lower) = place(self.y, y, self.height);
        let mut sum = [0.0f32; 4];
        for (row, of_row) in [(upper, 1.0 - to_lower), (lower, to_lower)] {
            for (column, of_column) in [(left, 1.0 - to_right), (right, to_right)] {
                let [r, g, b, a] = self.pixels[row * self.width + column].map(f32::from);
                // Transparent pixels have no colour.
                let weight = of_row * of_column * a;
                sum = [sum[0] + weight * r, sum[1] + weight * g, sum[2] + weight * b, sum[3] + weight];
            }
        }
        match sum[3] > 0.0 {
            true => [sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3], sum[3]],
            false => [0.0; 4],
        }
    }
}

/// Returns a colour over another, as browsers and other globes do: in sRGB. Alpha is 0 to 255.
fn over([r, g, b, a]: [f32; 4], opacity: f32, below: [u8; 4]) -> [u8; 4] {
    let alpha = a / 255.0 * opacity;
    let rest = f32::from(below[3]) / 255.0 * (1.0 - alpha);
    let sum = alpha + rest;
    if sum <= 0.0 {
        return below;
    }
    let mix = |above: f32, below: u8| ((above * alpha + f32::from(below) * rest) / sum + 0.5) as u8;
    [mix(r, below[0]), mix(g, below[1]), mix(b, below[2]), (sum * 255.0 + 0.5) as u8]
}

#[cfg(test)]
mod tests {
    use super::super::grid::{TileGrid, TileIndex};
    use super::*;

    fn flat(color: [u8; 4], side: u32) -> Texture {
        Texture::rgba8(side, side, vec![color.repeat((side * side) as usize)])
    }

    /// An image whose red is the column and whose green is the row.
    fn numbered(side: u32) -> Texture {
        let pixels = (0..side * side).flat_map(|i| [(i % side) as u8, (i / side) as u8, 0, 255]);
        Texture::rgba8(side, side, vec![pixels.collect()])
    }

    fn degrees(edges: [f64; 4]) -> GeoRectangle {
        GeoRectangle::from_degrees(edges).unwrap()
    }

    /// Draws the tiles of a level; `image` returns the image of a tile.
    fn drawn<'a>(
        canvas: &mut Canvas,
        grid: &TileGrid,
        level: usize,
        opacity: f32,
        image: impl Fn(TileIndex) -> Option<&'a Texture>,
    ) {
        let cover = grid.cover(level, &canvas.rectangle).unwrap();
        let mut sources = Vec::new();
        for (row, column) in (0..cover.rows).flat_map(|row| (0..cover.columns).map(move |column| (row, column))) {
            let tile = grid.tile_at(&cover, column, row);
            let area = grid.continuous_area(&cover, column, row).unwrap();
            sources.push(image(tile).map(|image| PlacedImage { image, area }));
        }
        let tiles = grid.area_of_cover(&cover).unwrap();
        canvas.draw(grid.tiling, &cover, tiles, opacity, &sources);
    }

    fn at(canvas: &Canvas, x: u32, y: u32) -> [u8; 4] {
        canvas.texels[(y * canvas.width + x) as usize]
    }

    #[test]
    fn tiles_lie_where_they_belong() {
        let grid = TileGrid::world(Tiling::Geographic, 0..=3, 64);
        let colors: Vec<Texture> = (0..32).map(|i| flat([i as u8 * 8, 255 - i as u8, 7, 255], 64)).collect();
        let mut canvas = Canvas::new(degrees([-180.0, -90.0, 180.0, 90.0]), [128, 64]);
        drawn(&mut canvas, &grid, 2, 1.0, |tile| colors.get((tile.row * 8 + tile.column) as usize));
        for (column, row) in (0..8).flat_map(|column| (0..4).map(move |row| (column, row))) {
            let expected = [(row * 8 + column) as u8 * 8, 255 - (row * 8 + column) as u8, 7, 255];
            assert_eq!(at(&canvas, column * 16 + 8, row * 16 + 8), expected, "{column} {row}");
        }
        assert!(canvas.is_opaque());
    }

    /// A row of the canvas has the latitude that Web Mercator gives it, not a linear share of the tile.
    #[test]
    fn web_mercator_is_projected_row_by_row() {
        let grid = TileGrid::world(Tiling::WebMercator, 0..=0, 256);
        let image = numbered(256);
        let mut canvas = Canvas::new(degrees([-180.0, -80.0, 180.0, 80.0]), [65, 161]);
        drawn(&mut canvas, &grid, 0, 1.0, |_| Some(&image));
        for latitude in [-80i32, -60, -30, 0, 45, 70, 80] {
            let sin = f64::from(latitude).to_radians().sin();
            let y = 0.5 - ((1.0 + sin) / (1.0 - sin)).ln() / (4.0 * std::f64::consts::PI);
            let expected = 256.0 * y - 0.5;
            let got = at(&canvas, 32, (80 - latitude) as u32)[1];
            assert!((f64::from(got) - expected).abs() <= 0.51, "{latitude}: {got} {expected}");
        }
        // Beyond the last latitude, the last row continues.
        let mut pole = Canvas::new(degrees([-180.0, 86.0, 180.0, 90.0]), [64, 8]);
        drawn(&mut pole, &grid, 0, 1.0, |_| Some(&image));
        assert!(pole.is_opaque() && (0..8).all(|y| at(&pole, 32, y)[1] == 0));
    }

    #[test]
    fn neighbours_have_equal_texels_at_their_edge() {
        let grid = TileGrid::world(Tiling::WebMercator, 0..=2, 256);
        let image = numbered(256);
        let west = degrees([10.0, 10.0, 20.0, 20.0]);
        let east = degrees([20.0, 10.0, 30.0, 20.0]);
        let [mut west, mut east] = [west, east].map(|rectangle| Canvas::new(rectangle, [32, 32]));
        for canvas in [&mut west, &mut east] {
            drawn(canvas, &grid, 2, 1.0, |_| Some(&image));
        }
        for y in 0..32 {
            assert_eq!(at(&west, 31, y), at(&east, 0, y));
        }
    }

    #[test]
    fn overlays_are_composed_in_order_with_their_opacity() {
        let grid = TileGrid::world(Tiling::Geographic, 0..=0, 16);
        let [red, green] = [flat([200, 0, 0, 255], 16), flat([0, 100, 0, 255], 16)];
        let mut canvas = Canvas::new(degrees([10.0, 10.0, 20.0, 20.0]), [4, 4]);
        assert!(canvas.is_empty());
        drawn(&mut canvas, &grid, 0, 0.6, |_| Some(&red));
        assert_eq!(at(&canvas, 1, 1), [200, 0, 0, 153]);
        drawn(&mut canvas, &grid, 0, 1.0, |_| Some(&red));
        drawn(&mut canvas, &grid, 0, 0.25, |_| Some(&green));
        assert_eq!(at(&canvas, 1, 1), [150, 25, 0, 255]);
        drawn(&mut canvas, &grid, 0, 1.0, |_| None);
        assert_eq!(at(&canvas, 1, 1), [150, 25, 0, 255], "a missing image leaves what is below");
    }

    #[test]
    fn image_with_a_rectangle_covers_it_alone() {
        let rectangle = degrees([12.0, 10.0, 18.0, 15.0]);
        let grid = TileGrid::image(Tiling::Geographic, rectangle);
        let image = flat([9, 8, 7, 255], 32);
        let mut canvas = Canvas::new(degrees([10.0, 10.0, 20.0, 20.0]), [101, 101]);
        drawn(&mut canvas, &grid, 0, 1.0, |_| Some(&image));
        let count = canvas.texels.iter().filter(|texel| texel[3] == 255).count();
        assert_eq!(
            (count, at(&canvas, 20, 50), at(&canvas, 19, 50), at(&canvas, 50, 49)),
            (61 * 51, [9, 8, 7, 255], [0; 4], [0; 4])
        );
    }

    #[test]
    fn transparent_pixels_do_not_darken_their_neighbours() {
        let image = Texture::rgba8(2, 1, vec![vec![200, 100, 50, 255, 0, 0, 0, 0]]);
        let area = Area { left: 0.0, bottom: 0.0, right: 2.0, top: 1.0 };
        let sampler = Sampler::new(&PlacedImage { image: &image, area }, 0.1, 0.1).unwrap();
        let [r, g, b, a] = sampler.texel(1.0, 0.5);
        assert!((r - 200.0).abs() < 1e-3 && (g - 100.0).abs() < 1e-3 && (b - 50.0).abs() < 1e-3, "{r} {g} {b}");
        assert!((a - 127.5).abs() < 1e-3);
    }

    #[test]
    fn own_texture_is_resampled_north_up() {
        let image = numbered(64);
        let mut canvas = Canvas::new(degrees([10.0, 10.0, 20.0, 20.0]), [64, 64]);
        canvas.fill(&image);
        assert_eq!((at(&canvas, 0, 0), at(&canvas, 63, 63)), ([0, 0, 0, 255], [63, 63, 0, 255]));
        assert_eq!(at(&canvas, 63, 0)[..2], [63, 0]);
    }
}
