//! Several rasters as one elevation source. Where they overlap, the first with data wins; between neighbours heights
//! are interpolated, so that there is no step.

use super::raster::Raster;
use super::source::{ElevationSource, SourceSample};
use crate::{Extent, GenError};

/// Rasters in the order of their priority.
pub(crate) struct Mosaic {
    rasters: Vec<Raster>,
    /// [`Raster::steps`] of each raster.
    steps: Vec<Option<[f64; 2]>>,
    /// [`Raster::bounds`] of each raster, larger by a pixel of the coarsest one.
    bounds: Vec<[f64; 4]>,
}

/// A raster near a position that lies between rasters.
#[derive(Clone, Copy)]
struct Neighbor {
    /// The height in metres at the nearest point inside the rectangle of its sample centres.
    height_m: f64,
    /// The offset from that point to the position, east and north, in radians.
    beyond: [f64; 2],
    /// The size of a pixel, east and north, in radians.
    step: [f64; 2],
}

impl Mosaic {
    pub fn new(rasters: Vec<Raster>) -> Self {
        let steps = rasters.iter().map(Raster::steps).collect();
        let distances = rasters.iter().map(Raster::sample_distance);
        let [dx, dy] = distances.fold([0.0; 2], |a: [f64; 2], b| [a[0].max(b[0]), a[1].max(b[1])]);
        let larger = |[west, south, east, north]: [f64; 4]| [west - dx, south - dy, east + dx, north + dy];
        let bounds = rasters.iter().map(|raster| larger(raster.bounds())).collect();
        Self { rasters, steps, bounds }
    }

    /// Returns the indices of the rasters whose bounds, larger by a pixel of the coarsest one, contain a position.
    fn near(&self, longitude: f64, latitude: f64) -> impl Iterator<Item = usize> {
        let contains = move |[west, south, east, north]: &[f64; 4]| {
            (*west..=*east).contains(&longitude) && (*south..=*north).contains(&latitude)
        };
        self.bounds.iter().enumerate().filter(move |(_, bounds)| contains(bounds)).map(|(k, _)| k)
    }

    /// Interpolates at a position between the outermost sample centres of neighbours. The nearest raster in each of the
    /// four quadrants around the position is weighted by its distance along both axes. Between files cut from one grid
    /// the result is that of the uncut file.
    fn interpolate_between(&self, longitude: f64, latitude: f64) -> Option<f64> {
        let covers = |r: &&Raster| r.locate(longitude, latitude).is_some_and(|p| p.is_covered());
        let mut owner = None;
        for (k, raster) in self.near(longitude, latitude).map(|k| (k, &self.rasters[k])).filter(|(_, r)| covers(r)) {
            let Some(neighbor) = self.neighbor(k, longitude, latitude) else {
                match raster.at(longitude, latitude) {
                    Some(height_m) => return Some(height_m),
                    None => continue,
                }
            };
            owner = Some(neighbor);
            break;
        }
        let owner = owner?;
        // South-west, south-east, north-west and north-east of the position.
        let mut quadrants: [Option<Neighbor>; 4] = [None; 4];
        for n in self.near(longitude, latitude).filter_map(|k| self.neighbor(k, longitude, latitude)) {
            // Between the sample centres of files that touch lies half a pixel of each; 0.505 allows for rounding.
            let touches = (0..2).all(|axis| {
                let gap = (n.beyond[axis] - owner.beyond[axis]).abs();
                n.beyond[axis] == 0.0 || gap <= 0.505 * (n.step[axis].abs() + owner.step[axis].abs())
            });
            for (q, quadrant) in quadrants.iter_mut().enumerate().filter(|_| touches) {
                // The position lies east of its western neighbours, so their offsets are positive.
                let signs = [if q & 1 == 0 { 1.0 } else { -1.0 }, if q & 2 == 0 { 1.0 } else { -1.0 }];
                let is_in_quadrant = (0..2).all(|axis| n.beyond[axis] * signs[axis] >= 0.0);
                let far = |n: &Neighbor| n.beyond[0].abs() + n.beyond[1].abs();
                if is_in_quadrant && quadrant.is_none_or(|other| far(&n) < far(&other)) {
                    *quadrant = Some(n);
                }
            }
        }
        let (mut sum, mut weights) = (0.0, 0.0);
        for (q, quadrant) in quadrants.iter().enumerate() {
            let Some(n) = quadrant else { continue };
            let share = |axis: usize| {
                // The opposite quadrant along the axis; if it is empty, the diagonal one.
                let Some(opposite) = quadrants[q ^ (1 << axis)].or(quadrants[q ^ 3]) else { return 1.0 };
                let (own, other) = (n.beyond[axis].abs(), opposite.beyond[axis].abs());
                if own + other > 0.0 { other / (own + other) } else { 0.5 }
            };
            let weight = share(0) * share(1);
            sum += weight * n.height_m;
            weights += weight;
        }
        (weights > 1e-6).then(|| sum / weights)
    }

