//! Sets of other bodies than the earth in a viewer: what is seen, picked and culled.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;

use kit::bodies::{self, Square, write_set};
use kit::frames::pixel;
use kit::tile_sets::generate;
use kit::viewer::{Settle as _, offscreen};
use terrane::gpu::AdapterChoice;
use terrane::math::{Geodetic, MOON, WGS84};
use terrane::pager::PagerConfig;
use terrane::scene::{
    DistanceFog, Environment, HeightQuery, IntersectionLimit, PageId, Scene, Sky, SlotState, Vertical,
};
use terrane::viewer::manipulators::SceneGround;
use terrane::viewer::{Viewer, ViewerConfig, world_from_eye};

/// The radius of the Moon, metres.
const RADIUS_M: f64 = 1_737_400.0;

fn config(adapter: AdapterChoice) -> ViewerConfig {
    ViewerConfig {
        size_px: [160, 120],
        adapter,
        validation: false,
        pager: PagerConfig { build_kd_trees: true, blocking: true, ..PagerConfig::default() },
        ..ViewerConfig::default()
    }
}

fn square(longitude: f64, latitude: f64) -> Square {
    Square { ellipsoid: MOON, middle: Geodetic { longitude, latitude, height_m: 250.0 }, half_m: 2000.0 }
}

/// Returns true for each content that is resident, by the name of its file.
fn contents(scene: &Scene, page: PageId, found: &mut BTreeMap<String, bool>) {
    for slot in scene.slots_of_page(page) {
        let info = scene.slot(slot).unwrap();
        let name = info.uri.rsplit('/').next().unwrap().to_owned();
        found.insert(name, matches!(info.state, SlotState::Resident(_)));
        if let SlotState::Resident(below) = info.state {
            contents(scene, below, found);
        }
    }
}

/// A square of the Moon that an external tileset has is looked at from 1 km above it. One on the far side lies in the frustum.
#[test]
fn place_on_the_moon_is_picked_and_its_far_side_is_culled() {
    let folder = tempfile::tempdir().unwrap();
    let (near, far) = (square(0.26, 0.31), square(0.26 - PI, -0.31));
    let below = [near.tile(folder.path(), "near")];
    write_set(&folder.path().join("below.json"), "", near.region(), &below);
    let external = format!(
        r#"{{"boundingVolume":{{"region":{:?}}},"geometricError":1e6,"content":{{"uri":"below.json"}}}}"#,
        near.region()
    );
    let whole = [-PI, -0.5 * PI, PI, 0.5 * PI, -2000.0, 2000.0];
    let tiles = [external, far.tile(folder.path(), "far")];
    write_set(&folder.path().join("tileset.json"), bodies::MOON, whole, &tiles);
    let mut viewer = Viewer::new_offscreen(&config(AdapterChoice::Noop)).unwrap();
    viewer.load(folder.path().to_str().unwrap()).unwrap();
    viewer.view_mut().set_ground(Some(Box::new(SceneGround::default())));
    let ellipsoid = viewer.scene().ellipsoid();
    let bounds = *viewer.bounds().unwrap();
    assert_eq!((ellipsoid, bounds.ellipsoid, bounds.frame.ellipsoid), (MOON, MOON, Some(MOON)));
    let body = bounds.horizon_ellipsoid().unwrap();
    assert!(body.semi_major_m == RADIUS_M - 2000.0 && body.semi_minor_m == body.semi_major_m, "{body:?}");

    let frame = MOON.ecef_from_enu(&Geodetic { height_m: 1250.0, ..near.middle });
    let (eye, up) = (frame.translation, frame.matrix3.z_axis);
    viewer.view_mut().camera.world_from_eye = world_from_eye(eye, -up, frame.matrix3.y_axis);
    viewer.frame().unwrap();
    let mut found = BTreeMap::new();
    contents(viewer.scene(), viewer.scene().roots()[0], &mut found);
    let expected = [("below.json", true), ("far.glb", false), ("near.glb", true)];
    assert_eq!(found, expected.map(|(name, is_there)| (name.to_owned(), is_there)).into());
    assert!((viewer.view().environment.up_in_world - up).length() < 1e-12);

    for (x, y) in [(80.0, 60.0), (20.5, 31.0), (140.0, 100.25)] {
        let direction = viewer.view().camera.ray_direction([160, 120], x, y);
        // The square is a plane 1 km below the eye.
        let expected = eye + direction * (1000.0 / -direction.dot(up));
        let hits = viewer.compute_intersections(x, y, IntersectionLimit::Nearest);
        let hit = hits.first().unwrap_or_else(|| panic!("nothing at {x} {y}")).world_point();
        assert!(hit.distance(expected) < 1e-3, "{x} {y}: {}", hit.distance(expected));
        let place = ellipsoid.geodetic(hit);
        let by_hand =
            [expected.y.atan2(expected.x), (expected.z / expected.length()).asin(), expected.length() - RADIUS_M];
        let off_m = [place.longitude - by_hand[0], place.latitude - by_hand[1]].map(|angle| angle.abs() * RADIUS_M);
        assert!(off_m[0].max(off_m[1]).max((place.height_m - by_hand[2]).abs()) < 1e-3, "{place:?} {by_hand:?}");
    }

    let above_m = viewer.manipulator_view().height_above_ground_m(eye).unwrap();
    assert!((above_m - 1000.0).abs() < 1e-3, "{above_m}");
    let query = HeightQuery::new(Vertical::Ellipsoid(ellipsoid));
    query.publish(viewer.scene());
    let ground = query.highest_ground_at(eye).unwrap();
    assert!((ground.height_m - 250.0).abs() < 1e-3, "{}", ground.height_m);
}

