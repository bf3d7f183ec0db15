//! The form of a world's tiles: heights or meshes, and colours; and what tilesets say of them.
//!
//! A mesh is made of the samples of its own tile alone. Its skirts, and how far its triangles may be from the grid, depend on the errors
//! of levels.

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use terrane::formats::writers::GlbRoughness;

use super::scatter::TALLEST_M;
use super::tiles::WorldSet;
use crate::output::{Look, MeshForm, MeshTile, half_step_m, sagitta_m};
use crate::pyramid::CELLS;
use crate::{Color, ContentKind, GenArgs, GenError, TextureFormat, TileKey, Triangles};

/// The largest distance of triangles from the grid, as a share of the error of the level above.
const TIN_SHARE: f64 = 0.5;
/// Shares of that distance, tried in turn as the limit at samples: between samples, triangles may be farther off.
const SAMPLE_SHARES: [f64; 3] = [0.5, 0.25, 0.125];

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
        // Meshes contain their place, so that they do not depend on the tileset.
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

/// The values of a tile that a tileset declares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Described {
    pub geometric_error_m: f64,
    /// The lowest and the highest height of its volume in metres.
    pub heights_m: [f64; 2],
}

/// A mesh that was made.
pub(super) struct MadeMesh {
    pub glb: Vec<u8>,
    pub measures: MeshMeasures,
}

/// The measures of a mesh that its description contains.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct MeshMeasures {
    /// The largest distance of its triangles from those of the grid, in metres.
    pub distance_m: f64,
    /// The depth of its skirts in metres.
    pub skirt_m: f64,
}

impl WorldSet {
    /// Makes the mesh of a tile from its samples.
    pub(super) fn mesh(
        &self,
        form: &MeshForm,
        key: TileKey,
        heights_m: Vec<f32>,
        look: Look,
    ) -> Result<MadeMesh, GenError> {
        let [low_m, high_m] = range_m(&heights_m).map(f64::from);
        let tile = MeshTile {
            key,
            set: self.extent(TileKey::ROOT),
            extent: self.extent(key),
            origin_m: 0.5 * (low_m + high_m),
            heights_m,
            has_data: None,
            ellipsoid: self.world().ellipsoid,
        };
        let most_m = self.tin_limit_m(key.level);
        let mut tin = tile.triangles(form.triangles, &SAMPLE_SHARES.map(|share| share * most_m), most_m);
        // The diagonals of rough cells may be others than those of the grid: then the tile is the grid.
        if tin.distance_m > most_m {
            tin = tile.triangles(Triangles::Grid, &[], 0.0);
        }
        let skirt_m = self.max_skirt_m(key.level).min(self.own_skirt_m(&tile));
        let glb = tile.glb(form, &tin, skirt_m, look)?;
        Ok(MadeMesh { glb, measures: MeshMeasures { distance_m: tin.distance_m, skirt_m } })
    }

    /// Returns the depth of the skirts that cover the steps to neighbours of a tile, in metres. Infinite, so that [`Self::max_skirt_m`]
    /// decides, where coarser neighbours have no rivers.
    fn own_skirt_m(&self, tile: &MeshTile<'_>) -> f64 {
        let step_m = |level: u32| self.lattice(TileKey { level, x: 0, y: 0 }, 0).step_m();
        let [own, above] =
            [tile.key.level, tile.key.level.saturating_sub(2)].map(|l| self.world().has_rivers(step_m(l)));
        if own != above {
            return f64::INFINITY;
        }
        1.0 + self.level_errors_m()[tile.key.level as usize] + 3.0 * tile.edge_step_m()
    }

    /// Returns the largest distance of the triangles of a level from those of the grid, in metres.
    fn tin_limit_m(&self, level: u32) -> f64 {
        let errors_m = self.level_errors_m();
        match self.form.mesh {
            Some(MeshForm { triangles: Triangles::Tin, .. }) if level == 0 => 2.0 * TIN_SHARE * errors_m[0],
            Some(MeshForm { triangles: Triangles::Tin, .. }) => TIN_SHARE * errors_m[level as usize - 1],
            _ => 0.0,
        }
    }

    /// Returns the largest depth of the skirts of a level in metres. They cover the steps to finer neighbours and to those up to two levels
    /// coarser.
    fn max_skirt_m(&self, level: u32) -> f64 {
        let off_m = |level: u32| self.level_errors_m()[level as usize] + self.tin_limit_m(level);
        1.0 + off_m(level) + off_m(level.saturating_sub(2))
    }

    /// Returns the description of a tile from its key alone.
    pub(super) fn expected(&self, key: TileKey) -> Described {
        let (error_m, heights_m) = (self.level_errors_m()[key.level as usize], self.bounds_m(key));
        match self.form.mesh {
            None => Described { geometric_error_m: error_m, heights_m },
            Some(_) => {
                let (distance_m, skirt_m) = (self.tin_limit_m(key.level), self.max_skirt_m(key.level));
                self.described(key, heights_m, error_m, MeshMeasures { distance_m, skirt_m })
            }
        }
    }

    /// Returns the description of a tile by bounds of its heights in metres, by the error of its grid, and by the measures of a mesh.
    pub(super) fn described(
        &self,
        key: TileKey,
        [low_m, high_m]: [f64; 2],
        error_m: f64,
        MeshMeasures { distance_m, skirt_m }: MeshMeasures,
    ) -> Described {
        let extent = self.extent(key);
        let ellipsoid = &self.world().ellipsoid;
        let half_step_m = half_step_m(ellipsoid, &extent, high_m - low_m + skirt_m);
        let is_quantized = self.form.mesh.is_some_and(|form| form.is_quantized);
        let slack_m = 0.1 + half_step_m;
        Described {
            geometric_error_m: error_m + distance_m + if is_quantized { half_step_m } else { 0.0 },
            heights_m: [low_m - skirt_m - sagitta_m(ellipsoid, &extent) - distance_m - slack_m, high_m + slack_m],
        }
    }

    /// Returns the height in metres that trees of a level may have above the ground; 0 for levels without any.
    pub(super) fn tallest_m(&self, level: u32) -> f64 {
        if self.has_scatter(level) { TALLEST_M } else { 0.0 }
    }
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
