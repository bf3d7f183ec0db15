//! Several rasters as one elevation source. Where they overlap, the first with data wins, or they blend into each other along
//! the edges of the upper one; between neighbours heights are interpolated, so that there is no step.

use super::blend::{Blend, Edges};
use super::nearby::Nearby;
use super::raster::{Raster, SamplePosition};
use super::source::{ElevationSource, SampleRow, SourceSample};
use super::window::Window;
use crate::store::Cursor;
use crate::{Extent, GenError};

/// Rasters in the order of their priority.
pub(crate) struct Mosaic {
    rasters: Vec<Raster>,
    /// [`Raster::steps`] of each raster.
    steps: Vec<Option<[f64; 2]>>,
    /// The longitude and latitude of a pixel of the coarsest raster.
    margin: [f64; 2],
    /// [`Raster::bounds`] of each raster, larger by the margin.
    nearby: Nearby,
    /// The bands along the edges of rasters in which they blend; `None` for sharp edges.
    edges: Option<Edges>,
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
    /// Creates a source of rasters that blend into those below in bands of a width in metres. With 0 their edges are sharp.
    pub fn new(rasters: Vec<Raster>, blend_m: f64) -> Self {
        let steps = rasters.iter().map(Raster::steps).collect();
        let distances = rasters.iter().map(Raster::sample_distance);
        let [dx, dy] = distances.fold([0.0; 2], |a: [f64; 2], b| [a[0].max(b[0]), a[1].max(b[1])]);
        let larger = |[west, south, east, north]: [f64; 4]| [west - dx, south - dy, east + dx, north + dy];
        let nearby = Nearby::new(rasters.iter().map(|raster| larger(raster.bounds())).collect());
        let edges = (blend_m > 0.0 && rasters.len() > 1).then(|| Edges::new(&rasters, blend_m));
        Self { rasters, steps, margin: [dx, dy], nearby, edges }
    }

    /// Returns the raster that alone decides the heights and extrema in a rectangle; `None` if there are several, or none.
    fn only_raster_in(&self, [west, south, east, north]: [f64; 4]) -> Option<&Raster> {
        if let [one] = &self.rasters[..] {
            return Some(one);
        }
        let [dx, dy] = self.margin;
        let [one] = self.nearby.within([west - dx, south - dy, east + dx, north + dy])[..] else { return None };
        let b = self.rasters[one].bounds();
        let is_inside = b[0] <= west - dx && b[1] <= south - dy && east + dx <= b[2] && north + dy <= b[3];
        is_inside.then_some(&self.rasters[one])
    }

