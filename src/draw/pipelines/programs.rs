//! Programs of the application: parsed and checked here, so that what is wrong is one error and not a lost device;
//! their uniforms filled by name. Draw thread.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use crate::draw::pipelines::further::{Input, inputs_of};
use crate::draw::pipelines::key::MOST_PROGRAMS;
use crate::draw::pipelines::{HEIGHT_PROGRAM_PRELUDE, PROGRAM_PRELUDE};
use crate::gpu::watched;
use crate::state::{CompareFunction, FilterMode, Program, ResolvedState, Sampler, TEXTURE_UNITS};

/// Group of what a program declares itself.
const GROUP: u32 = 2;

/// A member of a program's uniforms.
#[derive(Debug)]
struct Member {
    name: String,
    offset: usize,
    /// WGSL's name of its type, arrays without their length.
    type_name: String,
    size: usize,
}

/// A texture a program declares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) struct UnitLayout {
    pub(in crate::draw) dimension: wgpu::TextureViewDimension,
    pub(in crate::draw) is_depth: bool,
    pub(in crate::draw) is_filtered: bool,
    has_sampler: bool,
    compares: bool,
}

/// A program that can be used.
#[derive(Debug)]
pub(in crate::draw) struct Compiled {
    pub(in crate::draw) module: wgpu::ShaderModule,
    /// The same for height tiles, once it was wanted.
    pub(in crate::draw) heights: Option<wgpu::ShaderModule>,
    pub(in crate::draw) layout: wgpu::BindGroupLayout,
    members: Vec<Member>,
    /// Further attributes that it reads.
    pub(super) inputs: Vec<Input>,
    pub(in crate::draw) uniform_bytes: usize,
    pub(in crate::draw) units: [Option<UnitLayout>; TEXTURE_UNITS],
    /// Values of overrides.
    pub(in crate::draw) constants: Vec<(String, f64)>,
    /// Bits of the locations that the fragment shader writes.
    pub(in crate::draw) outputs: u32,
    /// The fragment shader may drop fragments, or give them another depth.
    pub(in crate::draw) discards: bool,
}

struct Entry {
    /// Also keeps the address from being used again. Not held: renderers of other devices have it too.
    program: Weak<Program>,
    compiled: Option<Compiled>,
}

/// Programs that are in use, by identity.
#[derive(Default)]
pub(in crate::draw) struct Programs {
    /// A program's place is its own while it is there.
    entries: Vec<Option<Entry>>,
    /// By address, which entries keep from being used again. Only looked up, never walked while anything is drawn.
    place_of: HashMap<usize, u16>,
}

/// Times and matrices that uniforms named `osg_…` get.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::draw) struct Builtins {
    pub frame: u32,
    pub frame_time_s: f32,
    pub delta_frame_time_s: f32,
    pub simulation_time_s: f32,
    pub view: glam::Mat4,
    pub view_inverse: glam::Mat4,
}

impl Programs {
    /// The place of a program that can be used; compiles it when first met. What is wrong with it only then.
    pub(in crate::draw) fn ensure(
        &mut self,
        device: &wgpu::Device,
        program: &Arc<Program>,
    ) -> Result<Option<u16>, String> {
        let address = Arc::as_ptr(program).addr();
        if let Some(&place) = self.place_of.get(&address) {
            return Ok(self.get(place).is_some().then_some(place));
        }
        let free = self.entries.iter().position(Option::is_none);
        let place = free.unwrap_or(self.entries.len());
        if place >= MOST_PROGRAMS {
            let name = &program.name;
            return Err(format!("program {name:?} is one more than the {MOST_PROGRAMS} that there can be"));
        }
        let (compiled, error) = watched(device, || compile(device, program));
        let compiled = compiled.and_then(|compiled| error.map_or(Ok(compiled), |error| Err(error.to_string())));
        let (compiled, result) = match compiled {
            Ok(compiled) => (Some(compiled), Ok(Some(place as u16))),
            Err(reason) => (None, Err(format!("program {:?}: {reason}", program.name))),
        };
        self.place_of.insert(address, place as u16);
        let entry = Some(Entry { program: Arc::downgrade(program), compiled });
        match free {
            Some(place) => self.entries[place] = entry,
            None => self.entries.push(entry),
        }
        result
    }

