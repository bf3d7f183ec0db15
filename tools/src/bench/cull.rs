//! Measures cull on the scene of the `osg_cull` peer: a grid of N cells, divided recursively in four. Even depths are
//! groups, odd depths are transforms, and a cell is a geode with one triangle and one of S state sets.
//!
//! Needs no GPU. Prints one JSON object per line with the peer's field names, so that both can be compared line by line.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::json;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{
    CullSettings, CullingMode, DrawSlot, Drawable, Geometry, Material, Mesh, MeshVertex, Node, NodeId, NodeKind, Page,
    Scene, Topology,
};
use terrane::state::{BinDetails, SortMode, StateSet};

use glam::{DAffine3, DVec3};

use super::measurement::{percentile, print_line};

/// Measures each case for about `seconds` and prints a line for it. `drawables` are the sizes of the scenes.
pub fn run(seconds: f64, drawables: &[u32]) {
    let seconds = if seconds.is_finite() { seconds.clamp(0.0, 3600.0) } else { 1.0 };
    for &cells in drawables {
        for state_sets in [1, 64] {
            for view in [View::Tilted, View::All, View::Tenth] {
                for (name, sort) in SORTS {
                    print_line(measure(cells, state_sets, view, name, sort, Duration::from_secs_f64(seconds)));
                }
            }
        }
    }
}

const SORTS: [(&str, SortMode); 3] = [
    ("by_state", SortMode::ByState),
    ("state_then_front_to_back", SortMode::ByStateThenFrontToBack),
    ("back_to_front", SortMode::BackToFront),
];

/// The position of the camera, which decides how many cells are visible.
#[derive(Clone, Copy)]
pub enum View {
    /// From above, a tenth of the cells is visible.
    Tenth,
    /// From above, all cells are visible.
    All,
    /// At an angle, all cells are visible.
    Tilted,
}

/// A grid of `gx` by `gy` cells.
pub struct Grid {
    gx: u32,
    gy: u32,
}

impl Grid {
    /// Creates a grid of exactly this number of cells, as square as possible.
    pub fn new(cells: u32) -> Self {
        let mut gx = f64::from(cells).sqrt() as u32;
        while !cells.is_multiple_of(gx) {
            gx -= 1;
        }
        Self { gx, gy: cells / gx }
    }

    /// Returns the root node. The state sets are spread over the cells by a hash of their numbers.
    pub fn build(&self, sets: &[Arc<StateSet>]) -> Node {
        self.rect([0, 0, self.gx, self.gy], 0, DVec3::ZERO, sets)
    }

    fn rect(&self, [x0, y0, x1, y1]: [u32; 4], depth: u32, origin: DVec3, sets: &[Arc<StateSet>]) -> Node {
        if x1 - x0 == 1 && y1 - y0 == 1 {
            let i = y0 * self.gx + x0;
            let set = (i.wrapping_mul(2_654_435_761) >> 16) as usize % sets.len();
            let center = DVec3::new(f64::from(x0) + 0.5, f64::from(y0) + 0.5, 0.0) - origin;
            return Node::geode(vec![triangle(center)]).with_state_set(sets[set].clone());
        }
        let middle = DVec3::new(f64::from(x0 + x1) * 0.5, f64::from(y0 + y1) * 0.5, 0.0);
        let (kind, child_origin) = if depth % 2 == 1 {
            (NodeKind::Transform(DAffine3::from_translation(middle - origin)), middle)
        } else {
            (NodeKind::Group, origin)
        };
        let split = |a: u32, b: u32| if b - a > 1 { [a, a.midpoint(b), b] } else { [a, b, b] };
        let (xs, ys) = (split(x0, x1), split(y0, y1));
        let mut node = Node::new(kind);
        for j in 0..2 {
            for i in 0..2 {
                if xs[i] < xs[i + 1] && ys[j] < ys[j + 1] {
                    let rect = [xs[i], ys[j], xs[i + 1], ys[j + 1]];
                    node.children.push(self.rect(rect, depth + 1, child_origin, sets));
                }
            }
        }
        node
    }

