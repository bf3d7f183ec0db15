//! Images that are missing or no images: a coarser one stands in, and the geometry is drawn in any case.

use kit::server::{How, Reply, Server};
use terrane::formats::RasterOverlay;

use crate::earth::{
    Look, Looking, Patch, color_of, error_for, expected, mercator, mercator_pixel_m, numbered, numbers, png,
};

const PATCH: Patch = Patch([8.0, 47.0, 8.6, 47.4]);
const Z: u32 = 10;

fn set(folder: &std::path::Path, look: Look) -> String {
    PATCH.set(folder, error_for(mercator_pixel_m(Z, 47.0)), look)
}

fn overlay(server: &Server) -> RasterOverlay {
    RasterOverlay::template(&format!("{}/{{z}}/{{x}}/{{y}}.png", server.url))
}

#[test]
fn coarser_image_stands_in_for_one_that_is_missing() {
    for (what, bad) in [
        ("404", Reply::new(404, "")),
        ("403", Reply::new(403, "no key")),
        ("204", Reply::new(204, "")),
        ("HTML", Reply::ok("<!DOCTYPE html><html><body>Sorry</body></html>")),
        ("another size", Reply::ok(png([1, 2, 3], 1))),
        ("half of an image", Reply::ok(png([1, 2, 3], 256)[..40].to_vec())),
    ] {
        let server = Server::start(move |request| match numbers(request.path()) {
            Some([Z, x, _]) if x % 2 == 0 => bad.clone(),
            Some([z, ..]) if z == Z - 1 => bad.clone(),
            _ => numbered(request),
        });
        let folder = tempfile::tempdir().unwrap();
        let Some(looking) = Looking::at("", &set(folder.path(), Look::White), vec![overlay(&server)], &PATCH) else {
            return;
        };
        looking.check(&PATCH, |place| {
            let tile = mercator(Z, place);
            let own = expected(|at| mercator(Z, at), place, 0.006)?;
            Some(if tile[1].is_multiple_of(2) { color_of(mercator(Z - 2, place)) } else { own })
        });
        let missing = looking.overlays.missing();
        assert!(looking.overlays.missing_count() >= 2 && !missing.is_empty(), "{what}: {missing:?}");
        assert!(missing.iter().all(|image| image.error.to_string().starts_with(&server.url)), "{what}: {missing:?}");
        let ignored = looking.viewer.pager().unwrap().ignored();
        assert!(ignored.count("overlay: image that is missing or invalid") > 0, "{what}: {ignored:?}");
        assert!(looking.viewer.pager().unwrap().errors().is_empty(), "{what}");
    }
}

#[test]
fn geometry_keeps_its_own_colours_without_images() {
    let server = Server::start(|_| Reply::new(404, ""));
    let folder = tempfile::tempdir().unwrap();
    let look = Look::Textured([20, 200, 90]);
    let Some(looking) = Looking::at("", &set(folder.path(), look), vec![overlay(&server)], &PATCH) else { return };
    looking.check(&PATCH, |_| Some([20, 200, 90]));
    assert!(looking.viewer.pager().unwrap().errors().is_empty());
}

/// A server that does not answer is asked once, and the tile is drawn after all.
#[test]
fn server_that_hangs_does_not_keep_geometry_from_appearing() {
    let server = Server::start(|_| Reply::ok("").how(How::Silent));
    let folder = tempfile::tempdir().unwrap();
    let Some(looking) = Looking::at("", &set(folder.path(), Look::White), vec![overlay(&server)], &PATCH) else {
        return;
    };
    looking.check(&PATCH, |_| Some([255; 3]));
    assert!(server.seen().iter().all(|request| request.path().starts_with("/10/")), "no coarser level was asked for");
    assert!(looking.overlays.missing_count() > 0);
}

/// The document of a service is as little needed as its images.
#[test]
fn document_that_is_no_document_is_one_error() {
    use terrane::formats::OverlaySource;
    for body in ["<html></html>", "{}", "<TileMap><SRS>EPSG:2056</SRS></TileMap>"] {
        let server = Server::start(move |_| Reply::ok(body));
        let source = OverlaySource::Tms { document: format!("{}/tilemapresource.xml", server.url) };
        let folder = tempfile::tempdir().unwrap();
        let set = set(folder.path(), Look::White);
        let Some(looking) = Looking::at("", &set, vec![RasterOverlay::new(source)], &PATCH) else { return };
        looking.check(&PATCH, |_| Some([255; 3]));
        let missing = looking.overlays.missing();
        assert_eq!((missing.len(), server.count()), (1, 1), "{missing:?}");
        assert!(missing[0].error.to_string().contains("tilemapresource.xml"), "{missing:?}");
    }
}
