//! A pick hits the triangle that is drawn at its pixel with any projection. The oracle transforms the corners of all
//! triangles to clip space. No GPU.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec2, DVec3, DVec4};
use proptest::prelude::*;

use terrane::scene::{
    Attachment, CameraNode, CameraTarget, ComputeNearFar, CullSettings, Drawable, EyePoint, Geometry, Inherit,
    Intersection, IntersectionLimit, IntersectionVisitor, LineSegmentIntersector, Material, Mesh, MeshVertex, Node,
    NodeKind, Page, PolytopeIntersector, RayIntersector, ReferenceFrame, RenderOrder, Scene, Topology, WindowView,
};
use terrane::state::{TextureFormat, TextureObject};

const SIZE_PX: [u32; 2] = [640, 360];

/// Repeatable random numbers.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn point(&mut self, reach: f64) -> DVec3 {
        DVec3::from_array([0; 3].map(|_| (2.0 * self.next() - 1.0) * reach))
    }

    fn below(&mut self, count: usize) -> usize {
        (self.next() * count as f64) as usize
    }

    fn motion(&mut self) -> DAffine3 {
        DAffine3::from_rotation_translation(DQuat::from_scaled_axis(self.point(0.7)), self.point(15.0))
    }
}

fn mesh(random: &mut Random) -> Drawable {
    let vertices = (0..24)
        .map(|_| MeshVertex { position: random.point(20.0).as_vec3().to_array(), ..MeshVertex::default() })
        .collect::<Vec<_>>();
    let indices = (0..24).collect();
    Drawable::new(Geometry::Mesh(Arc::new(Mesh::new(vertices, indices, Topology::Triangles))), Material::default())
}

fn projection(random: &mut Random) -> DMat4 {
    let (narrow, wide) = (0.6 + random.next(), 10.0 + 20.0 * random.next());
    match random.below(4) {
        0 => proj::perspective_infinite_reverse(narrow, 1.0, 0.5),
        // In reversed depth, near and far are swapped.
        1 => proj::perspective(narrow, 1.5, 60.0, 1.0),
        2 => proj::orthographic(-wide, wide, -wide, wide, 40.0, 5.0),
        // The projection is off its axis.
        _ => DMat4::from_translation(DVec3::new(0.4, -0.3, 0.0)) * proj::perspective(narrow, 1.0, 80.0, 2.0),
    }
}

/// Returns a texture, or `None` for the target of the parent stage.
fn target(random: &mut Random) -> CameraTarget {
    let texture = || Attachment::new(TextureObject::target("elsewhere", [8, 8], TextureFormat::Rgba8Srgb));
    let colors = if random.next() < 0.5 { vec![texture()] } else { Vec::new() };
    CameraTarget { colors, ..CameraTarget::default() }
}

fn camera(random: &mut Random) -> CameraNode {
    let order = [RenderOrder::Nested, RenderOrder::PostRender(random.below(3) as i32), RenderOrder::PreRender(0)];
    let rect = [random.below(300), random.below(150), 40 + random.below(300), 30 + random.below(150)];
    let fits =
        CullSettings { compute_near_far: ComputeNearFar::BoundingVolumes, cull_mask: 2, ..CullSettings::default() };
    CameraNode {
        view: random.motion().inverse(),
        frame: if random.next() < 0.5 { ReferenceFrame::Absolute } else { ReferenceFrame::Relative },
        projection: (random.next() < 0.6).then(|| projection(random)),
        viewport_px: (random.next() < 0.4).then_some(rect.map(|v| v as u32)),
        clear_depth: random.next() < 0.7,
        target: (random.next() < 0.2).then(|| Arc::new(target(random))),
        settings: fits,
        inherit: if random.next() < 0.8 { Inherit::ALL } else { Inherit::NONE },
        ..CameraNode::new(order[random.below(3)])
    }
}

