//! Near and far planes by primitives, compared with all triangles one by one, and with the pixels.

use std::sync::Arc;

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DMat4, DQuat, DVec3, DVec4};
use kit::rig::camera;
use kit::shapes::mesh;
use kit::terrain::Terrain;
use proptest::prelude::*;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::scene::{
    ComputeNearFar, Drawable, Geometry, Material, Mesh, MeshVertex, Node, NodeKind, Page, Scene, Topology,
};

fn cull(root: Node, with_trees: bool, camera: &CullCamera) -> RenderStage {
    let mut page = Page::from_node(root).unwrap();
    if with_trees {
        page.build_kd_trees();
    }
    let mut scene = Scene::new();
    scene.add_root(page);
    let mut stage = RenderStage::new();
    CullVisitor::new().cull(&scene, camera, &mut stage);
    stage
}

fn by(mode: ComputeNearFar, camera: &CullCamera) -> CullCamera {
    let mut camera = *camera;
    camera.settings.compute_near_far = mode;
    camera
}

/// Returns the distances of a point inside each side of the frustum, and in front of the eye, in eye space.
fn insides(clip_from_eye: &DMat4, p: DVec3) -> [f64; 5] {
    let clip = *clip_from_eye * p.extend(1.0);
    [clip.w + clip.x, clip.w - clip.x, clip.w + clip.y, clip.w - clip.y, -p.z]
}

/// Returns the depths of the visible part of a triangle: corners inside, and points where edges pass the sides or the
/// edges of the frustum pass the triangle.
fn seen_depths(clip_from_eye: &DMat4, triangle: [DVec3; 3]) -> Vec<f64> {
    let size = triangle.iter().map(|p| p.length()).fold(1.0, f64::max);
    let is_inside = |p: &DVec3| insides(clip_from_eye, *p).iter().all(|d| *d >= -1e-9 * size);
    let mut points = triangle.to_vec();
    for (from, to) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (triangle[i], triangle[j])) {
        for (a, b) in insides(clip_from_eye, from).into_iter().zip(insides(clip_from_eye, to)) {
            if (a < 0.0) != (b < 0.0) {
                points.push(from.lerp(to, a / (a - b)));
            }
        }
    }
    let eye_from_clip = clip_from_eye.inverse();
    let on_plane = |x: f64, y: f64, z: f64| {
        let p = eye_from_clip * DVec4::new(x, y, z, 1.0);
        p.truncate() / p.w
    };
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    // An orthographic frustum starts at the plane of the eye, which cuts triangles as well.
    let eyes_plane = |(x, y): (f64, f64)| on_plane(x, y, 1.0) * DVec3::new(1.0, 1.0, 0.0);
    let along = corners.map(|c| (on_plane(c.0, c.1, 1.0), on_plane(c.0, c.1, 0.5), f64::INFINITY));
    let across = [0, 1, 2, 3].map(|i| (eyes_plane(corners[i]), eyes_plane(corners[(i + 1) % 4]), 1.0));
    let is_orthographic = clip_from_eye.w_axis.w == 1.0;
    for (from, to, end) in along.into_iter().chain(across.into_iter().filter(|_| is_orthographic)) {
        let (a, b, c) = (triangle[0], triangle[1], triangle[2]);
        let normal = (b - a).cross(c - a);
        let along = to - from;
        let t = normal.dot(a - from) / normal.dot(along);
        let p = from + along * t;
        let sides = [(a, b), (b, c), (c, a)].map(|(p0, p1)| normal.dot((p1 - p0).cross(p - p0)));
        let is_between = end.is_infinite() || (0.0..=end).contains(&t);
        if t.is_finite() && is_between && sides.iter().all(|s| *s >= -1e-12 * normal.length_squared()) {
            points.push(p);
        }
    }
    points.retain(is_inside);
    points.into_iter().map(|p| -p.z).collect()
}

fn triangles(corners: &[[f32; 3]]) -> Drawable {
    let vertices = corners.iter().map(|p| MeshVertex { position: *p, ..MeshVertex::default() }).collect();
    let indices = (0..corners.len() as u32 / 3 * 3).collect();
    Drawable::new(Geometry::Mesh(Arc::new(mesh(vertices, indices))), Material::default())
}

