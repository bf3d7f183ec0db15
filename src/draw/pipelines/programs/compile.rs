//! Compiles a program: finds out what it declares and creates its module and bind group layout. Draw thread.

use super::builtin_uniforms::Builtins;
use super::check::checked;
use super::inputs::{Input, inputs_of};
use super::texture_units::{UnitLayout, bindings};
use super::wgsl_types::type_name;
use crate::draw::pipelines::sources::PROGRAM_PRELUDE;
use crate::state::{Program, ResolvedState, TEXTURE_UNITS};

/// The bind group of the uniforms and textures that a program declares.
const GROUP: u32 = 2;
/// The bind group of the application's own state attribute.
const ATTRIBUTE_GROUP: u32 = 3;

/// A member of a program's uniforms.
#[derive(Debug)]
struct Member {
    name: String,
    offset: usize,
    /// WGSL's name of its type, arrays without their length.
    type_name: String,
    size: usize,
}

/// A program that compiled without errors.
#[derive(Debug)]
pub(in crate::draw) struct Compiled {
    pub(in crate::draw) module: wgpu::ShaderModule,
    /// The module for height tiles, once one was drawn with the program.
    pub(in crate::draw) heights: Option<wgpu::ShaderModule>,
    pub(in crate::draw) layout: wgpu::BindGroupLayout,
    /// The layout of bind group 3, if the program declares one.
    pub(in crate::draw) attribute_layout: Option<wgpu::BindGroupLayout>,
    members: Vec<Member>,
    /// The custom attributes that it reads.
    pub(in crate::draw::pipelines) inputs: Vec<Input>,
    /// The size of its uniforms in bytes; 0 without any.
    pub(in crate::draw) uniform_bytes: usize,
    pub(in crate::draw) units: [Option<UnitLayout>; TEXTURE_UNITS],
    /// Values of overrides.
    pub(in crate::draw) constants: Vec<(String, f64)>,
    /// Bits of the locations that the fragment shader writes.
    pub(in crate::draw) outputs: u32,
    /// True if the fragment shader may discard fragments or write their depth.
    pub(in crate::draw) discards: bool,
}

impl Compiled {
    /// Writes the uniforms of a state to zeroed bytes. Uniforms of another type than the program declares stay zero; the
    /// first of them is the error.
    pub(in crate::draw) fn fill(
        &self,
        state: &ResolvedState,
        builtins: &Builtins,
        bytes: &mut [u8],
    ) -> Result<(), String> {
        let mut misfit = None;
        for member in &self.members {
            let Some(target) = bytes.get_mut(member.offset..member.offset + member.size) else { continue };
            match state.uniform(&member.name) {
                Some(uniform) if uniform.value.type_name() == member.type_name => {
                    let (values, column, stride) = uniform.value.columns();
                    for (value, target) in values.chunks(column).zip(target.chunks_mut(stride)) {
                        let count = value.len().min(target.len());
                        target[..count].copy_from_slice(&value[..count]);
                    }
                }
                Some(uniform) => {
                    let (given, wanted) = (uniform.value.type_name(), &member.type_name);
                    misfit.get_or_insert_with(|| format!("uniform {} is {given} instead of {wanted}", member.name));
                }
                None => builtins.fill(&member.name, target),
            }
        }
        misfit.map_or(Ok(()), Err)
    }
}