    /// Returns the camera of a view.
    pub fn camera(&self, view: View) -> CullCamera {
        let (gx, gy) = (f64::from(self.gx), f64::from(self.gy));
        let side = match view {
            View::Tenth => (0.1 * gx * gy).sqrt(),
            View::All | View::Tilted => gx.max(gy) * 1.02,
        };
        let height = side * 0.5 / 30f64.to_radians().tan();
        let center = DVec3::new(gx * 0.5, gy * 0.5, 0.0);
        let (offset, up) = match view {
            View::Tilted => (DVec3::new(0.3 * height, -0.9 * height, height), DVec3::Z),
            View::All | View::Tenth => (DVec3::new(0.0, 0.0, height), DVec3::Y),
        };
        let eye_from_world = glam::dcamera::rh::view::look_at_mat4(center + offset, center, up);
        CullCamera {
            eye_from_world: DAffine3::from_mat4(eye_from_world),
            settings: CullSettings { culling: CullingMode::VIEW_FRUSTUM_SIDES, ..CullSettings::default() },
            ..CullCamera::default()
        }
    }
}

/// Returns a drawable of one triangle.
pub fn triangle(center: DVec3) -> Drawable {
    let corners = [DVec3::new(-0.25, -0.25, 0.0), DVec3::new(0.25, -0.25, 0.1), DVec3::new(0.0, 0.25, 0.0)];
    let vertex = |p: DVec3| MeshVertex { position: p.as_vec3().to_array(), ..MeshVertex::default() };
    let points = corners.map(|c| center + c);
    let bounds = Aabb::from_points(points.map(|p| p.as_vec3().as_dvec3()));
    Drawable::new(
        Geometry::Mesh(Arc::new(Mesh {
            vertices: points.map(vertex).to_vec(),
            indices: Arc::new([0, 1, 2]),
            topology: Topology::Triangles,
            bounds,
            ..Mesh::default()
        })),
        Material::default(),
    )
}

fn measure(cells: u32, state_sets: u32, view: View, name: &str, sort: SortMode, time: Duration) -> serde_json::Value {
    let grid = Grid::new(cells);
    let bin = Some(BinDetails::new(0, sort));
    let sets: Vec<_> = (0..state_sets)
        .map(|i| {
            let color = [f64::from(i % 8) as f32 / 8.0, f64::from(i / 8) as f32 / 8.0, 0.5, 1.0];
            Arc::new(StateSet { color: Some(color), bin, ..StateSet::default() })
        })
        .collect();
    let built = Instant::now();
    let mut page = match Page::from_node(grid.build(&sets)) {
        Ok(page) => page,
        Err(error) => return json!({"bench": "terrane_cull", "n": cells, "error": error.to_string()}),
    };
    let flatten = built.elapsed();
    page.take_drawables();
    page.set_draw_slots(0, (0..cells).map(DrawSlot).collect());
    let mut scene = Scene::new();
    let root = scene.add_root(page);
    debug_assert!(scene.slot(NodeId { page: root, index: 0 }).is_none());

    let mut camera = grid.camera(view);
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    for _ in 0..3 {
        visitor.cull(&scene, &camera, &mut stage);
    }
    let (mut traverse, mut sorting, mut total) = (Vec::new(), Vec::new(), Vec::new());
    let end = Instant::now() + time;
    while Instant::now() < end || total.len() < 5 {
        camera.frame += 1;
        let t0 = Instant::now();
        visitor.traverse(&scene, &camera, &mut stage);
        let t1 = Instant::now();
        visitor.sort(&mut stage);
        let t2 = Instant::now();
        traverse.push((t1 - t0).as_secs_f64());
        sorting.push((t2 - t1).as_secs_f64());
        total.push((t2 - t0).as_secs_f64());
    }
    let counters = stage.counters;
    let median = percentile(&mut traverse, 0.5);
    let visited = f64::from((counters.nodes_visited + counters.drawables_tested).max(1));
    let us = |seconds: f64, digits: i32| (seconds * 1e6 * 10f64.powi(digits)).round() / 10f64.powi(digits);
    json!({
        "bench": "terrane_cull", "n": cells, "statesets": state_sets,
        "view": match view { View::Tenth => "tenth", View::All => "all", View::Tilted => "tilted" },
        "sort": name, "nodes_visited": counters.nodes_visited, "drawables_tested": counters.drawables_tested,
        "leaves": counters.leaves, "iters": total.len(),
        "traverse_us": us(median, 2), "traverse_p95_us": us(percentile(&mut traverse, 0.95), 2),
        "ns_per_node": (median * 1e10 / visited).round() / 10.0,
        "ns_per_leaf": (median * 1e10 / f64::from(counters.leaves.max(1))).round() / 10.0,
        "sort_us": us(percentile(&mut sorting, 0.5), 2), "reset_us": 0.0,
        "total_us": us(percentile(&mut total, 0.5), 2), "flatten_us": us(flatten.as_secs_f64(), 1),
    })
}
