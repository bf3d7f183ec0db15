//! KHR_draco_mesh_compression: the attributes and indices of a primitive in one compressed mesh.
//!
//! The numbers of vertices and indices that the accessors declare, which are counted in the budget, bound the decoder. Some
//! exporters declare slightly fewer vertices than they compress, so that a few more are allowed.

use std::borrow::Cow;
use std::sync::Arc;

use draco_core::{
    DataType as DracoType, DecodeLimits, DecoderBuffer, ErrorKind, Mesh, MeshDecoder, PointAttribute, PointIndex,
};
use gltf::accessor::DataType;
use gltf::mesh::Semantic;
use serde_json::{Map, Value};

use crate::fetch::{IoError, content_bytes_left};
use crate::formats::gltf::accessors::{Buffers, Elements};
use crate::formats::gltf::context::Context;

const EXTENSION: &str = "KHR_draco_mesh_compression";
/// The maximum number of attributes of a vertex, for the limit of decoded bytes.
const MAX_ATTRIBUTES: u64 = 32;

/// Returns the number of vertices that a mesh may have whose accessors declare `declared` ones.
fn max_vertices(declared: usize) -> u64 {
    (declared as u64).saturating_mul(5) / 4 + 64
}

/// A decompressed mesh.
pub(super) struct DracoMesh<'a> {
    context: &'a Context<'a>,
    mesh: Mesh,
    /// Ids in the compressed mesh by the name of the attribute.
    ids: &'a Map<String, Value>,
}

/// The compressed mesh of a primitive.
pub(super) enum Compressed<'a> {
    /// The primitive is not compressed.
    No,
    /// The buffer with the compressed mesh is missing.
    Missing,
    Mesh(Box<DracoMesh<'a>>),
}

impl<'a> Compressed<'a> {
    /// Decompresses the mesh of a primitive whose accessors have `vertices` vertices, which the caller has counted in the
    /// budget. Notes a mesh with another number of vertices.
    pub fn new(
        context: &'a Context<'a>,
        buffers: &Buffers<'_>,
        document: &gltf::Document,
        primitive: &'a gltf::Primitive<'a>,
        vertices: usize,
    ) -> Result<Self, IoError> {
        let Some(extension) = primitive.extension_value(EXTENSION) else { return Ok(Self::No) };
        let bad = |reason: &str| context.bad(format_args!("{EXTENSION}: {reason}"));
        let view = extension.get("bufferView").and_then(Value::as_u64).and_then(|view| usize::try_from(view).ok());
        let view = view.and_then(|view| document.views().nth(view)).ok_or_else(|| bad("no bufferView"))?;
        let ids = extension.get("attributes").and_then(Value::as_object).ok_or_else(|| bad("no attributes"))?;
        let Some(bytes) = buffers.view(&view)? else { return Ok(Self::Missing) };
        let indices = primitive.indices().map_or(0, |accessor| accessor.count());
        context.budget.add_indices(indices)?;
        let max_vertices = max_vertices(vertices);
        let max_decoded_bytes = max_vertices.saturating_mul(16 * MAX_ATTRIBUTES);
        let mut limits = DecodeLimits::default();
        limits.max_points = max_vertices;
        limits.max_faces = (indices as u64).div_ceil(3).max(max_vertices);
        limits.max_decoded_bytes =
            max_decoded_bytes.min(context.options.limits.max_file_bytes).min(content_bytes_left());
        let mut mesh = Mesh::new();
        let mut buffer = DecoderBuffer::new(bytes).with_limits(limits);
        if let Err(error) = MeshDecoder::new().decode(&mut buffer, &mut mesh) {
            // The budget of the content was the limit, which has a better error.
            if error.kind() == ErrorKind::LimitExceeded && limits.max_decoded_bytes == content_bytes_left() {
                context.budget.ask(limits.max_decoded_bytes.saturating_add(1))?;
            }
            // The extension may be optional: the accessors then have plain data.
            return match primitive.get(&Semantic::Positions).and_then(|positions| positions.view()) {
                Some(_) => {
                    context.notes.add("glTF: Draco mesh that is damaged (drawn from plain accessors)");
                    Ok(Self::No)
                }
                None => Err(bad(&error.to_string())),
            };
        }
        let points = mesh.num_points();
        if points as u64 > max_vertices {
            return Err(bad(&format!("{points} vertices, the accessors have {vertices}")));
        }
        // An attribute has up to four numbers of four bytes.
        let attributes = u64::try_from(mesh.num_attributes()).unwrap_or(0);
        context.budget.ask(16 * attributes.saturating_mul(points as u64))?;
        if points != vertices {
            context
                .notes
                .add("glTF: Draco mesh with another number of vertices than its accessors (drawn as compressed)");
            context.budget.add_vertices(points.saturating_sub(vertices))?;
        }
        Ok(Self::Mesh(Box::new(DracoMesh { context, mesh, ids })))
    }
}

