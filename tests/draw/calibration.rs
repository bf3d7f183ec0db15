//! Exposure and haze of the default environment: what a grey card, bare ground and far contrasts are displayed as.

use glam::{DAffine3, DQuat, DVec3};
use image::RgbaImage;
use kit::frames::{keep, pixel};
use kit::rig::{Rig, camera, rig};
use kit::shapes::quad;
use terrane::scene::{Drawable, Environment, Node};

/// Returns a linear value, 0 to 1, of an sRGB one.
fn linear(srgb: u8) -> f64 {
    let s = f64::from(srgb) / 255.0;
    if s <= 0.040_45 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
}

fn picture(rig: &mut Rig, root: Node, eye: DVec3, target: DVec3, up: DVec3, environment: &Environment) -> RgbaImage {
    let scene = rig.scene(root);
    let picture = rig.picture(&scene, &camera([256, 256], eye, target, up), environment);
    rig.release(scene);
    picture
}

/// Draws a matte grey square around the origin of a z-up world from 3 m along its normal.
fn square(rig: &mut Rig, albedo: f32, normal: DVec3, environment: &Environment) -> [u8; 3] {
    let mut drawable: Drawable = quad([0.0; 3], [10.0, 10.0], [albedo, albedo, albedo, 1.0]);
    drawable.material.unlit = false;
    let turned = DAffine3::from_quat(DQuat::from_rotation_arc(DVec3::Z, normal));
    let root = Node::transform(turned, vec![Node::geode(vec![drawable])]);
    let picture = picture(rig, root, 3.0 * normal, DVec3::ZERO, DVec3::Y, environment);
    pixel(&picture, 128, 128)
}

#[test]
fn grey_card_facing_the_sun_is_mid_grey() {
    let Some(mut rig) = rig("grey_card_facing_the_sun_is_mid_grey") else { return };
    let environment = Environment::default();
    let grey = square(&mut rig, 0.18, environment.sun_direction, &environment);
    println!("{grey:?}");
    assert!(grey.iter().all(|part| (110..=140).contains(part)), "{grey:?}");
}

#[test]
fn level_ground_has_the_colour_of_its_image() {
    let Some(mut rig) = rig("level_ground_has_the_colour_of_its_image") else { return };
    let environment = Environment::default();
    for albedo in [0.05f32, 0.1, 0.3] {
        let ground = square(&mut rig, albedo, DVec3::Z, &environment).map(linear);
        println!("{albedo}: {ground:?}");
        let mean = ground.iter().sum::<f64>() / 3.0 / f64::from(albedo);
        assert!((0.94..1.06).contains(&mean), "{albedo} is displayed as {ground:?}");
    }
}

/// Koschmieder's law: 2 % of a contrast are left at the meteorological range, here 100 km.
#[test]
fn clear_air_shows_objects_up_to_100_km() {
    let Some(mut rig) = rig("clear_air_shows_objects_up_to_100_km") else { return };
    let up = DVec3::Y;
    // The light of the air is dim, so that 8 bits hold differences well.
    let environment = Environment {
        up_in_world: up,
        sun_direction: DVec3::new(0.5, 0.8, 0.3).normalize(),
        sun_color: [0.02; 3],
        exposure: None,
        ..Environment::default()
    };
    let eye = 50.0 * up;
    let mut contrast = |distance_m: f32| {
        let card = |side: f32, white: f32| {
            quad([0.2 * side * distance_m, 50.0, -distance_m], [0.2 * distance_m; 2], [white, white, white, 1.0])
        };
        let root = Node::geode(vec![card(-1.0, 0.0), card(1.0, 1.0)]);
        let picture = picture(&mut rig, root, eye, eye + DVec3::NEG_Z, up, &environment);
        keep(&format!("contrast_{distance_m}"), &picture);
        let [black, white] = [80, 175].map(|x| pixel(&picture, x, 128).map(linear));
        (0..3).map(|i| white[i] - black[i]).sum::<f64>() / 3.0
    };
    let [near, middle, far] = [1e3, 1e4, 1e5].map(&mut contrast);
    println!("{near} {middle} {far}");
    assert!(near > 0.95 && (0.65..0.75).contains(&middle), "{near} at 1 km, {middle} at 10 km");
    // A level ray rises from the ground into clearer air.
    assert!((0.015..0.05).contains(&far), "{far} at 100 km");
}
