//! [`MeshReader`]: meshes of a glTF as drawables.

use std::sync::Arc;

use glam::Vec3;
use gltf::accessor::Dimensions;
use gltf::mesh::{Mode, Semantic};

use super::budget::Budget;
use super::buffers::Buffers;
use super::elements::{Elements, attribute_format, columns_and_rows};
use super::indices::{IndexLists, list_key_of};
use super::textures::Textures;
use crate::fetch::IoError;
use crate::formats::options::ReadOptions;
use crate::math::Aabb;
use crate::scene::{
    AlphaMode, ContentKey, Drawable, Geometry, Material, Mesh, MeshVertex, Node, PrimitiveMode, SharedParts,
    VertexAttributes, VertexFormat,
};

/// Reads the meshes of one glTF.
pub(super) struct MeshReader<'a> {
    uri: &'a str,
    options: &'a ReadOptions,
    buffers: Buffers<'a>,
    budget: Budget<'a>,
    textures: Textures<'a>,
    index_lists: IndexLists<'a>,
}

impl<'a> MeshReader<'a> {
    pub fn new(uri: &'a str, options: &'a ReadOptions, buffers: Buffers<'a>) -> Self {
        let limits = &options.limits;
        Self {
            uri,
            options,
            buffers,
            budget: Budget::new(uri, limits),
            textures: Textures::new(uri, limits, options.sharing.as_deref()),
            index_lists: IndexLists::new(uri, limits),
        }
    }

    fn bad(&self, reason: impl Into<String>) -> IoError {
        IoError::invalid(self.uri, format!("glTF: {}", reason.into()))
    }

    /// Reads a mesh as one geode.
    pub fn mesh(&mut self, mesh: &gltf::Mesh<'_>) -> Result<Node, IoError> {
        self.budget.add_primitives(mesh.primitives().len())?;
        let mut drawables = Vec::with_capacity(mesh.primitives().len());
        for primitive in mesh.primitives() {
            drawables.push(self.primitive(&primitive)?);
        }
        Ok(Node::geode(drawables))
    }

    fn primitive(&mut self, primitive: &gltf::Primitive<'_>) -> Result<Drawable, IoError> {
        let positions = primitive.get(&Semantic::Positions).ok_or_else(|| self.bad("primitive without POSITION"))?;
        let count = positions.count();
        self.budget.add_vertices(count)?;
        let material = primitive.material();
        let pbr = material.pbr_metallic_roughness();
        let base_texture = pbr.base_color_texture();
        let uv_transform = base_texture.as_ref().and_then(|t| t.texture_transform());
        let uv_set = base_texture
            .as_ref()
            .map_or(0, |t| uv_transform.as_ref().and_then(|x| x.tex_coord()).unwrap_or_else(|| t.tex_coord()));
        let positions = self.buffers.elements(&positions, Dimensions::Vec3)?;
        let normals = self.attribute(primitive, &Semantic::Normals, count, &[Dimensions::Vec3])?;
        let uvs = self.attribute(primitive, &Semantic::TexCoords(uv_set), count, &[Dimensions::Vec2])?;
        let colors = self.attribute(primitive, &Semantic::Colors(0), count, &[Dimensions::Vec3, Dimensions::Vec4])?;
        let (mut min, mut max, mut is_finite) = (Vec3::INFINITY, Vec3::NEG_INFINITY, true);
        let mut vertices = vec![MeshVertex { color: [255; 4], ..MeshVertex::default() }; count];
        positions.read_into(&mut vertices, |vertex, position| {
            vertex.position = position;
            let p = Vec3::from_array(position);
            (min, max) = (min.min(p), max.max(p));
            is_finite &= p.is_finite();
        });
        if !is_finite {
            let first = vertices.iter().position(|vertex| !Vec3::from_array(vertex.position).is_finite());
            return Err(self.bad(format!("position {} is not finite", first.unwrap_or_default())));
        }
        if let Some(normals) = &normals {
            normals.read_into(&mut vertices, |vertex, normal: [f32; 3]| {
                let [x, y, z] = normal.map(snorm8);
                vertex.normal = [x, y, z, 0];
            });
        }
        if let Some(uvs) = &uvs {
            uvs.read_into(&mut vertices, |vertex, uv| vertex.uv = uv);
            if let Some(t) = &uv_transform {
                let ([sx, sy], [ox, oy], (sin, cos)) = (t.scale(), t.offset(), t.rotation().sin_cos());
                for MeshVertex { uv, .. } in &mut vertices {
                    let [u, v] = [uv[0] * sx, uv[1] * sy];
                    *uv = [u * cos + v * sin + ox, v * cos - u * sin + oy];
                }
            }
        }
        if let Some(c) = &colors {
            for (i, vertex) in vertices.iter_mut().enumerate() {
                for k in 0..c.components.min(4) {
                    vertex.color[k] = (c.value(i, k).clamp(0.0, 1.0) * 255.0).round() as u8;
                }
            }
        }
        let packs = vertices.iter().all(MeshVertex::packs);
        let format = match packs {
            true if positions.is_unorm16() => VertexFormat::Quantized,
            true => VertexFormat::Packed,
            false => VertexFormat::Full,
        };
        let attributes = self.additional_attributes(primitive, count)?;
        // Hashed here, while the vertices are in the CPU cache.
        let vertices_key = self.options.sharing.as_deref().map(|_| ContentKey::of_vertices(&vertices, &attributes));
        let (read, list_key) = match primitive.indices() {
            Some(accessor) => self
                .index_lists
                .get(&accessor, count, &self.buffers, &mut self.budget)
                .map(|(list, key)| (list.list, Some(key)))?,
            None => ((0..count as u32).collect(), None),
        };
        let mode = mode(primitive.mode());
        self.budget.add_indices(mode.assembled(read.len()))?;
        let (topology, indices) = mode.assemble(read.clone());
        let list_key = list_key.filter(|_| Arc::ptr_eq(&read, &indices));
        let bounds = if count == 0 { Aabb::EMPTY } else { Aabb { min: min.as_dvec3(), max: max.as_dvec3() } };
        let (texture, shared_texture) = match base_texture {
            Some(t) => self
                .textures
                .get(&t.texture(), &self.buffers, &mut self.budget)
                .map(|(image, shared)| (Some(image), shared))?,
            None => (None, None),
        };
        let material = Material {
            base_color: pbr.base_color_factor(),
            texture,
            alpha: match material.alpha_mode() {
                gltf::material::AlphaMode::Opaque => AlphaMode::Opaque,
                gltf::material::AlphaMode::Mask => AlphaMode::Mask(material.alpha_cutoff().unwrap_or(0.5)),
                gltf::material::AlphaMode::Blend => AlphaMode::Blend,
            },
            double_sided: material.double_sided(),
            unlit: material.unlit(),
        };
        let mut mesh = Arc::new(Mesh { vertices, indices, topology, bounds, attributes });
        let (geometry, indices) = match (self.options.sharing.as_deref(), vertices_key) {
            (Some(sharing), Some(vertices_key)) => {
                let list_key = list_key.unwrap_or_else(|| list_key_of(&mesh.indices));
                sharing.mesh(&mut mesh, &vertices_key, &list_key)
            }
            _ => (None, None),
        };
        let mut drawable = Drawable::new(Geometry::Mesh(mesh), material);
        drawable.shared = SharedParts { geometry, indices, texture: shared_texture };
        Ok(drawable.with_vertex_format(format))
    }

