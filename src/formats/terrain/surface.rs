//! [`Surface`]: the triangles of a terrain tile over the unit square, and parts of them. Plain values; decode threads.

use std::collections::HashMap;

use glam::Vec3;

/// A vertex of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SurfaceVertex {
    /// The share of the tile's width, from the west.
    pub u: f64,
    /// The share of the tile's height, from the south.
    pub v: f64,
    /// The height above the ellipsoid, metres.
    pub height_m: f64,
    /// The unit normal in the earth's frame, if the surface has normals.
    pub normal: Vec3,
}

/// The origin of the normals of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Normals {
    /// They follow from the triangles.
    Computed,
    /// Each vertex has its own.
    Given,
    /// They are those of the ellipsoid.
    OfEllipsoid,
}

/// The triangles of a tile.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    pub vertices: Vec<SurfaceVertex>,
    /// Three indices a triangle, counter-clockwise from above.
    pub triangles: Vec<[u32; 3]>,
    /// The vertices of the western, southern, eastern and northern edge, in any order.
    pub edges: [Vec<u32>; 4],
    pub normals: Normals,
}

/// A line that a surface is cut along: the side where `sign * (coordinate - at)` is positive stays.
#[derive(Clone, Copy)]
struct Cut {
    is_v: bool,
    at: f64,
    sign: f64,
}

impl Cut {
    fn coordinate(self, vertex: &SurfaceVertex) -> f64 {
        if self.is_v { vertex.v } else { vertex.u }
    }

    /// Returns how far a vertex is on the side that stays.
    fn inside(self, vertex: &SurfaceVertex) -> f64 {
        self.sign * (self.coordinate(vertex) - self.at)
    }

    /// Returns the point of an edge that lies on the line. It does not depend on the direction of the edge, so that all
    /// triangles and both sides of the line have the same point.
    fn crossing(self, a: &SurfaceVertex, b: &SurfaceVertex) -> SurfaceVertex {
        let key = |vertex: &SurfaceVertex| [vertex.u, vertex.v, vertex.height_m];
        let (a, b) = if key(a) <= key(b) { (a, b) } else { (b, a) };
        let (from, to) = (self.coordinate(a), self.coordinate(b));
        let t = ((self.at - from) / (to - from)).clamp(0.0, 1.0);
        let mix = |a: f64, b: f64| a + (b - a) * t;
        let mut point = SurfaceVertex {
            u: mix(a.u, b.u),
            v: mix(a.v, b.v),
            height_m: mix(a.height_m, b.height_m),
            normal: a.normal.lerp(b.normal, t as f32).normalize_or_zero(),
        };
        *if self.is_v { &mut point.v } else { &mut point.u } = self.at;
        point
    }

    /// Stores the part of a convex polygon that stays; nothing if only an edge or a corner does.
    fn clip(self, polygon: &[SurfaceVertex], kept: &mut Vec<SurfaceVertex>) {
        kept.clear();
        for (i, a) in polygon.iter().enumerate() {
            let b = &polygon[(i + 1) % polygon.len()];
            let (at_a, at_b) = (self.inside(a), self.inside(b));
            if at_a >= 0.0 {
                kept.push(*a);
            }
            if at_a * at_b < 0.0 {
                kept.push(self.crossing(a, b));
            }
        }
        if !kept.iter().any(|vertex| self.inside(vertex) > 0.0) {
            kept.clear();
        }
    }
}

impl Surface {
    /// Returns a part of the ellipsoid as a grid. The arguments are the numbers of cells along its width and height.
    pub fn of_ellipsoid([width, height]: [u32; 2]) -> Self {
        let side = width + 1;
        let share = |i: u32, of: u32| f64::from(i) / f64::from(of);
        let grid = (0..=height).flat_map(|j| (0..=width).map(move |i| (share(i, width), share(j, height))));
        let vertices = grid.map(|(u, v)| SurfaceVertex { u, v, height_m: 0.0, normal: Vec3::ZERO });
        let cells = (0..height).flat_map(|j| (0..width).map(move |i| j * side + i));
        let triangles = cells.flat_map(|c| [[c, c + 1, c + side + 1], [c, c + side + 1, c + side]]).collect();
        let mut surface =
            Self { vertices: vertices.collect(), triangles, edges: Default::default(), normals: Normals::OfEllipsoid };
        surface.find_edges();
        surface
    }

