//! A set of tiles of a world: each tile is computed alone from its place, with the same bytes in every program.

use std::f64::consts::PI;
use std::num::NonZeroUsize;
use std::sync::{Mutex, OnceLock, PoisonError};

use lru::LruCache;
use terrane::formats::writers::{write_height_exr, write_packed_heights};

use super::points::{meridians, sin_cos};
use super::scatter::{MAX_CELL_M, Scatter, TALLEST_M};
use super::surface::{Lattice, Patch, RowBuffers, TEXELS_PER_CELL, World, rounded};
use super::tile_form::{MeshMeasures, TileForm, range_m, roughness};
use crate::output::{Look, compress};
use crate::pyramid::{CELLS, QUANTUM_M};
use crate::{Extent, GenArgs, GenError, TileKey};

/// The number of estimates of errors that are kept.
const KEPT_ESTIMATES: usize = 1 << 16;

/// The factor of errors in bounds of heights: what lies outside of its volume may be cut off.
const BOUNDS_MARGIN: f64 = 1.5;

/// A rectangle of a world as a quadtree of tiles.
#[derive(Debug)]
pub struct WorldSet {
    world: World,
    extent: Extent,
    levels: u32,
    has_scatter: bool,
    pub(super) form: TileForm,
    pub(super) level_errors_m: OnceLock<Vec<f64>>,
    /// The errors of the tiles that were estimated last, in metres. Locked for moments by the threads that describe tiles.
    pub(super) estimates: Mutex<LruCache<TileKey, f64>>,
    /// Buffers of the threads that make tiles. Neighbouring tiles have rivers in common, which the buffers keep.
    buffers: Mutex<Vec<RowBuffers>>,
}

/// A tile that was made.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldTile {
    /// The extension of each file and its content: heights as `exr` or `heights` with an image beside, or a mesh as `glb`; and
    /// on levels that have them trees and rocks, as `glb` beside heights and as `scatter.glb` beside meshes.
    pub files: Vec<(&'static str, Vec<u8>)>,
    /// The lowest and the highest height in metres, that of the border included.
    pub range_m: [f32; 2],
    /// Heights in metres with a border of one sample, southern row first.
    pub(super) heights_m: Vec<f32>,
    /// The measures of the mesh; 0 without one.
    pub(super) measures: MeshMeasures,
}

impl WorldTile {
    /// Returns the content of the file with an extension, if the tile has it.
    pub fn file(&self, extension: &str) -> Option<&[u8]> {
        self.files.iter().find(|(of, _)| *of == extension).map(|(_, content)| content.as_slice())
    }
}

/// A step of making a tile, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TileStep {
    /// The rivers and lakes around the tile were found.
    Drainage,
    /// The heights were computed from noise.
    Heights,
    /// The texels were painted.
    Colors,
    /// The image was encoded.
    Image,
    /// The heights were encoded, or the mesh was made.
    HeightFile,
    /// Trees and rocks were placed, on levels that have them.
    Scatter,
}

impl WorldSet {
    /// Creates the set of the whole planet with a number of levels, at most 22.
    pub fn globe(world: World, levels: u32) -> Self {
        let extent = Extent { west: -PI, south: -0.5 * PI, east: PI, north: 0.5 * PI };
        Self::of(world, extent, levels)
    }

    fn of(world: World, extent: Extent, levels: u32) -> Self {
        Self {
            world,
            extent,
            levels,
            has_scatter: false,
            form: TileForm::default(),
            level_errors_m: OnceLock::new(),
            estimates: Mutex::new(LruCache::new(NonZeroUsize::new(KEPT_ESTIMATES).unwrap_or(NonZeroUsize::MIN))),
            buffers: Mutex::default(),
        }
    }

    /// Creates the set of a square around a longitude and latitude in radians, with sides in metres. The latitude is moved
    /// so that the square does not reach over a pole.
    pub fn square(world: World, [longitude, latitude]: [f64; 2], size_m: f64, levels: u32) -> Self {
        let half = (0.5 * size_m / world.radius_m()).min(0.49 * PI);
        let latitude = latitude.clamp(half - 0.49 * PI, 0.49 * PI - half);
        let half_longitude = (half / sin_cos(latitude).1).min(PI);
        let west = longitude - half_longitude;
        let extent = Extent { west, south: latitude - half, east: west + 2.0 * half_longitude, north: latitude + half };
        Self::of(world, extent, levels)
    }

    /// Calls `op` with buffers of this set, which no other thread uses meanwhile.
    pub(super) fn with_buffers<R>(&self, op: impl FnOnce(&mut RowBuffers) -> R) -> R {
        let all = || self.buffers.lock().unwrap_or_else(PoisonError::into_inner);
        let mut buffers = all().pop().unwrap_or_default();
        buffers.network.bound();
        let result = op(&mut buffers);
        all().push(buffers);
        result
    }

