//! Scenes without a GPU for the tests and benches of cull: a grid of drawables and a quadtree of tiles.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use terrane::cull::CullCamera;
use terrane::math::{Aabb, BoundingVolume, OrientedBox};
use terrane::scene::{
    CullingMode, DrawSlot, Drawable, Geometry, Material, Mesh, Node, NodeKind, Page, PagedLod, PagingOptions,
    RangeMode, Refine, Topology,
};
use terrane::state::StateSet;

/// Returns a drawable without vertices: cull reads only its bound.
pub fn drawable(bounds: Aabb) -> Drawable {
    let mesh =
        Mesh { vertices: Vec::new(), indices: Arc::new([]), topology: Topology::Triangles, bounds, ..Mesh::default() };
    Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())
}

/// Returns a page whose drawables are uploaded in context 0, to the slots from `first` on.
pub fn page(root: Node, first: u32) -> Page {
    let mut page = Page::from_node(root).unwrap();
    let count = page.drawable_count() as u32;
    page.set_draw_slots(0, (first..first + count).map(DrawSlot).collect());
    page.take_drawables();
    page
}

/// A grid of `gx * gy` cells, divided recursively in four; groups of odd depth are transforms.
///
/// The program `osg_cull` in `tools/peers` builds the same.
pub struct Grid {
    /// Number of cells along x.
    pub gx: u32,
    /// Number of cells along y.
    pub gy: u32,
}

impl Grid {
    /// Creates a grid of exactly that many cells, as square as possible.
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
            let corners = [DVec3::new(-0.25, -0.25, 0.0), DVec3::new(0.25, 0.25, f64::from(0.1f32))];
            let bounds = Aabb::from_points(corners.map(|c| center + c));
            return Node::geode(vec![drawable(bounds)]).with_state_set(sets[set].clone());
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

    /// Returns a camera that sees a tenth of the cells (`tenth`), all from above (`all`), or all obliquely (`tilted`).
    pub fn camera(&self, view: &str) -> CullCamera {
        let (gx, gy) = (f64::from(self.gx), f64::from(self.gy));
        let side = if view == "tenth" { (0.1 * gx * gy).sqrt() } else { gx.max(gy) * 1.02 };
        let height = side * 0.5 / 30f64.to_radians().tan();
        let center = DVec3::new(gx * 0.5, gy * 0.5, 0.0);
        let (offset, up) = if view == "tilted" {
            (DVec3::new(0.3 * height, -0.9 * height, height), DVec3::Z)
        } else {
            (DVec3::new(0.0, 0.0, height), DVec3::Y)
        };
        let mut camera = look_at(center + offset, center, up);
        camera.settings.culling = CullingMode::VIEW_FRUSTUM_SIDES;
        camera
    }
}

/// Returns copies of a state set that are equal and not the same object.
pub fn state_sets(count: usize, set: &StateSet) -> Vec<Arc<StateSet>> {
    (0..count).map(|_| Arc::new(set.clone())).collect()
}

/// Returns a camera at `eye` with a field of view of 60 degrees and 1024 x 1024 pixels.
pub fn look_at(eye: DVec3, target: DVec3, up: DVec3) -> CullCamera {
    let eye_from_world = DAffine3::from_mat4(glam::dcamera::rh::view::look_at_mat4(eye, target, up));
    CullCamera { eye_from_world, ..CullCamera::default() }
}

/// Returns the box of a square of terrain, 1 m above and below its center.
pub fn square_box(center: DVec3, half_m: f64) -> OrientedBox {
    OrientedBox { center, half_axes: DMat3::from_diagonal(DVec3::new(half_m, half_m, 1.0)) }
}

/// Returns a quadtree of tiles over a square of `2 * half_m` metres; geometric errors halve from `error_m`.
///
/// URIs are `0` for the root and the digit of the child, 0 to 3, for each level below it.
pub fn quadtree(levels: u32, half_m: f64, error_m: f64, refine: Refine) -> Node {
    quad(levels, DVec3::ZERO, half_m, error_m, refine, "0")
}

fn quad(levels: u32, center: DVec3, half_m: f64, error_m: f64, refine: Refine, name: &str) -> Node {
    let geometric_error_m = if levels <= 1 { 0.0 } else { error_m };
    let mut node = Node::new(NodeKind::PagedLod(Box::new(PagedLod {
        bounds: BoundingVolume::Box(square_box(center, half_m)),
        range_mode: RangeMode::ScreenSpaceError { geometric_error_m },
        refine,
        content: Some(name.into()),
        content_transform: DAffine3::from_translation(center),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    })));
    if levels > 1 {
        for (i, (x, y)) in [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].into_iter().enumerate() {
            let middle = center + DVec3::new(x, y, 0.0) * half_m;
            let name = format!("{name}{i}");
            node.children.push(quad(levels - 1, middle, 0.5 * half_m, 0.5 * error_m, refine, &name));
        }
    }
    node
}

/// Returns the content of a tile: one drawable around the origin, uploaded to `slot`.
pub fn content(half_m: f64, slot: u32) -> Page {
    let half = DVec3::new(half_m, half_m, 1.0);
    page(Node::geode(vec![drawable(Aabb { min: -half, max: half })]), slot)
}