    /// Returns the lowest and the highest height, metres.
    pub fn heights_m(&self) -> [f64; 2] {
        let heights = self.vertices.iter().map(|vertex| vertex.height_m);
        heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], h| [low.min(h), high.max(h)])
    }

    /// Returns the part between two shares of the width and two of the height, stretched to the unit square; `None` if there
    /// are no triangles. Parts beside each other have the same vertices on their common edge.
    pub fn part(&self, [west, south, east, north]: [f64; 4]) -> Option<Self> {
        let cut = |is_v: bool, at: f64, sign: f64| Cut { is_v, at, sign };
        let cuts = [cut(false, west, 1.0), cut(true, south, 1.0), cut(false, east, -1.0), cut(true, north, -1.0)];
        let mut part =
            Self { vertices: Vec::new(), triangles: Vec::new(), edges: Default::default(), normals: self.normals };
        let mut known: HashMap<[u64; 3], u32> = HashMap::new();
        let (mut polygon, mut clipped) = (Vec::new(), Vec::new());
        for triangle in &self.triangles {
            polygon.clear();
            polygon.extend(triangle.map(|i| self.vertices[i as usize]));
            for cut in cuts {
                cut.clip(&polygon, &mut clipped);
                std::mem::swap(&mut polygon, &mut clipped);
            }
            let corners: Vec<u32> = polygon
                .iter()
                .map(|vertex| {
                    let (u, v) = ((vertex.u - west) / (east - west), (vertex.v - south) / (north - south));
                    *known.entry([u, v, vertex.height_m].map(f64::to_bits)).or_insert_with(|| {
                        part.vertices.push(SurfaceVertex { u, v, ..*vertex });
                        part.vertices.len() as u32 - 1
                    })
                })
                .collect();
            part.triangles.extend((2..corners.len()).map(|last| [corners[0], corners[last - 1], corners[last]]));
        }
        part.find_edges();
        (!part.triangles.is_empty()).then_some(part)
    }

    /// Collects the vertices on the edges of the unit square.
    fn find_edges(&mut self) {
        let on = |is_on: fn(&SurfaceVertex) -> bool| {
            let vertices = self.vertices.iter().enumerate();
            vertices.filter(|(_, vertex)| is_on(vertex)).map(|(i, _)| i as u32).collect()
        };
        self.edges = [on(|p| p.u == 0.0), on(|p| p.v == 0.0), on(|p| p.u == 1.0), on(|p| p.v == 1.0)];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A fan around a point beside the middle.
    fn fan() -> Surface {
        let at = |u: f64, v: f64, height_m: f64| SurfaceVertex { u, v, height_m, normal: Vec3::Z };
        let mut surface = Surface {
            vertices: vec![
                at(0.0, 0.0, 10.0),
                at(1.0, 0.0, 20.0),
                at(1.0, 1.0, 30.0),
                at(0.0, 1.0, 40.0),
                at(0.375, 0.625, 100.0),
            ],
            triangles: vec![[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
            edges: Default::default(),
            normals: Normals::Given,
        };
        surface.find_edges();
        surface
    }

    fn area(surface: &Surface) -> f64 {
        let areas = surface.triangles.iter().map(|triangle| {
            let [a, b, c] = triangle.map(|i| surface.vertices[i as usize]);
            let twice = (b.u - a.u) * (c.v - a.v) - (c.u - a.u) * (b.v - a.v);
            assert!(twice >= 0.0, "a triangle is turned over");
            0.5 * twice
        });
        areas.sum()
    }

    /// Returns the points of an edge: the coordinate along it, and the height.
    fn edge(surface: &Surface, edge: usize) -> Vec<[f64; 2]> {
        let vertices = surface.edges[edge].iter().map(|i| surface.vertices[*i as usize]);
        let mut points: Vec<_> =
            vertices.map(|p| [if edge.is_multiple_of(2) { p.v } else { p.u }, p.height_m]).collect();
        points.sort_by(|a, b| a.partial_cmp(b).unwrap());
        points
    }

    #[test]
    fn quarters_cover_a_tile_and_share_their_edges() {
        let whole = fan();
        let quarter = |x: f64, y: f64| whole.part([0.5 * x, 0.5 * y, 0.5 * x + 0.5, 0.5 * y + 0.5]).unwrap();
        let [sw, se, nw, ne] = [quarter(0.0, 0.0), quarter(1.0, 0.0), quarter(0.0, 1.0), quarter(1.0, 1.0)];
        for part in [&sw, &se, &nw, &ne] {
            assert!((area(part) - 1.0).abs() < 1e-12, "{}", area(part));
            for points in (0..4).map(|i| edge(part, i)) {
                assert!(points.first().is_some_and(|p| p[0] == 0.0) && points.last().is_some_and(|p| p[0] == 1.0));
            }
        }
        for (a, b) in [
            (edge(&sw, 2), edge(&se, 0)),
            (edge(&nw, 2), edge(&ne, 0)),
            (edge(&sw, 3), edge(&nw, 1)),
            (edge(&se, 3), edge(&ne, 1)),
        ] {
            assert_eq!(a.len(), b.len(), "{a:?} {b:?}");
            let is_equal = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).abs() < 1e-12 && (a[1] - b[1]).abs() < 1e-9;
            assert!(a.iter().zip(&b).all(is_equal), "{a:?} {b:?}");
        }
        assert_eq!(sw.heights_m()[0], 10.0);
        assert!(nw.vertices.iter().any(|p| p.height_m == 100.0 && p.u == 0.75 && p.v == 0.25));
    }

    #[test]
    fn deep_parts_are_whole_and_empty_ones_are_none() {
        let whole = fan();
        let side = 2f64.powi(-12);
        let part = whole.part([0.3, 0.4, 0.3 + side, 0.4 + side]).unwrap();
        assert!((area(&part) - 1.0).abs() < 1e-9);
        assert!(Surface { triangles: vec![[0, 1, 4]], ..whole }.part([0.0, 0.9, 0.1, 1.0]).is_none());
    }

    #[test]
    fn ellipsoid_is_a_whole_grid() {
        let grid = Surface::of_ellipsoid([4, 2]);
        assert_eq!((grid.vertices.len(), grid.triangles.len()), (15, 16));
        assert!((area(&grid) - 1.0).abs() < 1e-12 && grid.edges.iter().map(Vec::len).eq([3, 5, 3, 5]));
    }
}
