//! Domes and panoramas: the direction that each pixel shows, in every threading model. Needs a GPU; a software adapter
//! suffices.

use glam::DVec3;
use image::RgbaImage;
use kit::shapes::ball;
use kit::skip::or_skip;
use terrane::scene::{Node, Page, Sky};
use terrane::viewer::{SphericalDisplay, SphericalProjection, ThreadingModel, Viewer, ViewerConfig};

const RED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];
const GREEN: [f32; 4] = [0.0, 1.0, 0.0, 1.0];
const BLUE: [f32; 4] = [0.0, 0.0, 1.0, 1.0];
const YELLOW: [f32; 4] = [1.0, 1.0, 0.0, 1.0];
const CYAN: [f32; 4] = [0.0, 1.0, 1.0, 1.0];
const PURPLE: [f32; 4] = [1.0, 0.0, 1.0, 1.0];

/// Balls around an eye that looks along y, with z up: ahead, right, back, left, up, down.
const BALLS: [(DVec3, [f32; 4]); 6] = [
    (DVec3::Y, RED),
    (DVec3::X, GREEN),
    (DVec3::NEG_Y, BLUE),
    (DVec3::NEG_X, YELLOW),
    (DVec3::Z, CYAN),
    (DVec3::NEG_Z, PURPLE),
];

fn picture(size_px: [u32; 2], threading: ThreadingModel, projection: SphericalProjection) -> Option<RgbaImage> {
    let config = ViewerConfig { size_px, threading, adapter: kit::adapter(), ..ViewerConfig::default() };
    let mut viewer = or_skip(Viewer::new_offscreen(&config))?;
    let balls = BALLS.map(|(at, color)| ball(10.0 * at, 3.0, color));
    viewer.add_root(Page::from_node(Node::group(balls.to_vec())).unwrap()).unwrap();
    viewer.view_mut().environment.sky = Sky::Background([0, 0, 0]);
    viewer.view_mut().environment.fog.enabled = false;
    viewer.view_mut().camera.look_at(DVec3::ZERO, DVec3::Y, DVec3::Z);
    let (view, context) = (viewer.view_id(), viewer.context());
    let display = SphericalDisplay { projection, face_px: 128 };
    viewer.composite_mut().set_up_spherical_display(view, context, &display).unwrap();
    (0..4).for_each(|_| viewer.frame().unwrap());
    // The image shows its own frame, and not the one before.
    viewer.view_mut().camera.look_at(DVec3::ZERO, DVec3::NEG_Y, DVec3::Z);
    viewer.frame().unwrap();
    viewer.view_mut().camera.look_at(DVec3::ZERO, DVec3::Y, DVec3::Z);
    viewer.frame().unwrap();
    Some(viewer.read_back().unwrap())
}

/// True if a pixel has the hue of a colour; balls are shaded.
fn shows(picture: &RgbaImage, x: u32, y: u32, color: [f32; 4]) -> bool {
    let found = picture.get_pixel(x, y).0;
    (0..3).all(|i| (found[i] > 40) == (color[i] > 0.5))
}

#[test]
fn panorama_shows_every_direction_at_its_longitude_and_latitude() {
    for threading in ThreadingModel::ALL {
        let Some(picture) = picture([256, 128], threading, SphericalProjection::Panorama) else { return };
        for (x, y, color) in
            [(128, 64, RED), (192, 64, GREEN), (2, 64, BLUE), (64, 64, YELLOW), (128, 2, CYAN), (128, 125, PURPLE)]
        {
            assert!(shows(&picture, x, y, color), "{threading}: {:?} at {x}, {y}", picture.get_pixel(x, y));
        }
        // Between two balls there is the background.
        assert!(shows(&picture, 160, 64, [0.0; 4]), "{threading}: {:?}", picture.get_pixel(160, 64));
    }
}

#[test]
fn dome_is_a_disc_around_the_direction_of_view() {
    let hemisphere = SphericalProjection::Dome { radius: 5.0, collar: 5.0 };
    let Some(picture) = picture([200, 120], ThreadingModel::DrawThreadPerContext, hemisphere) else { return };
    // The disc has the height of the image, and its edge shows what is at a right angle to the direction of view.
    for (x, y, color) in [(100, 60, RED), (157, 60, GREEN), (43, 60, YELLOW), (100, 3, CYAN), (100, 117, PURPLE)] {
        assert!(shows(&picture, x, y, color), "{:?} at {x}, {y}", picture.get_pixel(x, y));
    }
    assert!(shows(&picture, 130, 60, [0.0; 4]) && shows(&picture, 20, 60, [0.0; 4]));
}

/// The projector is behind the viewer, so that the disc covers more than half of the surroundings.
#[test]
fn collar_widens_the_angle_of_a_dome() {
    let (radius, collar) = (1.0f64, 0.6);
    let dome = SphericalProjection::Dome { radius, collar };
    let Some(picture) = picture([240, 240], ThreadingModel::SingleThreaded, dome) else { return };
    // The direction at a right angle to that of view lies where the ray of the projector meets the dome beside the viewer.
    let distance = (radius * radius - collar * collar).sqrt();
    let phi = radius.atan2(distance);
    let r_px = (120.0 * phi / std::f64::consts::FRAC_PI_2).round() as u32;
    assert!((40..100).contains(&r_px), "{r_px}");
    for (x, y, color) in [(120 + r_px, 120, GREEN), (120 - r_px, 120, YELLOW), (120, 120 - r_px, CYAN), (120, 120, RED)]
    {
        assert!(shows(&picture, x, y, color), "{:?} at {x}, {y}", picture.get_pixel(x, y));
    }
}
