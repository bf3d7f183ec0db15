//! Compares reference systems with PROJ 9.1.1 at points over their whole areas of use.

use std::collections::BTreeSet;

use terrane_data_gen::Crs;

/// In each line a code of EPSG, longitude and latitude in degrees, and the coordinates of
/// `cs2cs EPSG:4326 EPSG:CODE`, east before north: 4 x 4 points in the rectangle of each system's area of use.
const POINTS: &str = include_str!("proj_points.txt");

/// The systems whose coordinates are survey feet.
const SURVEY_FEET: [f64; 7] = [2229.0, 2263.0, 2272.0, 2284.0, 3089.0, 6539.0, 9748.0];

/// The largest distance in metres.
const MAX_ERROR_M: f64 = 0.005;

#[test]
fn systems_agree_with_proj_over_their_areas_of_use() {
    let mut codes = BTreeSet::new();
    for line in POINTS.lines() {
        let numbers: Vec<f64> = line.split(' ').map(|number| number.parse().unwrap()).collect();
        let &[code, longitude, latitude, x, y] = numbers.as_slice() else { panic!("{line}") };
        let crs = Crs::from_epsg(code as u32).unwrap();
        let unit_m = if SURVEY_FEET.contains(&code) { 1200.0 / 3937.0 } else { 1.0 };
        let [own_x, own_y] = crs.project(longitude.to_radians(), latitude.to_radians());
        let forward_m = (own_x - x).hypot(own_y - y) * unit_m;
        let [lon, lat] = crs.unproject(x, y);
        let east = (lon - longitude.to_radians() + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU);
        let east_m = (east - std::f64::consts::PI) * latitude.to_radians().cos() * 6_378_137.0;
        let back_m = east_m.hypot((lat - latitude.to_radians()) * 6_378_137.0);
        assert!(forward_m <= MAX_ERROR_M && back_m <= MAX_ERROR_M, "{line}: {forward_m} m, {back_m} m back");
        codes.insert(code as u32);
    }
    assert_eq!(codes.len(), 79);
}
