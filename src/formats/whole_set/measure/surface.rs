//! [`Surface`]: what a content draws, as triangles over the map without their skirts, and distances from it. Plain values.

use glam::{DAffine3, DVec3, Vec3};

use super::grid::Grid;
use super::place::{MapFrame, Place};
use crate::scene::{Drawable, Geometry, HeightTile, Node, NodeKind, Topology};

/// Contents with more triangles are not measured: their copies would take too much memory.
const MAX_TRIANGLES: usize = 4_000_000;
/// A vertex lies on an edge of its tile if it is nearer than this share of the tile's size.
const EDGE_SHARE: f64 = 1e-3;
/// Vertices that are nearer on the map than this share of the tile's size are above each other: positions may be quantised.
const ABOVE_SHARE: f64 = 2e-4;
/// The share of a mesh's area that may face down in a mesh that is still measured by heights.
const MAX_SHARE_DOWN: f64 = 1e-3;
/// A triangle belongs to a place if its barycentric coordinates are at least this: edges along a parallel are chords of it.
const MIN_INSIDE: f64 = -1e-3;

/// The edges of a tile, in the order of the profiles of a [`Surface`].
pub(super) const WEST: usize = 0;
pub(super) const SOUTH: usize = 1;
pub(super) const EAST: usize = 2;
pub(super) const NORTH: usize = 3;

/// The heights along an edge of a tile.
#[derive(Clone, Default)]
pub(super) struct Profile {
    /// The place along the edge and the height of each vertex, in order.
    pub points: Vec<[f64; 2]>,
    /// The parts of the edge that triangles lie on, in order: a tile with voids has gaps.
    pub covered: Vec<[f64; 2]>,
}

/// The triangles of a content.
pub(super) struct Surface {
    pub frame: MapFrame,
    pub vertices: Vec<Place>,
    /// The directions east, north and up at each vertex: it is compared with each tile above.
    pub axes: Vec<[DVec3; 3]>,
    triangles: Vec<[u32; 3]>,
    /// The smallest x and y on the map, then the largest.
    pub rectangle: [f64; 4],
    /// Depths of the skirts, smallest and largest.
    pub skirt_m: Option<[f64; 2]>,
    /// The four edges.
    pub profiles: [Profile; 4],
    /// True if a place has one height, so that heights are compared; otherwise distances are.
    pub is_height_field: bool,
    /// True for the samples of a height tile: those of coarser tiles are among those of finer ones.
    pub is_samples: bool,
    grid: Grid,
}