prop_compose! {
    fn soup()(at in prop::array::uniform3(-20.0f32..20.0), size in 0.1f32..15.0,
        corners in prop::collection::vec(prop::array::uniform3(-1.0f32..1.0), 3..60)) -> Vec<[f32; 3]> {
        corners.iter().map(|c| [0, 1, 2].map(|i| at[i] + size * c[i])).collect()
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, ..ProptestConfig::default() })]

    #[test]
    fn near_and_far_planes_equal_those_of_all_triangles(
        soups in prop::collection::vec((soup(), any::<bool>()), 1..12),
        eye in prop::array::uniform3(-25.0f64..25.0),
        turn in prop::array::uniform4(-1.0f64..1.0),
        fov in 0.2f64..2.0,
        is_orthographic in any::<bool>(),
        scale in 0.3f64..3.0,
    ) {
        let rotation = DQuat::from_array(turn);
        prop_assume!(rotation.length() > 0.1);
        let clip_from_eye = if is_orthographic {
            proj::orthographic(-6.0, 6.0, -4.0, 4.0, 500.0, 0.01)
        } else {
            proj::perspective(fov, 1.5, 500.0, 0.01)
        };
        let eye_from_world =
            DAffine3::from_rotation_translation(rotation.normalize(), DVec3::ZERO)
                * DAffine3::from_translation(-DVec3::from_array(eye));
        let camera = CullCamera { eye_from_world, clip_from_eye, viewport_px: [300, 200], ..CullCamera::default() };
        let place = DAffine3::from_scale_rotation_translation(
            DVec3::new(scale, 1.0, 1.0 / scale), DQuat::from_rotation_z(scale), DVec3::new(1.0, scale, -2.0));
        let node = || Node::group(soups.iter().map(|(soup, is_moved)| {
            let geode = Node::geode(vec![triangles(soup)]);
            if *is_moved { Node::transform(place, vec![geode]) } else { geode }
        }).collect());
        let mut wanted = [f64::INFINITY, f64::NEG_INFINITY];
        for (soup, is_moved) in &soups {
            let map = eye_from_world * if *is_moved { place } else { DAffine3::IDENTITY };
            for t in soup.chunks_exact(3) {
                let in_eye = [0, 1, 2].map(|i: usize| map.transform_point3(DVec3::from_array(t[i].map(f64::from))));
                for depth in seen_depths(&clip_from_eye, in_eye) {
                    wanted = [wanted[0].min(depth), wanted[1].max(depth)];
                }
            }
        }
        let stage = cull(node(), true, &by(ComputeNearFar::Primitives, &camera));
        let bounds = cull(node(), true, &by(ComputeNearFar::BoundingVolumes, &camera));
        // K-d trees are not used where bounds suffice.
        let without = cull(node(), false, &by(ComputeNearFar::Primitives, &camera));
        prop_assert_eq!([without.near_m, without.far_m], [bounds.near_m, bounds.far_m]);
        prop_assert_eq!(stage.leaf_count(), bounds.leaf_count());
        if wanted[0] > wanted[1] {
            prop_assert_eq!([stage.near_m, stage.far_m], [0.0, 0.0]);
            prop_assert_eq!(stage.camera.clip_from_eye, clip_from_eye);
        } else {
            let slack = 1e-5 * (1.0 + wanted[1]);
            prop_assert!((stage.near_m - wanted[0].max(0.0)).abs() < slack, "{} {:?}", stage.near_m, wanted);
            prop_assert!((stage.far_m - wanted[1]).abs() < slack, "{} {:?}", stage.far_m, wanted);
            prop_assert!(stage.near_m >= bounds.near_m - slack && stage.far_m <= bounds.far_m + slack);
        }
    }
}

