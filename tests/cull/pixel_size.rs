//! Levels of detail by the pixels that a sphere covers: `Lod`, and `PagedLod` whose content its children replace.

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DQuat, DVec3};
use kit::cull_scenes::{content, drawable, look_at, page};
use proptest::prelude::*;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::{Aabb, BoundingSphere, BoundingVolume};
use terrane::scene::{
    CullingMode, Drawable, IntersectionVisitor, LineSegmentIntersector, Material, Mesh, Node, NodeKind, Page, PagedLod,
    PagingOptions, RangeMode, Refine, Scene,
};

const RADIUS_M: f64 = 2.0;
/// The last level has no minimum size, so that one is always drawn.
const RANGES_PX: [[f64; 2]; 4] = [[0.0, 40.0], [40.0, 160.0], [160.0, f64::INFINITY], [0.0, f64::INFINITY]];

fn cube(half_m: f64) -> Node {
    Node::geode(vec![drawable(Aabb { min: DVec3::splat(-half_m), max: DVec3::splat(half_m) })])
}

fn lod() -> Node {
    let ranges_px = RANGES_PX.to_vec();
    let kind = NodeKind::LodByPixelSize { center: DVec3::ZERO, radius_m: RADIUS_M, ranges_px };
    Node { children: (0..4).map(|_| cube(1.0)).collect(), ..Node::new(kind) }
}

fn cull(scene: &Scene, camera: &CullCamera) -> RenderStage {
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    // The last level is drawn at any size.
    let mut camera = *camera;
    camera.settings.culling = CullingMode::NONE;
    visitor.cull(scene, &camera, &mut stage);
    stage
}

/// Returns the children that are drawn.
fn shown(root: Node, camera: &CullCamera) -> Vec<u32> {
    let mut scene = Scene::new();
    scene.add_root(page(root, 0));
    let stage = cull(&scene, camera);
    let mut shown: Vec<u32> = stage.bins.iter().flat_map(|bin| bin.leaves.iter().map(|leaf| leaf.slot.0)).collect();
    shown.sort_unstable();
    shown
}

fn expected(size_px: f64) -> Vec<u32> {
    let is_shown = |range: &&[f64; 2]| range[0] <= size_px && size_px < range[1];
    let places = RANGES_PX.iter().enumerate().filter(|(_, range)| is_shown(range));
    places.map(|(place, _)| place as u32).collect()
}

proptest! {
    /// The visible level follows from the sphere's size in pixels, with any rotation and scale.
    #[test]
    fn lods_are_selected_by_their_size_in_pixels(
        (distance_m, scale, height_px) in (6.0..2000.0f64, 0.2..5.0f64, 100u32..2000),
        (fovy, lod_scale, turn) in (0.2..2.0f64, 0.3..3.0f64, -3.0..3.0f64),
        is_parallel in any::<bool>(),
    ) {
        // An orthographic projection uses metres of the node's frame.
        let scale = if is_parallel { 1.0 } else { scale };
        let mut camera = look_at(DVec3::new(0.0, -distance_m * scale, 0.0), DVec3::ZERO, DVec3::Z);
        camera.viewport_px = [height_px, height_px];
        camera.settings.lod_scale = lod_scale;
        // Half of the view's height in metres, at the sphere's distance.
        let half_m = if is_parallel { 50.0 * fovy * scale } else { (0.5 * fovy).tan() * distance_m * scale };
        camera.clip_from_eye = match is_parallel {
            true => proj::orthographic(-half_m, half_m, -half_m, half_m, 10.0 * distance_m * scale, 0.01),
            false => proj::perspective_infinite_reverse(fovy, 1.0, 0.01),
        };
        let size_px = RADIUS_M * scale / half_m * f64::from(height_px) / lod_scale;
        prop_assume!(RANGES_PX.iter().flatten().all(|end| (size_px / end - 1.0).abs() > 1e-4));
        let above = DAffine3::from_scale_rotation_translation(
            DVec3::splat(scale), DQuat::from_rotation_z(turn), DVec3::ZERO,
        );
        prop_assert_eq!(shown(Node::transform(above, vec![lod()]), &camera), expected(size_px), "{} px", size_px);
    }

    /// A child replaces a tile if the sphere covers more pixels, independent of the camera's error limit.
    #[test]
    fn tiles_are_refined_by_the_size_of_a_sphere(
        (distance_m, size_px, lod_scale) in (6.0..2000.0f64, 5.0..500.0f64, 0.3..3.0f64),
        max_sse_px in 0.01..100.0f64,
    ) {
        let mut camera = look_at(DVec3::new(0.0, -distance_m, 0.0), DVec3::ZERO, DVec3::Z);
        (camera.settings.lod_scale, camera.settings.max_sse_px) = (lod_scale, max_sse_px);
        let covers_px = 2.0 * RADIUS_M * camera.px_per_radian() / distance_m / lod_scale;
        prop_assume!((covers_px / size_px - 1.0).abs() > 1e-4);
        let mut scene = Scene::new();
        let root = scene.add_root(page(tile(size_px, vec![tile(size_px, Vec::new())]), 0));
        let slots: Vec<_> = scene.slots_of_page(root).collect();
        for (number, slot) in (0..).zip(slots) {
            scene.attach(slot, content(1.0, number)).unwrap();
        }
        let stage = cull(&scene, &camera);
        let drawn: Vec<u32> = stage.bins.iter().flat_map(|bin| bin.leaves.iter().map(|leaf| leaf.slot.0)).collect();
        prop_assert_eq!(drawn, [u32::from(covers_px > size_px)], "{} of {} px", covers_px, size_px);
    }
}