impl Surface {
    /// Returns the surface of a height tile, whose region on the earth, or whose transform, is known; the samples are taken as
    /// they are in the file.
    pub fn of_heights(
        tile: &HeightTile,
        set_from_tile: &DAffine3,
        region: Option<[f64; 4]>,
        frame: MapFrame,
    ) -> Option<Self> {
        let side = tile.side as usize;
        let stride = side + 2;
        let mut vertices = Vec::with_capacity(side * side);
        for j in 0..side {
            for i in 0..side {
                let height_m = f64::from(*tile.heights.get((j + 1) * stride + i + 1)?);
                let share = |k: usize| k as f64 / (side - 1) as f64;
                vertices.push(match (region, frame) {
                    (Some([west, south, east, north]), MapFrame::Globe(_)) => {
                        frame.place_at([west + (east - west) * share(i), south + (north - south) * share(j)], height_m)
                    }
                    _ => {
                        let ([dp, dz, cos, sin], [s, c1]) =
                            (tile.rows.get(j)?.map(f64::from), tile.columns.get(i)?.map(f64::from));
                        let across = dp + height_m * cos;
                        let p = f64::from(tile.p0_m) + across;
                        frame.place(set_from_tile.transform_point3(DVec3::new(
                            p * s,
                            across - p * c1,
                            dz + height_m * sin,
                        )))
                    }
                });
            }
        }
        let at = |i: usize, j: usize| (j * side + i) as u32;
        let cells = (0..side - 1).flat_map(|j| (0..side - 1).map(move |i| (i, j)));
        // The diagonal runs from south-west to north-east, as it is drawn.
        let triangles = cells.flat_map(|(i, j)| {
            let [sw, se, ne, nw] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[sw, se, ne], [sw, ne, nw]]
        });
        let skirt_m = Some([f64::from(tile.skirt_m); 2]);
        let triangles = triangles.collect();
        let axes = vertices.iter().map(|vertex| frame.axes(vertex)).collect();
        Some(Self { is_samples: true, ..Self::new(frame, vertices, axes, triangles, skirt_m)? })
    }

    /// Returns the surface of the meshes of a content; `None` if there are none, or too large ones.
    pub fn of_meshes(node: &Node, set_from_node: &DAffine3, frame: MapFrame) -> Option<Self> {
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for (drawable, set_from_drawable) in drawables(node, set_from_node) {
            let Geometry::Mesh(mesh) = &drawable.geometry else { continue };
            if mesh.topology != Topology::Triangles {
                continue;
            }
            if triangles.len() + mesh.indices.len() / 3 > MAX_TRIANGLES
                || vertices.len() + mesh.vertices.len() > MAX_TRIANGLES
            {
                return None;
            }
            let first = vertices.len() as u32;
            vertices.extend(mesh.vertices.iter().map(|vertex| {
                let position = Vec3::from_array(vertex.position).as_dvec3();
                frame.place(set_from_drawable.transform_point3(position))
            }));
            let is_known = |t: &&[u32]| t.iter().all(|i| (*i as usize) < mesh.vertices.len());
            let known = mesh.indices.chunks_exact(3).filter(is_known);
            triangles.extend(known.map(|t| [first + t[0], first + t[1], first + t[2]]));
        }
        if vertices.iter().any(|vertex: &Place| !vertex.position.is_finite()) {
            return None;
        }
        unwrap(frame, &mut vertices);
        let axes: Vec<[DVec3; 3]> = vertices.iter().map(|vertex| frame.axes(vertex)).collect();
        // Without its skirts the ground has one height at a place. Upright sides of other models are walls.
        let skirts = Skirts::find(&vertices, &triangles, frame).filter(|skirts| {
            let ground: Vec<[u32; 3]> = triangles.iter().copied().filter(|t| !skirts.is_skirt(*t)).collect();
            !ground.is_empty() && is_height_field(&vertices, &axes, &ground)
        });
        let kept: Vec<[u32; 3]> = match &skirts {
            Some(skirts) => triangles.into_iter().filter(|t| !skirts.is_skirt(*t)).collect(),
            None => triangles,
        };
        // Vertices that no triangle of the ground has are left out.
        let mut numbers = vec![u32::MAX; vertices.len()];
        let (mut ground, mut ground_axes) = (Vec::new(), Vec::new());
        let mut number_of = |i: u32| {
            let number = &mut numbers[i as usize];
            if *number == u32::MAX {
                *number = ground.len() as u32;
                ground.push(vertices[i as usize]);
                ground_axes.push(axes[i as usize]);
            }
            *number
        };
        let kept: Vec<[u32; 3]> = kept.into_iter().map(|t| t.map(&mut number_of)).collect();
        Self::new(frame, ground, ground_axes, kept, skirts.map(|skirts| skirts.depth_m))
    }

    fn new(
        frame: MapFrame,
        mut vertices: Vec<Place>,
        axes: Vec<[DVec3; 3]>,
        triangles: Vec<[u32; 3]>,
        skirt_m: Option<[f64; 2]>,
    ) -> Option<Self> {
        if triangles.is_empty() {
            return None;
        }
        let mut rectangle = rectangle_of(frame, &vertices);
        // Western edges at the antimeridian are at -pi, so that neighbours find each other.
        if frame.is_globe() {
            let west = wrapped(rectangle[0]);
            let shift = west - rectangle[0];
            (rectangle[0], rectangle[2]) = (west, rectangle[2] + shift);
            vertices.iter_mut().for_each(|vertex| vertex.at[0] += shift);
        }
        let profiles = profiles(frame, &vertices, &triangles, rectangle);
        let is_height_field = is_height_field(&vertices, &axes, &triangles);
        let grid = Grid::new(frame, &vertices, &triangles, rectangle);
        let is_samples = false;
        Some(Self { frame, vertices, axes, triangles, rectangle, skirt_m, profiles, is_height_field, is_samples, grid })
    }

    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// Returns the lowest and the highest height, metres.
    pub fn heights_m(&self) -> [f64; 2] {
        let heights = self.vertices.iter().map(|vertex| vertex.height_m);
        heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], h| [low.min(h), high.max(h)])
    }

    /// Returns a place with the longitude that this surface has there.
    fn own_at(&self, place: &Place) -> [f64; 2] {
        let [west, _, east, _] = self.rectangle;
        [self.frame.near(place.at[0], 0.5 * (west + east)), place.at[1]]
    }

    /// Returns true if the rectangle of the surface contains a place.
    pub fn contains(&self, place: &Place) -> bool {
        let [west, south, east, north] = self.rectangle;
        (south..=north).contains(&place.at[1]) && (west..=east).contains(&self.own_at(place)[0])
    }

    /// Returns the vertical distance of a point from the triangle below or above it, metres. `axes` are those of its place.
    /// `None` beside the triangles.
    pub fn vertical_distance_m(&self, place: &Place, axes: &[DVec3; 3]) -> Option<f64> {
        let [east, north, up] = axes;
        let mut best: Option<(f64, f64)> = None;
        for triangle in self.grid.at(self.own_at(place)) {
            let corners =
                self.triangles[triangle as usize].map(|i| self.vertices[i as usize].position - place.position);
            let flat = corners.map(|c| [c.dot(*east), c.dot(*north)]);
            let cross = |a: [f64; 2], b: [f64; 2]| a[0] * b[1] - a[1] * b[0];
            let parts = [cross(flat[1], flat[2]), cross(flat[2], flat[0]), cross(flat[0], flat[1])];
            let area: f64 = parts.iter().sum();
            if area.abs() < 1e-12 {
                continue;
            }
            let shares = parts.map(|part| part / area);
            let inside = shares.iter().copied().fold(f64::INFINITY, f64::min);
            if inside >= MIN_INSIDE && best.is_none_or(|(known, _)| inside > known) {
                let above_m: f64 = shares.iter().zip(&corners).map(|(share, corner)| share * corner.dot(*up)).sum();
                best = Some((inside, above_m.abs()));
            }
        }
        best.map(|(_, distance_m)| distance_m)
    }

    /// Returns the distance of a point from the nearest triangle, metres.
    pub fn distance_m(&self, place: &Place) -> Option<f64> {
        let mut best_m = f64::INFINITY;
        self.grid.around(self.own_at(place), |triangles, beyond_m| {
            if beyond_m >= best_m {
                return false;
            }
            for triangle in triangles {
                let corners =
                    self.triangles[*triangle as usize].map(|i| self.vertices[i as usize].position - place.position);
                best_m = best_m.min(nearest_to_origin(corners).length());
            }
            true
        });
        best_m.is_finite().then_some(best_m)
    }
}