impl DracoMesh<'_> {
    /// Returns the number of vertices.
    pub fn count(&self) -> usize {
        self.mesh.num_points()
    }

    /// Returns the elements of an attribute, or `None` if it is not compressed.
    pub fn elements(&self, name: &str, accessor: &gltf::Accessor<'_>) -> Result<Option<Elements<'_>>, IoError> {
        let bad = |reason: &str| self.context.bad(format_args!("{EXTENSION}: attribute {name} {reason}"));
        let Some(id) = self.ids.get(name) else { return Ok(None) };
        let id = id.as_u64().and_then(|id| u32::try_from(id).ok()).ok_or_else(|| bad("has no valid id"))?;
        let attribute = self.mesh.attribute_by_unique_id(id).ok_or_else(|| bad("is not in the compressed mesh"))?;
        let data_type = match attribute.data_type() {
            DracoType::Int8 => DataType::I8,
            DracoType::Uint8 | DracoType::Bool => DataType::U8,
            DracoType::Int16 => DataType::I16,
            DracoType::Uint16 => DataType::U16,
            DracoType::Uint32 => DataType::U32,
            DracoType::Float32 => DataType::F32,
            other => return Err(bad(&format!("has the type {other:?}"))),
        };
        let components = usize::from(attribute.num_components());
        if components != accessor.dimensions().multiplicity() {
            return Err(bad(&format!("has {components} components")));
        }
        let size = components * data_type.size();
        let stride = usize::try_from(attribute.byte_stride()).ok().filter(|stride| *stride >= size && size > 0);
        let stride = stride.ok_or_else(|| bad("has an invalid stride"))?;
        let bytes = self.bytes(attribute, size, stride).ok_or_else(|| bad("reaches beyond its data"))?;
        let stride = if attribute.is_mapping_identity() { stride } else { size };
        Ok(Some(Elements {
            bytes,
            stride,
            count: self.mesh.num_points(),
            components,
            data_type,
            normalized: accessor.normalized() || attribute.normalized(),
        }))
    }

    /// Returns the values of all vertices: a part of the mesh if they lie in order, else a copy without gaps.
    fn bytes<'m>(&'m self, attribute: &'m PointAttribute, size: usize, stride: usize) -> Option<Cow<'m, [u8]>> {
        let (data, count) = (attribute.buffer().data(), self.mesh.num_points());
        if attribute.is_mapping_identity() {
            let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size))?;
            return data.get(..needed).map(Cow::Borrowed);
        }
        let mut gathered = Vec::with_capacity(count.checked_mul(size)?);
        for point in 0..count as u32 {
            let begin = (attribute.mapped_index(PointIndex(point)).0 as usize).checked_mul(stride)?;
            gathered.extend_from_slice(data.get(begin..begin.checked_add(size)?)?);
        }
        Some(Cow::Owned(gathered))
    }

    /// Returns false for a point cloud.
    pub fn has_triangles(&self) -> bool {
        self.mesh.num_faces() > 0
    }

    /// Returns the indices of the triangles, each below the number of vertices.
    pub fn indices(&self) -> Result<Arc<[u32]>, IoError> {
        let indices: Arc<[u32]> = self.mesh.faces().iter().flatten().map(|point| point.0).collect();
        let vertices = self.mesh.num_points();
        match indices.iter().find(|index| **index as usize >= vertices) {
            Some(index) => Err(self.context.bad(format_args!("{EXTENSION}: index {index} of {vertices} vertices"))),
            None => Ok(indices),
        }
    }
}