fn graph(random: &mut Random, depth: usize) -> Node {
    let mut node = match if depth == 0 { 9 } else { random.below(10) } {
        0 => Node::new(NodeKind::Group),
        1 | 2 => Node::new(NodeKind::Transform(random.motion())),
        3 => Node::new(NodeKind::AbsoluteTransform(random.motion())),
        4 | 5 => Node::new(NodeKind::Projection(projection(random))),
        6..=8 => Node::camera(camera(random), Vec::new()),
        _ => Node::geode((0..1 + random.below(2)).map(|_| mesh(random)).collect()),
    };
    node.mask = if random.next() < 0.1 { 1 } else { u32::MAX };
    if depth > 0 {
        node.children = (0..1 + random.below(3)).map(|_| graph(random, depth - 1)).collect();
    }
    node
}

/// A triangle of a drawable in clip space.
struct Triangle {
    key: (u32, u32),
    local: [DVec3; 3],
    clip_from_local: DMat4,
    view: Drawn,
}

/// The stage in which it is drawn.
#[derive(Clone, Debug)]
struct Drawn {
    clip_from_eye: DMat4,
    viewport_px: [u32; 4],
    mask: u32,
    /// True if near and far planes cut nothing off: in texture images, and with fitted depths.
    is_whole: bool,
    fits: bool,
    /// The position in the order of drawing: for each stage above, before (-1) or after (1) it, its number, and its
    /// index.
    path: Vec<(i32, i32, u32)>,
}

struct Oracle {
    drawables: u32,
    cameras: u32,
    triangles: Vec<Triangle>,
}

impl Oracle {
    fn visit(&mut self, node: &Node, eye_from_node: Option<DAffine3>, drawn: &Drawn) {
        let eye_from_node = eye_from_node.filter(|_| node.mask & drawn.mask != 0);
        let (mut below, mut how) = (eye_from_node, drawn.clone());
        match &node.kind {
            NodeKind::Transform(map) => below = eye_from_node.map(|e| e * *map),
            NodeKind::AbsoluteTransform(map) => below = eye_from_node.map(|_| *map),
            NodeKind::Projection(clip_from_eye) => (how.clip_from_eye, how.is_whole) = (*clip_from_eye, drawn.fits),
            NodeKind::Camera(camera) => {
                let is_elsewhere = camera.target.as_ref().is_some_and(|target| !target.colors.is_empty());
                if camera.order != RenderOrder::Nested && is_elsewhere {
                    below = None;
                }
                below = match camera.frame {
                    ReferenceFrame::Absolute => below.map(|_| camera.view),
                    ReferenceFrame::Relative => below.map(|e| e * camera.view),
                };
                if camera.inherit == Inherit::NONE {
                    (how.mask, how.fits) = (2, true);
                }
                if camera.projection.is_some() || camera.viewport_px.is_some() {
                    how.is_whole = how.fits;
                    how.clip_from_eye = camera.projection.unwrap_or(how.clip_from_eye);
                    how.viewport_px = camera.viewport_px.unwrap_or(how.viewport_px);
                } else {
                    // It has the image of the parent stage, and its depths.
                    how.fits = drawn.fits;
                }
                self.cameras += 1;
                match camera.order {
                    RenderOrder::PreRender(order) => how.path.push((-1, order, self.cameras)),
                    RenderOrder::PostRender(order) if camera.clear_depth => how.path.push((1, order, self.cameras)),
                    _ => {}
                }
            }
            NodeKind::Geode(drawables) => {
                for drawable in drawables {
                    let number = self.drawables;
                    self.drawables += 1;
                    let (Geometry::Mesh(mesh), Some(eye_from_node)) = (&drawable.geometry, eye_from_node) else {
                        continue;
                    };
                    let clip_from_local = drawn.clip_from_eye * DMat4::from(eye_from_node);
                    for (primitive, t) in mesh.indices.chunks_exact(3).enumerate() {
                        let corner = |i: u32| DVec3::from_array(mesh.vertices[i as usize].position.map(f64::from));
                        let local = [corner(t[0]), corner(t[1]), corner(t[2])];
                        let key = (number, primitive as u32);
                        self.triangles.push(Triangle { key, local, clip_from_local, view: drawn.clone() });
                    }
                }
            }
            _ => {}
        }
        for child in &node.children {
            self.visit(child, below, &how);
        }
    }
}

