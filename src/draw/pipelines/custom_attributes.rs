//! Custom attributes of vertices: their layouts, and their binding to the inputs of programs by name. Draw thread.

use std::sync::Arc;

use super::key::{Kind, PipelineKey, Shading};
use super::programs::Programs;
use super::programs::inputs::Input;
use crate::gpu::{MAX_ATTRIBUTE_LAYOUTS, VertexFormat};
use crate::scene::{AttributeFormat, AttributeLayout, SecondUv};

/// The locations of further texture coordinates in surface_vertex.wgsl and textured_mesh.wgsl, with the names of their
/// attributes.
const FURTHER_UVS: [(u32, &str); 2] = [(4, SecondUv::ATTRIBUTE), (5, SecondUv::THIRD_ATTRIBUTE)];

/// The layouts of custom attributes by index, as the context numbers them from 1 on.
#[derive(Default)]
pub(super) struct AttributeLayouts([Option<Arc<AttributeLayout>>; MAX_ATTRIBUTE_LAYOUTS]);

impl AttributeLayouts {
    /// Returns the layout of an index; an empty one for 0.
    pub(super) fn get(&self, index: u32) -> &AttributeLayout {
        let layout = (index as usize).checked_sub(1).and_then(|index| self.0.get(index)?.as_deref());
        layout.unwrap_or_default()
    }

    /// Sets the layout of an index. Returns true if another one had the index before.
    pub(super) fn replace(&mut self, index: u32, layout: &Arc<AttributeLayout>) -> bool {
        let Some(known) = self.0.get_mut((index as usize).wrapping_sub(1)) else { return false };
        known.replace(layout.clone()).is_some_and(|known| known != *layout)
    }
}

/// Returns the attributes of a layout that the program of a key reads, at the locations of its inputs. Returns an error
/// for the first input that the layout lacks or has in another format.
pub(super) fn bind_attributes(
    programs: &Programs,
    key: PipelineKey,
    layout: &AttributeLayout,
) -> Result<Vec<wgpu::VertexAttribute>, String> {
    let Shading::Program(index) = key.shading() else { return Ok(Vec::new()) };
    let Some(program) = programs.get(index).filter(|_| key.kind() != Kind::Height) else { return Ok(Vec::new()) };
    let bound = program.inputs.iter().map(|input| bind(input, layout));
    bound.collect::<Result<_, _>>().map_err(|problem| {
        let program = programs.name(index).unwrap_or_default();
        let kind = match key.kind() {
            Kind::Height | Kind::Triangles => "triangles",
            Kind::Lines => "lines",
            Kind::Points => "points",
        };
        let names = layout.iter().map(|(name, _)| &**name).collect::<Vec<_>>().join(", ");
        let with = if names.is_empty() { "without custom attributes".into() } else { format!("with {names}") };
        format!("program {program:?} cannot draw {kind} {with}: {problem}")
    })
}

/// Returns the inputs for further texture coordinates of a key: second ones of surfaces, second and third ones of texture
/// units. They are attributes of a layout, or else the first coordinates, which are at location 1 of `attributes`.
pub(super) fn further_uvs(
    key: PipelineKey,
    layout: &AttributeLayout,
    attributes: &[wgpu::VertexAttribute],
) -> Vec<wgpu::VertexAttribute> {
    let count = match key.shading() {
        Shading::FixedTextured => FURTHER_UVS.len(),
        _ => usize::from(key.has_surface()),
    };
    let Some(first) = attributes.iter().find(|attribute| attribute.shader_location == 1) else { return Vec::new() };
    let input = |(location, wanted): &(u32, &str)| {
        let mut offset = VertexFormat::Full.stride();
        for (name, format) in layout {
            if **name == **wanted && *format == AttributeFormat::Float32x2 {
                let (format, offset) = (wgpu_format(*format), offset as u64);
                return wgpu::VertexAttribute { format, offset, shader_location: *location };
            }
            offset += format.size_bytes();
        }
        wgpu::VertexAttribute { shader_location: *location, ..*first }
    };
    FURTHER_UVS.iter().take(count).map(input).collect()
}

/// Returns the attribute of a layout with the name of an input, at the input's location.
fn bind(input: &Input, layout: &AttributeLayout) -> Result<wgpu::VertexAttribute, String> {
    let Input { name, location, scalar, type_name } = input;
    let mut offset = VertexFormat::Full.stride();
    for (attribute, format) in layout {
        if **attribute != **name {
            offset += format.size_bytes();
            continue;
        }
        return match format.scalar() == *scalar {
            true => Ok(wgpu::VertexAttribute {
                format: wgpu_format(*format),
                offset: offset as u64,
                shader_location: *location,
            }),
            false => Err(format!("attribute {name:?} is {format:?}, which the program reads as {type_name}")),
        };
    }
    Err(format!("attribute {name:?} ({type_name}) is missing"))
}

fn wgpu_format(format: AttributeFormat) -> wgpu::VertexFormat {
    macro_rules! same {
        ($($name:ident),+) => {
            match format { $(AttributeFormat::$name => wgpu::VertexFormat::$name),+ }
        };
    }
    same!(
        Uint8x4, Sint8x4, Unorm8x4, Snorm8x4, Uint16x2, Uint16x4, Sint16x2, Sint16x4, Unorm16x2, Unorm16x4, Snorm16x2,
        Snorm16x4, Float16x2, Float16x4, Float32, Float32x2, Float32x3, Float32x4, Uint32, Uint32x2, Uint32x3,
        Uint32x4, Sint32, Sint32x2, Sint32x3, Sint32x4
    )
}