    /// Returns a raster's height and offset near a position. `None` if it has no data there or is rotated.
    fn neighbor(&self, k: usize, longitude: f64, latitude: f64) -> Option<Neighbor> {
        let step = self.steps[k]?;
        let position = self.rasters[k].locate(longitude, latitude)?;
        let height_m = self.rasters[k].bilinear_m(position.nearest_px)?;
        Some(Neighbor { height_m, beyond: [0, 1].map(|axis| position.beyond_px[axis] * step[axis]), step })
    }
}

impl Mosaic {
    /// Returns the height in metres at a longitude and latitude in radians, `None` without data.
    fn at(&self, longitude: f64, latitude: f64) -> Option<f64> {
        if let [one] = &self.rasters[..] {
            return one.at(longitude, latitude);
        }
        let inside = self.near(longitude, latitude).find_map(|k| {
            let raster = &self.rasters[k];
            let position = raster.locate(longitude, latitude).filter(|p| p.beyond_px == [0.0; 2])?;
            raster.bilinear_m(position.nearest_px)
        });
        inside.or_else(|| self.interpolate_between(longitude, latitude))
    }
}

impl ElevationSource for Mosaic {
    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
        Ok(self.at(longitude, latitude))
    }

    fn samples_in(&self, extent: &Extent, call: &mut dyn FnMut(SourceSample)) -> Result<(), GenError> {
        for (k, raster) in self.rasters.iter().enumerate().filter(|(k, _)| overlaps(&self.bounds[*k], extent)) {
            let [columns, rows] = raster.samples_within(extent);
            for (column, row) in rows.flat_map(|row| columns.clone().map(move |column| (column, row))) {
                let Some(([longitude, latitude], height_m)) = raster.sample(column, row) else { continue };
                let is_inside = (extent.west..=extent.east).contains(&longitude)
                    && (extent.south..=extent.north).contains(&latitude);
                let is_hidden = || {
                    self.near(longitude, latitude).take_while(|other| *other < k).any(|other| {
                        let other = &self.rasters[other];
                        let position = other.locate(longitude, latitude).filter(|p| p.beyond_px == [0.0; 2]);
                        position.is_some_and(|p| other.bilinear_m(p.nearest_px).is_some())
                    })
                };
                if is_inside && !is_hidden() {
                    let is_extremum =
                        raster.is_extremum(column, row, |longitude, latitude| self.at(longitude, latitude));
                    call(SourceSample { longitude, latitude, height_m, is_extremum });
                }
            }
        }
        Ok(())
    }

    fn may_have_data_in(&self, extent: &Extent) -> bool {
        self.bounds.iter().any(|bounds| overlaps(bounds, extent))
    }
}

