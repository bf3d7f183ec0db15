//! Measures intersections with a terrain of a million triangles: one mesh, a tile tree of meshes, a tile tree of heights.
//! Needs no GPU. Prints one JSON object per line.

use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use serde_json::json;
use terrane::math::{Aabb, BoundingVolume, OrientedBox};
use terrane::scene::{
    Drawable, Geometry, HeightQuery, HeightTile, IntersectionLimit, IntersectionVisitor, LineSegmentIntersector,
    Material, Mesh, MeshVertex, Node, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine, Scene, Topology,
    Vertical,
};

use super::measurement::{percentile, print_line};

/// Half the side of the terrain in metres.
const HALF_M: f64 = 10_000.0;
/// The number of cells along a tile's side.
const TILE_CELLS: u32 = 64;
/// The number of levels of the tile trees, which have 4^4 leaves of 8,192 triangles.
const LEVELS: u32 = 5;

/// Measures each case for about `seconds` and prints a line for it.
pub fn run(seconds: f64) {
    let time = Duration::from_secs_f64(if seconds.is_finite() { seconds.clamp(0.0, 3600.0) } else { 1.0 });
    // The mesh has 2 * 708^2 = 1,002,528 triangles.
    for (name, scene, build) in [one_mesh(708), tiles("mesh_tiles", false), tiles("height_tiles", true)] {
        let memory = memory(&scene);
        let made = json!({
            "bench": "terrane_pick_build", "scene": name, "triangles": memory.0, "drawables": memory.2,
            "build_ms": round(build * 1e3, 1), "build_ns_per_triangle": round(build * 1e9 / memory.0 as f64, 1),
            "bytes_per_triangle": round(memory.1 as f64 / memory.0 as f64, 2),
        });
        print_line(made);
        for lines in [Lines::Down, Lines::Slanted, Lines::Grazing] {
            for limit in [IntersectionLimit::Nearest, IntersectionLimit::NoLimit] {
                print_line(pick(name, &scene, lines, limit, time));
            }
        }
        print_line(heights(name, &scene, time));
    }
}

/// The kinds of lines.
#[derive(Clone, Copy, Debug)]
enum Lines {
    /// Vertical lines, like those of a manipulator that stays above the ground.
    Down,
    /// Lines like those of a pointer in a window: from 200 m to 5 km above the ground to a point on it.
    Slanted,
    /// Lines a few metres above the ground, across the whole terrain.
    Grazing,
}

fn height_m(x: f64, y: f64) -> f64 {
    let wave = |k: f64, tilt: f64| (k * (x + tilt * y)).sin() * (k * (y - 0.7 * tilt * x) + 1.0).cos();
    600.0 * wave(0.0005, 0.3) + 120.0 * wave(0.003, -0.4) + 15.0 * wave(0.02, 0.9) + 2.0 * wave(0.11, -0.2)
}

/// Returns a square of ground with `cells` squared cells around a point, in the frame of that point.
fn ground(cells: u32, center: DVec3, half_m: f64) -> Geometry {
    let at = |k: u32| -half_m + 2.0 * half_m * f64::from(k) / f64::from(cells);
    let side = cells + 1;
    let vertices: Vec<_> = (0..side * side)
        .map(|k| (at(k % side), at(k / side)))
        .map(|(x, y)| MeshVertex {
            position: [x as f32, y as f32, height_m(center.x + x, center.y + y) as f32],
            ..MeshVertex::default()
        })
        .collect();
    let indices: Vec<u32> = (0..cells * cells)
        .flat_map(|k| {
            let sw = k / cells * side + k % cells;
            [sw, sw + 1, sw + side + 1, sw, sw + side + 1, sw + side]
        })
        .collect();
    let bounds = Aabb::from_points(vertices.iter().map(|v| DVec3::from_array(v.position.map(f64::from))));
    Geometry::Mesh(Arc::new(Mesh {
        vertices,
        indices: indices.into(),
        topology: Topology::Triangles,
        bounds,
        ..Mesh::default()
    }))
}

