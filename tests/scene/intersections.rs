//! Intersectors find the same as a test of every triangle of the scene. Brute force is the oracle.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use terrane::state::DataVariance;

use glam::{DAffine3, DMat3, DQuat, DVec3, DVec4};
use kit::cull_scenes::quadtree;
use proptest::prelude::*;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{
    AutoScale, Billboard, BillboardMode, CullingMode, DrawSlot, Drawable, EyePoint, Geometry, HeightTile, Intersection,
    IntersectionLimit, IntersectionVisitor, LineSegmentIntersector, LodSelection, Material, Mesh, MeshVertex, Node,
    NodeId, NodeKind, Page, PolytopeIntersector, RayIntersector, Refine, Scene, Topology,
};

/// Repeatable random numbers.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, reach: f64) -> f64 {
        (2.0 * self.next() - 1.0) * reach
    }

    fn point(&mut self, reach: f64) -> DVec3 {
        DVec3::new(self.within(reach), self.within(reach), self.within(reach))
    }

    fn below(&mut self, count: usize) -> usize {
        (self.next() * count as f64) as usize
    }
}

fn mesh(random: &mut Random, topology: Topology) -> Mesh {
    let vertices: Vec<_> = (0..3 + random.below(60))
        .map(|_| MeshVertex { position: random.point(20.0).as_vec3().to_array(), ..MeshVertex::default() })
        .collect();
    let indices = (0..3 * (1 + random.below(60))).map(|_| random.below(vertices.len()) as u32).collect();
    Mesh::new(vertices, indices, topology)
}

fn drawable(mesh: Mesh) -> Drawable {
    Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())
}

fn affine(random: &mut Random) -> DAffine3 {
    let rotation = DQuat::from_scaled_axis(random.point(3.0));
    let scale = DVec3::new(0.5 + random.next(), 0.5 + random.next(), if random.next() < 0.2 { -1.0 } else { 1.2 });
    DAffine3::from_scale_rotation_translation(scale, rotation, random.point(40.0))
}

fn graph(random: &mut Random, depth: usize) -> Node {
    let kind = if depth == 0 { 9 } else { random.below(10) };
    let mut node = match kind {
        0 | 1 => Node::new(NodeKind::Group),
        2..=4 => Node::new(NodeKind::Transform(affine(random))),
        5 => Node::new(NodeKind::Switch((0..3).map(|_| random.next() < 0.7).collect())),
        6 => {
            let ranges_m = vec![[0.0, 60.0], [30.0, 90.0], [90.0, 1e9]];
            Node::new(NodeKind::Lod { center: random.point(10.0), ranges_m })
        }
        7 => {
            let modes = [
                BillboardMode::PointRotEye,
                BillboardMode::PointRotWorld,
                BillboardMode::NoRotation,
                BillboardMode::AxialRot { axis: DVec3::Z },
            ];
            let mode = modes[random.below(modes.len())];
            let auto_scale = (random.next() < 0.5).then_some(AutoScale { min: 0.05, max: 1.5 });
            let drawables = (0..2).map(|_| (random.point(20.0), drawable(mesh(random, Topology::Triangles)))).collect();
            Node::new(NodeKind::Billboard(Box::new(Billboard { mode, auto_scale, drawables })))
        }
        8 => Node::new(NodeKind::AbsoluteTransform(affine(random))),
        _ => Node::geode((0..1 + random.below(3)).map(|_| drawable(mesh(random, Topology::Triangles))).collect()),
    };
    node.mask = if random.next() < 0.1 { 2 } else { u32::MAX };
    if depth > 0 {
        node.children = (0..1 + random.below(3)).map(|_| graph(random, depth - 1)).collect();
    }
    node
}

/// A triangle in the world: drawable, number and corners.
type Triangle = (u32, u32, [DVec3; 3]);

struct Oracle {
    mask: u32,
    eye: Option<EyePoint>,
    /// The eye selects levels.
    sees: bool,
    drawables: u32,
    triangles: Vec<Triangle>,
}

