//! Normal maps of mesh tiles: the normals of all samples, for meshes whose triangles have fewer.
//!
//! The frame of the map is east, north and up, and the mesh has these directions as tangents and normals of its vertices. So it is
//! the same for all triangles, however steep, and for all ways in which readers derive tangents. Texels lie on samples: neighbours
//! have the same ones on a common edge. Called by all threads that write tiles.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};
use terrane::formats::writers::GlbNormalMap;

use super::mesh::Lattice;
use crate::pyramid::CELLS;

/// The texels along a side of a map: one for each sample.
const TEXELS: u32 = CELLS as u32 + 1;

/// Returns the map of a tile, without tangents. On failure returns the reason.
///
/// PNG takes the fewest bytes: a map of the samples of Kilauea 4.3 kB, as WebP without loss 5.1 kB. JPEG would show its blocks.
pub(super) fn normal_map(lattice: &Lattice) -> Result<GlbNormalMap, String> {
    let last = CELLS as i64;
    let mut texels = Vec::with_capacity(3 * (TEXELS * TEXELS) as usize);
    for (j, i) in (0..=last).rev().flat_map(|j| (0..=last).map(move |i| (j, i))) {
        let normal = lattice.normal(i, j);
        texels.extend(lattice.frame(i, j).map(|axis| ((0.5 + 0.5 * normal.dot(axis)) * 255.0).round() as u8));
    }
    let mut image = Vec::new();
    PngEncoder::new_with_quality(&mut image, CompressionType::Default, FilterType::Paeth)
        .write_image(&texels, TEXELS, TEXELS, ExtendedColorType::Rgb8)
        .map_err(|e| e.to_string())?;
    // The texture coordinates of a tile reach from the centres of the outermost texels to each other.
    let texel = 1.0 / TEXELS as f32;
    Ok(GlbNormalMap { image, tangents: Vec::new(), uv_scale: [1.0 - texel; 2], uv_offset: [0.5 * texel; 2] })
}