/// Returns the same square as a height tile, with heights in steps of 1/128 m: x is east, "polar" is up.
fn height_tile(cells: u32, center: DVec3, half_m: f64) -> Geometry {
    let side = cells + 1;
    let cell_m = 2.0 * half_m / f64::from(cells);
    let at = |k: f64| -half_m + cell_m * k;
    let p0_m = 1e12f64;
    let heights: Vec<f32> = (0..(side + 2) * (side + 2))
        .map(|k| (at(f64::from(k % (side + 2)) - 1.0), at(f64::from(k / (side + 2)) - 1.0)))
        .map(|(x, y)| ((height_m(center.x + x, center.y + y) * 128.0).round() / 128.0) as f32)
        .collect();
    let (low, high) = heights.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), h| (a.min(*h), b.max(*h)));
    Geometry::Height(Arc::new(HeightTile {
        side,
        rows: (0..side).map(|j| [-at(f64::from(j)) as f32, 0.0, 0.0, 1.0]).collect(),
        columns: (0..side).map(|i| [(at(f64::from(i)) / p0_m) as f32, 0.0]).collect(),
        heights,
        p0_m: p0_m as f32,
        level: 0,
        coarser_errors_m: Vec::new(),
        skirt_m: 0.0,
        cell_m: [cell_m as f32; 2],
        texture: None,
        bounds: Aabb {
            min: DVec3::new(-half_m, -half_m, f64::from(low)),
            max: DVec3::new(half_m, half_m, f64::from(high)),
        },
    }))
}

/// Returns the scene of one mesh, and the seconds to build its trees.
fn one_mesh(cells: u32) -> (&'static str, Scene, f64) {
    let mut scene = Scene::new();
    let build = content(ground(cells, DVec3::ZERO, HALF_M), false).map_or(0.0, |(page, seconds)| {
        scene.add_root(page);
        seconds
    });
    ("one_mesh", scene, build)
}

fn content(geometry: Geometry, is_height: bool) -> Option<(Page, f64)> {
    let geode = Node::geode(vec![Drawable::new(geometry, Material::default())]);
    // The "radial" axis of height tiles is south here.
    let rows = glam::DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::Z);
    let map = if is_height { DAffine3 { matrix3: rows, translation: DVec3::ZERO } } else { DAffine3::IDENTITY };
    let mut page = Page::from_node(Node::transform(map, vec![geode])).ok()?;
    let start = Instant::now();
    page.build_kd_trees();
    let seconds = start.elapsed().as_secs_f64();
    page.take_drawables();
    Some((page, seconds))
}

fn tiles(name: &'static str, is_height: bool) -> (&'static str, Scene, f64) {
    let mut scene = Scene::new();
    let mut build = 0.0;
    let Ok(page) = Page::from_node(tile(LEVELS, DVec3::ZERO, HALF_M)) else { return (name, scene, build) };
    let root = scene.add_root(page);
    let slots: Vec<_> = scene.slots_of_page(root).collect();
    for slot in slots {
        let place = scene.slot(slot).and_then(|s| serde_json::from_str::<[f64; 3]>(s.uri).ok());
        let Some([x, y, half_m]) = place else { continue };
        let center = DVec3::new(x, y, 0.0);
        let make = if is_height { height_tile } else { ground };
        let Some((page, seconds)) = content(make(TILE_CELLS, center, half_m), is_height) else { continue };
        build += seconds;
        if scene.attach(slot, page).is_err() {
            // Slots are empty, so attaching does not fail.
            break;
        }
    }
    (name, scene, build)
}

fn tile(levels: u32, center: DVec3, half_m: f64) -> Node {
    let half_axes = glam::DMat3::from_diagonal(DVec3::new(half_m, half_m, 1000.0));
    let mut node = Node::new(NodeKind::PagedLod(Box::new(PagedLod {
        bounds: BoundingVolume::Box(OrientedBox { center, half_axes }),
        range_mode: RangeMode::ScreenSpaceError { geometric_error_m: half_m / 100.0 },
        refine: Refine::Replace,
        content: Some(format!("[{},{},{half_m}]", center.x, center.y).into()),
        content_transform: DAffine3::from_translation(center),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    })));
    if levels > 1 {
        let quarter = |(x, y): (f64, f64)| tile(levels - 1, center + DVec3::new(x, y, 0.0) * half_m, 0.5 * half_m);
        node.children = [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].map(quarter).into();
    }
    node
}

