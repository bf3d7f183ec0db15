//! Meshes of a world's tiles, and what tilesets say of tiles.
//!
//! A mesh is made of the samples of its own tile alone. Its skirts, and how far its triangles may be from the grid, depend on
//! the errors of levels.

use super::scatter::TALLEST_M;
use super::tile_form::{MeshMeasures, range_m};
use super::tiles::WorldSet;
use crate::output::{Look, MeshForm, MeshTile, half_step_m, sagitta_m};
use crate::{GenError, TileKey, Triangles};

/// The largest distance of triangles from the grid, as a share of the error of the level above.
const TIN_SHARE: f64 = 0.5;
/// Shares of that distance, tried in turn as the limit at samples: between samples, triangles may be farther off.
const SAMPLE_SHARES: [f64; 3] = [0.5, 0.25, 0.125];

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

    /// Returns the depth of the skirts that cover the steps to neighbours of a tile, in metres. Infinite, so that
    /// [`Self::max_skirt_m`] decides, where coarser neighbours have no rivers.
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

    /// Returns the largest depth of the skirts of a level in metres. They cover the steps to finer neighbours and to those up
    /// to two levels coarser.
    fn max_skirt_m(&self, level: u32) -> f64 {
        let off_m = |level: u32| self.level_errors_m()[level as usize] + self.tin_limit_m(level);
        1.0 + off_m(level) + off_m(level.saturating_sub(2))
    }

    /// Returns the description of a tile from its key alone.
    pub(super) fn expected(&self, key: TileKey) -> Described {
        let heights_m = self.bounds_m(key);
        match self.form.mesh {
            None => Described { geometric_error_m: self.estimated_error_m(key), heights_m },
            Some(_) => {
                let error_m = self.level_errors_m()[key.level as usize];
                let (distance_m, skirt_m) = (self.tin_limit_m(key.level), self.max_skirt_m(key.level));
                self.described(key, heights_m, error_m, MeshMeasures { distance_m, skirt_m })
            }
        }
    }

    /// Returns the description of a tile by bounds of its heights in metres, by the error of its grid, and by the measures of a
    /// mesh.
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