    /// Reads the additional attributes in the order of [`ReadOptions::vertex_attributes`]. Matrices are split into columns.
    fn additional_attributes(
        &mut self,
        primitive: &gltf::Primitive<'_>,
        vertices: usize,
    ) -> Result<VertexAttributes, IoError> {
        let mut attributes = VertexAttributes::default();
        for name in self.options.vertex_attributes.iter() {
            let named = |(semantic, _): &(Semantic, gltf::Accessor<'_>)| semantic.to_string() == **name;
            let Some((_, accessor)) = primitive.attributes().find(named) else { continue };
            let (count, dimensions) = (accessor.count(), accessor.dimensions());
            let (columns, rows) = columns_and_rows(dimensions);
            let Some(format) = attribute_format(accessor.data_type(), accessor.normalized(), rows) else { continue };
            if count != vertices {
                return Err(self.bad(format!("{name} has {count} elements for {vertices} vertices")));
            }
            let bytes = columns * format.size_bytes();
            self.budget.add_vertices(vertices.saturating_mul(bytes).div_ceil(size_of::<MeshVertex>()))?;
            for column in 0..columns {
                let elements =
                    self.buffers.elements(&accessor, dimensions)?.column(column, rows).padded(format.size_bytes());
                let name = if columns > 1 { format!("{name}_{column}") } else { name.to_string() };
                attributes.push(vertices, &name, format, elements).map_err(|error| self.bad(error.to_string()))?;
            }
        }
        Ok(attributes)
    }

    /// Returns the elements of an attribute, or `None` if the primitive lacks it.
    fn attribute(
        &self,
        primitive: &gltf::Primitive<'_>,
        semantic: &Semantic,
        count: usize,
        dimensions: &[Dimensions],
    ) -> Result<Option<Elements<'_>>, IoError> {
        let Some(accessor) = primitive.get(semantic) else { return Ok(None) };
        let dimension = accessor.dimensions();
        if !dimensions.contains(&dimension) || accessor.count() != count {
            return Err(self.bad(format!("{} has the wrong type or count", semantic.to_string())));
        }
        self.buffers.elements(&accessor, dimension).map(Some)
    }
}

/// Converts the mode of a primitive.
fn mode(mode: Mode) -> PrimitiveMode {
    match mode {
        Mode::Points => PrimitiveMode::Points,
        Mode::Lines => PrimitiveMode::Lines,
        Mode::LineStrip => PrimitiveMode::LineStrip,
        Mode::LineLoop => PrimitiveMode::LineLoop,
        Mode::Triangles => PrimitiveMode::Triangles,
        Mode::TriangleStrip => PrimitiveMode::TriangleStrip,
        Mode::TriangleFan => PrimitiveMode::TriangleFan,
    }
}

/// Converts to 8 bits, rounded to nearest: between 2^23 and 2^24 the lowest bit of an f32 is 1.
fn snorm8(x: f32) -> i8 {
    (x.clamp(-1.0, 1.0) * 127.0 + 12_582_912.0).to_bits() as i8
}