impl Drawn {
    fn contains(&self, at: DVec2, margin: f64) -> bool {
        let [x, y, w, h] = self.viewport_px.map(f64::from);
        at.x > x + margin && at.x < x + w - margin && at.y > y + margin && at.y < y + h - margin
    }

    fn ndc(&self, at: DVec2) -> DVec2 {
        let [x, y, w, h] = self.viewport_px.map(f64::from);
        DVec2::new(2.0 * (at.x - x) / w - 1.0, 1.0 - 2.0 * (at.y - y) / h)
    }

    fn window(&self, clip: DVec4) -> DVec2 {
        let [x, y, w, h] = self.viewport_px.map(f64::from);
        DVec2::new(x + 0.5 * w * (1.0 + clip.x / clip.w), y + 0.5 * h * (1.0 - clip.y / clip.w))
    }

    /// Returns the part between near and far, or in front of the eye if those are fitted.
    fn keeps(&self, clip: DVec4, margin: f64) -> bool {
        let by_depth = clip.z > margin * clip.w && clip.z < (1.0 - margin) * clip.w;
        let in_front = -(self.clip_from_eye.inverse() * clip).z > margin;
        clip.w > margin && if self.is_whole { in_front } else { by_depth }
    }
}

impl Triangle {
    /// Returns the shares of the corners at a pixel, and the point in clip space. `None` if it is seen from the side.
    fn at(&self, at: DVec2) -> Option<(DVec3, DVec4)> {
        let ndc = self.view.ndc(at);
        let corners = self.local.map(|p| self.clip_from_local * p.extend(1.0));
        let column = |c: DVec4| DVec3::new(c.x - ndc.x * c.w, c.y - ndc.y * c.w, 1.0);
        let shares = DMat3::from_cols(column(corners[0]), column(corners[1]), column(corners[2]));
        let size = corners.map(|c| column(c).length()).iter().product::<f64>();
        let shares = (shares.determinant().abs() > 1e-6 * size).then(|| shares.inverse() * DVec3::Z)?;
        Some((shares, corners[0] * shares.x + corners[1] * shares.y + corners[2] * shares.z))
    }

    /// Returns whether it is certainly drawn at a pixel, certainly not, or neither.
    fn shows(&self, at: DVec2) -> Option<(bool, bool)> {
        let (shares, clip) = self.at(at)?;
        let inside = shares.min_element();
        let surely = inside > 1e-4 && self.view.keeps(clip, 1e-4) && self.view.contains(at, 1e-3);
        let never = inside < -1e-4 || !self.view.keeps(clip, -1e-4) || !self.view.contains(at, -1e-3);
        Some((surely, never))
    }
}

/// Compares by order: a later stage covers an earlier one.
fn is_over(a: &Drawn, b: &Drawn) -> bool {
    let path = |d: &Drawn| d.path.iter().copied().chain([(0, 0, 0)]).collect::<Vec<_>>();
    path(a) > path(b)
}

struct Setup {
    scene: Scene,
    visitor: IntersectionVisitor,
    view: WindowView,
    oracle: Oracle,
}

