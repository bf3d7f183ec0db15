//! Light and air. A grey card, bare ground and far contrasts are drawn in the default environment, to check its exposure
//! and haze. The shading of height tiles does not depend on their level.

use glam::{DAffine3, DQuat, DVec3};
use image::RgbaImage;
use kit::frames::{differ, keep, pixel};
use kit::rig::{Rig, camera, rig};
use kit::shapes::quad;
use kit::terrain::Terrain;
use terrane::math::color::linear_from_srgb8;
use terrane::scene::{DistanceFog, Drawable, Environment, Node, Sky};

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
        let ground = square(&mut rig, albedo, DVec3::Z, &environment).map(linear_from_srgb8);
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
        let [black, white] = [80, 175].map(|x| pixel(&picture, x, 128).map(linear_from_srgb8));
        (0..3).map(|i| white[i] - black[i]).sum::<f64>() / 3.0
    };
    let [near, middle, far] = [1e3, 1e4, 1e5].map(&mut contrast);
    println!("{near} {middle} {far}");
    assert!(near > 0.95 && (0.65..0.75).contains(&middle), "{near} at 1 km, {middle} at 10 km");
    // A level ray rises from the ground into clearer air.
    assert!((0.015..0.05).contains(&far), "{far} at 100 km");
}

/// Returns bare ground, 1,270 km a side, whose levels have the same shape. They do not morph: their errors are large.
fn plain_ground() -> Terrain {
    Terrain { west: 0.1, south: 0.7, width: 0.2, relief_m: 0.0, root_error_m: 1e9, textured: false }
}

/// Draws all tiles of a level from 1 km above the ground. The triangles of level 0 are 20 km long.
fn picture_of_level(rig: &mut Rig, level: u32, environment: &Environment) -> RgbaImage {
    let ground = plain_ground();
    let tiles = (0..1u32 << level).flat_map(|y| (0..1u32 << level).map(move |x| (x, y)));
    let scene = rig.scene(Node::group(tiles.map(|(x, y)| ground.tile(level, x, y)).collect()));
    let eye = ground.world(0.503, 0.1, 1_000.0);
    let camera = camera([256, 256], eye, ground.world(0.503, 0.105, 0.0), ground.up(0.503, 0.1));
    let picture = rig.picture(&scene, &camera, environment);
    rig.release(scene);
    picture
}

/// Regression: light and air were computed at vertices, so that haze and dusk had the shape of the triangles.
#[test]
fn shading_of_ground_does_not_depend_on_its_level() {
    let Some(mut rig) = rig("shading_of_ground_does_not_depend_on_its_level") else { return };
    let up = plain_ground().up(0.5, 0.1);
    let east = DVec3::Z.cross(up).normalize();
    let north = up.cross(east);
    let fog = DistanceFog { enabled: true, density_per_m: 3e-5 };
    // The third sun sets on the ground that is seen.
    for (name, height, side, exposure) in
        [("noon", 0.7, east, 0.6), ("evening", 0.08, -east, 1.0), ("sunset", 0.012, north, 8.0)]
    {
        let sun_direction = (height * up + side).normalize();
        let exposure = Some(exposure);
        let haze = Environment { up_in_world: up, sun_direction, fog, exposure, ..Environment::default() };
        let air = [haze, Environment { sky: Sky::Background([90, 120, 200]), ..haze }];
        for (kind, environment) in ["air", "haze"].into_iter().zip(air) {
            let [coarse, fine] = [0, 3].map(|level| picture_of_level(&mut rig, level, &environment));
            keep(&format!("{name}_{kind}_coarse"), &coarse);
            keep(&format!("{name}_{kind}_fine"), &fine);
            let differing = differ(&coarse, &fine, 2);
            // The horizon lies a little lower on coarse triangles.
            assert!(differing <= 300, "{name} {kind}: {differing} pixels differ");
        }
    }
}