impl Oracle {
    fn drawable(&mut self, drawable: &Drawable, world: Option<DAffine3>) {
        let number = self.drawables;
        self.drawables += 1;
        let (Geometry::Mesh(mesh), Some(world)) = (&drawable.geometry, world) else { return };
        for (primitive, t) in mesh.indices.chunks_exact(3).enumerate() {
            let corner =
                |i: u32| world.transform_point3(DVec3::from_array(mesh.vertices[i as usize].position.map(f64::from)));
            self.triangles.push((number, primitive as u32, [corner(t[0]), corner(t[1]), corner(t[2])]));
        }
    }

    /// Visits a graph. `world` is `None` where intersections are off.
    fn visit(&mut self, node: &Node, world: Option<DAffine3>) {
        let world = world.filter(|_| node.mask & self.mask != 0);
        let mut below = world;
        let mut shown: Box<dyn Fn(usize) -> bool> = Box::new(|_| true);
        match &node.kind {
            NodeKind::Transform(map) => below = world.map(|w| w * *map),
            NodeKind::AbsoluteTransform(map) => {
                below = world.and_then(|_| Some(self.eye?.world_from_eye * *map));
            }
            NodeKind::Geode(drawables) => drawables.iter().for_each(|d| self.drawable(d, world)),
            NodeKind::Switch(flags) => shown = Box::new(|i| flags.get(i).copied().unwrap_or(false)),
            NodeKind::Lod { center, ranges_m } => {
                let at = match (self.eye, world) {
                    (Some(eye), Some(w)) if self.sees => {
                        w.inverse().transform_point3(eye.position()).distance(*center) * eye.lod_scale
                    }
                    _ => 0.0,
                };
                shown = Box::new(move |i| ranges_m.get(i).is_some_and(|r| r[0] <= at && at < r[1]));
            }
            NodeKind::Billboard(billboard) => {
                for (position, drawable) in &billboard.drawables {
                    let turned = world.and_then(|w| Some(turned(billboard, *position, w, &self.eye?)));
                    self.drawable(drawable, turned);
                }
            }
            _ => {}
        }
        for (i, child) in node.children.iter().enumerate() {
            self.visit(child, below.filter(|_| shown(i)));
        }
    }
}

/// Returns the transform from a billboard's drawable to the world: x right, -y towards the viewer, z up.
fn turned(billboard: &Billboard, position: DVec3, world_from_node: DAffine3, eye: &EyePoint) -> DAffine3 {
    let m = world_from_node.matrix3;
    let place = world_from_node.transform_point3(position);
    let to_eye = (world_from_node.inverse().transform_point3(eye.position()) - position).normalize();
    let matrix3 = match &billboard.mode {
        BillboardMode::NoRotation => m,
        BillboardMode::PointRotEye => {
            let e = eye.world_from_eye.matrix3;
            DMat3::from_cols(e.x_axis * m.x_axis.length(), -e.z_axis * m.y_axis.length(), e.y_axis * m.z_axis.length())
        }
        BillboardMode::PointRotWorld => m * DMat3::from_quat(DQuat::from_rotation_arc(DVec3::NEG_Y, to_eye)),
        BillboardMode::AxialRot { axis } => {
            let front = (to_eye - *axis * to_eye.dot(*axis)).normalize();
            m * DMat3::from_cols(axis.cross(front), -front, *axis)
        }
    };
    let scale = billboard.auto_scale.map_or(1.0, |limits| {
        let depth = (place - eye.position()).dot(eye.world_from_eye.matrix3.z_axis);
        let px = depth.abs() / eye.px_per_radian;
        (px / m.determinant().abs().powf(1.0 / 3.0)).clamp(limits.min, limits.max)
    });
    DAffine3 { matrix3: matrix3 * scale, translation: place }
}

/// Returns the ratio along the line, and how far inside the triangle's edges it is, in shares. `None` for a triangle
/// that is nearly seen from the side.
fn meet(start: DVec3, direction: DVec3, [a, b, c]: [DVec3; 3]) -> Option<(f64, f64)> {
    let normal = (b - a).cross(c - a);
    let across = normal.dot(direction);
    if across.abs() <= 1e-7 * normal.length() * direction.length() {
        return None;
    }
    let ratio = normal.dot(a - start) / across;
    let p = start + direction * ratio;
    let share = |u: DVec3, v: DVec3| (v - u).cross(p - u).dot(normal) / normal.length_squared();
    Some((ratio, share(a, b).min(share(b, c)).min(share(c, a))))
}

const UNSURE: f64 = 1e-4;