/// Compiles a program. Returns an error text without its name.
pub(super) fn compile(device: &wgpu::Device, program: &Program) -> Result<Compiled, String> {
    let source = format!("{PROGRAM_PRELUDE}\n{}", program.wgsl);
    let module = checked(&source)?;
    let fragment = module
        .entry_points
        .iter()
        .find(|e| e.name == "fs_main" && e.stage == naga::ShaderStage::Fragment)
        .ok_or("no fragment entry point fs_main")?;
    let vertex = module
        .entry_points
        .iter()
        .find(|e| e.name == "vs_main" && e.stage == naga::ShaderStage::Vertex)
        .ok_or("no vertex entry point vs_main")?;
    let inputs = inputs_of(&module, vertex);
    let mut layouter = naga::proc::Layouter::default();
    layouter.update(module.to_ctx()).map_err(|e| e.to_string())?;
    let mut members = Vec::new();
    let mut uniform_bytes = 0;
    let mut units = [None; TEXTURE_UNITS];
    let mut of_attribute = Vec::new();
    for (_, variable) in module.global_variables.iter() {
        let Some(binding) = variable.binding.as_ref().filter(|b| b.group >= GROUP) else { continue };
        let inner = &module.types[variable.ty].inner;
        if binding.group == ATTRIBUTE_GROUP {
            of_attribute.push(attribute_entry(binding.binding, variable.space, inner)?);
            continue;
        }
        match (binding.group, binding.binding, inner) {
            (GROUP, 0, naga::TypeInner::Struct { members: declared, span }) => {
                uniform_bytes = *span as usize;
                members.extend(declared.iter().map(|m| Member {
                    name: m.name.clone().unwrap_or_default(),
                    offset: m.offset as usize,
                    type_name: type_name(&module, m.ty),
                    size: layouter[m.ty].size as usize,
                }));
            }
            (GROUP, b, naga::TypeInner::Image { dim, arrayed, class })
                if b % 2 == 1 && b < 2 * TEXTURE_UNITS as u32 =>
            {
                let (dimension, is_depth) = sampled_texture(b, *dim, *arrayed, *class)?;
                let is_filtered = !is_depth;
                let unit: &mut Option<UnitLayout> = &mut units[(b / 2) as usize];
                let (has_sampler, compares) = unit.map_or((false, false), |u| (u.has_sampler, u.compares));
                *unit = Some(UnitLayout { dimension, is_depth, is_filtered, has_sampler, compares });
            }
            (GROUP, b, naga::TypeInner::Sampler { comparison })
                if b % 2 == 0 && (2..=2 * TEXTURE_UNITS as u32).contains(&b) =>
            {
                let unit = &mut units[(b / 2 - 1) as usize];
                let before = unit.unwrap_or(UnitLayout {
                    dimension: wgpu::TextureViewDimension::D2,
                    is_depth: false,
                    is_filtered: true,
                    has_sampler: true,
                    compares: *comparison,
                });
                *unit = Some(UnitLayout { has_sampler: true, compares: *comparison, ..before });
            }
            (group, binding, _) => {
                return Err(format!("group {group} binding {binding} is neither uniforms nor a texture nor a sampler"));
            }
        }
    }
    let constants = module
        .overrides
        .iter()
        .filter_map(|(_, o)| o.name.as_ref())
        .filter_map(|name| program.defines.iter().find(|(n, _)| n == name).cloned())
        .collect();
    let max = device.limits().max_uniform_buffer_binding_size;
    if uniform_bytes as u64 > max {
        return Err(format!("{uniform_bytes} bytes of uniforms are more than the {max} that the adapter allows"));
    }
    let entries = bindings(uniform_bytes, &units);
    let layout = device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(&program.name), entries: &entries });
    let attribute_layout = (!of_attribute.is_empty()).then(|| {
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(&program.name),
            entries: &of_attribute,
        })
    });
    let outputs = fragment.function.result.as_ref().map_or(0, |r| written(&module, r));
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(&program.name),
        source: wgpu::ShaderSource::Wgsl(source.into()),
    });
    // A word in a comment only makes the pipeline a little slower.
    let discards = ["discard", "frag_depth"].iter().any(|word| program.wgsl.contains(word));
    Ok(Compiled {
        module,
        heights: None,
        layout,
        attribute_layout,
        members,
        inputs,
        uniform_bytes,
        units,
        constants,
        outputs,
        discards,
    })
}

/// Returns the layout of a binding of the application's own state attribute.
fn attribute_entry(
    binding: u32,
    space: naga::AddressSpace,
    inner: &naga::TypeInner,
) -> Result<wgpu::BindGroupLayoutEntry, String> {
    let buffer = |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    let ty = match (space, inner) {
        (naga::AddressSpace::Uniform, _) => buffer(wgpu::BufferBindingType::Uniform),
        (naga::AddressSpace::Storage { access }, _) if !access.contains(naga::StorageAccess::STORE) => {
            buffer(wgpu::BufferBindingType::Storage { read_only: true })
        }
        (_, naga::TypeInner::Image { dim, arrayed, class }) => {
            let (view_dimension, is_depth) = sampled_texture(binding, *dim, *arrayed, *class)?;
            let sample_type = match is_depth {
                true => wgpu::TextureSampleType::Depth,
                false => wgpu::TextureSampleType::Float { filterable: true },
            };
            wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false }
        }
        (_, naga::TypeInner::Sampler { comparison: true }) => {
            wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Comparison)
        }
        (_, naga::TypeInner::Sampler { comparison: false }) => {
            wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)
        }
        _ => {
            let group = ATTRIBUTE_GROUP;
            return Err(format!(
                "group {group} binding {binding} is neither a uniform or read-only storage buffer nor a texture nor a sampler"
            ));
        }
    };
    Ok(wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::VERTEX_FRAGMENT, ty, count: None })
}

/// Returns the dimension of a declared texture, and whether it is a depth texture.
fn sampled_texture(
    binding: u32,
    dimension: naga::ImageDimension,
    is_array: bool,
    class: naga::ImageClass,
) -> Result<(wgpu::TextureViewDimension, bool), String> {
    let is_depth = match class {
        naga::ImageClass::Sampled { kind: naga::ScalarKind::Float, multi: false } => false,
        naga::ImageClass::Depth { multi: false } => true,
        _ => return Err(format!("binding {binding} is not a texture that can be sampled")),
    };
    let dimension = match (dimension, is_array) {
        (naga::ImageDimension::D2, false) => wgpu::TextureViewDimension::D2,
        (naga::ImageDimension::D2, true) => wgpu::TextureViewDimension::D2Array,
        (naga::ImageDimension::D3, _) => wgpu::TextureViewDimension::D3,
        (naga::ImageDimension::Cube, false) => wgpu::TextureViewDimension::Cube,
        _ => return Err(format!("binding {binding}: one-dimensional textures are texture_2d, of height 1")),
    };
    Ok((dimension, is_depth))
}

/// Returns the bits of the locations that a fragment shader writes.
fn written(module: &naga::Module, result: &naga::FunctionResult) -> u32 {
    let bit = |binding: &Option<naga::Binding>| match binding {
        Some(naga::Binding::Location { location, .. }) => 1 << (*location).min(31),
        _ => 0,
    };
    match &module.types[result.ty].inner {
        naga::TypeInner::Struct { members, .. } => members.iter().map(|m| bit(&m.binding)).fold(0, |a, b| a | b),
        _ => bit(&result.binding),
    }
}
