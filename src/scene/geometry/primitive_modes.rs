//! Conversion of strips, loops, fans and quads to lists of points, lines or triangles. Any thread; used by applications and
//! file readers.

use std::sync::Arc;

use super::mesh::{Mesh, MeshVertex, Topology};
use crate::scene::error::MeshError;

/// How consecutive vertices form primitives; OSG's `PrimitiveSet::Mode`, glTF's `mode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PrimitiveMode {
    /// Each vertex is a point.
    Points,
    /// Every two vertices are a line.
    Lines,
    /// Lines from each vertex to the next.
    LineStrip,
    /// A `LineStrip` that is closed by a line from the last vertex to the first.
    LineLoop,
    /// Every three vertices are a triangle, counter-clockwise front, as in all modes below.
    Triangles,
    /// Each vertex with the two before it, every second triangle reversed.
    TriangleStrip,
    /// Each vertex with the one before it and the first.
    TriangleFan,
    /// Every four vertices surround a convex area.
    Quads,
    /// Every two vertices with the two before them.
    QuadStrip,
    /// All vertices surround one convex area.
    Polygon,
}

impl PrimitiveMode {
    /// Returns the maximum number of indices that [`Self::assemble`] allocates for `count`; 0 if it uses the list unchanged.
    pub(crate) fn assembled(self, count: usize) -> usize {
        match self {
            Self::Points => 0,
            Self::Lines if count.is_multiple_of(2) => 0,
            Self::Triangles if count.is_multiple_of(3) => 0,
            Self::Lines | Self::Triangles => count,
            Self::LineStrip | Self::LineLoop | Self::Quads => count.saturating_mul(2),
            Self::TriangleStrip | Self::TriangleFan | Self::QuadStrip | Self::Polygon => count.saturating_mul(3),
        }
    }

    /// Converts indices to a list of points, lines or triangles. Incomplete primitives are dropped, and so are degenerate
    /// triangles of strips, fans and quads, which join strips.
    pub(crate) fn assemble(self, i: Arc<[u32]>) -> (Topology, Arc<[u32]>) {
        let whole = |n: usize| -> Arc<[u32]> {
            if i.len().is_multiple_of(n) { i.clone() } else { i[..i.len() - i.len() % n].into() }
        };
        let has_area = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
        match self {
            Self::Points => (Topology::Points, i.clone()),
            Self::Lines => (Topology::Lines, whole(2)),
            Self::LineStrip | Self::LineLoop => {
                let mut out: Vec<u32> = i.windows(2).flatten().copied().collect();
                if let (Self::LineLoop, [first, .., last]) = (self, &*i) {
                    out.extend([*last, *first]);
                }
                (Topology::Lines, out.into())
            }
            Self::Triangles => (Topology::Triangles, whole(3)),
            Self::TriangleStrip | Self::QuadStrip => {
                let whole = if self == Self::QuadStrip { &i[..i.len() & !1] } else { &i[..] };
                let turned = |(k, t): (usize, &[u32])| if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
                (Topology::Triangles, whole.windows(3).enumerate().map(turned).filter(has_area).flatten().collect())
            }
            Self::TriangleFan | Self::Polygon => {
                let fan = i.split_first().map_or(Vec::new(), |(first, around)| {
                    around.windows(2).map(|t| [*first, t[0], t[1]]).filter(has_area).flatten().collect()
                });
                (Topology::Triangles, fan.into())
            }
            Self::Quads => {
                let halves = |q: &[u32]| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]];
                (Topology::Triangles, i.chunks_exact(4).flat_map(halves).filter(has_area).flatten().collect())
            }
        }
    }
}

impl Mesh {
    /// Creates a mesh of all vertices in their order, with the box around them; OSG's `DrawArrays`.
    pub fn from_arrays(mode: PrimitiveMode, vertices: Vec<MeshVertex>) -> Self {
        let all = (0..=u32::MAX).zip(&vertices).map(|(index, _)| index).collect();
        Self::assembled(mode, vertices, all)
    }

