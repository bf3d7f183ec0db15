//! Properties of the light of the sky that hold for any model, checked on images of air alone: from the ground to
//! orbit, by day and by night.

use glam::DVec3;
use image::RgbaImage;
use kit::rig::{Rig, camera, rig};

use terrane::scene::{DistanceFog, Environment, Node};

/// The distance from the earth's centre to the north pole in metres (WGS 84).
const POLE_M: f64 = 6_356_752.3;

/// Draws from `height_m` above the north pole, looking down by `pitch` radians, with the sun `sun` radians above the
/// horizon.
fn sky(rig: &mut Rig, height_m: f64, pitch: f64, sun: f64, turn: f64) -> RgbaImage {
    let scene = rig.scene(Node::group(vec![]));
    let eye = DVec3::new(0.0, 0.0, POLE_M + height_m);
    let ahead = DVec3::new(turn.cos() * pitch.cos(), turn.sin() * pitch.cos(), -pitch.sin());
    let camera = camera([256, 256], eye, eye + 1000.0 * ahead, DVec3::Z);
    let environment = Environment {
        up_in_world: DVec3::Z,
        sun_direction: DVec3::new(sun.cos(), 0.0, sun.sin()),
        fog: DistanceFog { enabled: true, density_per_m: 1.2e-5 },
        ..Environment::default()
    };
    let picture = rig.picture(&scene, &camera, &environment);
    rig.release(scene);
    picture
}

fn at(picture: &RgbaImage, x: u32, y: u32) -> [f32; 3] {
    let p = picture.get_pixel(x, y).0;
    [0, 1, 2].map(|i| f32::from(p[i]))
}

fn brightness(c: [f32; 3]) -> f32 {
    c[0] + c[1] + c[2]
}

/// Returns how blue a colour is, -1 to 1.
fn blueness(c: [f32; 3]) -> f32 {
    (c[2] - c[0]) / (c[0] + c[2]).max(1.0)
}

#[test]
fn daytime_sky_is_deep_blue_at_the_zenith_and_pale_at_the_horizon() {
    let Some(mut rig) = rig("daytime_sky_is_deep_blue_at_the_zenith_and_pale_at_the_horizon") else { return };
    let picture = sky(&mut rig, 200.0, -0.3, 0.8, 1.0);
    let [top, horizon] = [at(&picture, 128, 0), at(&picture, 128, 200)];
    assert!(blueness(top) > 0.25 && blueness(horizon) < 0.5 * blueness(top), "{top:?} {horizon:?}");
    assert!(brightness(horizon) > 1.5 * brightness(top), "{top:?} {horizon:?}");
    // Colours change gradually from row to row: there are no rings or steps.
    for y in 1..256 {
        let step = brightness(at(&picture, 128, y)) - brightness(at(&picture, 128, y - 1));
        assert!(step.abs() < 24.0, "{step} at row {y}");
    }
}

#[test]
fn low_sun_reddens_its_side_of_the_sky() {
    let Some(mut rig) = rig("low_sun_reddens_its_side_of_the_sky") else { return };
    let towards = at(&sky(&mut rig, 200.0, -0.1, 0.02, 0.0), 128, 136);
    let away = at(&sky(&mut rig, 200.0, -0.1, 0.02, std::f64::consts::PI), 128, 136);
    let noon = at(&sky(&mut rig, 200.0, -0.1, 0.8, 0.0), 128, 136);
    assert!(blueness(towards) < -0.2, "{towards:?}");
    assert!(brightness(towards) > 1.5 * brightness(away), "{towards:?} {away:?}");
    assert!(blueness(noon) > 0.0 && brightness(noon) > brightness(away), "{noon:?} {away:?}");
}

#[test]
fn sky_darkens_after_sunset() {
    let Some(mut rig) = rig("sky_darkens_after_sunset") else { return };
    let of = |rig: &mut Rig, sun| brightness(at(&sky(rig, 200.0, -0.3, sun, 0.0), 128, 100));
    let sunk = [0.8, 0.02, -0.06, -0.5].map(|sun| of(&mut rig, sun));
    assert!(sunk.windows(2).all(|s| s[1] < 0.75 * s[0]), "{sunk:?}");
    assert!(sunk[3] < 6.0, "{sunk:?}");
}

#[test]
fn from_orbit_the_air_is_a_thin_line_before_black_space() {
    let Some(mut rig) = rig("from_orbit_the_air_is_a_thin_line_before_black_space") else { return };
    let day = sky(&mut rig, 400_000.0, 0.35, 0.8, 1.0);
    let lit: Vec<bool> = (0..256).map(|y| brightness(at(&day, 128, y)) > 30.0).collect();
    let edge = lit.iter().position(|lit| *lit).unwrap();
    assert!((120..132).contains(&edge), "the limb is at row {edge}");
    assert!(lit[edge..].iter().all(|lit| *lit));
    for y in 0..edge as u32 - 8 {
        assert!(brightness(at(&day, 128, y)) < 2.0, "space is black, row {y}");
    }
    // Seen through the whole atmosphere, the earth is blue.
    assert!(blueness(at(&day, 128, 250)) > 0.1);
    // The night side is dark.
    let night = sky(&mut rig, 400_000.0, 0.35, -0.9, 1.0);
    assert!((0..256).all(|y| brightness(at(&night, 128, y)) < 9.0));
    // Behind the limb the sun lights a ring of air, red at the bottom and blue at the top.
    let rising = sky(&mut rig, 400_000.0, 0.35, -0.3, 0.0);
    let column: Vec<_> = (0..256).map(|y| at(&rising, 128, y)).collect();
    let reddest = column.iter().rposition(|c| brightness(*c) > 60.0 && blueness(*c) < -0.2).unwrap();
    let bluest = column.iter().position(|c| brightness(*c) > 30.0 && blueness(*c) > 0.1).unwrap();
    assert!(bluest < reddest, "{bluest} {reddest}");
}

#[test]
fn image_is_continuous_where_the_eye_leaves_the_air() {
    let Some(mut rig) = rig("image_is_continuous_where_the_eye_leaves_the_air") else { return };
    // The air ends a little above 100 km.
    let heights = [96_000.0, 99_000.0, 102_000.0, 105_000.0, 120_000.0, 130_000.0, 150_000.0];
    let pictures: Vec<_> = heights.iter().map(|&height| sky(&mut rig, height, 0.5, 0.8, 1.0)).collect();
    for pair in pictures.windows(2) {
        for y in [160, 200, 250] {
            let [a, b] = [at(&pair[0], 128, y), at(&pair[1], 128, y)];
            assert!((0..3).all(|i| (a[i] - b[i]).abs() < 12.0), "{a:?} {b:?} at row {y}");
        }
    }
}