fn tile(size_px: f64, children: Vec<Node>) -> Node {
    let kind = NodeKind::PagedLod(Box::new(PagedLod {
        bounds: BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, RADIUS_M)),
        range_mode: RangeMode::PixelSize { center: DVec3::ZERO, radius_m: RADIUS_M, size_px },
        refine: Refine::Replace,
        content: Some("ball.glb".into()),
        content_transform: DAffine3::IDENTITY,
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    }));
    Node { children, ..Node::new(kind) }
}

#[test]
fn finest_level_is_drawn_around_the_eye_and_without_a_size() {
    let inside = look_at(DVec3::new(0.0, -1.5, 0.0), DVec3::ZERO, DVec3::Z);
    assert_eq!(shown(lod(), &inside), [2, 3]);
    let far = look_at(DVec3::new(0.0, -1e6, 0.0), DVec3::ZERO, DVec3::Z);
    for size_px in [0.0, f64::NAN, -1.0] {
        let mut scene = Scene::new();
        let root = scene.add_root(page(tile(size_px, vec![tile(1.0, Vec::new())]), 0));
        let slots: Vec<_> = scene.slots_of_page(root).collect();
        for (number, slot) in (0..).zip(slots) {
            scene.attach(slot, content(1.0, number)).unwrap();
        }
        assert_eq!(cull(&scene, &far).counters.tiles_visited, 2, "{size_px}");
    }
}

/// Lines intersect what is drawn: the child of that size, or without an eye the child for the nearest distance.
#[test]
fn lines_intersect_the_visible_child() {
    let ball = |radius_m: f64| {
        let mesh = Mesh::sphere(DVec3::ZERO, radius_m, 32);
        Node::geode(vec![Drawable::new(mesh.into(), Material::default())])
    };
    let ranges_px = RANGES_PX[..3].to_vec();
    let kind = NodeKind::LodByPixelSize { center: DVec3::ZERO, radius_m: RADIUS_M, ranges_px };
    let children = [1.0, 2.0, 3.0].map(ball).to_vec();
    let mut scene = Scene::new();
    scene.add_root(Page::from_node(Node { children, ..Node::new(kind) }).unwrap());
    let met_m = |mut visitor: IntersectionVisitor| {
        let mut line = LineSegmentIntersector::new(DVec3::new(0.01, -500.0, 0.02), DVec3::new(0.01, 0.0, 0.02));
        visitor.traverse(&scene, &mut line);
        line.first_intersection().map(|hit| -hit.world_point().y)
    };
    let near = |met_m: Option<f64>, radius_m: f64| met_m.is_some_and(|met_m| (met_m - radius_m).abs() < 0.05);
    assert!(near(met_m(IntersectionVisitor::new()), 3.0));
    let mut camera = CullCamera::default();
    for (size_px, radius_m) in [(20.0, 1.0), (100.0, 2.0), (400.0, 3.0)] {
        let distance_m = 2.0 * RADIUS_M * camera.px_per_radian() / size_px;
        let eye = look_at(DVec3::new(0.0, -distance_m, 0.0), DVec3::ZERO, DVec3::Z);
        camera.eye_from_world = eye.eye_from_world;
        let met_m = met_m(IntersectionVisitor::as_seen_from(camera.eye_point()));
        assert!(near(met_m, radius_m), "{size_px}: {met_m:?}");
    }
}
