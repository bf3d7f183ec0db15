//! Several overlays, single images, and the kinds of geometry that they cover.

use std::path::Path;

use serde_json::json;
use terrane::formats::writers::write_height_exr;
use terrane::formats::{GeoRectangle, OverlaySource, RasterOverlay, Tiling};
use terrane::viewer::handlers::CreditsHandler;

use crate::earth::{
    COPYRIGHTS, Look, Looking, Patch, error_for, expected, mercator, mercator_pixel_m, numbered_server, png, requests,
    write_set,
};

const PATCH: Patch = Patch([8.0, 47.0, 8.6, 47.4]);
const Z: u32 = 10;

/// Returns an overlay of one colour that covers a patch.
fn flat(folder: &Path, name: &str, color: [u8; 3], patch: &Patch, opacity: f32) -> RasterOverlay {
    let file = folder.join(name);
    std::fs::write(&file, png(color, 64)).unwrap();
    let rectangle = GeoRectangle::from_degrees(patch.0).unwrap();
    let source = OverlaySource::Image { address: file.to_str().unwrap().to_owned(), rectangle };
    RasterOverlay { tiling: Tiling::Geographic, opacity, ..RasterOverlay::new(source) }
}

fn set(folder: &Path, look: Look) -> String {
    PATCH.set(folder, error_for(mercator_pixel_m(Z, 47.0)), look)
}

#[test]
fn later_overlays_lie_above_with_their_opacity() {
    let folder = tempfile::tempdir().unwrap();
    let (_server, template) = numbered_server();
    let below = || RasterOverlay::template(&template);
    // It covers the western half.
    let half = Patch([8.0, 46.0, 8.3, 48.0]);
    let above = |opacity| flat(folder.path(), "flat.png", [200, 100, 40], &half, opacity);
    let set = set(folder.path(), Look::White);
    let mix = |below: [u8; 3], opacity: f64| {
        let mixed = |above: u8, below: u8| f64::from(above) * opacity + f64::from(below) * (1.0 - opacity);
        [mixed(200, below[0]), mixed(100, below[1]), mixed(40, below[2])].map(|c| c.round() as u8)
    };
    for opacity in [0.25f32, 1.0] {
        let overlays = vec![below(), above(opacity)];
        let Some(looking) = Looking::at(&format!("overlay-order-{opacity}"), &set, overlays, &PATCH) else { return };
        looking.check(&PATCH, |place| {
            let own = expected(|at| mercator(Z, at), place, 0.006)?;
            let is_near_edge = (place[0] - 8.3).abs() < 0.006;
            (!is_near_edge).then(|| if place[0] < 8.3 { mix(own, f64::from(opacity)) } else { own })
        });
    }
    let Some(looking) = Looking::at("", &set, vec![above(1.0), below()], &PATCH) else { return };
    looking.check(&PATCH, |place| expected(|at| mercator(Z, at), place, 0.006));
}

/// The texture of a mesh shows beside and through an overlay.
#[test]
fn textured_mesh_keeps_its_texture_below_an_overlay() {
    let folder = tempfile::tempdir().unwrap();
    let half = Patch([8.0, 46.0, 8.3, 48.0]);
    let (own, above) = ([20u8, 200, 90], [200u8, 100, 40]);
    let set = set(folder.path(), Look::Textured(own));
    for opacity in [0.5f32, 1.0] {
        let overlays = vec![flat(folder.path(), "flat.png", above, &half, opacity)];
        let Some(looking) = Looking::at(&format!("overlay-textured-{opacity}"), &set, overlays, &PATCH) else { return };
        // They are blended in linear light.
        let blended = [0, 1, 2].map(|c| {
            let linear = |of: u8| f64::from(of) / 255.0;
            let to_linear = |s: f64| if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) };
            let to_srgb = |l: f64| if l <= 0.003_130_8 { l * 12.92 } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
            let mixed = to_linear(linear(above[c])) * f64::from(opacity)
                + to_linear(linear(own[c])) * (1.0 - f64::from(opacity));
            (to_srgb(mixed) * 255.0).round() as u8
        });
        looking.check(&PATCH, |place| {
            let is_near_edge = (place[0] - 8.3).abs() < 0.01;
            (!is_near_edge).then_some(if place[0] < 8.3 { blended } else { own })
        });
    }
}