    fn height_at<'a>(
        &'a self,
        cursors: &mut Cursors<'a>,
        longitude: f64,
        latitude: f64,
    ) -> Result<Option<f64>, GenError> {
        if let [one] = &self.rasters[..] {
            return one.height_m(longitude, latitude);
        }
        let mut blend = Blend::default();
        for k in self.nearby.at(longitude, latitude) {
            let position = self.rasters[k].locate(longitude, latitude).filter(SamplePosition::is_covered);
            let Some(position) = position else { continue };
            let found = match position.is_inside() {
                true => self.rasters[k].bilinear_m(cursors.of(self, k), position.nearest_px)?,
                false => self.interpolate_beyond(cursors, k, longitude, latitude)?,
            };
            let Some(height_m) = found else { continue };
            let Some(edges) = &self.edges else { return Ok(found) };
            blend.add(height_m, edges.share(&self.rasters, &self.nearby, k, &position));
            if blend.is_full() {
                break;
            }
        }
        Ok(blend.height_m())
    }

    /// Returns true if a raster before another one has data at a position and does not blend into those below there.
    fn is_hidden<'a>(
        &'a self,
        cursors: &mut Cursors<'a>,
        raster: usize,
        longitude: f64,
        latitude: f64,
    ) -> Result<bool, GenError> {
        for k in self.nearby.at(longitude, latitude).take_while(|k| *k < raster) {
            let position = self.rasters[k].locate(longitude, latitude).filter(SamplePosition::is_covered);
            let Some(position) = position else { continue };
            let is_full = |edges: &Edges| edges.share(&self.rasters, &self.nearby, k, &position) >= 1.0;
            if self.edges.as_ref().is_none_or(is_full)
                && self.rasters[k].bilinear_m(cursors.of(self, k), position.nearest_px)?.is_some()
            {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Interpolates at a position beyond the outermost sample centres of a raster, by at most half a pixel. The nearest raster
    /// in each of the four quadrants around the position is weighted by its distance along both axes. Between files cut from
    /// one grid the result is that of the uncut file.
    fn interpolate_beyond<'a>(
        &'a self,
        cursors: &mut Cursors<'a>,
        raster: usize,
        longitude: f64,
        latitude: f64,
    ) -> Result<Option<f64>, GenError> {
        let Some(owner) = self.neighbor(cursors, raster, longitude, latitude)? else {
            // It is rotated, or has no data there.
            return self.rasters[raster].height_m(longitude, latitude);
        };
        // South-west, south-east, north-west and north-east of the position.
        let mut quadrants: [Option<Neighbor>; 4] = [None; 4];
        for k in self.nearby.at(longitude, latitude) {
            let Some(n) = self.neighbor(cursors, k, longitude, latitude)? else { continue };
            // A raster that reaches across the position lies above or below.
            if n.beyond == [0.0; 2] {
                continue;
            }
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
        Ok((weights > 1e-6).then(|| sum / weights))
    }

    /// Returns a raster's height and offset near a position. `None` if it has no data there or is rotated.
    fn neighbor<'a>(
        &'a self,
        cursors: &mut Cursors<'a>,
        k: usize,
        longitude: f64,
        latitude: f64,
    ) -> Result<Option<Neighbor>, GenError> {
        let (Some(step), Some(position)) = (self.steps[k], self.rasters[k].locate(longitude, latitude)) else {
            return Ok(None);
        };
        let height_m = self.rasters[k].bilinear_m(cursors.of(self, k), position.nearest_px)?;
        let beyond = [0, 1].map(|axis| position.beyond_px[axis] * step[axis]);
        Ok(height_m.map(|height_m| Neighbor { height_m, beyond, step }))
    }
}

impl ElevationSource for Mosaic {
    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
        self.height_at(&mut Cursors::default(), longitude, latitude)
    }

    fn heights_of_row(&self, longitude: f64, step: f64, latitude: f64, out: &mut [f32]) -> Result<(), GenError> {
        if let [one] = &self.rasters[..] {
            return one.heights_of_row(longitude, step, latitude, out);
        }
        out.fill(f32::NAN);
        let end = longitude + step * out.len().saturating_sub(1) as f64;
        let mut cursors = Cursors::default();
        if self.edges.is_some() {
            for (k, height_m) in out.iter_mut().enumerate() {
                let found = self.height_at(&mut cursors, longitude + step * k as f64, latitude)?;
                *height_m = found.map_or(f32::NAN, |h| h as f32);
            }
            return Ok(());
        }
        for k in self.nearby.within([longitude.min(end), latitude, longitude.max(end), latitude]) {
            let mut beyond = Vec::new();
            self.rasters[k].fill_row(cursors.of(self, k), [longitude, step, latitude], out, |at, position| {
                let is_inside = position.is_inside();
                if !is_inside && position.is_covered() {
                    beyond.push(at);
                }
                is_inside
            })?;
            for at in beyond {
                let found = self.interpolate_beyond(&mut cursors, k, longitude + step * at as f64, latitude)?;
                out[at] = found.map_or(f32::NAN, |h| h as f32);
            }
        }
        Ok(())
    }

    fn heights_of_grid(&self, longitudes: &[f64], latitudes: &[f64], out: &mut [f32]) -> Result<bool, GenError> {
        let ([west, .., east], [south, .., north]) = (longitudes, latitudes) else { return Ok(false) };
        match self.only_raster_in([*west, *south, *east, *north]) {
            Some(raster) => raster.heights_of_grid(longitudes, latitudes, out),
            None => Ok(false),
        }
    }

    fn sample_rows(
        &self,
        extent: &Extent,
        finds_extrema: bool,
        call: &mut dyn FnMut(SampleRow<'_>),
    ) -> Result<bool, GenError> {
        match self.only_raster_in([extent.west, extent.south, extent.east, extent.north]) {
            Some(raster) => raster.sample_rows(extent, finds_extrema, call),
            None => Ok(false),
        }
    }

    fn samples_in(&self, extent: &Extent, call: &mut dyn FnMut(SourceSample)) -> Result<(), GenError> {
        for k in self.nearby.within([extent.west, extent.south, extent.east, extent.north]) {
            let raster = &self.rasters[k];
            let Some(window) = Window::of(raster, extent) else { continue };
            let [west, south, east, north] = raster.bounds();
            let hides = self.nearby.within([west, south, east, north]).into_iter().any(|other| other < k);
            let mut cursors = Cursors::default();
            let outside = |longitude: f64, latitude: f64| self.height_m(longitude, latitude);
            window.samples(extent, outside, |mut sample| {
                let [x, y] = [sample.longitude, sample.latitude];
                if hides && self.is_hidden(&mut cursors, k, x, y)? {
                    return Ok(());
                }
                if self.edges.is_some()
                    && let Some(height_m) = self.height_at(&mut cursors, x, y)?
                    && (height_m as f32) != sample.height_m as f32
                {
                    (sample.height_m, sample.is_extremum) = (height_m, false);
                }
                call(sample);
                Ok(())
            })?;
        }
        Ok(())
    }

    fn prepare(&self, extent: &Extent) {
        for k in self.nearby.within([extent.west, extent.south, extent.east, extent.north]) {
            if self.rasters[k].is_remote()
                && let Some(window) = Window::of(&self.rasters[k], extent)
            {
                window.read_ahead();
            }
        }
    }

    fn may_have_data_in(&self, extent: &Extent) -> bool {
        let [dx, dy] = self.margin;
        let e = Extent {
            west: extent.west - dx,
            south: extent.south - dy,
            east: extent.east + dx,
            north: extent.north + dy,
        };
        let near = self.nearby.within([e.west, e.south, e.east, e.north]);
        near.into_iter().any(|k| Window::of(&self.rasters[k], &e).is_some_and(|window| window.may_have_data()))
    }
}

/// A cursor for each raster that was read.
#[derive(Default)]
struct Cursors<'a> {
    read: Vec<(usize, Cursor<'a>)>,
}

impl<'a> Cursors<'a> {
    /// Returns the cursor of a raster.
    fn of(&mut self, mosaic: &'a Mosaic, raster: usize) -> &mut Cursor<'a> {
        let at = self.read.iter().position(|(k, _)| *k == raster).unwrap_or_else(|| {
            self.read.push((raster, mosaic.rasters[raster].cursor()));
            self.read.len() - 1
        });
        &mut self.read[at].1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrane::formats::writers::write_height_exr;

    /// Creates rasters from a function of longitude and latitude in degrees. Each has a north-west corner and a pixel
    /// size in degrees, and a side in pixels.
    fn mosaic(height: impl Fn(f64, f64) -> f64, places: &[([f64; 2], f64, usize)]) -> Mosaic {
        let folder = tempfile::tempdir().unwrap();
        // Reading decodes a small file, and its only block stays in the cache.
        let read = |&([west, north], pixel, side): &([f64; 2], f64, usize)| {
            let center = |k: usize| (k as f64 + 0.5) * pixel;
            let at = |k: usize| height(west + center(k % side), north - center(k / side)) as f32;
            let path = folder.path().join("a.exr");
            std::fs::write(&path, write_height_exr("test", side, (0..side * side).map(at).collect()).unwrap()).unwrap();
            let world = format!("{pixel}\n0\n0\n-{pixel}\n{}\n{}\n", west + center(0), north - center(0));
            std::fs::write(path.with_extension("wld"), world).unwrap();
            Raster::read(&path).unwrap()
        };
        Mosaic::new(places.iter().map(read).collect(), 0.0)
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
        first = Mosaic::new(first.rasters, 0.0);
        assert_eq!(
            [8.5, 9.5, 9.99, 10.01, 10.5].map(|x| at(&first, x, 43.0).unwrap()),
            [100.0, 100.0, 100.0, 300.0, 300.0]
        );
    }

    /// Regression: between the sample centres of neighbours, heights were those of a file below both.
    #[test]
    fn files_below_are_not_seen_between_neighbours() {
        let both = mosaic(|x, _| 3.0 * x, &[([8.0, 44.0], 0.25, 8), ([10.0, 44.0], 0.25, 8)]);
        let below = mosaic(|_, _| 900.0, &[([4.0, 48.0], 1.0, 12)]);
        let all = Mosaic::new(both.rasters.into_iter().chain(below.rasters).collect(), 0.0);
        let mut row = [0.0; 101];
        let (west, step) = (9.5f64.to_radians(), 0.01f64.to_radians());
        all.heights_of_row(west, step, 43f64.to_radians(), &mut row).unwrap();
        for (k, height_m) in row.iter().enumerate() {
            let x = 9.5 + 0.01 * k as f64;
            assert!((f64::from(*height_m) - 3.0 * x).abs() < 1e-3, "{x}: {height_m}");
            assert_eq!(
                all.height_m(west + step * k as f64, 43f64.to_radians()).unwrap().map(|h| h as f32),
                Some(*height_m)
            );
        }
        assert_eq!([12.1, 7.9].map(|x| at(&all, x, 43.0)), [Some(900.0); 2]);
    }

    #[test]
    fn overlapping_files_blend_within_a_band() {
        // Two degrees of overlap; a band of about one degree.
        let files = || {
            let upper = mosaic(|_, _| 100.0, &[([8.0, 44.0], 0.25, 16)]);
            let lower = mosaic(|_, _| 300.0, &[([10.0, 46.0], 0.25, 32)]);
            upper.rasters.into_iter().chain(lower.rasters).collect::<Vec<_>>()
        };
        let sharp = Mosaic::new(files(), 0.0);
        assert!(steepest(&sharp, [11.0, 42.0], [12.5, 42.0]) > 190.0);
        let band_m = 81_000.0;
        let blended = Mosaic::new(files(), band_m);
        for (from, to) in [([8.2, 42.0], [17.0, 42.0]), ([11.0, 40.2], [11.0, 45.8]), ([8.5, 40.5], [13.0, 45.0])] {
            let found = steepest(&blended, from, to);
            assert!(found < 1.0, "{from:?}: {found} m in 0.001 degrees");
        }
        // Each file is itself away from the band, and so is a file that no other one overlaps.
        assert_eq!([8.2, 9.0, 10.0].map(|x| at(&blended, x, 42.0)), [Some(100.0); 3]);
        assert_eq!([12.2, 14.0, 17.5].map(|x| at(&blended, x, 42.0)), [Some(300.0); 3]);
        let half = at(&blended, 11.375, 42.0).unwrap();
        assert!((half - 200.0).abs() < 10.0, "{half}");
        let mut row = [0.0; 90];
        let (west, step) = (8.2f64.to_radians(), 0.1f64.to_radians());
        blended.heights_of_row(west, step, 42f64.to_radians(), &mut row).unwrap();
        for (k, height_m) in row.iter().enumerate() {
            let single = blended.height_m(west + step * k as f64, 42f64.to_radians()).unwrap();
            assert_eq!(single.map(|h| h as f32), Some(*height_m).filter(|h| h.is_finite()));
        }
        // Samples are those of the blended surface, so that errors are measured against it.
        let [west, south, east, north] = [8.0, 40.0, 18.0, 46.0f64].map(f64::to_radians);
        let mut in_between = 0;
        let mut check = |s: SourceSample| {
            let surface = blended.height_m(s.longitude, s.latitude).unwrap().unwrap();
            assert!((s.height_m - surface).abs() < 1e-3, "{s:?}, not {surface}");
            in_between += usize::from((101.0..299.0).contains(&s.height_m));
        };
        blended.samples_in(&Extent { west, south, east, north }, &mut check).unwrap();
        assert!(in_between > 20, "{in_between}");
    }

    /// Neighbours cut from one grid do not fade into a file below along their common edge.
    #[test]
    fn common_edges_of_neighbours_do_not_blend() {
        let both = mosaic(|_, _| 100.0, &[([8.0, 44.0], 0.25, 16), ([12.0, 44.0], 0.25, 16)]);
        let below = mosaic(|_, _| 300.0, &[([0.0, 52.0], 0.5, 48)]);
        let all = Mosaic::new(both.rasters.into_iter().chain(below.rasters).collect(), 60_000.0);
        for k in 0..200 {
            let x = 11.0 + 0.01 * f64::from(k);
            assert!((at(&all, x, 42.0).unwrap() - 100.0).abs() < 1e-9, "{x}");
        }
        assert!(steepest(&all, [7.0, 42.0], [9.0, 42.0]) < 1.0);
        assert_eq!([at(&all, 7.9, 42.0), at(&all, 9.0, 42.0)], [Some(300.0), Some(100.0)]);
    }
}