/// Returns the drawables of a content with their transforms. Tiles in it are other contents.
pub(super) fn drawables<'a>(node: &'a Node, set_from_node: &DAffine3) -> Vec<(&'a Drawable, DAffine3)> {
    let (mut found, mut nodes) = (Vec::new(), vec![(node, *set_from_node)]);
    while let Some((node, set_from_node)) = nodes.pop() {
        let below = match &node.kind {
            NodeKind::Transform(map) => set_from_node * *map,
            NodeKind::Geode(list) => {
                found.extend(list.iter().map(|drawable| (drawable, set_from_node)));
                set_from_node
            }
            NodeKind::PagedLod(_) | NodeKind::MultiContentTile(_) | NodeKind::ProxyNode(_) => continue,
            // Billboards turn to the eye, and other frames move with it.
            NodeKind::Billboard(_) | NodeKind::AbsoluteTransform(_) | NodeKind::Camera(_) => continue,
            _ => set_from_node,
        };
        nodes.extend(node.children.iter().rev().map(|child| (child, below)));
    }
    found
}

/// Makes the longitudes of a mesh continuous across the antimeridian.
fn unwrap(frame: MapFrame, vertices: &mut [Place]) {
    if frame == MapFrame::Local {
        return;
    }
    let middle: DVec3 = vertices.iter().map(|vertex| vertex.position).sum();
    let longitude = middle.y.atan2(middle.x);
    for vertex in vertices {
        vertex.at[0] = if frame.is_pole(vertex.at[1]) { longitude } else { frame.near(vertex.at[0], longitude) };
    }
}

/// Returns a longitude from -pi to just below pi.
pub(super) fn wrapped(longitude: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let slack = 1e-9;
    (longitude + PI + slack).rem_euclid(TAU) - PI - slack
}

fn rectangle_of(frame: MapFrame, vertices: &[Place]) -> [f64; 4] {
    let mut rectangle = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for Place { at: [x, y], .. } in vertices {
        let [west, south, east, north] = rectangle;
        // The longitude of a pole says nothing.
        rectangle = match frame.is_pole(*y) {
            true => [west, south.min(*y), east, north.max(*y)],
            false => [west.min(*x), south.min(*y), east.max(*x), north.max(*y)],
        };
    }
    rectangle
}