/// Compares the hits with all triangles. Near an edge both results are accepted.
fn compare(triangles: &[Triangle], found: &[Intersection], start: DVec3, direction: DVec3, max: f64) {
    let keys: BTreeMap<(u32, u32), &Intersection> = found.iter().map(|h| ((h.drawable, h.primitive), h)).collect();
    assert_eq!(keys.len(), found.len(), "each once");
    assert!(found.windows(2).all(|w| w[0].ratio <= w[1].ratio), "in order");
    for (drawable, primitive, corners) in triangles {
        let hit = keys.get(&(*drawable, *primitive));
        let Some((ratio, inside)) = meet(start, direction, *corners) else { continue };
        let surely = inside > UNSURE && ratio > UNSURE && ratio < max - UNSURE;
        let never = inside < -UNSURE || ratio < -UNSURE || ratio > max + UNSURE;
        assert!(!surely || hit.is_some(), "{drawable}/{primitive} at {ratio} is missed");
        assert!(!never || hit.is_none(), "{drawable}/{primitive} at {ratio} is not met");
        let Some(hit) = hit else { continue };
        let scale = 1.0 + direction.length() * ratio.abs();
        assert!((hit.ratio - ratio).abs() * direction.length() < 1e-6 * scale, "{} {ratio}", hit.ratio);
        assert!(hit.world_point().distance(start + direction * hit.ratio) < 1e-6 * scale);
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).normalize();
        // The corners of a mirrored drawable have the reverse order in the world.
        assert!(hit.world_normal().dot(normal).abs() > 1.0 - 1e-6, "{} {normal}", hit.world_normal());
        let [u, v, w] = hit.weights;
        assert!((*a * u + *b * v + *c * w).distance(hit.world_point()) < 1e-6 * scale, "weights");
    }
    let of_scene: BTreeSet<_> = triangles.iter().map(|t| (t.0, t.1)).collect();
    assert!(keys.keys().all(|k| of_scene.contains(k)), "only visible drawables are hit");
}

