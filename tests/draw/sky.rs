//! Sky, sea and haze: their order with other drawables, and orthographic views.

use std::sync::Arc;

use glam::dcamera::rh::proj::directx as proj;
use glam::{DMat4, DVec3, DVec4};
use kit::frames::{MAGENTA, count};
use kit::rig::{camera, rig, unit_camera};
use kit::shapes::quad;
use terrane::cull::{CullCamera, RenderStage};
use terrane::draw::CameraView;
use terrane::scene::{AlphaMode, DistanceFog, Environment, Node, Sky, Water};
use terrane::state::{Attribute, BinDetails, BlendFactor, BlendFunc, SortMode, StateSet};

const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];

#[test]
fn sky_is_behind_opaque_leaves_and_in_front_of_none_that_blend() {
    let Some(mut rig) = rig("sky_is_behind_opaque_leaves_and_in_front_of_none_that_blend") else { return };
    let mut glass = quad([0.5, 0.0, 0.0], [0.25, 0.25], [1.0, 0.0, 0.0, 0.5]);
    glass.material.alpha = AlphaMode::Blend;
    // Only its state set makes it sorted and blended, so it keeps writing depth.
    let sorted = quad([0.5, 0.6, 0.0], [0.25, 0.25], [1.0, 0.0, 0.0, 0.5]);
    let blends = BlendFunc::new(BlendFactor::SrcAlpha, BlendFactor::OneMinusSrcAlpha);
    let bin = Some(BinDetails::new(10, SortMode::BackToFront));
    let set = StateSet { bin, ..StateSet::default() }.with(Attribute::BlendFunc(blends));
    let scene = rig.scene(Node::group(vec![
        Node::geode(vec![sorted]).with_state_set(Arc::new(set)),
        Node::geode(vec![glass]),
        Node::geode(vec![quad([-0.5, 0.0, 0.0], [0.25, 0.25], RED)]),
    ]));
    let fog = DistanceFog { enabled: false, density_per_m: 0.0 };
    let sun_direction = DVec3::new(0.3, 0.8, 0.5).normalize();
    let environment =
        Environment { up_in_world: DVec3::Y, sun_direction, fog, sky: Sky::Atmosphere, ..Environment::default() };
    let picture = rig.picture(&scene, &unit_camera(256), &environment);
    assert_eq!(count(&picture, [255, 0, 0]), 64 * 64);
    let [sky, through] = [picture.get_pixel(128, 128).0, picture.get_pixel(192, 128).0];
    assert!(sky[2] > sky[0], "{sky:?}");
    assert!(through[0] > sky[0] && through[2] < sky[2] && through[2] > 60, "{through:?} over {sky:?}");
    let [above, through] = [picture.get_pixel(128, 51).0, picture.get_pixel(192, 51).0];
    assert!(through[0] > above[0] && through[2] < above[2] && through[2] > 60, "{through:?} over {above:?}");
    let top = picture.get_pixel(128, 4).0;
    assert!(top[0] < sky[0], "the zenith is deeper blue: {top:?} {sky:?}");
    rig.release(scene);
}

/// The sky is correct in a view that is rotated by a quarter. Regression: its rays had infinite length.
#[test]
fn rotated_view_shows_the_same_sky() {
    let Some(mut rig) = rig("rotated_view_shows_the_same_sky") else { return };
    let sun_direction = DVec3::new(0.6, 0.2, -0.7).normalize();
    let environment = Environment { up_in_world: DVec3::Y, sun_direction, ..Environment::default() };
    let mut sky = |camera: &CullCamera| {
        let scene = rig.scene(Node::group(Vec::new()));
        let picture = rig.picture(&scene, camera, &environment);
        rig.release(scene);
        picture
    };
    let straight = unit_camera(128);
    let before = image::imageops::rotate270(&sky(&straight));
    let turn = DMat4::from_rotation_z(std::f64::consts::FRAC_PI_2);
    let after = sky(&CullCamera { clip_from_eye: turn * straight.clip_from_eye, ..straight });
    let colors: std::collections::BTreeSet<_> = before.pixels().map(|p| p.0).collect();
    assert!(colors.len() > 50, "a sky of {} colours", colors.len());
    let most = before.iter().zip(after.iter()).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(most <= Some(2), "{most:?}");
}

/// Returns an orthographic camera from an eye to the origin, with half its width, whose depth range starts 1 m in front
/// of it.
fn parallel(eye: DVec3, up: DVec3, half_m: f64, far_m: f64) -> CullCamera {
    let depth = far_m - 1.0;
    let mut clip_from_eye = DMat4::from_diagonal(DVec4::new(1.0 / half_m, 1.0 / half_m, 1.0 / depth, 1.0));
    clip_from_eye.w_axis.z = far_m / depth;
    CullCamera { clip_from_eye, ..camera([256, 256], eye, DVec3::ZERO, up) }
}