fn setup(random: &mut Random, fits_depth: bool) -> Setup {
    let root = Node { children: (0..3).map(|_| graph(random, 3)).collect(), ..Node::new(NodeKind::Group) };
    let world_from_eye = random.motion();
    let clip_from_eye = proj::perspective_infinite_reverse(0.8, 640.0 / 360.0, 0.1);
    let viewport_px = [0, 0, SIZE_PX[0], SIZE_PX[1]];
    let view = WindowView { world_from_eye, clip_from_eye, viewport_px, fits_depth };
    let mut oracle = Oracle { drawables: 0, cameras: 0, triangles: Vec::new() };
    let drawn =
        Drawn { clip_from_eye, viewport_px, mask: u32::MAX, is_whole: true, fits: fits_depth, path: Vec::new() };
    oracle.visit(&root, Some(world_from_eye.inverse()), &drawn);
    let mut page = Page::from_node(root).unwrap();
    if random.next() < 0.5 {
        page.build_kd_trees();
        page.take_drawables();
    }
    let mut scene = Scene::new();
    scene.add_root(page);
    let eye = EyePoint { world_from_eye, px_per_radian: 400.0, is_parallel: false, max_sse_px: 16.0, lod_scale: 1.0 };
    let mut visitor = IntersectionVisitor::new();
    visitor.eye = Some(eye);
    Setup { scene, visitor, view, oracle }
}

