//! Overlays that are added, removed and changed while tiles are on screen.

use std::sync::Arc;

use terrane::formats::{OverlaySet, RasterOverlay};

use crate::earth::{Look, Looking, Patch, error_for, expected, mercator, mercator_pixel_m, numbered_server, requests};

const PATCH: Patch = Patch([8.0, 47.0, 8.6, 47.4]);
const Z: u32 = 10;
/// The colour of the set without overlays.
const WHITE: [u8; 3] = [255; 3];

/// Changes the overlays. Nothing may leave the screen before it is loaded again.
fn change(looking: &mut Looking, overlays: Option<Arc<OverlaySet>>, before: impl Fn([f64; 2]) -> Option<[u8; 3]>) {
    looking.viewer.pager_mut().unwrap().set_paused(true);
    looking.viewer.set_overlays(overlays);
    for _ in 0..4 {
        looking.draw();
        looking.check(&PATCH, &before);
    }
    looking.viewer.pager_mut().unwrap().set_paused(false);
    looking.settle();
}

/// Overlays were fixed with their pager: a change removed all that was on screen.
#[test]
fn overlays_change_while_tiles_stay_on_screen() {
    let folder = tempfile::tempdir().unwrap();
    let (server, template) = numbered_server();
    let set = PATCH.set(folder.path(), error_for(mercator_pixel_m(Z, 47.0)), Look::White);
    let overlay = |opacity| RasterOverlay { opacity, ..RasterOverlay::template(&template) };
    let numbered = |place| expected(|at| mercator(Z, at), place, 0.006);
    let Some(mut looking) = Looking::at("", &set, Vec::new(), &PATCH) else { return };
    looking.check(&PATCH, |_| Some(WHITE));
    let loaded = looking.viewer.pager().unwrap().stats().loaded;

    let opaque = Arc::new(looking.overlays.with_overlays(vec![overlay(1.0)]).unwrap());
    change(&mut looking, Some(opaque.clone()), |_| Some(WHITE));
    looking.check(&PATCH, numbered);
    assert_eq!(looking.viewer.pager().unwrap().stats().loaded, loaded + 1, "by the same pager");

    let half = Arc::new(opaque.with_overlays(vec![overlay(0.5)]).unwrap());
    change(&mut looking, Some(half), numbered);
    let Some(fresh) = Looking::at("", &set, vec![overlay(0.5)], &PATCH) else { return };
    let as_fresh = |place| Some(fresh.color(place));
    looking.check(&PATCH, as_fresh);
    assert_ne!(fresh.color(PATCH.place(0.5, 0.5)), WHITE);

    let asked = requests(&server);
    change(&mut looking, None, as_fresh);
    looking.check(&PATCH, |_| Some(WHITE));
    assert_eq!(requests(&server), asked);
    assert!(looking.viewer.overlays().is_none() && looking.viewer.pager().unwrap().errors().is_empty());
}

/// What was loaded before stays if it cannot be loaded again.
#[test]
fn content_that_is_gone_keeps_what_was_loaded_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let (_server, template) = numbered_server();
    let set = PATCH.set(folder.path(), error_for(mercator_pixel_m(Z, 47.0)), Look::White);
    let Some(mut looking) = Looking::at("", &set, Vec::new(), &PATCH) else { return };
    std::fs::remove_file(folder.path().join("patch.gltf")).unwrap();
    let overlays = OverlaySet::new(vec![RasterOverlay::template(&template)]).unwrap();
    change(&mut looking, Some(Arc::new(overlays)), |_| Some(WHITE));
    looking.check(&PATCH, |_| Some(WHITE));
    assert_eq!(looking.viewer.pager().unwrap().errors().len(), 1);
}
