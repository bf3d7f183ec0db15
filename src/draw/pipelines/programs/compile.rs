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
    let fragment =
        entry_point(&module, "fs_main", naga::ShaderStage::Fragment).ok_or("no fragment entry point fs_main")?;
    let vertex = entry_point(&module, "vs_main", naga::ShaderStage::Vertex).ok_or("no vertex entry point vs_main")?;
    let Declared { members, uniform_bytes, units, of_attribute } = Declared::of(&module)?;
    let max = device.limits().max_uniform_buffer_binding_size;
    if uniform_bytes as u64 > max {
        return Err(format!("{uniform_bytes} bytes of uniforms are more than the {max} that the adapter allows"));
    }
    let label = Some(&*program.name);
    let layout = |entries: &[wgpu::BindGroupLayoutEntry]| {
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries })
    };
    let overrides = module.overrides.iter().filter_map(|(_, o)| o.name.as_ref());
    Ok(Compiled {
        layout: layout(&bindings(uniform_bytes, &units)),
        attribute_layout: (!of_attribute.is_empty()).then(|| layout(&of_attribute)),
        inputs: inputs_of(&module, vertex),
        constants: overrides.filter_map(|name| program.defines.iter().find(|(n, _)| n == name).cloned()).collect(),
        outputs: fragment.function.result.as_ref().map_or(0, |r| written(&module, r)),
        // A word in a comment only makes the pipeline a little slower.
        discards: ["discard", "frag_depth"].iter().any(|word| program.wgsl.contains(word)),
        members,
        uniform_bytes,
        units,
        module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label,
            source: wgpu::ShaderSource::Wgsl(source.into()),
        }),
        heights: None,
    })
}

fn entry_point<'a>(module: &'a naga::Module, name: &str, stage: naga::ShaderStage) -> Option<&'a naga::EntryPoint> {
    module.entry_points.iter().find(|entry| entry.name == name && entry.stage == stage)
}

/// The uniforms and bindings that a program declares.
struct Declared {
    members: Vec<Member>,
    uniform_bytes: usize,
    units: [Option<UnitLayout>; TEXTURE_UNITS],
    /// The bindings of the application's own state attribute.
    of_attribute: Vec<wgpu::BindGroupLayoutEntry>,
}

impl Declared {
    fn of(module: &naga::Module) -> Result<Self, String> {
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).map_err(|e| e.to_string())?;
        let mut declared =
            Self { members: Vec::new(), uniform_bytes: 0, units: [None; TEXTURE_UNITS], of_attribute: Vec::new() };
        for (_, variable) in module.global_variables.iter() {
            let Some(binding) = variable.binding.as_ref().filter(|b| b.group >= GROUP) else { continue };
            let inner = &module.types[variable.ty].inner;
            if binding.group == ATTRIBUTE_GROUP {
                declared.of_attribute.push(attribute_entry(binding.binding, variable.space, inner)?);
                continue;
            }
            match (binding.group, binding.binding, inner) {
                (GROUP, 0, naga::TypeInner::Struct { members, span }) => {
                    declared.uniform_bytes = *span as usize;
                    declared.members.extend(members.iter().map(|m| Member {
                        name: m.name.clone().unwrap_or_default(),
                        offset: m.offset as usize,
                        type_name: type_name(module, m.ty),
                        size: layouter[m.ty].size as usize,
                    }));
                }
                (GROUP, b, naga::TypeInner::Image { dim, arrayed, class })
                    if b % 2 == 1 && b < 2 * TEXTURE_UNITS as u32 =>
                {
                    let (dimension, is_depth) = sampled_texture(b, *dim, *arrayed, *class)?;
                    declared.add_texture((b / 2) as usize, dimension, is_depth);
                }
                (GROUP, b, naga::TypeInner::Sampler { comparison })
                    if b % 2 == 0 && (2..=2 * TEXTURE_UNITS as u32).contains(&b) =>
                {
                    declared.add_sampler((b / 2 - 1) as usize, *comparison);
                }
                (group, binding, _) => {
                    return Err(format!(
                        "group {group} binding {binding} is neither uniforms nor a texture nor a sampler"
                    ));
                }
            }
        }
        Ok(declared)
    }

    /// Adds the texture of a unit, whose sampler may be declared before or after.
    fn add_texture(&mut self, unit: usize, dimension: wgpu::TextureViewDimension, is_depth: bool) {
        let unit = &mut self.units[unit];
        let (has_sampler, compares) = unit.map_or((false, false), |u| (u.has_sampler, u.compares));
        *unit = Some(UnitLayout { dimension, is_depth, is_filtered: !is_depth, has_sampler, compares });
    }

    /// Adds the sampler of a unit. A unit without a texture gets a two-dimensional one.
    fn add_sampler(&mut self, unit: usize, compares: bool) {
        let unit = &mut self.units[unit];
        let dimension = wgpu::TextureViewDimension::D2;
        let before =
            unit.unwrap_or(UnitLayout { dimension, is_depth: false, is_filtered: true, has_sampler: true, compares });
        *unit = Some(UnitLayout { has_sampler: true, compares, ..before });
    }
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