    /// Adds trees and rocks to the levels whose cells are at most 60 m high.
    #[must_use]
    pub fn with_scatter(self) -> Self {
        Self { has_scatter: true, ..self }
    }

    /// Makes tiles of the form that options ask for: their content, triangles, textures and archive.
    #[must_use]
    pub fn with_form_of(self, args: &GenArgs) -> Self {
        Self { form: TileForm::new(args), ..self }
    }

    /// Returns true if tiles are meshes.
    pub fn has_meshes(&self) -> bool {
        self.form.mesh.is_some()
    }

    /// Returns true if files are put into a packed set.
    pub(super) fn is_packed(&self) -> bool {
        self.form.is_packed
    }

    /// Returns the extensions of the files of a level's tiles.
    pub(super) fn extensions(&self, level: u32) -> impl Iterator<Item = &'static str> {
        let scatter = self.has_scatter(level).then(|| self.form.scatter());
        [self.form.surface()].into_iter().chain(self.form.imagery()).chain(scatter)
    }

    /// Returns true if the tiles of a level have trees and rocks.
    pub fn has_scatter(&self, level: u32) -> bool {
        self.has_scatter && self.lattice(TileKey { level, x: 0, y: 0 }, 0).step_m() <= MAX_CELL_M
    }

    /// Returns true if any tiles have trees and rocks.
    pub(super) fn has_instances(&self) -> bool {
        self.levels > 0 && self.has_scatter(self.levels - 1)
    }

    /// Returns the number of conifers, broadleaf trees, rocks, shrubs and stones on a tile.
    pub fn scatter_counts(&self, key: TileKey) -> [usize; 5] {
        self.with_buffers(|buffers| {
            let mut patch = self.patch(key, buffers);
            patch.paint(&self.world, buffers);
            self.scatter(&patch).counts()
        })
    }

    fn scatter(&self, patch: &Patch) -> Scatter {
        Scatter::new(&self.world, patch, &self.lattice(TileKey { level: 0, x: 0, y: 0 }, 0))
    }

    /// Returns the world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Returns the number of levels.
    pub fn levels(&self) -> u32 {
        self.levels
    }

    /// Returns true if the set has a tile.
    pub fn contains(&self, key: TileKey) -> bool {
        key.level < self.levels && key.x >> key.level == 0 && key.y >> key.level == 0
    }

    /// Returns true if a tile of the set has a file with an extension.
    pub fn has_file(&self, key: TileKey, extension: &str) -> bool {
        self.contains(key) && self.extensions(key.level).any(|of| of == extension)
    }

    /// Returns the rectangle of a tile.
    pub fn extent(&self, key: TileKey) -> Extent {
        let lattice = self.lattice(key, 0);
        let cells = CELLS as i64;
        let (west, south) = (lattice.longitude(0), lattice.latitude(0));
        Extent { west, south, east: lattice.longitude(cells), north: lattice.latitude(cells) }
    }

    /// Returns the positions of a tile's vertices, or of those a number of levels finer.
    pub(super) fn lattice(&self, key: TileKey, finer: u32) -> Lattice {
        let e = self.extent;
        let cells = (CELLS as i64) << finer;
        Lattice {
            origin: [e.west, e.south],
            side: [e.east - e.west, e.north - e.south],
            steps: (cells << key.level) as f64,
            column: i64::from(key.x) * cells,
            row: i64::from(key.y) * cells,
            radius_m: self.world.radius_m(),
        }
    }

    /// Computes the samples of a tile.
    fn patch(&self, key: TileKey, buffers: &mut RowBuffers) -> Patch {
        Patch::new(&self.world, self.lattice(key, 0), CELLS, buffers)
    }

    /// Returns the heights of a tile's vertices in metres, row by row from the north, with a border of one sample.
    pub fn heights_m(&self, key: TileKey) -> Vec<f32> {
        northern_first(&self.samples_m(key))
    }

    /// Returns the same heights, southern row first.
    pub(super) fn samples_m(&self, key: TileKey) -> Vec<f32> {
        self.with_buffers(|buffers| heights_m(&self.patch(key, buffers)))
    }

    /// Computes the files of a tile.
    pub fn tile(&self, key: TileKey) -> Result<WorldTile, GenError> {
        self.tile_in_steps(key, &mut |_| ())
    }

    /// Computes the files of a tile, and calls `done` at the end of each step, for measurements.
    pub fn tile_in_steps(&self, key: TileKey, done: &mut dyn FnMut(TileStep)) -> Result<WorldTile, GenError> {
        self.with_buffers(|buffers| self.tile_with(key, buffers, done))
    }

    fn tile_with(
        &self,
        key: TileKey,
        buffers: &mut RowBuffers,
        done: &mut dyn FnMut(TileStep),
    ) -> Result<WorldTile, GenError> {
        let lattice = self.lattice(key, 0);
        self.world.find_rivers(&lattice, CELLS, buffers);
        done(TileStep::Drainage);
        let mut patch = Patch::new(&self.world, lattice, CELLS, buffers);
        done(TileStep::Heights);
        let has_scatter = self.has_scatter(key.level);
        // Trees stand by the climate, which is found while the texels are painted.
        let rgb = (self.form.texture.is_some() || has_scatter).then(|| patch.paint(&self.world, buffers));
        done(TileStep::Colors);
        let side = (TEXELS_PER_CELL * CELLS) as u16;
        let encoded = self.form.texture.zip(rgb).map(|(format, rgb)| format.encode(&rgb, side)).transpose();
        let image = encoded.map_err(|e| GenError::Encode(format!("image of tile {key:?}: {e}")))?;
        done(TileStep::Image);
        let heights_m = heights_m(&patch);
        let (mut files, mut measures) = (Vec::new(), MeshMeasures::default());
        match &self.form.mesh {
            Some(form) => {
                let mut look = Look { image, ..Look::default() };
                if look.image.is_some() {
                    let failed = |e| GenError::Encode(format!("roughness of tile {key:?}: {e}"));
                    look.roughness = roughness(&patch.water(&self.world)).map_err(failed)?;
                }
                let made = self.mesh(form, key, heights_m.clone(), look)?;
                measures = made.measures;
                files.push(("glb", made.glb));
            }
            None => {
                files.push((self.form.surface(), self.height_file(key, &heights_m)?));
                files.extend(self.form.imagery().zip(image));
            }
        }
        done(TileStep::HeightFile);
        if has_scatter {
            files.push((self.form.scatter(), self.scatter(&patch).glb()));
        }
        done(TileStep::Scatter);
        Ok(WorldTile { files, range_m: range_m(&heights_m), heights_m, measures })
    }

    fn height_file(&self, key: TileKey, heights_m: &[f32]) -> Result<Vec<u8>, GenError> {
        let name = format!("{}/{}/{}.{}", key.level, key.x, key.y, self.form.surface());
        let side = CELLS + 3;
        let file = match self.form.is_packed {
            // The rows of packed heights begin in the south.
            true => write_packed_heights(&name, side, QUANTUM_M, heights_m, compress),
            false => write_height_exr(&name, side, northern_first(heights_m)),
        };
        file.map_err(|e| GenError::Encode(e.to_string()))
    }

    /// Returns bounds of the heights in a tile, in metres. They are those of every fourth vertex, which are the vertices of
    /// two levels above, with the error of that level: finer vertices are off by at most that. The first two levels have none
    /// above, and take all vertices.
    pub(super) fn bounds_m(&self, key: TileKey) -> [f64; 2] {
        let lattice = self.lattice(key, 0);
        let up = if key.level < 2 { 0 } else { 2 };
        let stride = 1usize << up;
        let every = || (0..=CELLS as i64).step_by(stride);
        let longitudes = meridians(every().map(|column| lattice.longitude(column)));
        let (mut low_m, mut high_m) = (f32::INFINITY, f32::NEG_INFINITY);
        self.with_buffers(|buffers| {
            for row in every() {
                let step_m = stride as f64 * lattice.step_m();
                self.world.ground_row_of(&longitudes, lattice.latitude(row), step_m, buffers);
                for surface_m in &buffers.ground.surface_m {
                    (low_m, high_m) = (low_m.min(*surface_m), high_m.max(*surface_m));
                }
            }
        });
        let above = TileKey { level: key.level - up, x: key.x >> up, y: key.y >> up };
        let error_m = match self.has_meshes() {
            true => self.level_errors_m()[above.level as usize],
            false => BOUNDS_MARGIN * self.estimated_error_m(above),
        };
        let above_m = if self.has_scatter(key.level) { TALLEST_M } else { 1.0 };
        [f64::from(low_m) - error_m - 1.0, f64::from(high_m) + error_m + above_m]
    }
}

/// Returns the heights of a tile with a border of one sample, southern row first.
fn heights_m(patch: &Patch) -> Vec<f32> {
    let last = CELLS as i64 + 1;
    (-1..=last).flat_map(|row| (-1..=last).map(move |column| rounded(patch.surface_m(column, row)))).collect()
}

/// Returns the same heights, northern row first.
fn northern_first(heights_m: &[f32]) -> Vec<f32> {
    heights_m.chunks(CELLS + 3).rev().flatten().copied().collect()
}
