//! Light and air on height tiles, which are computed for each pixel.

use glam::DVec3;
use image::RgbaImage;
use kit::frames::{differ, keep};
use kit::rig::{Rig, camera, rig};
use kit::terrain::Terrain;
use terrane::scene::{DistanceFog, Environment, Node, Sky};

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
