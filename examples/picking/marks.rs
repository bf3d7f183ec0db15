//! Marks on the ground: pins at intersections of rays, and balls at heights that another thread queries.

use glam::{DAffine3, DQuat, DVec3};
use terrane::math::Aabb;
use terrane::scene::{Drawable, HeightQuery, IntersectionLimit, Material, Mesh, Node, Page, Vertical};
use terrane::viewer::{Viewer, ViewerError};

/// Adds pins on the visible ground, and a ring of balls above it.
pub fn add(viewer: &mut Viewer) -> Result<(), ViewerError> {
    let colored = |mesh: Mesh, base_color| Drawable::new(mesh.into(), Material { base_color, ..Material::default() });
    let needle = Mesh::cuboid(&Aabb { min: DVec3::new(-0.12, -0.12, -1.0), max: DVec3::new(0.12, 0.12, 4.0) });
    let head = colored(Mesh::sphere(DVec3::Z * 4.0, 0.7, 16), [1.0, 0.3, 0.2, 1.0]);
    let pin = Node::geode(vec![colored(needle, [0.9, 0.1, 0.1, 1.0]), head]);
    let ball = Node::geode(vec![colored(Mesh::sphere(DVec3::ZERO, 1.0, 24), [0.1, 0.3, 0.9, 1.0])]);

    let mut marks = Vec::new();
    let [width, height] = viewer.view().size_px().map(f64::from);
    for (i, j) in (0..9).flat_map(|i| (0..6).map(move |j| (f64::from(i) + 0.5, f64::from(j) + 0.5))) {
        let hits = viewer.compute_intersections(i * width / 9.0, j * height / 6.0, IntersectionLimit::Nearest);
        let Some(hit) = hits.first() else { continue };
        let upright = DQuat::from_rotation_arc(DVec3::Z, hit.world_normal());
        let scale = DVec3::splat(0.008 * hit.ratio);
        let map = DAffine3::from_scale_rotation_translation(scale, upright, hit.world_point());
        marks.push(Node::transform(map, vec![pin.clone()]));
    }

    // Any thread may query the published heights.
    let bounds = *viewer.bounds().expect("a tile set is loaded");
    let vertical = bounds.frame.ellipsoid.map_or(Vertical::Flat, Vertical::Ellipsoid);
    let query = HeightQuery::new(vertical);
    query.publish(viewer.scene());
    let radius_m = 0.2 * bounds.sphere.radius_m;
    let ring = move || {
        let points = (0..32).filter_map(|i| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 32.0).sin_cos();
            let around = bounds.frame.world_from_local.transform_point3(DVec3::new(sin, cos, 0.0) * radius_m);
            Some(query.highest_ground_at(around)?.point + bounds.frame.up() * 0.06 * radius_m)
        });
        points.collect::<Vec<_>>()
    };
    for point in std::thread::spawn(ring).join().expect("the thread only queries heights") {
        let scale = DVec3::splat(0.02 * radius_m);
        let map = DAffine3::from_scale_rotation_translation(scale, DQuat::IDENTITY, point);
        marks.push(Node::transform(map, vec![ball.clone()]));
    }
    viewer.add_root(Page::from_node(Node::group(marks)).expect("a shallow graph")).map(drop)
}
