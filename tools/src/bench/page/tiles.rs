//! The terrain of the `osg_page` peer: 5461 tiles in seven levels, as files and as a tile tree that names them.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use glam::{DAffine3, DMat3, DVec3};
use serde_json::json;
use terrane::formats::writers::{GlbMesh, write_glb, write_height_exr};
use terrane::math::{BoundingSphere, BoundingVolume, OrientedBox};
use terrane::scene::{Node, NodeKind, PagedLod, PagingOptions, RangeMode, ReaderData, Refine};

use crate::args::PageContent;

/// The side of the terrain in metres. One corner is at the origin.
pub const WORLD_M: f64 = 65536.0;
/// The finest level.
const LEVELS: u32 = 6;
/// The number of tiles of the terrain.
pub const COUNT: f64 = 5461.0;
/// The number of vertices along a tile's side.
const SIDE: usize = 33;
/// The number of texels along a tile's side.
const TEXELS: usize = 64;
/// A tile is refined if the eye is nearer than this number of its radii.
const RATIO: f64 = 7.0;
/// The folder of the tiles. It changes with their format, so that old tiles are not used.
const VERSION: &str = "bench-page-3";

/// Returns the height of the ground in metres.
pub fn height_m(x: f64, y: f64) -> f64 {
    800.0 * (x / 5000.0).sin() * (y / 7000.0).cos()
        + 200.0 * (x / 900.0 + 1.0).sin() * (y / 1100.0).sin()
        + 40.0 * (x / 170.0).sin() * (y / 130.0).cos()
}

/// A tile of the quadtree.
#[derive(Clone, Copy)]
pub struct Tile {
    level: u32,
    x: u32,
    y: u32,
}

impl Tile {
    fn side_m(self) -> f64 {
        WORLD_M / f64::from(1u32 << self.level)
    }

    fn corner(self) -> [f64; 2] {
        [f64::from(self.x) * self.side_m(), f64::from(self.y) * self.side_m()]
    }

    fn center(self) -> DVec3 {
        let [x, y] = self.corner().map(|c| c + 0.5 * self.side_m());
        DVec3::new(x, y, height_m(x, y))
    }

    /// Returns the name of the tile's file.
    pub fn file(self, extension: &str) -> String {
        format!("t_{}_{}_{}.{extension}", self.level, self.x, self.y)
    }

    /// Returns the URI of the content, and the additional data for its reader.
    fn content(self, base: &str, content: PageContent) -> (Arc<str>, Option<ReaderData>) {
        let uri = |extension| format!("{base}{}", self.file(extension));
        match content {
            PageContent::Mesh => return (uri("glb").into(), None),
            PageContent::Quantized => return (uri("quantized.glb").into(), None),
            PageContent::Height => {}
        }
        let half = 0.5 * self.side_m();
        let data = json!({
            "plane": [-half, -half, half, half], "side": SIDE, "border": 1, "level": self.level, "errors_m": [[1.0, 1.0, 1.0, 1.0]],
            "imagery": uri("png"),
        });
        (uri("exr").into(), Some(data.to_string().into()))
    }

    fn children(self) -> impl Iterator<Item = Self> {
        let inner = self.level < LEVELS;
        let child = move |i: u32| Self { level: self.level + 1, x: 2 * self.x + i % 2, y: 2 * self.y + i / 2 };
        (0..if inner { 4 } else { 0 }).map(child)
    }

    /// Returns the node of the tile with everything below it.
    pub fn node(self, base: &str, content: PageContent) -> Node {
        let center = self.center();
        let radius_m = self.side_m() * 0.5f64.sqrt();
        let bounds = if self.level < LEVELS {
            BoundingVolume::Sphere(BoundingSphere { center, radius_m })
        } else {
            // The bound of a leaf is the box of its mesh, as in the peer.
            let [x0, y0] = self.corner();
            let step = self.side_m() / (SIDE - 1) as f64;
            let heights =
                (0..SIDE * SIDE).map(|k| height_m(x0 + (k % SIDE) as f64 * step, y0 + (k / SIDE) as f64 * step));
            let (low, high) = heights.fold((f64::MAX, f64::MIN), |(l, h), z| (l.min(z), h.max(z)));
            let half = DVec3::new(0.5 * self.side_m(), 0.5 * self.side_m(), 0.5 * (high - low));
            let center = DVec3::new(center.x, center.y, 0.5 * (low + high));
            BoundingVolume::Box(OrientedBox { center, half_axes: DMat3::from_diagonal(half) })
        };
        let (uri, reader_data) = self.content(base, content);
        let lod = PagedLod {
            bounds,
            range_mode: RangeMode::Distance { center, range_m: RATIO * radius_m },
            refine: Refine::Replace,
            content: Some(uri),
            content_transform: DAffine3::from_translation(DVec3::new(center.x, center.y, 0.0)),
            reader_data,
            request_volume: None,
            paging: PagingOptions::default(),
        };
        let children = self.children().map(|c| c.node(base, content)).collect();
        Node { children, ..Node::new(NodeKind::PagedLod(Box::new(lod))) }
    }