    /// Lets those go that nobody has any more; their places.
    pub(in crate::draw) fn prune(&mut self) -> Vec<u16> {
        let mut gone = Vec::new();
        for (place, slot) in (0u16..).zip(&mut self.entries) {
            if slot.take_if(|entry| entry.program.strong_count() == 0).is_some() {
                gone.push(place);
            }
        }
        if !gone.is_empty() {
            self.place_of.retain(|_, place| !gone.contains(place));
        }
        gone
    }

    /// Makes the module for height tiles, called once for each program. Why it cannot be.
    pub(in crate::draw) fn ensure_heights(&mut self, device: &wgpu::Device, place: u16) -> Result<(), String> {
        let Some(Some(entry)) = self.entries.get_mut(usize::from(place)) else { return Ok(()) };
        let Some(compiled) = entry.compiled.as_mut().filter(|c| c.heights.is_none()) else { return Ok(()) };
        // Whoever draws with it holds it.
        let Some(program) = entry.program.upgrade() else { return Ok(()) };
        let source = heights_source(&program.wgsl)
            .map_err(|reason| format!("program {:?} on height tiles: {reason}", program.name))?;
        let source = wgpu::ShaderSource::Wgsl(source.into());
        let descriptor = wgpu::ShaderModuleDescriptor { label: Some(&program.name), source };
        let (module, error) = watched(device, || device.create_shader_module(descriptor));
        compiled.heights = error.is_none().then_some(module);
        error.map_or(Ok(()), |error| Err(format!("program {:?} on height tiles: {error}", program.name)))
    }

    /// For errors.
    pub(in crate::draw) fn name(&self, place: u16) -> Option<String> {
        let entry = self.entries.get(usize::from(place))?.as_ref()?;
        entry.program.upgrade().map(|program| program.name.clone())
    }

    pub(in crate::draw) fn get(&self, place: u16) -> Option<&Compiled> {
        self.entries.get(usize::from(place))?.as_ref()?.compiled.as_ref()
    }
}

fn compile(device: &wgpu::Device, program: &Program) -> Result<Compiled, String> {
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
    for (_, variable) in module.global_variables.iter() {
        let Some(binding) = variable.binding.as_ref().filter(|b| b.group >= GROUP) else { continue };
        let inner = &module.types[variable.ty].inner;
        match (binding.group, binding.binding, inner) {
            (GROUP, 0, naga::TypeInner::Struct { members: of_struct, span }) => {
                uniform_bytes = *span as usize;
                members.extend(of_struct.iter().map(|m| Member {
                    name: m.name.clone().unwrap_or_default(),
                    offset: m.offset as usize,
                    type_name: type_name(&module, m.ty),
                    size: layouter[m.ty].size as usize,
                }));
            }
            (GROUP, b, naga::TypeInner::Image { dim, arrayed, class })
                if b % 2 == 1 && b < 2 * TEXTURE_UNITS as u32 =>
            {
                let (is_depth, is_filtered) = match class {
                    naga::ImageClass::Sampled { kind: naga::ScalarKind::Float, multi: false } => (false, true),
                    naga::ImageClass::Depth { multi: false } => (true, false),
                    _ => return Err(format!("binding {b} is no texture that can be sampled")),
                };
                let dimension = match (dim, arrayed) {
                    (naga::ImageDimension::D2, false) => wgpu::TextureViewDimension::D2,
                    (naga::ImageDimension::D2, true) => wgpu::TextureViewDimension::D2Array,
                    (naga::ImageDimension::D3, _) => wgpu::TextureViewDimension::D3,
                    (naga::ImageDimension::Cube, false) => wgpu::TextureViewDimension::Cube,
                    _ => return Err(format!("binding {b}: one-dimensional textures are texture_2d, of height 1")),
                };
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
                return Err(format!("group {group} binding {binding} is none of uniforms, textures and samplers"));
            }
        }
    }
    let constants = module
        .overrides
        .iter()
        .filter_map(|(_, o)| o.name.as_ref())
        .filter_map(|name| program.defines.iter().find(|(n, _)| n == name).cloned())
        .collect();
    let most = device.limits().max_uniform_buffer_binding_size;
    if uniform_bytes as u64 > most {
        return Err(format!("{uniform_bytes} bytes of uniforms, of which the adapter takes {most}"));
    }
    let entries = bindings(uniform_bytes, &units);
    let layout = device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(&program.name), entries: &entries });
    let outputs = fragment.function.result.as_ref().map_or(0, |r| written(&module, r));
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(&program.name),
        source: wgpu::ShaderSource::Wgsl(source.into()),
    });
    // In comments they only cost a little.
    let discards = ["discard", "frag_depth"].iter().any(|word| program.wgsl.contains(word));
    Ok(Compiled { module, heights: None, layout, members, inputs, uniform_bytes, units, constants, outputs, discards })
}