/// Returns true if bounds (west, south, east, north) and a rectangle have a point in common.
fn overlaps([west, south, east, north]: &[f64; 4], extent: &Extent) -> bool {
    extent.west <= *east && extent.east >= *west && extent.south <= *north && extent.north >= *south
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrane::formats::writers::write_height_exr;

    /// Creates rasters from a function of longitude and latitude in degrees. Each has a north-west corner and a pixel
    /// size in degrees, and a side in pixels.
    fn mosaic(height: impl Fn(f64, f64) -> f64, places: &[([f64; 2], f64, usize)]) -> Mosaic {
        let folder = tempfile::tempdir().unwrap();
        let read = |&([west, north], pixel, side): &([f64; 2], f64, usize)| {
            let center = |k: usize| (k as f64 + 0.5) * pixel;
            let at = |k: usize| height(west + center(k % side), north - center(k / side)) as f32;
            let path = folder.path().join("a.exr");
            std::fs::write(&path, write_height_exr("test", side, (0..side * side).map(at).collect()).unwrap()).unwrap();
            let world = format!("{pixel}\n0\n0\n-{pixel}\n{}\n{}\n", west + center(0), north - center(0));
            std::fs::write(path.with_extension("wld"), world).unwrap();
            Raster::read(&path).unwrap()
        };
        Mosaic::new(places.iter().map(read).collect())
    }

    fn at(source: &Mosaic, longitude: f64, latitude: f64) -> Option<f64> {
        source.height_m(longitude.to_radians(), latitude.to_radians()).unwrap()
    }

    fn bumps(x: f64, y: f64) -> f64 {
        500.0 + 90.0 * (3.0 * x).sin() * (4.0 * y).cos() + 20.0 * x
    }

    #[test]
    fn files_cut_from_one_grid_equal_the_uncut_file() {
        let whole = mosaic(bumps, &[([8.0, 44.0], 0.25, 16)]);
        let mut quarters = [[8.0, 44.0], [10.0, 44.0], [8.0, 42.0], [10.0, 42.0]].map(|corner| (corner, 0.25, 8));
        for _ in 0..4 {
            quarters.rotate_left(1);
            let parts = mosaic(bumps, &quarters);
            for j in 0..=97 {
                for i in 0..=97 {
                    let (x, y) = (8.0 + 4.0 * f64::from(i) / 97.0, 40.0 + 4.0 * f64::from(j) / 97.0);
                    let (a, b) = (at(&whole, x, y).unwrap(), at(&parts, x, y).unwrap());
                    assert!((a - b).abs() < 1e-3, "{x} {y}: {b}, not {a}");
                }
            }
        }
    }

    /// Returns the largest height difference between points 0.001 degrees apart on a line.
    fn steepest(source: &Mosaic, from: [f64; 2], to: [f64; 2]) -> f64 {
        let steps = ((to[0] - from[0]).hypot(to[1] - from[1]) / 0.001).ceil();
        let line = (0..=steps as usize).map(|k| {
            let t = k as f64 / steps;
            at(source, from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])).unwrap()
        });
        let heights: Vec<f64> = line.collect();
        heights.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn coarse_and_fine_files_meet_without_a_step() {
        // One tall coarse file and two fine ones beside it. A plane must stay a plane.
        let places = [([8.0, 44.0], 0.25, 16), ([12.0, 44.0], 0.1, 20), ([12.0, 42.0], 0.1, 20)];
        for order in [[0, 1, 2], [2, 0, 1], [1, 2, 0]] {
            let places = order.map(|k| places[k]);
            let plane = mosaic(|x, _| 3.0 * x + 40.0, &places);
            for k in 0..400 {
                let (x, y) = (11.5 + 0.0025 * f64::from(k), 41.013 + 0.003 * f64::from(k));
                assert!((at(&plane, x, y).unwrap() - (3.0 * x + 40.0)).abs() < 1e-4, "{x} {y}, {order:?}");
            }
            let rough = mosaic(bumps, &places);
            for y in [40.3, 41.9, 41.96, 42.0, 42.03, 43.7] {
                assert!(steepest(&rough, [11.0, y], [13.0, y]) < 1.0, "{y}, {order:?}");
            }
            for x in [11.9, 12.0, 12.02, 12.5] {
                assert!(steepest(&rough, [x, 41.0], [x, 43.0]) < 1.0, "{x}, {order:?}");
            }
        }
    }

    #[test]
    fn files_that_do_not_share_an_edge_end_at_their_own_edges() {
        let corner =
            mosaic(|x, _| if x < 10.0 { 100.0 } else { 300.0 }, &[([8.0, 44.0], 0.25, 8), ([10.0, 42.0], 0.25, 8)]);
        assert!(at(&corner, 10.01, 42.5).is_none() && at(&corner, 9.99, 41.5).is_none());
        assert_eq!(at(&corner, 9.99, 42.5), Some(100.0));
        assert!(steepest(&corner, [9.5, 42.02], [9.999, 42.02]) < 4.0);
        assert!(steepest(&corner, [9.5, 42.5], [10.5, 41.5]) < 4.0);
        let apart =
            mosaic(|x, _| if x < 10.0 { 100.0 } else { 300.0 }, &[([8.0, 44.0], 0.25, 8), ([10.2, 44.0], 0.25, 8)]);
        assert_eq!([9.99, 10.1, 10.21].map(|x| at(&apart, x, 43.0)), [Some(100.0), None, Some(300.0)]);
    }

    #[test]
    fn first_file_wins_where_files_overlap() {
        let mut first = mosaic(|_, _| 100.0, &[([8.0, 44.0], 0.25, 8)]);
        let second = mosaic(|_, _| 300.0, &[([9.0, 44.0], 0.25, 8)]);
        first.rasters.extend(second.rasters);
        first = Mosaic::new(first.rasters);
        assert_eq!(
            [8.5, 9.5, 9.87, 9.88, 10.5].map(|x| at(&first, x, 43.0).unwrap()),
            [100.0, 100.0, 100.0, 300.0, 300.0]
        );
    }
}
