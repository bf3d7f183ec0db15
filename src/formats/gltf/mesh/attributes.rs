//! Additional attributes that meshes keep for programs; see [`ReadOptions::vertex_attributes`].
//!
//! [`ReadOptions::vertex_attributes`]: crate::formats::ReadOptions::vertex_attributes

use gltf::accessor::Dimensions;
use gltf::mesh::Semantic;

use super::primitive::PrimitiveData;
use crate::fetch::IoError;
use crate::formats::gltf::accessors::{attribute_format, columns_and_rows};
use crate::formats::gltf::context::Context;
use crate::scene::{AttributeFormat, MeshVertex, SecondUv, VertexAttributes};

/// Reads the additional attributes in the order of the options. Matrices are split into columns.
pub(super) fn additional_attributes(
    context: &Context<'_>,
    data: &PrimitiveData<'_>,
) -> Result<VertexAttributes, IoError> {
    let (mut attributes, vertices) = (VertexAttributes::default(), data.count);
    for name in context.options.vertex_attributes.iter() {
        let Some(accessor) = data.accessor(name) else { continue };
        let dimensions = accessor.dimensions();
        let (columns, rows) = columns_and_rows(dimensions);
        let Some(elements) = data.elements(name, &accessor)? else { continue };
        let count = elements.count;
        if count != vertices {
            return Err(context.bad(format_args!("{name} has {count} elements for {vertices} vertices")));
        }
        let Some(format) = attribute_format(elements.data_type, elements.normalized, rows) else { continue };
        let bytes = columns * format.size_bytes();
        context.budget.add_vertices(vertices.saturating_mul(bytes).div_ceil(size_of::<MeshVertex>()))?;
        for column in 0..columns {
            let elements = elements.column(column, rows).padded(format.size_bytes());
            let name = if columns > 1 { format!("{name}_{column}") } else { name.to_string() };
            attributes.push(vertices, &name, format, elements).map_err(|error| context.bad(error))?;
        }
    }
    Ok(attributes)
}

/// Adds a set of texture coordinates for the maps that do not use those of the vertices.
pub(super) fn add_second_uv(
    context: &Context<'_>,
    data: &PrimitiveData<'_>,
    set: u32,
    attributes: &mut VertexAttributes,
) -> Result<(), IoError> {
    context.budget.add_vertices(data.count.saturating_mul(size_of::<[f32; 2]>()).div_ceil(size_of::<MeshVertex>()))?;
    let Some(elements) = data.optional(&Semantic::TexCoords(set), &[Dimensions::Vec2])? else {
        context.notes.add("glTF: texture without its coordinates");
        return Ok(());
    };
    let uvs: Vec<[f32; 2]> = (0..data.count).map(|i| [0, 1].map(|k| elements.value(i, k))).collect();
    let format = AttributeFormat::Float32x2;
    let bytes = bytemuck::cast_slice(&uvs).into();
    attributes.push(data.count, SecondUv::ATTRIBUTE, format, bytes).map_err(|error| context.bad(error))
}
