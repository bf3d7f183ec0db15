//! Heights above the terrain: comparison with intersections of lines, on a plane and on the earth, with concurrent
//! queries.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use glam::{DAffine3, DVec3};
use kit::pager::{Run, above};
use kit::tile_sets::{generate, show_grid};
use terrane::math::{Geodetic, WGS84};
use terrane::pager::PagerConfig;
use terrane::scene::{
    Drawable, Geometry, HeightQuery, IntersectionLimit, IntersectionVisitor, LineSegmentIntersector, LodSelection,
    Material, Mesh, Node, Page, Scene, Vertical,
};

fn square(z: f64) -> Page {
    let mesh = Mesh::rectangle(DVec3::new(-10.0, -10.0, z), DVec3::X * 20.0, DVec3::Y * 20.0);
    Page::from_node(Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())])).unwrap()
}

#[test]
fn ground_below_is_preferred_to_ground_above() {
    let query = HeightQuery::new(Vertical::Flat);
    assert_eq!(query.height_above_terrain_m(DVec3::ZERO), None, "nothing is published");
    let mut scene = Scene::new();
    scene.add_root(square(3.0));
    let upper = scene.add_root(square(50.0));
    assert!(query.publish(&scene) && !query.publish(&scene), "once");
    for (z, height) in [(10.0, 7.0), (3.0, 0.0), (49.0, 46.0), (60.0, 10.0), (1.0, -2.0)] {
        let found = query.height_above_terrain_m(DVec3::new(1.0, 2.0, z)).unwrap();
        assert!((found - height).abs() < 1e-9, "{z}: {found}");
        let highest = query.terrain_height_m(DVec3::new(1.0, 2.0, z)).unwrap();
        assert!((highest - 50.0).abs() < 1e-9, "{highest}");
    }
    assert_eq!(query.ground_at(DVec3::new(0.0, 0.0, 9.0)).unwrap().normal, DVec3::Z);
    for nowhere in [DVec3::new(11.0, 0.0, 5.0), DVec3::NAN, DVec3::INFINITY] {
        assert_eq!(query.height_above_terrain_m(nowhere), None);
        assert_eq!(query.terrain_height_m(nowhere), None);
    }
    scene.remove_root(upper).unwrap();
    assert_eq!(query.terrain_height_m(DVec3::ZERO).map(f64::round), Some(50.0), "not published yet");
    assert!(query.publish(&scene));
    assert_eq!(query.terrain_height_m(DVec3::ZERO).map(f64::round), Some(3.0));
}

/// Regression: both scenes had the same number of changes and were taken for the same ground.
#[test]
fn another_scene_has_another_ground() {
    let query = HeightQuery::new(Vertical::Flat);
    let ground = |z: f64| {
        let mut scene = Scene::new();
        scene.add_root(square(z));
        scene
    };
    let (low, high) = (ground(1.0), ground(2.0));
    assert!(query.publish(&low) && !query.publish(&low));
    assert!(!query.snapshot().is_of(&high) && query.publish(&high));
    assert_eq!(query.terrain_height_m(DVec3::new(0.1, 0.1, 9.0)).map(f64::round), Some(2.0));
}

#[test]
fn masks_select_the_ground() {
    let mut node = Node::geode(Vec::new());
    for (z, mask) in [(1.0, 1), (5.0, 2)] {
        let mesh = Mesh::rectangle(DVec3::new(-1.0, -1.0, z), DVec3::X * 2.0, DVec3::Y * 2.0);
        let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default());
        node.children.push(Node { mask, ..Node::geode(vec![drawable]) });
    }
    let mut page = Page::from_node(node).unwrap();
    page.build_kd_trees();
    page.take_drawables();
    let mut scene = Scene::new();
    scene.add_root(page);
    for (mask, height) in [(1, 1.0), (2, 5.0), (3, 5.0)] {
        let query = HeightQuery::new(Vertical::Flat).with_traversal_mask(mask);
        query.publish(&scene);
        assert_eq!(query.terrain_height_m(DVec3::ZERO).map(f64::round), Some(height));
    }
}

/// Loads all drawables of a set without a GPU. The decode workers build the k-d trees.
fn load(folder: &std::path::Path, eye: DVec3, config: PagerConfig) -> Run {
    let config = PagerConfig { build_kd_trees: true, ..config };
    let mut run = Run::new(folder.to_str().unwrap(), config);
    run.settle(eye);
    run
}

/// Returns a point of the ellipsoid at shares of a region's extent.
fn place(region: [f64; 4], east: f64, north: f64, height_m: f64) -> DVec3 {
    let [west, south, e, n] = region;
    WGS84.ecef(&Geodetic { longitude: west + (e - west) * east, latitude: south + (n - south) * north, height_m })
}

