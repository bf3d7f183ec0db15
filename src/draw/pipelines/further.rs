//! Further attributes of vertices: where they lie, and what of them programs read, by name. Draw thread.

use std::sync::Arc;

use super::key::{Kind, PipelineKey};
use super::programs::{scalar_name, type_name};
use super::{Pipelines, Shading};
use crate::gpu::{MOST_LAYOUTS, MeshPool, VertexFormat};
use crate::scene::{AttributeFormat, AttributeLayout};

/// The first location behind those of a `MeshVertex`.
const FIRST_LOCATION: u32 = 4;

/// What a program's vertex entry point reads beside a `MeshVertex`.
#[derive(Debug)]
pub(super) struct Input {
    /// That of the argument, or of the member of a struct.
    name: String,
    location: u32,
    scalar: &'static str,
    type_name: String,
}

/// All of them.
pub(super) fn inputs_of(module: &naga::Module, entry: &naga::EntryPoint) -> Vec<Input> {
    let mut inputs = Vec::new();
    let mut add = |name: &Option<String>, ty: naga::Handle<naga::Type>, binding: &Option<naga::Binding>| {
        let Some(naga::Binding::Location { location, .. }) = *binding else { return };
        let (naga::TypeInner::Scalar(scalar) | naga::TypeInner::Vector { scalar, .. }) = module.types[ty].inner else {
            return;
        };
        if location >= FIRST_LOCATION {
            let (scalar, type_name) = (scalar_name(scalar), type_name(module, ty));
            inputs.push(Input { name: name.clone().unwrap_or_default(), location, scalar, type_name });
        }
    };
    for argument in &entry.function.arguments {
        match &module.types[argument.ty].inner {
            naga::TypeInner::Struct { members, .. } => members.iter().for_each(|m| add(&m.name, m.ty, &m.binding)),
            _ => add(&argument.name, argument.ty, &argument.binding),
        }
    }
    inputs
}

/// Layouts by their places, as the context has them.
#[derive(Default)]
pub(super) struct Layouts([Option<Arc<AttributeLayout>>; MOST_LAYOUTS]);

impl Layouts {
    /// That of a key; empty where it has none.
    pub(super) fn of(&self, key: PipelineKey) -> &AttributeLayout {
        let layout = (key.layout() as usize).checked_sub(1).and_then(|place| self.0.get(place)?.as_deref());
        layout.unwrap_or_default()
    }
}

impl Pipelines {
    /// The key of what lies in a chunk of vertices.
    pub(in crate::draw) fn with_vertices(&mut self, key: PipelineKey, meshes: &MeshPool, chunk: u32) -> PipelineKey {
        match meshes.layout_of(chunk) {
            None => key.with_vertices(meshes.format_of(chunk)),
            Some((place, layout)) => self.with_layout(key, place, layout),
        }
    }

    /// The key of vertices with further attributes. A place may have come to mean another layout.
    pub(in crate::draw) fn with_layout(
        &mut self,
        key: PipelineKey,
        place: u32,
        layout: &Arc<AttributeLayout>,
    ) -> PipelineKey {
        if let Some(known) = self.layouts.0.get_mut((place as usize).wrapping_sub(1))
            && known.replace(layout.clone()).is_some_and(|known| known != *layout)
        {
            self.forget(|key| key.layout() == place);
        }
        key.with_layout(place)
    }

    /// Where in a vertex the attributes lie that a program reads; what is wrong with the first that is not there as the
    /// program has it.
    pub(super) fn further_attributes(&self, key: PipelineKey) -> Result<Vec<wgpu::VertexAttribute>, String> {
        let Shading::Program(place) = key.shading() else { return Ok(Vec::new()) };
        let Some(program) = self.programs.get(place).filter(|_| key.kind() != Kind::Height) else {
            return Ok(Vec::new());
        };
        let layout = self.layouts.of(key);
        let bound = program.inputs.iter().map(|input| bind(input, layout));
        bound.collect::<Result<_, _>>().map_err(|problem| {
            let program = self.programs.name(place).unwrap_or_default();
            let kind = match key.kind() {
                Kind::Height | Kind::Triangles => "triangles",
                Kind::Lines => "lines",
                Kind::Points => "points",
            };
            let names = layout.iter().map(|(name, _)| &**name).collect::<Vec<_>>().join(", ");
            let with = if names.is_empty() { "without further attributes".into() } else { format!("with {names}") };
            format!("program {program:?} cannot draw {kind} {with}: {problem}")
        })
    }
}

/// An attribute of a layout at the location of the input that has its name.
fn bind(input: &Input, layout: &AttributeLayout) -> Result<wgpu::VertexAttribute, String> {
    let Input { name, location, scalar, type_name } = input;
    let mut offset = VertexFormat::Full.stride();
    for (of, format) in layout {
        if **of != **name {
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
    Err(format!("attribute {name:?} ({type_name}) is not there"))
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