/// Returns the triangles, bytes and number of the k-d trees of the finest level, which is drawn.
fn memory(scene: &Scene) -> (u64, u64, u64) {
    let mut sum = (0, 0, 0);
    let mut add = |page: &Page| {
        for tree in (0..page.drawable_count() as u32).filter_map(|d| page.kd_tree(d)) {
            sum = (sum.0 + tree.primitive_count() as u64, sum.1 + tree.size_bytes(), sum.2 + 1);
        }
    };
    for root in scene.roots() {
        scene.page(*root).into_iter().for_each(&mut add);
        for slot in scene.slots_of_page(*root).filter_map(|id| scene.slot(id)) {
            if let terrane::scene::SlotState::Resident(id) = slot.state {
                scene.page(id).into_iter().for_each(&mut add);
            }
        }
    }
    sum
}

/// Repeatable random points and directions.
struct Random(u64);

impl Random {
    fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 11) as f64 / (1u64 << 53) as f64)
    }

    fn ground(&mut self) -> DVec3 {
        let (x, y) = (self.within(-0.95, 0.95) * HALF_M, self.within(-0.95, 0.95) * HALF_M);
        DVec3::new(x, y, height_m(x, y))
    }
}

impl Lines {
    fn next(self, random: &mut Random) -> (DVec3, DVec3) {
        let at = random.ground();
        match self {
            Self::Down => (at.with_z(9000.0), at.with_z(-9000.0)),
            Self::Slanted => {
                let mut eye = random.ground();
                eye.z += random.within(200.0, 5000.0);
                (eye, at + (at - eye) * 0.5)
            }
            Self::Grazing => {
                let mut other = random.ground();
                other.z += 5.0;
                (at + DVec3::Z * 5.0, other)
            }
        }
    }
}

fn pick(name: &str, scene: &Scene, lines: Lines, limit: IntersectionLimit, time: Duration) -> serde_json::Value {
    let mut random = Random(7);
    let mut visitor = IntersectionVisitor::new();
    let (mut times, mut hits, mut missed) = (Vec::new(), 0, 0);
    let end = Instant::now() + time;
    while Instant::now() < end || times.len() < 100 {
        let (start, end) = lines.next(&mut random);
        let before = Instant::now();
        let mut line = LineSegmentIntersector::new(start, end).with_limit(limit);
        visitor.traverse(scene, &mut line);
        times.push(before.elapsed().as_secs_f64());
        hits += line.intersections().len();
        missed += usize::from(line.intersections().is_empty());
    }
    let count = times.len() as f64;
    json!({
        "bench": "terrane_pick", "scene": name, "lines": format!("{lines:?}"), "limit": format!("{limit:?}"),
        "iters": times.len(), "median_us": round(percentile(&mut times, 0.5) * 1e6, 2),
        "p95_us": round(percentile(&mut times, 0.95) * 1e6, 2), "p99_us": round(percentile(&mut times, 0.99) * 1e6, 2),
        "hits_per_line": round(hits as f64 / count, 2), "missed": missed,
    })
}

fn heights(name: &str, scene: &Scene, time: Duration) -> serde_json::Value {
    let query = HeightQuery::new(Vertical::Flat);
    let start = Instant::now();
    query.publish(scene);
    let publish = start.elapsed().as_secs_f64();
    let mut random = Random(11);
    let first = Instant::now();
    let _ = query.height_above_terrain_m(random.ground());
    let first = first.elapsed().as_secs_f64();
    let (mut times, mut wrong) = (Vec::new(), 0);
    let end = Instant::now() + time;
    while Instant::now() < end || times.len() < 100 {
        let at = random.ground();
        let before = Instant::now();
        let found = query.height_above_terrain_m(at.with_z(2000.0));
        times.push(before.elapsed().as_secs_f64());
        // The ground between samples is flat, so the height may differ.
        wrong += usize::from(found.is_none_or(|h| (h - (2000.0 - at.z)).abs() > 5.0));
    }
    json!({
        "bench": "terrane_height_query", "scene": name, "drawables": query.snapshot().drawable_count(),
        "publish_us": round(publish * 1e6, 1), "first_us": round(first * 1e6, 1), "iters": times.len(),
        "median_us": round(percentile(&mut times, 0.5) * 1e6, 2), "p99_us": round(percentile(&mut times, 0.99) * 1e6, 2),
        "wrong": wrong,
    })
}

fn round(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}