fn region_of(folder: &std::path::Path) -> [f64; 4] {
    let text = std::fs::read_to_string(folder.join("tileset.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let list = json["root"]["boundingVolume"]["region"].as_array().unwrap();
    [0, 1, 2, 3].map(|i: usize| list[i].as_f64().unwrap())
}

#[test]
fn heights_and_meshes_of_the_same_ground_agree_on_the_earth() {
    let folder = tempfile::tempdir().unwrap();
    let mut queries = Vec::new();
    let mut region = [0.0; 4];
    for content in [terrane_data_gen::ContentKind::Height, terrane_data_gen::ContentKind::Mesh] {
        let set = folder.path().join(format!("{content:?}"));
        generate(&set, |args| {
            (args.levels, args.seed, args.size) = (Some(3), 5, 10_000.0);
            show_grid(args, content);
        });
        region = region_of(&set);
        let eye = place(region, 0.5, 0.5, 500.0);
        // From inside, all levels are wanted.
        let run = load(&set, eye, PagerConfig::default());
        assert!(run.pager.stats().merged > 5, "{:?}", run.pager.stats());
        let query = HeightQuery::new(Vertical::Ellipsoid(WGS84));
        query.publish(&run.scene);

        // The heights are compared with lines through the scene.
        let mut visitor = IntersectionVisitor::new();
        for i in 0..200 {
            let (east, north) = (f64::from(i % 20) / 20.0 + 0.013, f64::from(i / 20) / 10.0 + 0.027);
            let (high, low) = (place(region, east, north, 9000.0), place(region, east, north, -9000.0));
            let mut line = LineSegmentIntersector::new(high, low).with_limit(IntersectionLimit::Nearest);
            visitor.traverse(&run.scene, &mut line);
            let hit = line.first_intersection().expect("ground everywhere").world_point();
            let ground = query.ground_at(high).unwrap();
            assert!(ground.point.distance(hit) < 1e-3, "{}", ground.point.distance(hit));
            assert!((ground.height_m - WGS84.geodetic(hit).height_m).abs() < 1e-3);
            assert!((ground.above_m - (9000.0 - ground.height_m)).abs() < 1e-3, "{ground:?}");
            assert!(ground.normal.dot(high.normalize()) > 0.2);
            // The same from below and from the side.
            let below = query.highest_ground_at(low).unwrap();
            assert!(below.point.distance(hit) < 1e-3 && (below.above_m + 9000.0 + below.height_m).abs() < 1e-3);
            let under = query.height_above_terrain_m(low).unwrap();
            assert!((under + 9000.0 + ground.height_m).abs() < 1e-2, "{under}");
        }
        // The root alone is another surface, for queries as for lines.
        let of_root = HeightQuery::new(Vertical::Ellipsoid(WGS84)).with_lod_selection(LodSelection::Level(0));
        of_root.publish(&run.scene);
        visitor.lod_selection = LodSelection::Level(0);
        let differences_m = (0..20).map(|i| {
            let at = |height_m| place(region, f64::from(i) / 20.0 + 0.013, 0.627, height_m);
            let mut line = LineSegmentIntersector::new(at(9000.0), at(-9000.0));
            visitor.traverse(&run.scene, &mut line);
            let found = of_root.ground_at(at(9000.0)).unwrap().point;
            assert!(found.distance(line.first_intersection().unwrap().world_point()) < 1e-3);
            found.distance(query.ground_at(at(9000.0)).unwrap().point)
        });
        let largest_m = differences_m.fold(0.0, f64::max);
        assert!(largest_m > 0.1, "{content:?}: {largest_m}");
        assert_eq!(query.height_above_terrain_m(place(region, 1.5, 0.5, 100.0)), None, "beside the set");
        assert_eq!(query.height_above_terrain_m(-place(region, 0.5, 0.5, 100.0)), None, "on the other side");
        queries.push(query);
    }
    // The finest level of both has the same samples.
    for i in 0..100 {
        let at = place(region, f64::from(i) / 100.0 + 0.005, f64::from(i * 37 % 100) / 100.0 + 0.005, 5000.0);
        let [a, b] = [0, 1].map(|k: usize| queries[k].terrain_height_m(at).unwrap());
        assert!((a - b).abs() < 5.0, "{a} {b}");
    }
}

#[test]
fn threads_query_while_the_scene_changes() {
    let query = HeightQuery::new(Vertical::Flat);
    let stop = Arc::new(AtomicBool::new(false));
    let answered = Arc::new(AtomicU32::new(0));
    let threads: Vec<_> = (0..3)
        .map(|_| {
            let (query, stop, answered) = (query.clone(), stop.clone(), answered.clone());
            std::thread::spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    let ground = query.snapshot();
                    // One snapshot has one height.
                    let heights = [0.0, 3.0, -4.0].map(|x| ground.terrain_height_m(DVec3::new(x, x, 0.0)));
                    assert!(heights.iter().all(|h| h.map(f64::round) == heights[0].map(f64::round)));
                    if let Some(height) = heights[0] {
                        assert!((-0.5..1000.0).contains(&height) && (height - height.round()).abs() < 1e-6);
                        answered.fetch_add(1, Ordering::Relaxed);
                    }
                }
            })
        })
        .collect();
    let mut scene = Scene::new();
    let mut root = None;
    let mut height = 0;
    while height < 300 || answered.load(Ordering::Relaxed) < 1000 {
        if let Some(old) = root.take() {
            scene.remove_root(old).unwrap();
        }
        let mut page = square(f64::from(height % 1000));
        page.build_kd_trees();
        page.take_drawables();
        root = Some(scene.add_root(page));
        assert!(query.publish(&scene));
        height += 1;
    }
    stop.store(true, Ordering::Relaxed);
    threads.into_iter().for_each(|t| t.join().unwrap());
}

#[test]
fn moved_ground_is_published() {
    let mesh = Mesh::rectangle(DVec3::new(-1.0, -1.0, 0.0), DVec3::X * 2.0, DVec3::Y * 2.0);
    let geode = Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())]);
    let node = Node::transform(DAffine3::from_translation(DVec3::Z), vec![geode]).named("lift");
    let mut scene = Scene::new();
    let root = scene.add_root(Page::from_node(node).unwrap());
    let query = HeightQuery::new(Vertical::Flat);
    query.publish(&scene);
    let lift = scene.nodes_named(root, "lift").next().unwrap();
    scene.set_transform(lift, DAffine3::from_translation(DVec3::Z * 7.0)).unwrap();
    assert!(query.publish(&scene));
    assert_eq!(query.terrain_height_m(above(100.0)).map(f64::round), Some(7.0));
}