/// Regression: all rays started at the eye.
#[test]
fn orthographic_views_have_sky_and_sea() {
    let Some(mut rig) = rig("orthographic_views_have_sky_and_sea") else { return };
    let parallel = |eye: DVec3, up: DVec3| parallel(eye, up, 50.0, 1000.0);
    let fog = DistanceFog { enabled: false, density_per_m: 0.0 };
    let sun_direction = DVec3::new(0.3, -0.2, 0.8).normalize();
    let lit = Environment { up_in_world: DVec3::Z, sun_direction, fog, ..Environment::default() };

    // Flat quads lie below and above the water, seen from above and from the side.
    let scene = rig.scene(Node::geode(vec![
        quad([-25.0, 0.0, 2.0], [5.0, 5.0], RED),
        quad([25.0, 0.0, 8.0], [5.0, 5.0], RED),
        quad([-25.0, 30.0, 4.5], [5.0, 5.0], RED),
        quad([25.0, -30.0, 5.5], [5.0, 5.0], RED),
    ]));
    let sea = Environment { sky: Sky::Background(MAGENTA), water: Some(Water::at(5.0)), exposure: None, ..lit };
    for (eye, up) in [(DVec3::new(0.0, 0.0, 100.0), DVec3::Y), (DVec3::new(0.0, -100.0, 100.0), DVec3::Z)] {
        let view = parallel(eye, up);
        let picture = rig.picture(&scene, &view, &sea);
        let at = |place: DVec3| {
            let clip = view.clip_from_eye.project_point3(view.eye_from_world.transform_point3(place));
            let [x, y] = [128.0 + 128.0 * clip.x, 128.0 - 128.0 * clip.y].map(|v| v as u32);
            picture.get_pixel(x, y).0
        };
        let is_red = |place| at(place)[..3] == [255, 0, 0];
        assert!(is_red(DVec3::new(25.0, 0.0, 8.0)) && is_red(DVec3::new(25.0, -30.0, 5.5)), "{eye}");
        assert!(!is_red(DVec3::new(-25.0, 0.0, 2.0)) && !is_red(DVec3::new(-25.0, 30.0, 4.5)), "{eye}");
        let corners = [(4, 4), (251, 4), (4, 251), (251, 251)].map(|(x, y)| picture.get_pixel(x, y).0);
        assert!(corners.iter().all(|c| *c == corners[0] && c[..3] != MAGENTA), "{eye}: {corners:?}");
    }
    rig.release(scene);

    let sky = Environment { sky: Sky::Atmosphere, ..lit };
    let scene = rig.scene(Node::group(Vec::new()));
    let eye = DVec3::new(0.0, -100.0, 0.0);
    let picture = rig.picture(&scene, &parallel(eye, DVec3::Z), &sky);
    let middle = rig.picture(&scene, &camera([256, 256], eye, DVec3::ZERO, DVec3::Z), &sky).get_pixel(128, 127).0;
    let is_near = |p: &image::Rgba<u8>| (0..3).all(|c| p.0[c].abs_diff(middle[c]) <= 3);
    assert!(picture.pixels().all(is_near), "{middle:?} {:?}", picture.get_pixel(10, 10));
    rig.release(scene);
}

#[test]
fn haze_blends_distant_objects_with_the_horizon() {
    let Some(mut rig) = rig("haze_blends_distant_objects_with_the_horizon") else { return };
    let near = quad([-50.0, 0.0, -100.0], [20.0, 20.0], RED);
    let far = quad([250_000.0, 0.0, -500_000.0], [100_000.0, 100_000.0], RED);
    let scene = rig.scene(Node::geode(vec![near, far]));
    let mut camera = unit_camera(256);
    camera.clip_from_eye = proj::perspective_infinite_reverse(1.2, 1.0, 0.1);
    let fog = DistanceFog { enabled: true, density_per_m: 2e-5 };
    let sun_direction = DVec3::new(0.3, 0.8, 0.5).normalize();
    let environment =
        Environment { up_in_world: DVec3::Y, sun_direction, fog, sky: Sky::Atmosphere, ..Environment::default() };
    let picture = rig.picture(&scene, &camera, &environment);
    let [near, far, horizon] = [(36, 128), (220, 128), (128, 126)].map(|(x, y)| picture.get_pixel(x, y).0);
    println!("{near:?} {far:?} {horizon:?}");
    assert!(near[0] > 180 && near[1] < 60, "{near:?}");
    assert!(far.iter().zip(horizon).all(|(&far, sky)| far.abs_diff(sky) < 16), "{far:?} {horizon:?}");
    rig.release(scene);
}