fn key(hit: &Intersection) -> (u32, u32) {
    (hit.drawable, hit.primitive)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn picks_hit_the_triangle_drawn_at_the_pixel(seed: u64, fits: bool) {
        let mut random = Random(seed);
        let Setup { scene, mut visitor, view, oracle } = setup(&mut random, fits);
        for _ in 0..15 {
            let at = DVec2::new(640.0 * random.next(), 360.0 * random.next());
            let mut ray = RayIntersector::at_window(&view, at);
            visitor.traverse(&scene, &mut ray);
            let found: BTreeMap<_, _> = ray.intersections().iter().map(|hit| (key(hit), hit)).collect();
            prop_assert_eq!(found.len(), ray.intersections().len());
            for triangle in &oracle.triangles {
                let Some((surely, never)) = triangle.shows(at) else { continue };
                let hit = found.get(&triangle.key);
                prop_assert!(!surely || hit.is_some(), "{:?} is missed at {at} {:?}", triangle.key, triangle.view);
                prop_assert!(!never || hit.is_none(), "{:?} is not drawn at {at}", triangle.key);
                if let Some(hit) = hit {
                    let shown = triangle.view.window(triangle.clip_from_local * hit.local_point.extend(1.0));
                    prop_assert!(shown.distance(at) < 1e-3, "{:?} at {shown} instead of {at}", triangle.key);
                }
            }
            let of_scene: BTreeSet<_> = oracle.triangles.iter().map(|t| t.key).collect();
            prop_assert!(found.keys().all(|key| of_scene.contains(key)));

            // Stages drawn over others come first, then nearer hits within a stage.
            let triangle = |hit: &Intersection| oracle.triangles.iter().find(|t| t.key == key(hit)).unwrap();
            for pair in ray.intersections().windows(2) {
                let [a, b] = [triangle(&pair[0]), triangle(&pair[1])];
                prop_assert!(!is_over(&b.view, &a.view), "{:?} is over {:?}", b.key, a.key);
                if a.view.path == b.view.path {
                    prop_assert!(pair[0].ratio <= pair[1].ratio);
                    let depth = |t: &Triangle, hit: &Intersection| {
                        let clip = t.clip_from_local * hit.local_point.extend(1.0);
                        clip.z / clip.w
                    };
                    let (near, far) = (depth(a, &pair[0]), depth(b, &pair[1]));
                    prop_assert!(near >= far - 1e-9, "{near} {far}");
                }
            }
            // The other limits select from the same hits.
            for limit in [IntersectionLimit::Nearest, IntersectionLimit::One, IntersectionLimit::OnePerDrawable] {
                let mut ray = RayIntersector::at_window(&view, at).with_limit(limit);
                visitor.traverse(&scene, &mut ray);
                prop_assert!(ray.intersections().iter().all(|hit| found.contains_key(&key(hit))));
                prop_assert_eq!(ray.intersections().is_empty(), found.is_empty());
                if limit == IntersectionLimit::Nearest {
                    prop_assert!(ray.intersections().len() <= 1);
                }
            }
            let mut nearest = RayIntersector::at_window(&view, at).with_limit(IntersectionLimit::Nearest);
            visitor.traverse(&scene, &mut nearest);
            let mut all = RayIntersector::at_window(&view, at);
            visitor.traverse(&scene, &mut all);
            if let (Some(a), Some(b)) = (nearest.first_intersection(), all.first_intersection()) {
                prop_assert!((a.ratio - b.ratio).abs() <= 1e-9 * (1.0 + b.ratio.abs()), "{} {}", a.ratio, b.ratio);
                prop_assert_eq!(&triangle(a).view.path, &triangle(b).view.path);
            }

            // A segment is a piece of the ray between its depths.
            let depths = [0.9 * random.next() + 0.05, 0.04 * random.next() + 1e-4];
            let mut segment =
                LineSegmentIntersector::at_window(&view, at.extend(depths[0]), at.extend(depths[1]));
            visitor.traverse(&scene, &mut segment);
            let between: BTreeSet<_> = segment.intersections().iter().map(key).collect();
            for triangle in &oracle.triangles {
                let (Some((surely, _)), Some((_, clip))) = (triangle.shows(at), triangle.at(at)) else { continue };
                let depth = clip.z / clip.w;
                let is_in = surely && depth < depths[0] - 1e-6 && depth > depths[1] + 1e-6;
                prop_assert!(!is_in || between.contains(&triangle.key), "{:?} at depth {depth}", triangle.key);
                let is_out = surely && (depth > depths[0] + 1e-6 || depth < depths[1] - 1e-6);
                prop_assert!(!is_out || !between.contains(&triangle.key), "{:?} at depth {depth}", triangle.key);
            }
        }
    }

    #[test]
    fn rectangle_picks_hit_the_drawables_drawn_in_it(seed: u64, fits: bool) {
        let mut random = Random(seed);
        let Setup { scene, mut visitor, view, oracle } = setup(&mut random, fits);
        for _ in 0..4 {
            let corner = DVec2::new(560.0 * random.next(), 300.0 * random.next());
            let (min, max) = (corner, corner + DVec2::new(5.0 + 75.0 * random.next(), 5.0 + 55.0 * random.next()));
            let mut polytope = PolytopeIntersector::at_window(&view, min, max);
            visitor.traverse(&scene, &mut polytope);
            let found: BTreeMap<_, _> = polytope.intersections().iter().map(|hit| (key(hit), hit)).collect();
            for triangle in &oracle.triangles {
                let inside = (0..60).any(|_| {
                    let (u, v) = (random.next(), random.next());
                    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                    let [a, b, c] = triangle.local;
                    let clip = triangle.clip_from_local * (a + (b - a) * u + (c - a) * v).extend(1.0);
                    let at = triangle.view.window(clip);
                    triangle.view.keeps(clip, 1e-6)
                        && triangle.view.contains(at, 1e-6)
                        && at.cmpgt(min + 1e-6).all()
                        && at.cmplt(max - 1e-6).all()
                });
                let hit = found.get(&triangle.key);
                prop_assert!(!inside || hit.is_some(), "{:?} is missed in {min} to {max} {:?}", triangle.key, triangle.view);
                if let Some(hit) = hit {
                    // The middle of a convex piece is inside as well.
                    let clip = triangle.clip_from_local * hit.local_point.extend(1.0);
                    let at = triangle.view.window(clip);
                    prop_assert!(triangle.view.keeps(clip, -1e-6) && triangle.view.contains(at, -1e-3), "{at}");
                    prop_assert!(at.cmpgt(min - 1e-3).all() && at.cmplt(max + 1e-3).all(), "{at} in {min} to {max}");
                    prop_assert!(hit.ratio <= hit.max_ratio + 1e-9);
                }
            }
        }
    }
}

