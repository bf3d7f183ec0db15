//! Tiles of map servers: the right one at the right place, of the right level.

use glam::DAffine3;
use terrane::formats::{RasterOverlay, Tiling};

use crate::earth::{
    Look, Looking, Patch, color_of, error_for, expected, geographic, mercator, mercator_pixel_m, numbered_server,
    numbers, requests, write_set,
};

const ZURICH: Patch = Patch([8.0, 47.0, 8.6, 47.4]);

#[test]
fn images_of_the_level_that_the_screen_needs_lie_at_their_places() {
    for z in [8, 10, 11] {
        let folder = tempfile::tempdir().unwrap();
        let (server, template) = numbered_server();
        let set = ZURICH.set(folder.path(), error_for(mercator_pixel_m(z, 47.0)), Look::White);
        let overlays = vec![RasterOverlay::template(&template)];
        let Some(looking) = Looking::at(&format!("overlay-{z}"), &set, overlays, &ZURICH) else { return };
        looking.check(&ZURICH, |place| expected(|at| mercator(z, at), place, 0.006));
        // Each image that covers the patch was requested once, and no other.
        let [west, south, east, north] = ZURICH.0;
        let [[_, x0, y0], [_, x1, y1]] = [[west, north], [east, south]].map(|corner| mercator(z, corner));
        let mut wanted: Vec<String> =
            (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| format!("/{z}/{x}/{y}.png"))).collect();
        wanted.sort();
        let seen = requests(&server);
        assert_eq!(seen.keys().cloned().collect::<Vec<_>>(), wanted, "level {z}");
        assert!(seen.values().all(|count| *count == 1), "{seen:?}");
        assert_eq!(looking.overlays.missing_count(), 0);
    }
}

#[test]
fn geographic_tiles_and_rows_from_the_south_are_in_their_places() {
    let z = 9;
    let folder = tempfile::tempdir().unwrap();
    let (_server, template) = numbered_server();
    let pixel_m = 180.0 / f64::from(256u32 << z) * 6_378_137.0f64.to_radians();
    let set = ZURICH.set(folder.path(), error_for(pixel_m), Look::White);
    let overlay = RasterOverlay { tiling: Tiling::Geographic, ..RasterOverlay::template(&template) };
    let from_south = template.replace("{y}", "{-y}");
    let south = RasterOverlay { tiling: Tiling::Geographic, ..RasterOverlay::template(&from_south) };
    let Some(looking) = Looking::at("overlay-geographic", &set, vec![overlay], &ZURICH) else { return };
    looking.check(&ZURICH, |place| expected(|at| geographic(z, at), place, 0.006));
    let Some(looking) = Looking::at("overlay-south", &set, vec![south], &ZURICH) else { return };
    let counted = |at| {
        let [z, x, y] = geographic(z, at);
        [z, x, (1 << z) - 1 - y]
    };
    looking.check(&ZURICH, |place| expected(counted, place, 0.006));
}

/// A tile across the antimeridian, and one at the pole: images beyond 180 degrees, and none beyond 85.
#[test]
fn antimeridian_and_poles_have_no_hole() {
    let z = 6;
    let across = Patch([177.0, 10.0, 183.0, 14.0]);
    let folder = tempfile::tempdir().unwrap();
    let (_server, template) = numbered_server();
    let set = across.set(folder.path(), error_for(mercator_pixel_m(z, 10.0)), Look::White);
    let overlays = || vec![RasterOverlay::template(&template)];
    let Some(looking) = Looking::at("overlay-antimeridian", &set, overlays(), &across) else { return };
    looking.check(&across, |place| expected(|at| mercator(z, at), place, 0.06));

    let pole = Patch([0.0, 82.0, 60.0, 89.0]);
    let folder = tempfile::tempdir().unwrap();
    let set = pole.set(folder.path(), error_for(mercator_pixel_m(3, 82.0)), Look::White);
    let Some(looking) = Looking::at("overlay-pole", &set, overlays(), &pole) else { return };
    // The last row continues to the pole.
    looking.check(&pole, |place| expected(|[x, y]| mercator(3, [x, y.min(85.0)]), place, 0.6));
}

/// Finer tiles of the set have finer images.
#[test]
fn each_level_of_a_set_has_its_own_level_of_images() {
    // Seen whole, the error of the root covers more than 16 pixels, and that of its children fewer.
    let z = 6;
    let whole = Patch([8.0, 47.0, 10.0, 48.0]);
    let folder = tempfile::tempdir().unwrap();
    let coarse_m = error_for(mercator_pixel_m(z, 47.0));
    let mut root = whole.tile(folder.path(), "root", coarse_m, Look::White, DAffine3::IDENTITY);
    let quarters: Vec<Patch> = (0..4)
        .map(|i| {
            let ([w, s], [e, n]) = (
                whole.place(f64::from(i % 2) * 0.5, f64::from(i / 2) * 0.5),
                whole.place(f64::from(i % 2) * 0.5 + 0.5, f64::from(i / 2) * 0.5 + 0.5),
            );
            Patch([w, s, e, n])
        })
        .collect();
    let children = quarters.iter().enumerate().map(|(i, quarter)| {
        quarter.tile(folder.path(), &format!("child-{i}"), coarse_m / 4.0, Look::White, whole.ecef_from_tile())
    });
    root["children"] = children.collect();
    let set = write_set(folder.path(), root);
    let (server, template) = numbered_server();
    let overlays = || vec![RasterOverlay::template(&template)];
    // From far away, an error of the root's size is small.
    let Some(far) = Looking::from_height("overlay-far", &set, overlays(), &whole, 40.0) else { return };
    let middle = far.color(whole.place(0.5, 0.5));
    assert!(middle[0].abs_diff(color_of(mercator(z, whole.place(0.5, 0.5)))[0]) <= 2, "{middle:?}");
    assert!(requests(&server).keys().all(|path| numbers(path).unwrap()[0] == z), "{:?}", requests(&server));
    let Some(near) = Looking::at("overlay-near", &set, overlays(), &whole) else { return };
    near.check(&whole, |place| expected(|at| mercator(z + 2, at), place, 0.02));
    // Neighbours share images, which are requested once in each viewer.
    let seen = requests(&server);
    assert!(seen.values().all(|count| *count <= 2), "{seen:?}");
}
