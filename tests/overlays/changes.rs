//! Overlays that are added, removed and changed while tiles are on screen.

use std::sync::Arc;

use kit::osg_files::{VERSION, group, osgt};
use kit::server::{Reply, Server};
use terrane::formats::{OverlaySet, RasterOverlay};
use terrane::math::{Geodetic, WGS84};

use crate::earth::{
    Look, Looking, Patch, error_for, expected, mercator, mercator_pixel_m, numbered_server, png, requests,
};

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

/// A geode in the words of OpenSceneGraph's text with the part of the patch between two shares of its width, unlit, and the sphere
/// around it.
fn osg_part(id: u32, [west, east]: [f64; 2]) -> (String, [f64; 4]) {
    const CELLS: usize = 8;
    let share = |i: usize| i as f64 / CELLS as f64;
    let frame = PATCH.ecef_from_tile().inverse();
    let points: Vec<_> = (0..=CELLS)
        .flat_map(|j| (0..=CELLS).map(move |i| (i, j)))
        .map(|(i, j)| PATCH.place(west + (east - west) * share(i), share(j)).map(f64::to_radians))
        .map(|[longitude, latitude]| {
            frame.transform_point3(WGS84.ecef(&Geodetic { longitude, latitude, height_m: 0.0 }))
        })
        .collect();
    let corners: Vec<_> = (0..CELLS * CELLS)
        .map(|cell| (cell / CELLS) * (CELLS + 1) + cell % CELLS)
        .flat_map(|c| [c, c + 1, c + CELLS + 2, c, c + CELLS + 2, c + CELLS + 1])
        .collect();
    let center = (points[0] + points[points.len() - 1]) / 2.0;
    let radius = points.iter().map(|point| point.distance(center)).fold(0.0, f64::max);
    let text = |numbers: Vec<String>| numbers.join(" ");
    let positions = text(points.iter().map(|p| format!("{} {} {}", p.x, p.y, p.z)).collect());
    let indices = text(corners.iter().map(usize::to_string).collect());
    let geode = format!(
        "osg::Geode {{ UniqueID {id} StateSet TRUE {{ osg::StateSet {{ UniqueID {} ModeList 1 {{ GL_LIGHTING OFF }} }} }}
        Drawables 1 {{ osg::Geometry {{ UniqueID {}
            PrimitiveSetList 1 {{ osg::DrawElementsUShort {{ UniqueID {} Mode TRIANGLES vector {} {{ {indices} }} }} }}
            VertexArray TRUE {{ osg::Vec3Array {{ UniqueID {} Binding BIND_PER_VERTEX vector {} {{ {positions} }} }} }} }} }} }}",
        id + 1, id + 2, id + 3, corners.len(), id + 4, points.len()
    );
    (geode, [center.x, center.y, center.z, radius])
}

/// Regression: files of OpenSceneGraph kept the overlays that they were loaded with, and the tiles in them had none. One half
/// of the patch is beside a tile in the file, the other one is the tile's own content.
#[test]
fn overlays_of_osg_files_change_too() {
    let folder = tempfile::tempdir().unwrap();
    let ((west, _), (east, [x, y, z, radius])) = (osg_part(10, [0.0, 0.5]), osg_part(20, [0.5, 1.0]));
    let tile = format!(
        "osg::PagedLOD {{ UniqueID 2 CenterMode USER_DEFINED_CENTER UserCenter {x} {y} {z} {radius}
        RangeMode DISTANCE_FROM_EYE_POINT RangeList 2 {{ 1 1e+30 0 1 }} RangeDataList 2 {{ \"\" \"fine.osgt\" }}
        PriorityList 2 {{ 0 1 0 1 }} Children 1 {{ {east} }} }}"
    );
    let set = PATCH.set(folder.path(), error_for(mercator_pixel_m(Z, 47.0)), Look::White);
    std::fs::write(folder.path().join("patch.gltf"), osgt(VERSION, &group(1, &[west, tile]))).unwrap();
    let server = Server::start(|request| {
        let color = if request.path().starts_with("/red/") { [200, 20, 20] } else { [20, 20, 200] };
        Reply::ok(png(color, 256))
    });
    let overlays = |name: &str| {
        let template = format!("{}/{name}/{{z}}/{{x}}/{{y}}.png", server.url);
        Arc::new(OverlaySet::new(vec![RasterOverlay::template(&template)]).unwrap())
    };
    let is_edge = |[longitude, _]: [f64; 2]| (longitude - PATCH.place(0.5, 0.5)[0]).abs() < 0.01;
    let all = |color: [u8; 3]| move |place| (!is_edge(place)).then_some(color);
    let Some(mut looking) = Looking::at("", &set, Vec::new(), &PATCH) else { return };
    looking.check(&PATCH, all(WHITE));
    for (name, color) in [("red", [200, 20, 20]), ("blue", [20, 20, 200])] {
        looking.viewer.set_overlays(Some(overlays(name)));
        looking.settle();
        looking.check(&PATCH, all(color));
    }
    looking.viewer.set_overlays(None);
    looking.settle();
    looking.check(&PATCH, all(WHITE));
    assert!(looking.viewer.pager().unwrap().errors().is_empty());
}

/// Regression: a file of OpenSceneGraph that is opened alone showed no overlays, since no tile says where it is.
#[test]
fn osg_file_that_is_opened_alone_is_covered() {
    let folder = tempfile::tempdir().unwrap();
    let (server, template) = numbered_server();
    let ((west, _), (east, _)) = (osg_part(10, [0.0, 0.5]), osg_part(20, [0.5, 1.0]));
    let matrix = glam::DMat4::from(PATCH.ecef_from_tile()).to_cols_array().map(|number| number.to_string()).join(" ");
    let placed = format!(
        "osg::MatrixTransform {{ UniqueID 2 Children 2 {{ {west} {east} }} ReferenceFrame RELATIVE_RF Matrix {{ {matrix} }} }}"
    );
    let file = folder.path().join("patch.osgt");
    let open = |root: &str| {
        std::fs::write(&file, osgt(VERSION, root)).unwrap();
        Looking::at("", file.to_str().unwrap(), vec![RasterOverlay::template(&template)], &PATCH)
    };
    let Some(looking) = open(&group(1, std::slice::from_ref(&placed))) else { return };
    let (shown, missing) = (looking.color(PATCH.place(0.25, 0.5)), looking.overlays.missing());
    assert!(missing.is_empty() && shown != WHITE, "{shown:?}: {missing:?}");
    // Images of a level near the resolution of the file, each where it belongs.
    let levels: std::collections::BTreeSet<String> =
        requests(&server).keys().filter_map(|path| Some(path.split('/').nth(1)?.to_owned())).collect();
    let [level] = levels.iter().collect::<Vec<_>>()[..] else { panic!("{levels:?}") };
    let level: u32 = level.parse().unwrap();
    assert!((8..=12).contains(&level), "{level}");
    looking.check(&PATCH, |place| expected(|at| mercator(level, at), place, 0.006));
    // A local frame is not on the earth.
    let asked = requests(&server).len();
    let Some(_local) = open(&group(1, &[placed.replace(&matrix, &"0 ".repeat(16))])) else { return };
    assert_eq!(requests(&server).len(), asked);
}