    /// Returns the tile as binary glTF with y up, relative to the centre of the tile. Its PNG is stored without compression.
    fn glb(self, png: &[u8], quantized: bool) -> Result<Vec<u8>> {
        let ([x0, y0], center, side_m) = (self.corner(), self.center(), self.side_m());
        let step = side_m / (SIDE - 1) as f64;
        let mut mesh = GlbMesh { image: Some(png.to_vec()), base_color: [1.0; 4], quantized, ..GlbMesh::default() };
        for j in 0..SIDE {
            for i in 0..SIDE {
                let (x, y) = (x0 + i as f64 * step, y0 + j as f64 * step);
                let n = DVec3::new(
                    height_m(x - step, y) - height_m(x + step, y),
                    height_m(x, y - step) - height_m(x, y + step),
                    2.0 * step,
                )
                .normalize();
                mesh.positions.push([(x - center.x) as f32, height_m(x, y) as f32, (center.y - y) as f32]);
                mesh.normals.push([n.x as f32, n.z as f32, -n.y as f32]);
                mesh.uvs.push([i as f32 / (SIDE - 1) as f32, 1.0 - j as f32 / (SIDE - 1) as f32]);
            }
        }
        for j in 0..SIDE - 1 {
            for i in 0..SIDE - 1 {
                let a = (j * SIDE + i) as u16;
                let (b, c, d) = (a + 1, a + SIDE as u16, a + SIDE as u16 + 1);
                mesh.indices.extend([a, b, d, a, d, c]);
            }
        }
        Ok(write_glb(&mesh))
    }

    /// Returns the heights of the tile as EXR, north row first, with a border of one sample.
    fn exr(self) -> Result<Vec<u8>> {
        let ([x0, y0], step) = (self.corner(), self.side_m() / (SIDE - 1) as f64);
        let stride = SIDE + 2;
        let height = |k: usize| {
            let (i, j) = ((k % stride) as f64 - 1.0, (SIDE - k / stride) as f64);
            height_m(x0 + i * step, y0 + j * step) as f32
        };
        Ok(write_height_exr("tile", stride, (0..stride * stride).map(height).collect())?)
    }

    /// Returns the image of the tile as PNG, with the texels of the peer, whose first row is in the south.
    fn png(self) -> Result<Vec<u8>> {
        use image::ImageEncoder as _;
        use image::codecs::png::{CompressionType, FilterType, PngEncoder};
        let ([x0, y0], side_m) = (self.corner(), self.side_m());
        let mut pixels = Vec::with_capacity(TEXELS * TEXELS * 3);
        for j in (0..TEXELS).rev() {
            for i in 0..TEXELS {
                let at = |k: usize| (k as f64 + 0.5) * side_m / TEXELS as f64;
                let h = height_m(x0 + at(i), y0 + at(j));
                pixels.push((60 + self.level * 25) as u8);
                pixels.push((127.0 + h * 0.12).clamp(0.0, 255.0) as u8);
                pixels.push(((i * 4) ^ (j * 4)) as u8);
            }
        }
        let mut out = Vec::new();
        let side = TEXELS as u32;
        PngEncoder::new_with_quality(&mut out, CompressionType::Uncompressed, FilterType::NoFilter).write_image(
            &pixels,
            side,
            side,
            image::ExtendedColorType::Rgb8,
        )?;
        Ok(out)
    }
}

/// The whole terrain.
pub const ROOT: Tile = Tile { level: 0, x: 0, y: 0 };

/// Returns the folder of the tiles. The first call writes them, 640 MB in the user's cache folder.
pub fn tiles() -> Result<PathBuf> {
    let cache = crate::default_set::cache_folder().unwrap_or_else(std::env::temp_dir);
    let folder = cache.join("terrane").join(VERSION);
    let complete = folder.join("complete");
    if !complete.exists() {
        let made = || format!("cannot write tiles to {}", folder.display());
        std::fs::create_dir_all(&folder).with_context(made)?;
        eprintln!("writing 5461 tiles in three forms to {} (640 MB)", folder.display());
        let mut open = vec![ROOT];
        while let Some(tile) = open.pop() {
            let png = tile.png()?;
            for (extension, quantized) in [("glb", false), ("quantized.glb", true)] {
                std::fs::write(folder.join(tile.file(extension)), tile.glb(&png, quantized)?).with_context(made)?;
            }
            std::fs::write(folder.join(tile.file("exr")), tile.exr()?).with_context(made)?;
            std::fs::write(folder.join(tile.file("png")), png).with_context(made)?;
            open.extend(tile.children());
        }
        std::fs::write(&complete, "").with_context(made)?;
    }
    // All files are read once, so that the system has them in its cache: the peer is measured warm as well.
    for entry in std::fs::read_dir(&folder)? {
        std::io::copy(&mut std::fs::File::open(entry?.path())?, &mut std::io::sink())?;
    }
    Ok(folder)
}
