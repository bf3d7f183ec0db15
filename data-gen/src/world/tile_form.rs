//! [`TileForm`]: what the files of tiles are, and measures of their content.

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use terrane::formats::writers::GlbRoughness;

use crate::output::MeshForm;
use crate::pyramid::CELLS;
use crate::{Color, ContentKind, GenArgs, TextureFormat};

/// The form of tiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TileForm {
    /// The form of meshes; `None` for heights.
    pub mesh: Option<MeshForm>,
    /// True if heights are packed instead of EXR.
    pub is_packed: bool,
    /// The format of images of colour; `None` without colours.
    pub texture: Option<TextureFormat>,
}

impl Default for TileForm {
    fn default() -> Self {
        Self { mesh: None, is_packed: false, texture: Some(TextureFormat::Jpeg) }
    }
}

impl TileForm {
    pub fn new(args: &GenArgs) -> Self {
        // Meshes contain their position on the earth, so that they do not depend on the tileset.
        let mesh = || MeshForm { is_placed: true, ..MeshForm::new(args) };
        Self {
            mesh: (args.content == ContentKind::Mesh).then(mesh),
            is_packed: args.output.is_packed(),
            texture: (args.color != Color::None).then_some(args.tiles.texture),
        }
    }

    /// Returns the extension of the files of heights or of meshes.
    pub fn surface(&self) -> &'static str {
        match self.mesh {
            Some(_) => "glb",
            None if self.is_packed => "heights",
            None => "exr",
        }
    }

    /// Returns the extension of the files of trees and rocks.
    pub fn scatter(&self) -> &'static str {
        if self.mesh.is_some() { "scatter.glb" } else { "glb" }
    }

    /// Returns the extension of images beside the files of heights. Meshes contain their images.
    pub fn imagery(&self) -> Option<&'static str> {
        self.texture.filter(|_| self.mesh.is_none()).map(TextureFormat::extension)
    }
}

/// The measures of a mesh that its description contains.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct MeshMeasures {
    /// The largest distance of its triangles from those of the grid, in metres.
    pub distance_m: f64,
    /// The depth of its skirts in metres.
    pub skirt_m: f64,
}

/// The roughness of water: the waves that are smaller than a pixel.
const WATER_ROUGHNESS: f32 = 0.2;

/// Returns the roughness of a tile from the share of water of its cells, northern row first: water is smooth, land is rough. On
/// failure returns the reason.
pub(super) fn roughness(water: &[u8]) -> Result<GlbRoughness, String> {
    if water.iter().all(|share| *share == 0) {
        return Ok(GlbRoughness::Rough);
    }
    if water.iter().all(|share| *share == 255) {
        return Ok(GlbRoughness::Even(WATER_ROUGHNESS));
    }
    let texel = |share: &u8| (255.0 - (1.0 - WATER_ROUGHNESS) * f32::from(*share)).round() as u8;
    let (texels, side) = (water.iter().map(texel).collect::<Vec<u8>>(), CELLS as u32);
    let mut file = Vec::new();
    PngEncoder::new(&mut file).write_image(&texels, side, side, ExtendedColorType::L8).map_err(|e| e.to_string())?;
    Ok(GlbRoughness::Map(file))
}

/// Returns the lowest and the highest of some heights.
pub(super) fn range_m(heights_m: &[f32]) -> [f32; 2] {
    heights_m.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], m| [low.min(*m), high.max(*m)])
}