fn one_square(folder: &Path) -> String {
    let square = square(2.0, -0.7);
    let tile = square.tile(folder, "square");
    write_set(&folder.join("tileset.json"), bodies::MOON, square.region(), &[tile]);
    folder.to_str().unwrap().to_owned()
}

/// There is no air: the sky is black, and nothing is hazy. What the application has chosen stays.
#[test]
fn first_view_of_the_moon_shows_it_under_a_black_sky() {
    let folder = tempfile::tempdir().unwrap();
    let set = one_square(folder.path());
    let Some(mut viewer) = offscreen(&config(kit::adapter())) else { return };
    viewer.load(&set).unwrap();
    let environment = viewer.view().environment;
    assert_eq!(
        (environment.sky, environment.fog.enabled, environment.ellipsoid),
        (Sky::Background([0; 3]), false, MOON)
    );
    viewer.settle(2);
    viewer.want_picture();
    viewer.frame().unwrap();
    viewer.finish().unwrap();
    let picture = viewer.take_pictures().pop().unwrap().1;
    let [middle, corner] = [[80, 60], [2, 2]].map(|[x, y]| pixel(&picture, x, y));
    assert!(middle.iter().all(|channel| *channel > 100), "{middle:?}");
    assert_eq!(corner, [0; 3]);

    let mut own = Viewer::new_offscreen(&config(AdapterChoice::Noop)).unwrap();
    let asked = Environment {
        sky: Sky::Background([9, 8, 7]),
        fog: DistanceFog { enabled: true, density_per_m: 0.0 },
        ..Environment::default()
    };
    own.view_mut().environment = asked;
    own.load(&set).unwrap();
    let got = own.view().environment;
    assert_eq!((got.sky, got.fog.enabled, got.sun_color), (asked.sky, true, asked.sun_color));
}

/// The region of a height tile is one of angles; its heights are the same on a body of another size.
#[test]
fn height_tiles_lie_on_the_body_of_their_set() {
    let folder = tempfile::tempdir().unwrap();
    let set = generate(&folder.path().join("set"), |args| (args.levels, args.size) = (Some(2), 10_000.0));
    let root = std::fs::read_to_string(Path::new(&set).join("tileset.json")).unwrap();
    let extension = format!(r#"{{"extensions":{{"3DTILES_ellipsoid":{}}},"#, bodies::MOON);
    std::fs::write(Path::new(&set).join("moon.json"), root.replacen('{', &extension, 1)).unwrap();
    let heights_m = |source: &str, places: Option<&[Geodetic]>| {
        let mut viewer = Viewer::new_offscreen(&config(AdapterChoice::Noop)).unwrap();
        viewer.load(source).unwrap();
        viewer.frame().unwrap();
        let (ellipsoid, bounds) = (viewer.scene().ellipsoid(), *viewer.bounds().unwrap());
        let middle = ellipsoid.geodetic(bounds.sphere.center);
        let around = (-2..=2).map(|k| Geodetic {
            longitude: middle.longitude + 1e-4 * f64::from(k),
            latitude: middle.latitude + 7e-5 * f64::from(k),
            height_m: 0.0,
        });
        let places = places.map_or_else(|| around.collect(), <[_]>::to_vec);
        let query = HeightQuery::new(Vertical::Ellipsoid(ellipsoid));
        query.publish(viewer.scene());
        let ground = places.iter().map(|place| query.highest_ground_at(ellipsoid.ecef(place)).unwrap().height_m);
        let ground: Vec<f64> = ground.collect();
        (ellipsoid, places, ground)
    };
    let (earth, places, on_earth_m) = heights_m(&set, None);
    let (moon, _, on_moon_m) = heights_m(&format!("{set}/moon.json"), Some(&places));
    assert_eq!((earth, moon), (WGS84, MOON));
    assert!(on_earth_m.iter().any(|height_m| height_m.abs() > 1.0), "{on_earth_m:?}");
    for (a, b) in on_earth_m.iter().zip(&on_moon_m) {
        // A ray meets a cell between its samples, where the earth is less curved.
        assert!((a - b).abs() < 0.2, "{on_earth_m:?} {on_moon_m:?}");
    }
}