/// Haze depends on height and distance, not on the angle. Regression: a map from above became pale towards its corners.
#[test]
fn orthographic_rays_pass_through_equal_amounts_of_air() {
    let Some(mut rig) = rig("orthographic_rays_pass_through_equal_amounts_of_air") else { return };
    let plain = Node::geode(vec![quad([0.0, 0.0, 0.0], [200_000.0, 200_000.0], [0.05, 0.05, 0.05, 1.0])]);
    let scene = rig.scene(plain);
    let lit = Environment { up_in_world: DVec3::Z, sun_direction: DVec3::Z, ..Environment::default() };
    let air = Environment { sky: Sky::Atmosphere, fog: DistanceFog { enabled: true, density_per_m: 1e-5 }, ..lit };
    let haze =
        Environment { sky: Sky::Background(MAGENTA), fog: DistanceFog { enabled: true, density_per_m: 1e-4 }, ..lit };
    let above = |height_m: f64| parallel(DVec3::new(0.0, 0.0, height_m), DVec3::Y, 100_000.0, 50_000.0);
    for environment in [air, haze] {
        let [picture, lower] = [20_000.0, 100.0].map(|height_m| rig.picture(&scene, &above(height_m), &environment));
        let colors = [(128, 128), (2, 2), (253, 128)].map(|(x, y)| picture.get_pixel(x, y).0);
        assert!(colors.iter().all(|c| (0..3).all(|k| c[k].abs_diff(colors[0][k]) <= 2)), "{colors:?}");
        let clear = lower.get_pixel(128, 128).0;
        assert!(colors[0][2] > clear[2] + 8, "haze is on: {clear:?} {colors:?}");
    }
    rig.release(scene);
}

/// Regression: without an atmosphere, the water reflected that of another image or frame.
#[test]
fn sea_below_a_plain_background_reflects_no_other_sky() {
    let Some(mut rig) = rig("sea_below_a_plain_background_reflects_no_other_sky") else { return };
    let rig = &mut *rig;
    let scene = rig.scene(Node::group(Vec::new()));
    let fog = DistanceFog { enabled: false, density_per_m: 0.0 };
    let view = camera([256, 256], DVec3::new(0.0, 0.0, 30.0), DVec3::new(0.0, 100.0, 20.0), DVec3::Z);
    let lit =
        |sun: DVec3| Environment { up_in_world: DVec3::Z, sun_direction: sun.normalize(), fog, ..Default::default() };
    let noon = lit(DVec3::new(0.2, 0.5, 0.8));
    let sea = Environment { sky: Sky::Background(MAGENTA), water: Some(Water::at(0.0)), ..noon };
    let [high, low] = [noon, lit(DVec3::new(0.5, 0.5, 0.02))].map(|lit| Environment { sky: Sky::Atmosphere, ..lit });
    let alone = [high, low].map(|air| {
        rig.picture(&scene, &view, &air);
        rig.picture(&scene, &view, &sea)
    });
    assert!(alone[0] == alone[1], "independent of earlier images");
    let far = alone[0].pixels().filter(|p| p.0[..3] != MAGENTA).map(|p| p.0[0]).max().unwrap();
    assert!(far > 100, "it reflects the bright horizon: {far}");

    rig.ctx.resize([512, 256]).unwrap();
    let environments = [low, sea];
    let mut stages = [RenderStage::new(), RenderStage::new()];
    for (place, (stage, environment)) in (0u32..).zip(stages.iter_mut().zip(&environments)) {
        rig.visitor.environment = Some(*environment);
        rig.visitor.cull(&scene, &view, stage);
        stage.target.viewport_px = Some([256 * place, 0, 256, 256]);
    }
    let views = stages.iter().zip(&environments).map(|(stage, environment)| CameraView { stage, environment });
    rig.renderer.draw_views(&mut rig.ctx, views).unwrap();
    let beside = image::imageops::crop_imm(&rig.read_back(), 256, 0, 256, 256).to_image();
    // At another position, rays differ by rounding.
    let differs = |(a, b): &(&image::Rgba<u8>, &image::Rgba<u8>)| (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > 2);
    assert_eq!(beside.pixels().zip(alone[0].pixels()).filter(differs).count(), 0, "beside an image with an atmosphere");
    rig.release(scene);
}
