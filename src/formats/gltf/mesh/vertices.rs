//! [`Vertices`]: the vertices of a primitive, assembled from its attributes.

use glam::Vec3;
use gltf::accessor::Dimensions;
use gltf::mesh::Semantic;

use super::deform::{Deformation, Deformed};
use super::primitive::PrimitiveData;
use crate::fetch::IoError;
use crate::formats::gltf::context::Context;
use crate::formats::gltf::materials::TextureRef;
use crate::math::Aabb;
use crate::scene::{MeshVertex, VertexFormat};

/// Assembled vertices.
pub(super) struct Vertices {
    pub list: Vec<MeshVertex>,
    /// The box around the positions.
    pub bounds: Aabb,
    /// The smallest format that holds the vertices.
    pub format: VertexFormat,
    pub has_normals: bool,
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
            false => data.attribute(&Semantic::Normals, &[Dimensions::Vec3])?,
        };
        let uv_set = texture.map_or(0, |texture| texture.uv_set);
        let uvs = data.attribute(&Semantic::TexCoords(uv_set), &[Dimensions::Vec2])?;
        let colors = data.attribute(&Semantic::Colors(0), &[Dimensions::Vec3, Dimensions::Vec4])?;
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
        if !is_finite {
            let first = list.iter().position(|vertex| !Vec3::from_array(vertex.position).is_finite());
            return Err(context.bad(format_args!("position {} is not finite", first.unwrap_or_default())));
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
        if let Some(colors) = &colors {
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
        Ok(Some(Self { list, bounds, format, has_normals: normals.is_some() }))
    }
}

/// Converts to 8 bits, rounded to nearest: between 2^23 and 2^24 the lowest bit of an f32 is 1.
fn snorm8(x: f32) -> i8 {
    (x.clamp(-1.0, 1.0) * 127.0 + 12_582_912.0).to_bits() as i8
}
