//! A world as a source of elevation: its heights at any longitude and latitude, for tiles that do not lie on the lattice of a
//! set. The planet continues beyond the rectangle of the set.

use super::points::meridians;
use super::tiles::WorldSet;
use crate::{ElevationSource, Extent, GenError, TileKey};

/// The heights of a world.
pub(crate) struct WorldSource {
    set: WorldSet,
}

impl WorldSource {
    pub fn new(set: WorldSet) -> Self {
        Self { set }
    }

    /// Returns the rectangle of the set.
    pub fn extent(&self) -> Extent {
        self.set.extent(TileKey::ROOT)
    }

    /// Returns the distances of the finest samples of the set, east and north, in radians.
    pub fn step(&self) -> [f64; 2] {
        let lattice = self.set.lattice(TileKey { level: self.set.levels() - 1, x: 0, y: 0 }, 0);
        lattice.side.map(|side| side / lattice.steps)
    }
}

impl ElevationSource for WorldSource {
    fn is_formula(&self) -> bool {
        true
    }

    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
        let mut height_m = [0.0];
        self.heights_of_row(longitude, 0.0, latitude, &mut height_m)?;
        Ok(Some(height_m[0].into()))
    }

    fn heights_of_row(&self, longitude: f64, step: f64, latitude: f64, out: &mut [f32]) -> Result<(), GenError> {
        let meridians = meridians((0..out.len()).map(|k| longitude + step * k as f64));
        self.set.with_buffers(|buffers| {
            self.set.world().ground_row(&meridians, latitude, buffers);
            out.copy_from_slice(&buffers.ground.surface_m);
        });
        Ok(())
    }

    fn water_depths_m(&self, longitudes: &[f64], latitudes: &[f64], out: &mut [f32]) -> Result<bool, GenError> {
        let world = self.set.world();
        if !world.has_water() {
            return Ok(false);
        }
        let step_m = match latitudes {
            [first, .., last] => (last - first) / (latitudes.len() - 1) as f64 * world.radius_m(),
            _ => 0.0,
        };
        let meridians = meridians(longitudes.iter().copied());
        self.set.with_buffers(|buffers| {
            for (latitude, row) in latitudes.iter().zip(out.chunks_exact_mut(longitudes.len().max(1))) {
                world.ground_row_of(&meridians, *latitude, step_m, buffers);
                match world.is_sea_frozen(*latitude) {
                    true => row.fill(-1.0),
                    false => row.copy_from_slice(&buffers.ground.depth_m),
                }
            }
        });
        Ok(true)
    }

    /// Rows that are far apart have no rivers and lakes, unlike those of [`Self::heights_of_row`].
    fn heights_of_grid(&self, longitudes: &[f64], latitudes: &[f64], out: &mut [f32]) -> Result<bool, GenError> {
        let ([first, .., last], [_, _, ..]) = (latitudes, longitudes) else { return Ok(false) };
        let step_m = (last - first) / (latitudes.len() - 1) as f64 * self.set.world().radius_m();
        let meridians = meridians(longitudes.iter().copied());
        self.set.with_buffers(|buffers| {
            for (latitude, row) in latitudes.iter().zip(out.chunks_exact_mut(longitudes.len())) {
                self.set.world().ground_row_of(&meridians, *latitude, step_m, buffers);
                row.copy_from_slice(&buffers.ground.surface_m);
            }
        });
        Ok(true)
    }
}