    /// Creates a mesh of vertices in the order of 8, 16 or 32-bit indices, with the box around all vertices; OSG's
    /// `DrawElements`. There is no index that restarts a strip. Fails if an index is out of range.
    pub fn from_elements<I: Copy + Into<u32>>(
        mode: PrimitiveMode,
        vertices: Vec<MeshVertex>,
        indices: &[I],
    ) -> Result<Self, MeshError> {
        let indices: Arc<[u32]> = indices.iter().map(|index| (*index).into()).collect();
        match indices.iter().find(|index| **index as usize >= vertices.len()) {
            Some(&index) => Err(MeshError::IndexOutside { index, vertices: vertices.len() }),
            None => Ok(Self::assembled(mode, vertices, indices)),
        }
    }

    fn assembled(mode: PrimitiveMode, vertices: Vec<MeshVertex>, indices: Arc<[u32]>) -> Self {
        let (topology, indices) = mode.assemble(indices);
        Self { indices, ..Self::new(vertices, Vec::new(), topology) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mode_becomes_a_list() {
        use PrimitiveMode::*;
        // Seven vertices leave some over in every mode.
        let seven = |mode: PrimitiveMode| {
            let (topology, list) = mode.assemble((0..7).collect());
            assert!(list.len() <= mode.assembled(7).max(7), "{mode:?}");
            (topology, list.to_vec())
        };
        assert_eq!(seven(Points), (Topology::Points, vec![0, 1, 2, 3, 4, 5, 6]));
        assert_eq!(seven(Lines), (Topology::Lines, vec![0, 1, 2, 3, 4, 5]));
        assert_eq!(seven(LineStrip), (Topology::Lines, vec![0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6]));
        assert_eq!(seven(LineLoop), (Topology::Lines, vec![0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 0]));
        assert_eq!(seven(Triangles), (Topology::Triangles, vec![0, 1, 2, 3, 4, 5]));
        let strip = vec![0, 1, 2, 2, 1, 3, 2, 3, 4, 4, 3, 5, 4, 5, 6];
        assert_eq!(seven(QuadStrip), (Topology::Triangles, strip[..12].to_vec()));
        assert_eq!(seven(TriangleStrip), (Topology::Triangles, strip));
        let fan = vec![0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 5, 0, 5, 6];
        assert_eq!(seven(TriangleFan), (Topology::Triangles, fan.clone()));
        assert_eq!(seven(Polygon), (Topology::Triangles, fan));
        assert_eq!(seven(Quads), (Topology::Triangles, vec![0, 1, 2, 0, 2, 3]));
        for mode in [Lines, LineStrip, LineLoop, Triangles, TriangleStrip, TriangleFan, Quads, QuadStrip, Polygon] {
            assert!(mode.assemble([5].into()).1.is_empty(), "{mode:?}");
            assert!(mode.assemble([].into()).1.is_empty(), "{mode:?}");
        }
    }

    #[test]
    fn joined_strips_keep_their_front_sides() {
        let joined = [0, 1, 2, 3, 3, 4, 4, 5, 6, 7];
        let (_, list) = PrimitiveMode::TriangleStrip.assemble(joined.into());
        assert_eq!(*list, [0, 1, 2, 2, 1, 3, 4, 5, 6, 6, 5, 7]);
    }

    #[test]
    fn indices_of_each_width_are_checked() {
        let vertices = || -> Vec<MeshVertex> {
            (0..4u8).map(|i| MeshVertex { position: [f32::from(i), 1.0, -2.0], ..MeshVertex::default() }).collect()
        };
        let mode = PrimitiveMode::TriangleStrip;
        let arrays = Mesh::from_arrays(mode, vertices());
        assert_eq!((&*arrays.indices, arrays.bounds.max.x), (&[0, 1, 2, 2, 1, 3][..], 3.0));
        let of_8 = Mesh::from_elements(mode, vertices(), &[0u8, 1, 2, 3]);
        let of_16 = Mesh::from_elements(mode, vertices(), &[0u16, 1, 2, 3]);
        let of_32 = Mesh::from_elements(mode, vertices(), &[0u32, 1, 2, 3]);
        assert!([of_8, of_16, of_32].into_iter().all(|mesh| mesh.as_ref() == Ok(&arrays)));
        let error = Mesh::from_elements(mode, vertices(), &[0u8, 4]).unwrap_err();
        assert_eq!(error, MeshError::IndexOutside { index: 4, vertices: 4 });
    }
}
