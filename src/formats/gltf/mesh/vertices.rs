//! [`Vertices`]: the vertices of a primitive, assembled from its attributes.

use std::sync::Arc;

use glam::Vec3;
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::Semantic;

use super::deform::{Deformation, Deformed};
use super::primitive::PrimitiveData;
use crate::fetch::IoError;
use crate::formats::gltf::context::Context;
use crate::formats::gltf::materials::TextureRef;
use crate::math::Aabb;
use crate::scene::{MeshVertex, Topology, VertexFormat};

/// Assembled vertices.
pub(super) struct Vertices {
    pub list: Vec<MeshVertex>,
    /// The box around the positions.
    pub bounds: Aabb,
    /// The smallest format that holds the vertices.
    pub format: VertexFormat,
    pub has_normals: bool,
    /// The vertices whose positions are not finite, by number; empty if there are none.
    invalid: Vec<bool>,
}

impl Vertices {
    /// Assembles the vertices with the texture coordinates of `texture`. Returns `None` if the positions are missing.
    pub fn new(
        context: &Context<'_>,
        data: &PrimitiveData<'_>,
        texture: Option<&TextureRef>,
        deformation: Deformation<'_>,
    ) -> Result<Option<Self>, IoError> {
        let Some(positions) = data.attribute(&Semantic::Positions, &[Dimensions::Vec3])? else { return Ok(None) };
        let normals = match data.has_odd_normals() {
            // Exporters of buildings write those of walls with two components, which mean nothing.
            true => {
                context.notes.add("glTF: normals that have not three components");
                None
            }
            false => data.optional(&Semantic::Normals, &[Dimensions::Vec3])?,
        };
        let uv_set = texture.map_or(0, |texture| texture.uv_set);
        let uvs = data.optional(&Semantic::TexCoords(uv_set), &[Dimensions::Vec2])?;
        let mut colors = data.optional(&Semantic::Colors(0), &[Dimensions::Vec3, Dimensions::Vec4])?;
        let (mut min, mut max, mut is_finite) = (Vec3::INFINITY, Vec3::NEG_INFINITY, true);
        let mut list = vec![MeshVertex { color: [255; 4], ..MeshVertex::default() }; data.count];
        let mut set_position = |vertex: &mut MeshVertex, position: [f32; 3]| {
            vertex.position = position;
            let p = Vec3::from_array(position);
            (min, max) = (min.min(p), max.max(p));
            is_finite &= p.is_finite();
        };
        let is_deformed = !deformation.is_none();
        if is_deformed {
            let deformed = Deformed::new(data, &positions, normals.as_ref(), deformation)?;
            for (vertex, position) in list.iter_mut().zip(&deformed.positions) {
                set_position(vertex, position.to_array());
            }
            for (vertex, normal) in list.iter_mut().zip(&deformed.normals) {
                let [x, y, z] = normal.normalize_or_zero().to_array().map(snorm8);
                vertex.normal = [x, y, z, 0];
            }
        } else {
            positions.read_into(&mut list, set_position);
            if let Some(normals) = &normals {
                normals.read_into(&mut list, |vertex, normal: [f32; 3]| {
                    let [x, y, z] = normal.map(snorm8);
                    vertex.normal = [x, y, z, 0];
                });
            }
        }
        let mut invalid = Vec::new();
        if !is_finite {
            invalid = list.iter().map(|vertex| !Vec3::from_array(vertex.position).is_finite()).collect();
            let first = invalid.iter().position(|is_invalid| !is_invalid);
            let first = first.ok_or_else(|| context.bad("no position is finite"))?;
            let position = list[first].position;
            (min, max) = (Vec3::from_array(position), Vec3::from_array(position));
            for (vertex, is_invalid) in list.iter_mut().zip(&invalid) {
                if *is_invalid {
                    vertex.position = position;
                }
                let p = Vec3::from_array(vertex.position);
                (min, max) = (min.min(p), max.max(p));
            }
        }
        if texture.is_some() && uvs.is_none() {
            context.notes.add("glTF: texture without its coordinates");
        }
        if let Some(uvs) = &uvs {
            uvs.read_into(&mut list, |vertex, uv| vertex.uv = uv);
            if let Some(texture) = texture.filter(|texture| texture.transform.is_some()) {
                let map = texture.affine();
                list.iter_mut().for_each(|vertex| vertex.uv = map.transform_point2(vertex.uv.into()).into());
            }
        }
        if let Some(colors) = &mut colors {
            // The specification has no other integers. Some writers forget to say so (py3dtiles).
            if !colors.normalized && matches!(colors.data_type, DataType::U8 | DataType::U16) {
                context.notes.add("glTF: colours of integers that are not normalized");
                colors.normalized = true;
            }
            for (i, vertex) in list.iter_mut().enumerate() {
                for k in 0..colors.components.min(4) {
                    vertex.color[k] = (colors.value(i, k).clamp(0.0, 1.0) * 255.0).round() as u8;
                }
            }
        }
        let format = match list.iter().all(MeshVertex::packs) {
            true if positions.is_unorm16() && !is_deformed => VertexFormat::Quantized,
            true => VertexFormat::Packed,
            false => VertexFormat::Full,
        };
        let bounds = match list.is_empty() {
            true => Aabb::EMPTY,
            false => Aabb { min: min.as_dvec3(), max: max.as_dvec3() },
        };
        Ok(Some(Self { list, bounds, format, has_normals: normals.is_some(), invalid }))
    }

    /// Returns false if a position is not finite.
    pub fn are_finite(&self) -> bool {
        self.invalid.is_empty()
    }

    /// Leaves out the primitives of a list that have a vertex whose position is not finite, and notes them.
    pub fn finite(
        &self,
        context: &Context<'_>,
        topology: Topology,
        indices: Arc<[u32]>,
    ) -> Result<Arc<[u32]>, IoError> {
        if self.are_finite() {
            return Ok(indices);
        }
        let size = match topology {
            Topology::Points => 1,
            Topology::Lines => 2,
            Topology::Triangles => 3,
            Topology::Squares => 6,
        };
        let is_invalid = |index: &u32| self.invalid.get(*index as usize).is_none_or(|is_invalid| *is_invalid);
        let is_finite = |primitive: &&[u32]| !primitive.iter().any(is_invalid);
        let finite: Arc<[u32]> = indices.chunks_exact(size).filter(is_finite).flatten().copied().collect();
        if finite.is_empty() {
            return Err(context.bad("no primitive has finite positions"));
        }
        let left_out = (indices.len() - finite.len()) / size;
        context.notes.add_count("glTF: triangle, line or point whose positions are not finite", left_out as u64);
        Ok(finite)
    }
}

/// Converts to 8 bits, rounded to nearest: between 2^23 and 2^24 the lowest bit of an f32 is 1.
fn snorm8(x: f32) -> i8 {
    (x.clamp(-1.0, 1.0) * 127.0 + 12_582_912.0).to_bits() as i8
}
