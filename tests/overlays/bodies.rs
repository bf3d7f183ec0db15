//! Overlays over other bodies than the earth: images are chosen by the angles that their texels cover.

use std::sync::Arc;

use kit::frames::{keep, pixel};
use kit::rig::plain;
use kit::viewer::{Settle, offscreen};
use terrane::formats::{OverlaySet, RasterOverlay};
use terrane::math::{Geodetic, MOON};
use terrane::pager::PagerConfig;
use terrane::scene::Environment;
use terrane::viewer::{LoadedRoot, ViewerConfig, world_from_eye};

use crate::earth::{SIDE, color_of, mercator, numbered_server, numbers, requests};

/// Longitude and latitude in degrees, in the middle of the tile 6/35/26 of Web Mercator.
const PLACE: [f64; 2] = [19.7, 29.5];

/// Straight down from 400 km a pixel is 1.8 km. A texel of level 4 is 2.3 km at this latitude on the Moon, and 8.5 km on the earth.
#[test]
fn images_over_the_moon_lie_at_their_places_and_are_of_its_scale() {
    let (server, template) = numbered_server();
    let overlays = Arc::new(OverlaySet::new(vec![RasterOverlay::template(&template)]).unwrap());
    let pager = PagerConfig { overlays: Some(overlays), ellipsoid: MOON, ..PagerConfig::default() };
    let mut config = ViewerConfig { size_px: [SIDE, SIDE], adapter: kit::adapter(), pager, ..ViewerConfig::default() };
    config.pager.http.allowed_hosts = vec!["127.0.0.1".parse().unwrap()];
    let Some(mut viewer) = offscreen(&config) else { return };
    viewer.set_root(LoadedRoot::ellipsoid(&config.pager).unwrap()).unwrap();
    assert_eq!(viewer.scene().ellipsoid(), MOON);
    let [longitude, latitude] = PLACE.map(f64::to_radians);
    let frame = MOON.ecef_from_enu(&Geodetic { longitude, latitude, height_m: 400_000.0 });
    // Level ground has the colour of its image.
    viewer.view_mut().environment = Environment { sun_color: [0.0; 3], ambient_color: [1.0; 3], ..plain() };
    viewer.view_mut().camera.world_from_eye =
        world_from_eye(frame.translation, -frame.matrix3.z_axis, frame.matrix3.y_axis);
    viewer.settle(2);
    viewer.want_picture();
    viewer.frame().unwrap();
    viewer.finish().unwrap();
    let picture = viewer.take_pictures().pop().unwrap().1;
    keep("overlay-moon", &picture);
    let middle = pixel(&picture, SIDE / 2, SIDE / 2);
    let is_of = |z: &u32| middle.iter().zip(color_of(mercator(*z, PLACE))).all(|(a, b)| a.abs_diff(b) <= 3);
    let level = (0..12).find(is_of).unwrap_or_else(|| panic!("{middle:?} is of no image of the place"));
    assert!((4..=5).contains(&level), "{level}");
    let finest = requests(&server).keys().filter_map(|path| numbers(path)).map(|[z, ..]| z).max();
    assert_eq!(finest, Some(level), "no finer image was asked for");
}
