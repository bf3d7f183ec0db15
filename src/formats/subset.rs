//! [`Subset`]: a mesh of some of the primitives of another one, with their features.

use std::sync::Arc;

use glam::Vec3;

use crate::math::Aabb;
use crate::scene::{DrawableFeatures, Mesh, MeshVertex, Topology, VertexAttributes};

/// The offsets of the corners of a square in units of half a side. Corners 0, 1, 2 and 2, 1, 3 are its triangles.
const CORNERS: [[f32; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]];

/// Some of the primitives of a mesh.
pub(super) struct Subset<'a> {
    of: &'a Mesh,
    /// By vertex: the number of the vertex in the other mesh.
    vertices: Vec<u32>,
    indices: Arc<[u32]>,
    topology: Topology,
}

impl<'a> Subset<'a> {
    /// Finds the vertices of primitives. `indices` are some of those of the mesh.
    pub fn new(of: &'a Mesh, indices: &[u32]) -> Self {
        let mut numbers = vec![u32::MAX; of.vertices.len()];
        for index in indices {
            if let Some(number) = numbers.get_mut(*index as usize) {
                *number = 0;
            }
        }
        let vertices: Vec<u32> = (0..).zip(&numbers).filter(|(_, n)| **n == 0).map(|(vertex, _)| vertex).collect();
        for (new, old) in (0..).zip(&vertices) {
            numbers[*old as usize] = new;
        }
        let indices = indices.iter().filter_map(|index| numbers.get(*index as usize).copied()).collect();
        Self { of, vertices, indices, topology: of.topology }
    }

    /// Makes lines between vertices of the mesh, two indices each.
    pub fn lines(of: &'a Mesh, indices: &[u32]) -> Self {
        Self { topology: Topology::Lines, ..Self::new(of, indices) }
    }

    /// Makes squares of points, each with four vertices. [`Self::mesh`] must set their sizes.
    pub fn squares(of: &'a Mesh, points: &[u32]) -> Self {
        let known = points.iter().filter(|point| (**point as usize) < of.vertices.len());
        let vertices: Vec<u32> = known.flat_map(|point| [*point; 4]).collect();
        let square = |first: u32| [0, 1, 2, 2, 1, 3].map(|corner| first + corner);
        let indices = (0..vertices.len() as u32).step_by(4).flat_map(square).collect();
        Self { of, vertices, indices, topology: Topology::Squares }
    }

    /// Returns the mesh. `change` may change each vertex, whose number in the other mesh it gets; for squares, its texture
    /// coordinates are the direction of the corner.
    pub fn mesh(&self, change: impl Fn(u32, &mut MeshVertex)) -> Mesh {
        let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let vertex = |(i, number): (usize, &u32)| {
            let mut vertex = self.of.vertices[*number as usize];
            if self.topology == Topology::Squares {
                vertex.uv = CORNERS[i % CORNERS.len()];
            }
            let position = Vec3::from_array(vertex.position);
            (min, max) = (min.min(position), max.max(position));
            change(*number, &mut vertex);
            vertex
        };
        let vertices: Vec<MeshVertex> = self.vertices.iter().enumerate().map(vertex).collect();
        let bounds = match vertices.is_empty() {
            true => Aabb::EMPTY,
            false => Aabb { min: min.as_dvec3(), max: max.as_dvec3() },
        };
        let attributes = self.attributes();
        Mesh { vertices, indices: self.indices.clone(), topology: self.topology, bounds, attributes }
    }

    fn attributes(&self) -> VertexAttributes {
        let mut attributes = VertexAttributes::default();
        for (name, format, bytes) in self.of.attributes.iter() {
            let size = format.size_bytes();
            let element = |number: &u32| &bytes[*number as usize * size..][..size];
            let elements: Vec<u8> = self.vertices.iter().flat_map(element).copied().collect();
            let added = attributes.push(self.vertices.len(), name, format, elements.into());
            added.expect("the other mesh has the same attributes");
        }
        attributes
    }

    /// Returns the features with the ids of the vertices that are left.
    pub fn features(&self, features: &DrawableFeatures) -> DrawableFeatures {
        features.with_vertices(&self.vertices)
    }
}