/// Returns the heights along each edge of a rectangle.
fn profiles(
    frame: MapFrame,
    vertices: &[Place],
    triangles: &[[u32; 3]],
    [west, south, east, north]: [f64; 4],
) -> [Profile; 4] {
    let near = EDGE_SHARE * (east - west).max(north - south);
    let is_near = |value: f64, edge: f64| (value - edge).abs() <= near;
    // A bit for each edge that a vertex lies on, and the sides of triangles along some edge.
    let edges_of: Vec<u8> = vertices
        .iter()
        .map(|Place { at: [x, y], .. }| {
            let edges = [is_near(*x, west), is_near(*y, south), is_near(*x, east), is_near(*y, north)];
            edges.into_iter().zip(0..).map(|(is_on, bit)| u8::from(is_on) << bit).sum()
        })
        .collect();
    let common = |a: u32, b: u32| edges_of[a as usize] & edges_of[b as usize];
    let sides = triangles.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]);
    let sides: Vec<[u32; 2]> = sides.filter(|[a, b]| common(*a, *b) != 0).collect();
    let on = |of: fn([f64; 2]) -> [f64; 2], side: usize| {
        let on_edge = vertices.iter().zip(&edges_of).filter(|(_, edges)| **edges >> side & 1 == 1);
        let mut points: Vec<[f64; 2]> = on_edge.map(|(vertex, _)| [of(vertex.at)[1], vertex.height_m]).collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        points.dedup();
        let along = sides.iter().filter(|[a, b]| common(*a, *b) >> side & 1 == 1);
        let ends = along.map(|ends| ends.map(|i| of(vertices[i as usize].at)[1]));
        let mut parts: Vec<[f64; 2]> = ends.map(|[from, to]| [from.min(to), from.max(to)]).collect();
        parts.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut covered: Vec<[f64; 2]> = Vec::new();
        for [from, to] in parts {
            match covered.last_mut() {
                Some(last) if from <= last[1] + 1e-2 * near => last[1] = last[1].max(to),
                _ => covered.push([from, to]),
            }
        }
        Profile { points, covered }
    };
    let across = |edge: f64, side: usize| match frame.is_pole(edge) {
        true => Profile::default(),
        false => on(|[x, y]| [y, x], side),
    };
    [on(|at| at, WEST), across(south, SOUTH), on(|at| at, EAST), across(north, NORTH)]
}

/// Returns true if a mesh has one height at a place: nearly no area faces down or is upright.
fn is_height_field(vertices: &[Place], axes: &[[DVec3; 3]], triangles: &[[u32; 3]]) -> bool {
    let (mut all, mut down) = (0.0, 0.0);
    for triangle in triangles {
        let [a, b, c] = triangle.map(|i| &vertices[i as usize]);
        let normal = (b.position - a.position).cross(c.position - a.position);
        let [_, _, up] = axes[triangle[0] as usize];
        let area = normal.length();
        all += area;
        if normal.dot(up) < 1e-3 * area {
            down += area;
        }
    }
    down <= MAX_SHARE_DOWN * all
}

/// The skirts of a mesh: upright triangles on the edges of its rectangle.
struct Skirts {
    /// The lower ends, by the number of the vertex.
    is_bottom: Vec<bool>,
    depth_m: [f64; 2],
}

impl Skirts {
    fn find(vertices: &[Place], triangles: &[[u32; 3]], frame: MapFrame) -> Option<Self> {
        let [west, south, east, north] = rectangle_of(frame, vertices);
        let size = (east - west).max(north - south);
        let (near, above) = (EDGE_SHARE * size, ABOVE_SHARE * size);
        // Vertices that differ by less are rounded.
        let min_depth_m = 0.02 + 1e-6 * size * frame.metres(0.0)[1];
        let is_on_edge = |[x, y]: [f64; 2]| [x - west, east - x, y - south, north - y].iter().any(|d| d.abs() <= near);
        let mut skirts = Self { is_bottom: vec![false; vertices.len()], depth_m: [f64::INFINITY, 0.0] };
        for t in triangles {
            for (i, j) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let [a, b] = [i, j].map(|i| &vertices[i as usize]);
                let is_above = (a.at[0] - b.at[0]).abs() <= above && (a.at[1] - b.at[1]).abs() <= above;
                let depth_m = (a.height_m - b.height_m).abs();
                if is_above && depth_m > min_depth_m && t.iter().all(|i| is_on_edge(vertices[*i as usize].at)) {
                    skirts.is_bottom[if a.height_m < b.height_m { i } else { j } as usize] = true;
                    skirts.depth_m = [skirts.depth_m[0].min(depth_m), skirts.depth_m[1].max(depth_m)];
                }
            }
        }
        (skirts.depth_m[1] > 0.0).then_some(skirts)
    }

    fn is_skirt(&self, triangle: [u32; 3]) -> bool {
        triangle.iter().any(|i| self.is_bottom[*i as usize])
    }
}

/// Returns the point of a triangle that is nearest to the origin (Ericson, Real-Time Collision Detection, 5.1.5).
fn nearest_to_origin([a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (-ab.dot(a), -ac.dot(a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let (d3, d4) = (-ab.dot(b), -ac.dot(b));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let (d5, d6) = (-ab.dot(c), -ac.dot(c));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    // A triangle without area has no such point, or one of the edges above has it.
    if sum == 0.0 { a } else { a + ab * (vb / sum) + ac * (vc / sum) }
}