fn checked(source: &str) -> Result<naga::Module, String> {
    let module = naga::front::wgsl::parse_str(source).map_err(|e| lines_of(&e.emit_to_string(source)))?;
    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
        .validate(&module)
        .map_err(|e| lines_of(&e.emit_to_string(source)))?;
    Ok(module)
}

/// Vertex entry point of programs on height tiles.
pub(in crate::draw) const HEIGHT_ENTRY: &str = "vs_height_main";

/// The source for height tiles: the program's vertex entry point becomes a function that is called with a displaced
/// vertex in the place of a mesh's.
fn heights_source(wgsl: &str) -> Result<String, String> {
    let of_meshes = naga::front::wgsl::parse_str(&format!("{PROGRAM_PRELUDE}\n{wgsl}")).map_err(|e| e.to_string())?;
    let entry = of_meshes.entry_points.iter().find(|e| e.name == "vs_main").ok_or("no vertex entry point vs_main")?;
    let arguments =
        entry.function.arguments.iter().map(|argument| match (&argument.binding, &of_meshes.types[argument.ty].name) {
            (Some(naga::Binding::BuiltIn(naga::BuiltIn::InstanceIndex)), _) => Ok("instance"),
            (Some(naga::Binding::BuiltIn(naga::BuiltIn::VertexIndex)), _) => Ok("index"),
            (None, Some(name)) if name == "MeshVertex" => Ok("height_vertex(index, instance)"),
            _ => Err("vs_main takes other than MeshVertex, vertex_index and instance_index"),
        });
    let arguments = arguments.collect::<Result<Vec<_>, _>>()?.join(", ");
    let result = entry.function.result.as_ref().ok_or("vs_main returns nothing")?;
    let result = match (&result.binding, &of_meshes.types[result.ty].name) {
        (Some(naga::Binding::BuiltIn(naga::BuiltIn::Position { .. })), _) => "@builtin(position) vec4<f32>",
        (None, Some(name)) => name,
        _ => return Err("vs_main returns neither a struct nor a position".into()),
    };
    // The attribute right before the function's name; what stands between them are spaces and lines.
    let name = find_function(wgsl, "vs_main").ok_or("`fn vs_main` is not found")?;
    let before = wgsl[..name].trim_end();
    let before = before.strip_suffix("@vertex").ok_or("`@vertex` does not stand right before `fn vs_main`")?;
    let (header, body) = wgsl[name..].split_at(wgsl[name..].find('{').unwrap_or(0));
    let header = without_attributes(header);
    let source = format!(
        "{HEIGHT_PROGRAM_PRELUDE}\n{before}{header}{body}\n@vertex\nfn {HEIGHT_ENTRY}(@builtin(vertex_index) index: u32, \
         @builtin(instance_index) instance: u32) -> {result} {{\n    return vs_main({arguments});\n}}\n"
    );
    checked(&source)?;
    Ok(source)
}

/// Functions that are no entry points have none on their arguments and results.
fn without_attributes(header: &str) -> String {
    let mut parts = header.split('@');
    let mut kept = parts.next().unwrap_or_default().to_owned();
    for attribute in parts {
        let name = attribute.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(attribute.len());
        let rest = &attribute[name..];
        let values = rest.trim_start();
        let end = values.find(')').filter(|_| values.starts_with('(')).map(|end| &values[end + 1..]);
        kept.push_str(end.unwrap_or(rest));
    }
    kept
}

/// Where `fn NAME` begins.
fn find_function(wgsl: &str, name: &str) -> Option<usize> {
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    wgsl.match_indices("fn").map(|(at, _)| at).find(|at| {
        let rest = &wgsl[at + 2..];
        let after = rest.trim_start();
        let is_word = !wgsl[..*at].ends_with(is_name) && after.len() < rest.len();
        is_word && after.strip_prefix(name).is_some_and(|end| !end.starts_with(is_name))
    })
}