/// Writes a height tile of the patch with its own imagery.
fn height_set(folder: &Path, own: [u8; 3], error_m: f64) -> String {
    let side = 7;
    let exr = write_height_exr("0.exr", side, vec![0.0; side * side]).unwrap();
    std::fs::write(folder.join("0.exr"), exr).unwrap();
    std::fs::write(folder.join("0.png"), png(own, 64)).unwrap();
    let [west, south, east, north] = PATCH.0.map(f64::to_radians);
    let set = json!({
        "asset": { "version": "1.1", "extras": { "terrane": {
            "content": "height", "side": 5, "border": 1, "level_errors_m": [error_m] } } },
        "geometricError": 1e7,
        "root": {
            "refine": "REPLACE", "geometricError": error_m,
            "boundingVolume": { "region": [west, south, east, north, -1000, 1000] },
            "content": { "uri": "0.exr" }, "extras": { "terrane": { "imagery": "0.png" } } },
    });
    let file = folder.join("tileset.json");
    std::fs::write(&file, set.to_string()).unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn height_tile_is_covered_over_its_own_imagery() {
    let folder = tempfile::tempdir().unwrap();
    // Height tiles are refined at an error of three pixels.
    let error_m = mercator_pixel_m(Z, 47.0) * 1.5;
    let own = [90, 90, 90];
    let set = height_set(folder.path(), own, error_m);
    let (server, template) = numbered_server();
    let west = GeoRectangle::from_degrees([0.0, 40.0, 8.3, 50.0]);
    let overlay = RasterOverlay { rectangle: west, ..RasterOverlay::template(&template) };
    let Some(covered) = Looking::at("overlay-height", &set, vec![overlay], &PATCH) else { return };
    let Some(plain) = Looking::at("", &set, Vec::new(), &PATCH) else { return };
    // Height tiles are lit: the colours are compared with those without an overlay.
    let own_light = plain.color(PATCH.place(0.9, 0.5));
    assert_eq!(covered.color(PATCH.place(0.9, 0.5)), own_light, "beside the overlay");
    let differs = (0..10).map(|k| PATCH.place(0.1 + 0.03 * f64::from(k), 0.5));
    assert!(differs.filter(|place| covered.color(*place) != own_light).count() >= 9);
    assert!(server.seen().iter().all(|request| request.path().starts_with("/10/")), "{:?}", server.seen());
}

#[test]
fn invalid_images_of_the_application_are_reported_not_fatal() {
    let folder = tempfile::tempdir().unwrap();
    let set = set(folder.path(), Look::White);
    let rectangle = GeoRectangle::from_degrees(PATCH.0).unwrap();
    let address = folder.path().join("nothing.png").to_str().unwrap().to_owned();
    let source = OverlaySource::Image { address, rectangle };
    let Some(looking) = Looking::at("", &set, vec![RasterOverlay::new(source)], &PATCH) else { return };
    looking.check(&PATCH, |_| Some([255; 3]));
    assert_eq!(looking.overlays.missing().len(), 1);
}

/// Attributions are those of what the last frames showed.
#[test]
fn credits_are_those_of_what_is_on_screen() {
    let folder = tempfile::tempdir().unwrap();
    let set = set(folder.path(), Look::White);
    let elsewhere = Patch([100.0, 10.0, 101.0, 11.0]);
    let overlays = vec![
        RasterOverlay {
            credit: Some("(c) Overlay".into()),
            ..flat(folder.path(), "flat.png", [200, 100, 40], &PATCH, 1.0)
        },
        RasterOverlay {
            credit: Some("(c) Elsewhere".into()),
            ..flat(folder.path(), "other.png", [1, 2, 3], &elsewhere, 1.0)
        },
    ];
    let Some(mut looking) = Looking::at("", &set, overlays, &PATCH) else { return };
    let mut credits = looking.viewer.credits();
    credits.sort();
    assert_eq!(credits, ["(c) Overlay", COPYRIGHTS[1], COPYRIGHTS[0]].map(Into::into));
    assert_eq!(looking.overlays.credits(), ["(c) Overlay".into()]);
    // Windows show them at the lower edge.
    let plain = looking.picture().clone();
    looking.viewer.view_mut().add_event_handler(CreditsHandler::default());
    (0..3).for_each(|_| looking.draw());
    let changed = |rows: std::ops::Range<u32>| {
        let places = rows.flat_map(|y| (0..plain.width()).map(move |x| (x, y)));
        places.filter(|(x, y)| plain.get_pixel(*x, *y) != looking.picture().get_pixel(*x, *y)).count()
    };
    let half = plain.height() / 2;
    assert_eq!(changed(0..half), 0);
    assert!(changed(half..plain.height()) > 100);
    // The patch is behind the camera; the set remains.
    let pose = &mut looking.viewer.view_mut().camera.world_from_eye;
    *pose *= glam::DAffine3::from_rotation_x(std::f64::consts::PI);
    for _ in 0..5 {
        looking.viewer.frame().unwrap();
    }
    assert_eq!(looking.viewer.credits(), [COPYRIGHTS[0].into()]);
}

/// Nothing of such a content is read, but for its images.
#[test]
fn content_inside_of_the_tileset_is_covered() {
    use base64::Engine as _;
    use terrane::formats::writers::{GlbMesh, write_glb};
    let folder = tempfile::tempdir().unwrap();
    let mut tile = PATCH.tile(
        folder.path(),
        "unused",
        error_for(mercator_pixel_m(Z, 47.0)),
        Look::White,
        glam::DAffine3::IDENTITY,
    );
    let glb = write_glb(&GlbMesh {
        positions: vec![[-2e4, -2e4, 0.0], [2e4, -2e4, 0.0], [0.0, 2e4, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    let text = base64::engine::general_purpose::STANDARD.encode(glb);
    tile["content"] = json!({ "uri": format!("data:model/gltf-binary;base64,{text}") });
    let set = write_set(folder.path(), tile);
    let (server, template) = numbered_server();
    let Some(plain) = Looking::at("", &set, Vec::new(), &PATCH) else { return };
    let Some(covered) = Looking::at("", &set, vec![RasterOverlay::template(&template)], &PATCH) else { return };
    let middle = PATCH.place(0.5, 0.5);
    assert_ne!(covered.color(middle), plain.color(middle));
    assert!(requests(&server).keys().all(|path| path.starts_with("/10/")) && server.count() > 3);
}