fn eye_at(random: &mut Random) -> EyePoint {
    EyePoint {
        world_from_eye: DAffine3::from_rotation_translation(
            DQuat::from_scaled_axis(random.point(3.0)),
            random.point(80.0),
        ),
        px_per_radian: 1000.0,
        is_parallel: false,
        max_sse_px: 16.0,
        lod_scale: 0.5 + random.next(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn lines_through_a_graph_hit_the_same_as_brute_force(seed in any::<u64>()) {
        let mut random = Random(seed);
        let node = graph(&mut random, 4);
        let mut page = Page::from_node(node.clone()).unwrap();
        if random.next() < 0.7 {
            page.build_kd_trees();
            page.take_drawables();
        }
        let mut scene = Scene::new();
        scene.add_root(page);
        let mut visitor = IntersectionVisitor::new();
        visitor.traversal_mask = if random.next() < 0.5 { 1 } else { u32::MAX };
        visitor.eye = (random.next() < 0.7).then(|| eye_at(&mut random));
        visitor.lod_selection = if random.next() < 0.5 { LodSelection::AsSeen } else { LodSelection::Highest };
        let mut oracle = Oracle {
            mask: visitor.traversal_mask,
            eye: visitor.eye,
            sees: visitor.lod_selection == LodSelection::AsSeen,
            drawables: 0,
            triangles: Vec::new(),
        };
        oracle.visit(&node, Some(DAffine3::IDENTITY));
        for _ in 0..20 {
            let (start, end) = (random.point(120.0), random.point(60.0));
            let mut segment = LineSegmentIntersector::new(start, end);
            visitor.traverse(&scene, &mut segment);
            prop_assert_eq!(visitor.unmet_drawables(), 0);
            compare(&oracle.triangles, segment.intersections(), start, end - start, 1.0);

            let direction = (end - start).normalize();
            let mut ray = RayIntersector::new(start, end - start);
            visitor.traverse(&scene, &mut ray);
            compare(&oracle.triangles, ray.intersections(), start, direction, f64::INFINITY);

            // The other limits select from the same hits.
            let all = ray.intersections().to_vec();
            let mut nearest = RayIntersector::new(start, direction).with_limit(IntersectionLimit::Nearest);
            visitor.traverse(&scene, &mut nearest);
            let key = |h: &Intersection| (h.drawable, h.primitive);
            prop_assert_eq!(nearest.intersections().len(), all.len().min(1));
            if let (Some(a), Some(b)) = (nearest.first_intersection(), all.first()) {
                prop_assert!((a.ratio - b.ratio).abs() < 1e-9 * (1.0 + b.ratio));
            }
            let mut one = RayIntersector::new(start, direction).with_limit(IntersectionLimit::One);
            visitor.traverse(&scene, &mut one);
            prop_assert_eq!(one.intersections().len(), all.len().min(1));
            prop_assert!(one.intersections().iter().all(|h| all.iter().any(|a| key(a) == key(h))));
            let mut each = RayIntersector::new(start, direction).with_limit(IntersectionLimit::OnePerDrawable);
            visitor.traverse(&scene, &mut each);
            let drawables: Vec<_> = each.intersections().iter().map(|h| h.drawable).collect();
            let mut firsts: Vec<u32> = Vec::new();
            for hit in &all {
                if !firsts.contains(&hit.drawable) {
                    firsts.push(hit.drawable);
                }
            }
            prop_assert_eq!(drawables, firsts);
        }
    }

    #[test]
    fn boxes_intersect_contained_drawables(seed in any::<u64>(), kind in 0usize..3) {
        let mut random = Random(seed);
        let topology = [Topology::Triangles, Topology::Lines, Topology::Points][kind];
        let mesh = mesh(&mut random, topology);
        let map = DAffine3::from_rotation_translation(DQuat::from_scaled_axis(random.point(3.0)), random.point(10.0));
        let count = 3 - kind;
        let world: Vec<Vec<DVec3>> = mesh
            .indices
            .chunks_exact(count)
            .map(|list| {
                let at = |i: &u32| DVec3::from_array(mesh.vertices[*i as usize].position.map(f64::from));
                list.iter().map(|i| map.transform_point3(at(i))).collect()
            })
            .collect();
        let mut page =
            Page::from_node(Node::transform(map, vec![Node::geode(vec![drawable(mesh)])])).unwrap();
        page.build_kd_trees();
        page.take_drawables();
        let mut scene = Scene::new();
        scene.add_root(page);
        for _ in 0..20 {
            let (a, b) = (random.point(25.0), random.point(25.0));
            let (min, max) = (a.min(b), a.max(b));
            let mut polytope = PolytopeIntersector::in_box(min, max);
            IntersectionVisitor::new().traverse(&scene, &mut polytope);
            let found: BTreeSet<_> = polytope.intersections().iter().map(|h| h.primitive).collect();
            for hit in polytope.intersections() {
                let point = hit.world_point();
                prop_assert!(point.cmpge(min - 1e-9).all() && point.cmple(max + 1e-9).all());
                prop_assert!(hit.ratio >= -1e-9 && hit.ratio <= point.z - min.z + 1e-9);
                prop_assert!(hit.max_ratio >= point.z - min.z - 1e-9 && hit.max_ratio <= max.z - min.z + 1e-9);
                let blend: DVec3 = world[hit.primitive as usize].iter().zip(hit.weights).map(|(p, w)| *p * w).sum();
                // A triangle without area has no weights.
                let area = world[hit.primitive as usize].get(2).map_or(1.0, |c| {
                    (world[hit.primitive as usize][1] - world[hit.primitive as usize][0])
                        .cross(*c - world[hit.primitive as usize][0])
                        .length()
                });
                prop_assert!(area < 1e-6 || blend.distance(point) < 1e-6, "{blend} {point}");
            }
            for (primitive, corners) in world.iter().enumerate() {
                let is_found = found.contains(&(primitive as u32));
                // If many points of the primitive are inside, it must be found. Hits are checked above.
                let inside = (0..300).any(|_| {
                    let (u, v) = (random.next(), random.next());
                    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                    let p = match corners[..] {
                        [a, b, c] => a + (b - a) * u + (c - a) * v,
                        [a, b] => a + (b - a) * u,
                        _ => corners[0],
                    };
                    p.cmpgt(min + 1e-9).all() && p.cmplt(max - 1e-9).all()
                });
                prop_assert!(!inside || is_found, "{primitive} {corners:?} {min} {max}");
            }
        }
    }

    #[test]
    fn tiles_are_hit_as_they_are_drawn(seed in any::<u64>(), add in any::<bool>()) {
        let mut random = Random(seed);
        let refine = if add { Refine::Add } else { Refine::Replace };
        let mut scene = Scene::new();
        let root = scene.add_root(Page::from_node(quadtree(4, 1000.0, 40.0, refine)).unwrap());
        let slots: Vec<NodeId> = scene.slots_of_page(root).collect();
        let mut names = BTreeMap::new();
        for (number, slot) in slots.iter().enumerate() {
            let name = scene.slot(*slot).unwrap().uri.to_string();
            let half = 1000.0 / 2f64.powi(name.len() as i32 - 1);
            if random.next() < 0.8 {
                let z = -0.1 * name.len() as f64;
                let corner = DVec3::new(-half, -half, z);
                let square = Mesh::rectangle(corner, DVec3::X * 2.0 * half, DVec3::Y * 2.0 * half);
                let mut page = Page::from_node(Node::geode(vec![drawable(square)])).unwrap();
                page.build_kd_trees();
                page.take_drawables();
                page.set_draw_slots(0, vec![DrawSlot(number as u32)]);
                let id = scene.attach(*slot, page).unwrap();
                names.insert(id, (name, number as u32));
            }
        }
        let eye = random.point(900.0);
        let camera = CullCamera {
            eye_from_world: DAffine3::from_translation(-DVec3::new(eye.x, eye.y, eye.z.abs())),
            settings: terrane::scene::CullSettings { culling: CullingMode(0), ..Default::default() },
            ..CullCamera::default()
        };
        let mut stage = RenderStage::default();
        CullVisitor::new().cull(&scene, &camera, &mut stage);
        let drawn: BTreeSet<u32> = stage.bins.iter().flat_map(|b| &b.leaves).map(|leaf| leaf.slot.0).collect();
        let mut visitor = IntersectionVisitor::as_seen_from(camera.eye_point());
        let mut everything = PolytopeIntersector::in_box(DVec3::splat(-5000.0), DVec3::splat(5000.0))
            .with_limit(IntersectionLimit::OnePerDrawable);
        // Squares are above or below the eye.
        visitor.traverse(&scene, &mut everything);
        let met: BTreeSet<u32> =
            everything.intersections().iter().map(|h| names[&h.node().unwrap().page].1).collect();
        prop_assert_eq!(&met, &drawn);

        // Paths lead from the root page into that of the tile.
        for hit in everything.intersections() {
            prop_assert_eq!(hit.node_path[0], NodeId { page: root, index: 0 });
            let page = hit.node().unwrap().page;
            let above = scene.slot_of(page).unwrap();
            let place = hit.node_path.iter().position(|n| *n == above).unwrap();
            prop_assert_eq!(hit.node_path[place + 1], NodeId { page, index: 0 });
            prop_assert_eq!(place + 1, names[&page].0.len(), "one node per level");
        }

        // The highest and a wanted level, straight down. The expected level follows from a walk by names.
        let is_in = |name: &str| names.values().any(|(n, _)| n == name);
        // The tile is resident, or all tiles that replace it are.
        fn stands(name: &str, is_in: &impl Fn(&str) -> bool) -> bool {
            is_in(name) || (name.len() < 4 && (0..4).all(|i| stands(&format!("{name}{i}"), is_in)))
        }
        let ready = |name: &str| (0..4).all(|i| stands(&format!("{name}{i}"), &is_in));
        for _ in 0..10 {
            let at = random.point(999.0);
            for level in [None, Some(0), Some(1), Some(2), Some(3)] {
                let mut expected = Vec::new();
                let (mut name, mut center, mut half) = ("0".to_string(), DVec3::ZERO, 1000.0);
                loop {
                    let wants = name.len() < 4 && level.is_none_or(|l| name.len() - 1 < l);
                    let down = if add { wants } else { wants && ready(&name) || name.len() < 4 && !is_in(&name) };
                    if is_in(&name) && (add || !down) {
                        expected.push(name.clone());
                    }
                    if !down {
                        break;
                    }
                    let (east, north) = (at.x > center.x, at.y > center.y);
                    let sign = |b: bool| if b { 0.5 } else { -0.5 };
                    center += DVec3::new(sign(east), sign(north), 0.0) * half;
                    half *= 0.5;
                    name.push(char::from(b'0' + u8::from(east) + 2 * u8::from(north)));
                }
                let mut visitor = IntersectionVisitor::new();
                visitor.lod_selection = level.map_or(LodSelection::Highest, |l| LodSelection::Level(l as u32));
                let mut line =
                    LineSegmentIntersector::new(DVec3::new(at.x, at.y, 50.0), DVec3::new(at.x, at.y, -50.0))
                        .with_limit(IntersectionLimit::OnePerDrawable);
                visitor.traverse(&scene, &mut line);
                let met: Vec<_> =
                    line.intersections().iter().map(|h| names[&h.node().unwrap().page].0.clone()).collect();
                prop_assert_eq!(&met, &expected, "{:?} {}", level, at);
            }
        }
    }

    #[test]
    fn height_tiles_are_hit_by_the_formula_that_draws_them(seed in any::<u64>(), smooth in any::<bool>()) {
        let mut random = Random(seed);
        let side = [3u32, 9, 33][random.below(3)];
        let (tile, corners) = height_tile(&mut random, side, smooth);
        let world = affine(&mut random);
        let geometry = Geometry::Height(Arc::new(tile));
        let node = Node::transform(world, vec![Node::geode(vec![Drawable::new(geometry, Material::default())])]);
        let mut page = Page::from_node(node).unwrap();
        let by_payload = random.next() < 0.3;
        if !by_payload {
            page.build_kd_trees();
            page.take_drawables();
        }
        let mut scene = Scene::new();
        scene.add_root(page);
        let at = |i: u32, j: u32| world.transform_point3(corners[(j * side + i) as usize]);
        let mut triangles = Vec::new();
        for j in 0..side - 1 {
            for i in 0..side - 1 {
                let (sw, se, nw, ne) = (at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1));
                let number = 2 * (j * (side - 1) + i);
                triangles.extend([(0, number, [sw, se, ne]), (0, number + 1, [sw, ne, nw])]);
            }
        }
        for _ in 0..20 {
            let cell = triangles[random.below(triangles.len())].2;
            let target = (cell[0] + cell[1] + cell[2]) / 3.0;
            let start = target + random.point(3000.0);
            let mut line = LineSegmentIntersector::new(start, target + (target - start));
            IntersectionVisitor::new().traverse(&scene, &mut line);
            prop_assert!(!line.intersections().is_empty());
            compare(&triangles, line.intersections(), start, 2.0 * (target - start), 1.0);
            for hit in line.intersections() {
                // The direction is from the middle of the ball.
                let corner = corners[hit.vertices[0] as usize];
                let up = corner - DVec3::new(0.0, -BALL_M * LAT.cos(), -BALL_M * LAT.sin());
                prop_assert!(hit.local_normal.dot(up) > 0.0, "normals point up");
            }
        }
    }
}

const BALL_M: f64 = 6.0e6;
const LAT: f64 = 0.7;

/// Returns a tile on a ball, rough or smooth, with its vertices by the documented formula.
fn height_tile(random: &mut Random, side: u32, smooth: bool) -> (HeightTile, Vec<DVec3>) {
    let step = 100.0 / BALL_M;
    let p0_m = (BALL_M * LAT.cos()) as f32;
    let offset = |k: u32| (f64::from(k) - f64::from(side - 1) / 2.0) * step;
    let rows: Vec<[f32; 4]> = (0..side)
        .map(|j| {
            let lat = LAT + offset(j);
            let (dp, dz) = (BALL_M * (lat.cos() - LAT.cos()), BALL_M * (lat.sin() - LAT.sin()));
            [dp as f32, dz as f32, lat.cos() as f32, lat.sin() as f32]
        })
        .collect();
    let columns: Vec<[f32; 2]> = (0..side)
        .map(|i| {
            let lon = offset(i);
            [lon.sin() as f32, (1.0 - lon.cos()) as f32]
        })
        .collect();
    let rough = if smooth { 0.0 } else { 300.0 };
    let heights: Vec<f32> =
        (0..(side + 2) * (side + 2)).map(|_| ((random.next() * rough * 8.0).round() / 8.0) as f32).collect();
    let mut corners = Vec::new();
    for j in 0..side as usize {
        for i in 0..side as usize {
            let h = f64::from(heights[(j + 1) * (side as usize + 2) + i + 1]);
            let [dp, dz, cos, sin] = rows[j].map(f64::from);
            let [col_sin, one_minus_cos] = columns[i].map(f64::from);
            let across = f64::from(p0_m) + dp + h * cos;
            corners.push(DVec3::new(across * col_sin, dp + h * cos - across * one_minus_cos, dz + h * sin));
        }
    }
    let bounds = Aabb::from_points(corners.iter().copied());
    let tile = HeightTile {
        side,
        heights,
        rows,
        columns,
        p0_m,
        level: 0,
        coarser_errors_m: Vec::new(),
        skirt_m: 0.0,
        cell_m: [100.0, 100.0],
        texture: None,
        bounds,
    };
    (tile, corners)
}

#[test]
fn non_finite_intersectors_hit_nothing() {
    let square = Mesh::rectangle(DVec3::ZERO, DVec3::X, DVec3::Y);
    let mut scene = Scene::new();
    scene.add_root(Page::from_node(Node::geode(vec![drawable(square)])).unwrap());
    let mut visitor = IntersectionVisitor::new();
    for (start, end) in
        [(DVec3::NAN, DVec3::ZERO), (DVec3::ONE, DVec3::splat(f64::INFINITY)), (DVec3::splat(0.5), DVec3::splat(0.5))]
    {
        let mut segment = LineSegmentIntersector::new(start, end);
        visitor.traverse(&scene, &mut segment);
        assert!(segment.intersections().is_empty());
        let mut ray = RayIntersector::new(start, end - start);
        visitor.traverse(&scene, &mut ray);
        assert!(ray.intersections().is_empty());
    }
    for plane in [DVec4::NAN, DVec4::new(0.0, 0.0, f64::INFINITY, 0.0)] {
        let mut polytope = PolytopeIntersector::new(vec![plane], DVec4::Z);
        visitor.traverse(&scene, &mut polytope);
        assert!(polytope.intersections().is_empty());
    }
    let mut ray = RayIntersector::new(DVec3::new(0.5, 0.5, 1e7), DVec3::NEG_Z);
    visitor.traverse(&scene, &mut ray);
    assert_eq!(ray.first_intersection().map(|h| h.world_point()), Some(DVec3::new(0.5, 0.5, 0.0)));
}

#[test]
fn drawables_without_tree_and_payload_are_counted() {
    let square = Mesh::rectangle(DVec3::ZERO, DVec3::X, DVec3::Y);
    let mut page = Page::from_node(Node::geode(vec![drawable(square)])).unwrap();
    page.take_drawables();
    let mut scene = Scene::new();
    scene.add_root(page);
    let mut visitor = IntersectionVisitor::new();
    let mut ray = RayIntersector::new(DVec3::new(0.5, 0.5, 5.0), DVec3::NEG_Z);
    visitor.traverse(&scene, &mut ray);
    assert!(ray.intersections().is_empty());
    assert_eq!(visitor.unmet_drawables(), 1);
}

#[test]
fn replaced_mesh_is_hit_at_its_new_position() {
    for (with_tree, with_payload) in [(true, true), (true, false), (false, true)] {
        let square = Mesh::rectangle(DVec3::ZERO, DVec3::X, DVec3::Y);
        let mut page = Page::from_node(Node::geode(vec![drawable(square)])).unwrap();
        if with_tree {
            page.build_kd_trees();
        }
        if !with_payload {
            page.take_drawables();
        }
        let mut scene = Scene::new();
        let root = scene.add_root(page);
        let raised = Mesh::rectangle(DVec3::new(0.0, 0.0, 2.0), DVec3::X, DVec3::Y);
        scene.set_mesh(NodeId { page: root, index: 0 }, 0, Arc::new(raised), DataVariance::Static).unwrap();
        let mut ray = RayIntersector::new(DVec3::new(0.5, 0.5, 5.0), DVec3::NEG_Z);
        IntersectionVisitor::new().traverse(&scene, &mut ray);
        let point = ray.first_intersection().map(|hit| hit.world_point());
        assert_eq!(point, Some(DVec3::new(0.5, 0.5, 2.0)), "tree {with_tree}, payload {with_payload}");
    }
}