/// Errors of naga point into the source over several lines.
fn lines_of(text: &str) -> String {
    text.trim().lines().map(str::trim).filter(|l| !l.is_empty()).take(4).collect::<Vec<_>>().join(" ")
}

fn bindings(uniform_bytes: usize, units: &[Option<UnitLayout>; TEXTURE_UNITS]) -> Vec<wgpu::BindGroupLayoutEntry> {
    let both = wgpu::ShaderStages::VERTEX_FRAGMENT;
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry { binding, visibility: both, ty, count: None };
    let mut entries = Vec::new();
    if uniform_bytes > 0 {
        let ty = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: true,
            min_binding_size: None,
        };
        entries.push(entry(0, ty));
    }
    for (unit, layout) in (0u32..).zip(units) {
        let Some(layout) = layout else { continue };
        let sample_type = if layout.is_depth {
            wgpu::TextureSampleType::Depth
        } else {
            wgpu::TextureSampleType::Float { filterable: layout.is_filtered }
        };
        let ty = wgpu::BindingType::Texture { sample_type, view_dimension: layout.dimension, multisampled: false };
        entries.push(entry(1 + 2 * unit, ty));
        if layout.has_sampler {
            let kind = match (layout.compares, layout.is_depth) {
                (true, _) => wgpu::SamplerBindingType::Comparison,
                (false, true) => wgpu::SamplerBindingType::NonFiltering,
                (false, false) => wgpu::SamplerBindingType::Filtering,
            };
            entries.push(entry(2 + 2 * unit, wgpu::BindingType::Sampler(kind)));
        }
    }
    entries
}

impl UnitLayout {
    /// A texture's sampler, as far as the program can use it; `None` where one compares and the other does not.
    pub(in crate::draw) fn sampler(&self, given: &Sampler) -> Option<Sampler> {
        if self.has_sampler && self.compares != given.compare.is_some() {
            return None;
        }
        // Depths as they are have nothing between them.
        let nearest = FilterMode::Nearest;
        let is_plain = self.is_depth && !self.compares;
        Some(if is_plain {
            Sampler { min_filter: nearest, mag_filter: nearest, mip_filter: nearest, ..*given }
        } else {
            *given
        })
    }

    /// The sampler where there is no texture.
    pub(in crate::draw) fn own_sampler(&self) -> Sampler {
        let compare = self.compares.then_some(CompareFunction::LessOrEqual);
        let own = Sampler { compare, ..Sampler::default() };
        self.sampler(&own).unwrap_or(own)
    }

    pub(in crate::draw) fn has_sampler(&self) -> bool {
        self.has_sampler
    }
}

pub(super) fn scalar_name(scalar: naga::Scalar) -> &'static str {
    match scalar.kind {
        naga::ScalarKind::Float => "f32",
        naga::ScalarKind::Sint => "i32",
        naga::ScalarKind::Uint => "u32",
        _ => "?",
    }
}

pub(super) fn type_name(module: &naga::Module, ty: naga::Handle<naga::Type>) -> String {
    match &module.types[ty].inner {
        naga::TypeInner::Scalar(scalar) => scalar_name(*scalar).into(),
        naga::TypeInner::Vector { size, scalar } => format!("vec{}<{}>", *size as u8, scalar_name(*scalar)),
        naga::TypeInner::Matrix { columns, rows, scalar } => {
            format!("mat{}x{}<{}>", *columns as u8, *rows as u8, scalar_name(*scalar))
        }
        naga::TypeInner::Array { base, .. } => format!("array<{}>", type_name(module, *base)),
        _ => "?".into(),
    }
}

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

impl Compiled {
    /// Appends the uniforms of a state; what does not fit stays zero and is named the first time (by the caller).
    pub(in crate::draw) fn fill(
        &self,
        state: &ResolvedState,
        builtins: &Builtins,
        bytes: &mut [u8],
    ) -> Result<(), String> {
        let mut misfit = None;
        for member in &self.members {
            let Some(place) = bytes.get_mut(member.offset..member.offset + member.size) else { continue };
            match state.uniform(&member.name) {
                Some(uniform) if uniform.value.type_name() == member.type_name => {
                    let (values, column, stride) = uniform.value.columns();
                    for (value, place) in values.chunks(column).zip(place.chunks_mut(stride)) {
                        let count = value.len().min(place.len());
                        place[..count].copy_from_slice(&value[..count]);
                    }
                }
                Some(uniform) => {
                    let (given, wanted) = (uniform.value.type_name(), &member.type_name);
                    misfit.get_or_insert_with(|| format!("uniform {} is {given} instead of {wanted}", member.name));
                }
                None => builtins.fill(&member.name, place),
            }
        }
        misfit.map_or(Ok(()), Err)
    }
}