/// A pick in an orthographic view starts at the near plane, also behind the eye, like its image.
#[test]
fn orthographic_picks_start_at_the_near_plane() {
    let mesh = Mesh::rectangle(DVec3::new(-1.0, -1.0, 5.0), DVec3::X * 2.0, DVec3::Y * 2.0);
    let mut scene = Scene::new();
    let square = Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())]);
    scene.add_root(Page::from_node(square).unwrap());
    let viewport_px = [0, 0, SIZE_PX[0], SIZE_PX[1]];
    for (near_m, count) in [(-10.0, true), (-2.0, false)] {
        let clip_from_eye = proj::orthographic(-2.0, 2.0, -2.0, 2.0, 50.0, near_m);
        let view = WindowView { world_from_eye: DAffine3::IDENTITY, clip_from_eye, viewport_px, fits_depth: false };
        let mut visitor = IntersectionVisitor::new();
        let mut ray = RayIntersector::at_window(&view, DVec2::new(330.0, 180.0));
        visitor.traverse(&scene, &mut ray);
        let mut polytope = PolytopeIntersector::at_window(&view, DVec2::new(310.0, 170.0), DVec2::new(330.0, 190.0));
        visitor.traverse(&scene, &mut polytope);
        assert_eq!((!ray.intersections().is_empty(), !polytope.intersections().is_empty()), (count, count), "{near_m}");
    }
}

#[test]
fn world_shapes_and_points_outside_hit_no_other_projection() {
    let square = |x: f64| {
        let mesh = Mesh::rectangle(DVec3::new(x, -1.0, -3.0), DVec3::X * 2.0, DVec3::Y * 2.0);
        Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())])
    };
    let hud = CameraNode {
        frame: ReferenceFrame::Absolute,
        projection: Some(proj::orthographic(-1.0, 1.0, -1.0, 1.0, 10.0, 0.0)),
        viewport_px: Some([600, 0, 40, 40]),
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    let mut scene = Scene::new();
    scene.add_root(Page::from_node(Node::camera(hud, vec![square(-1.0)])).unwrap());
    let view = WindowView {
        world_from_eye: DAffine3::IDENTITY,
        clip_from_eye: proj::perspective_infinite_reverse(0.8, 640.0 / 360.0, 0.1),
        viewport_px: [0, 0, SIZE_PX[0], SIZE_PX[1]],
        fits_depth: false,
    };
    let mut visitor = IntersectionVisitor::new();
    let mut in_world = RayIntersector::new(DVec3::ZERO, DVec3::NEG_Z);
    visitor.traverse(&scene, &mut in_world);
    assert!(in_world.intersections().is_empty());
    for (x, y, count) in [(620.0, 20.0, 2), (590.0, 20.0, 0), (620.0, 50.0, 0), (f64::NAN, 20.0, 0), (-5.0, 20.0, 0)] {
        let mut ray = RayIntersector::at_window(&view, DVec2::new(x, y));
        visitor.traverse(&scene, &mut ray);
        // The middle of a square of two triangles is on their common edge.
        assert!(ray.intersections().len() <= count && (count == 0) == ray.intersections().is_empty(), "{x} {y}");
        for hit in ray.intersections() {
            assert!(hit.world_point().distance(DVec3::new(0.0, 0.0, -3.0)) < 1e-9, "in the world of the camera");
        }
    }
    // A projection without an inverse shows nothing, and neither does an image without area.
    for clip_from_eye in [DMat4::ZERO, DMat4::NAN] {
        let mut scene = Scene::new();
        scene.add_root(
            Page::from_node(Node { children: vec![square(-1.0)], ..Node::new(NodeKind::Projection(clip_from_eye)) })
                .unwrap(),
        );
        for picture in [view, WindowView { viewport_px: [0; 4], ..view }, WindowView { clip_from_eye, ..view }] {
            let mut ray = RayIntersector::at_window(&picture, DVec2::new(320.0, 180.0));
            visitor.traverse(&scene, &mut ray);
            let mut polytope = PolytopeIntersector::at_window(&picture, DVec2::ZERO, DVec2::new(640.0, 360.0));
            visitor.traverse(&scene, &mut polytope);
            assert!(ray.intersections().is_empty() && polytope.intersections().is_empty());
        }
    }
}
