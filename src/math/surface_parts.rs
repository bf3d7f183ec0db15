//! [`SurfacePart`]: a part of a body's surface, which is divided as far as a test needs it. Culling threads.

use glam::DVec3;

use super::{Geodetic, Region};

/// Parts are divided this many times at most. Between the parts outside of the frustum and those behind the horizon may be a narrow
/// strip in which both tests hold.
const MAX_DEPTH: u32 = 7;
/// The number of parts that a test looks at; more belong to a region whose edge is everywhere near that of what is tested.
const MAX_PARTS: u32 = 256;
/// Share by which the reach is larger, beside a metre, for tests in f32.
const ROUNDING: f64 = 1e-3;

/// A part of a body's surface. The box around a large part is as wide as its widest parallel and as high as its middle; the hull of its
/// corners is not.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfacePart {
    /// In ECEF metres, at the middle of the region's heights.
    pub corners: [DVec3; 4],
    /// Nothing of the part is farther from the hull of its corners, metres.
    pub reach_m: f64,
}

/// The result of a test of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PartTest {
    /// It holds for the whole part.
    Holds,
    /// It does not hold for the part.
    Fails,
    /// It may hold for a part of the part.
    Unsure,
}

impl SurfacePart {
    /// Returns the part that is a whole region.
    ///
    /// Between four points the surface differs from the bilinear map of these by at most an eighth of its second derivatives, along
    /// parallel and meridian, times the squares of the steps.
    fn of(region: &Region) -> Self {
        let body = &region.ellipsoid;
        let height_m = region.center().height_m;
        let (width, height) = (region.width(), region.north - region.south);
        let corner = |longitude, latitude| body.ecef(&Geodetic { longitude, latitude, height_m });
        let east = region.west + width;
        let corners = [
            corner(region.west, region.south),
            corner(east, region.south),
            corner(region.west, region.north),
            corner(east, region.north),
        ];
        // The radius of curvature of a meridian is at most the equator's times this.
        let [long, short] = [f64::max, f64::min].map(|of| of(body.semi_major_m, body.semi_minor_m));
        let radius_m = (long / short).powi(2) * long + height_m.abs();
        let is_across_equator = region.south < 0.0 && region.north > 0.0;
        let widest = if is_across_equator { 1.0 } else { region.south.cos().max(region.north.cos()) };
        let bulge_m = radius_m * (widest * width * width + height * height) / 8.0;
        let reach_m = (bulge_m + 0.5 * (region.max_height_m - region.min_height_m)) * (1.0 + ROUNDING) + 1.0;
        Self { corners, reach_m }
    }

    /// Returns true if a test holds for all parts of a region. Parts for which it is unsure are divided; `false` if it stays unsure, or
    /// if the region is invalid.
    pub fn all(region: &Region, mut test: impl FnMut(&Self) -> PartTest) -> bool {
        let Region { west, south, north, min_height_m, max_height_m, .. } = *region;
        let is_valid = [west, south, region.width(), north, min_height_m, max_height_m].iter().all(|v| v.is_finite());
        is_valid && Self::all_below(region, MAX_DEPTH, &mut MAX_PARTS.clone(), &mut test)
    }

    fn all_below(region: &Region, depth: u32, left: &mut u32, test: &mut impl FnMut(&Self) -> PartTest) -> bool {
        if *left == 0 {
            return false;
        }
        *left -= 1;
        match test(&Self::of(region)) {
            PartTest::Holds => true,
            PartTest::Fails => false,
            PartTest::Unsure if depth == 0 => false,
            PartTest::Unsure => {
                let middle = region.center();
                let halves = [(region.west, middle.longitude), (middle.longitude, region.west + region.width())];
                halves.into_iter().all(|(west, east)| {
                    [(region.south, middle.latitude), (middle.latitude, region.north)].into_iter().all(
                        |(south, north)| {
                            Self::all_below(&Region { west, south, east, north, ..*region }, depth - 1, left, test)
                        },
                    )
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Ellipsoid, WGS84};

    fn region(degrees: [f64; 4], ellipsoid: Ellipsoid) -> Region {
        let [west, south, east, north] = degrees.map(f64::to_radians);
        Region { west, south, east, north, min_height_m: -400.0, max_height_m: 9000.0, ellipsoid }
    }

    /// Along any direction no part is farther than its corners and the reach.
    #[test]
    fn parts_stay_within_reach_of_their_corners() {
        const SAMPLES: u32 = 12;
        let flat = Ellipsoid::from_radii_m([6.4e6, 6.4e6, 5.0e6]).unwrap();
        let regions = [
            [-180.0, -90.0, 0.0, 90.0],
            [170.0, -10.0, -170.0, 35.0],
            [0.0, 67.5, 22.5, 90.0],
            [8.0, 46.0, 10.0, 47.0],
        ];
        for (degrees, body) in regions.into_iter().flat_map(|of| [(of, WGS84), (of, flat)]) {
            let region = region(degrees, body);
            let SurfacePart { corners, reach_m } = SurfacePart::of(&region);
            let share = |i: u32| f64::from(i) / f64::from(SAMPLES);
            let samples: Vec<DVec3> = (0..(SAMPLES + 1) * (SAMPLES + 1) * 2)
                .map(|i| {
                    let [east, north] = [share(i / 2 % (SAMPLES + 1)), share(i / 2 / (SAMPLES + 1))];
                    body.ecef(&Geodetic {
                        longitude: region.west + region.width() * east,
                        latitude: region.south + (region.north - region.south) * north,
                        height_m: [region.min_height_m, region.max_height_m][i as usize % 2],
                    })
                })
                .collect();
            for i in 0..40 {
                let (turn, rise) = (f64::from(i) * 2.4, f64::from(i) / 19.5 - 1.0);
                let direction = (glam::DVec2::from_angle(turn) * (1.0 - rise * rise).sqrt()).extend(rise);
                let farthest = |of: &[DVec3]| of.iter().map(|p| p.dot(direction)).fold(f64::NEG_INFINITY, f64::max);
                let beyond_m = farthest(&samples) - farthest(&corners);
                assert!(beyond_m <= reach_m, "{degrees:?}: {beyond_m} of {reach_m} m");
            }
        }
    }

    #[test]
    fn unsure_parts_are_divided_within_limits() {
        let region = region([170.0, 0.0, -170.0, 20.0], WGS84);
        let (mut count, mut reaches) = (0, Vec::new());
        let is_all = SurfacePart::all(&region, |part| {
            count += 1;
            reaches.push(part.reach_m);
            if count > 5 { PartTest::Holds } else { PartTest::Unsure }
        });
        assert!(is_all && reaches.windows(2).take(4).all(|pair| pair[1] < pair[0]), "{reaches:?}");
        assert_eq!(count, 1 + 4 * 5, "five parts are divided");
        count = 0;
        let mut never_sure = |_: &SurfacePart| {
            count += 1;
            PartTest::Unsure
        };
        assert!(!SurfacePart::all(&region, &mut never_sure));
        assert_eq!(count, MAX_DEPTH + 1, "one smallest part decides");
        for degrees in [[0.0, f64::NAN, 1.0, 1.0], [0.0, 0.0, f64::INFINITY, 1.0]] {
            assert!(!SurfacePart::all(&self::region(degrees, WGS84), |_| PartTest::Holds), "{degrees:?}");
        }
    }
}