impl Builtins {
    fn fill(&self, name: &str, place: &mut [u8]) {
        let value: &[u8] = match name {
            "osg_FrameNumber" => bytemuck::bytes_of(&self.frame),
            "osg_FrameTime" => bytemuck::bytes_of(&self.frame_time_s),
            "osg_DeltaFrameTime" => bytemuck::bytes_of(&self.delta_frame_time_s),
            "osg_SimulationTime" => bytemuck::bytes_of(&self.simulation_time_s),
            "osg_ViewMatrix" => bytemuck::bytes_of(&self.view),
            "osg_ViewMatrixInverse" => bytemuck::bytes_of(&self.view_inverse),
            _ => return,
        };
        if place.len() == value.len() {
            place.copy_from_slice(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    const FRAGMENT: &str = "@fragment fn fs_main() -> @location(0) vec4<f32> { return vec4<f32>(1.0); }";

    #[test]
    fn places_of_programs_that_nobody_has_are_used_again() {
        let traits = ContextTraits { adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let vertex = "@vertex fn vs_main(v: MeshVertex) -> @builtin(position) vec4<f32> { return vec4<f32>(1.0); }";
        let program = |wgsl: String| Arc::new(Program { name: "p".into(), wgsl, defines: Vec::new() });
        let whole = || program(format!("{vertex}{FRAGMENT}"));
        let mut programs = Programs::default();
        let [first, second] = [whole(), whole()];
        assert_eq!(programs.ensure(ctx.device(), &first), Ok(Some(0)));
        assert_eq!(programs.ensure(ctx.device(), &second), Ok(Some(1)));
        let broken = program(FRAGMENT.into());
        assert!(programs.ensure(ctx.device(), &broken).is_err());
        assert_eq!(programs.ensure(ctx.device(), &broken), Ok(None));
        assert!(programs.prune().is_empty());
        drop((first, broken));
        assert_eq!(programs.prune(), [0, 2]);
        assert_eq!(programs.place_of.len(), 1);
        assert!(programs.get(0).is_none() && programs.get(1).is_some());
        let third = whole();
        assert_eq!(programs.ensure(ctx.device(), &third), Ok(Some(0)));
        assert_eq!(programs.ensure(ctx.device(), &second), Ok(Some(1)));
    }

    #[test]
    fn programs_of_meshes_become_those_of_height_tiles() {
        let simple = format!(
            "// fn vs_main is below\n@vertex\n  fn vs_main(vertex: MeshVertex, @builtin(instance_index) instance: u32) -> \
             @builtin(position) vec4<f32> {{\n return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[instance], \
             vertex.position), 1.0);\n}}\n{FRAGMENT}"
        );
        assert_eq!(heights_source(&simple).unwrap_err(), "`@vertex` does not stand right before `fn vs_main`");
        let simple = simple.replace("// fn vs_main is below", "fn vs_main_helper() {}");
        let source = heights_source(&simple).unwrap();
        assert!(source.contains("return vs_main(height_vertex(index, instance), instance);"));
        let varying = "struct Out { @builtin(position) p: vec4<f32>, @location(0) n: vec3<f32> }
            @vertex fn vs_main(@builtin(instance_index) i: u32, @builtin(vertex_index) v: u32, m: MeshVertex) -> Out {
                return Out(vec4<f32>(f32(i), f32(v), 0.0, 1.0), m.normal.xyz);
            }";
        heights_source(&format!("{varying}{FRAGMENT}")).unwrap();
        let own_inputs = "@vertex fn vs_main(@location(0) p: vec3<f32>) -> @builtin(position) vec4<f32> {
            return vec4<f32>(p, 1.0); }";
        let said = heights_source(&format!("{own_inputs}{FRAGMENT}")).unwrap_err();
        assert!(said.contains("other than MeshVertex"), "{said}");
        // A name that the tiles' own shader has.
        let said = heights_source(&format!("fn height_at() {{}} {varying}{FRAGMENT}")).unwrap_err();
        assert!(said.contains("height_at"), "{said}");
    }
}