#[test]
fn lines_and_points_count_and_drawables_without_a_tree_use_bounds() {
    let camera = by(ComputeNearFar::Primitives, &camera([100, 100], DVec3::ZERO, DVec3::Y, DVec3::Z));
    let thin = |topology: Topology, corners: &[[f32; 3]]| {
        let vertices: Vec<_> = corners.iter().map(|p| MeshVertex { position: *p, ..MeshVertex::default() }).collect();
        let indices: Vec<u32> = (0..vertices.len() as u32).collect();
        let bounds = mesh(vertices.clone(), indices.clone()).bounds;
        let mesh = Mesh { vertices, indices: indices.into(), topology, bounds, ..Mesh::default() };
        Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())])
    };
    // A line from far on the left is nearer outside of the view than inside. Of the points, the nearest is outside.
    let line = thin(Topology::Lines, &[[-100.0, 1.0, 0.0], [0.0, 30.0, 0.0]]);
    let points = thin(Topology::Points, &[[-50.0, 2.0, 0.0], [0.0, 40.0, 0.0], [90.0, 60.0, 0.0]]);
    let stage = cull(Node::group(vec![line, points]), true, &camera);
    let half = 0.5f64.tan();
    let met = 30.0 / (1.0 + 0.29 * half);
    assert!((stage.near_m - met).abs() < 0.2 && (stage.far_m - 40.0).abs() < 1e-3, "{} {met}", stage.near_m);
    let near_m = cull(thin(Topology::Points, &[[-50.0, 2.0, 0.0], [0.0, 40.0, 0.0]]), false, &camera).near_m;
    assert!((near_m - 2.0).abs() < 1e-4, "{near_m}");
    // Below a projection, the sides are those of the projection.
    let narrow = proj::perspective_infinite_reverse(0.01, 1.0, 0.1);
    let mut scene = Node::new(NodeKind::Projection(narrow));
    scene.children =
        vec![thin(Topology::Lines, &[[-100.0, 1.0, 0.0], [0.0, 30.0, 0.0], [0.0, 30.0, 0.0], [0.0, 50.0, 0.0]])];
    let stage = cull(scene, true, &camera);
    let near = stage.views[0].clip_from_eye.w_axis.z / 0.98;
    assert!((near - 30.0).abs() < 0.1, "{near}");
}

#[test]
fn height_tiles_are_never_cut_by_the_near_plane() {
    let terrain =
        Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 2600.0, root_error_m: 250.0, textured: false };
    let mut nearer_than_bounds = 0;
    for (u, v, above_m) in [(0.3, 0.4, 2_000.0), (0.6, 0.6, 4_500.0), (0.5, 0.1, 9_000.0), (0.8, 0.3, 3_000.0)] {
        let eye = terrain.world(u, v, above_m);
        let target = terrain.world(0.5, 0.5, 0.0);
        let seen = camera([320, 200], eye, target, terrain.up(u, v));
        let tiles = || terrain.tiles_for(&seen, eye, 3);
        let stage = cull(tiles(), true, &by(ComputeNearFar::Primitives, &seen));
        let bounds = cull(tiles(), true, &by(ComputeNearFar::BoundingVolumes, &seen));
        // Points of the visible ground are checked.
        let mut nearest = f64::INFINITY;
        for j in 0..=400 {
            for i in 0..=400 {
                let in_eye = seen.eye_from_world.transform_point3(terrain.world(
                    f64::from(i) / 400.0,
                    f64::from(j) / 400.0,
                    0.0,
                ));
                if insides(&seen.clip_from_eye, in_eye).iter().all(|d| *d >= 0.0) {
                    nearest = nearest.min(-in_eye.z);
                }
            }
        }
        assert!(nearest.is_finite());
        assert!(stage.near_m <= nearest && stage.near_m >= bounds.near_m, "{} {nearest}", stage.near_m);
        assert!(stage.near_m > 0.8 * nearest, "{} {nearest}", stage.near_m);
        assert!((stage.far_m - bounds.far_m).abs() < 1e-3 * bounds.far_m);
        nearer_than_bounds += usize::from(bounds.near_m < 0.9 * stage.near_m);
    }
    assert!(nearer_than_bounds > 1, "{nearer_than_bounds}");
}
