//! Pipelines, made when first needed: a software adapter takes a third of a second for each at its first draw.

mod bare;
pub(in crate::draw) mod convert;
pub(in crate::draw) mod key;
pub(in crate::draw) mod programs;
mod sources;
mod variant;

use std::collections::HashMap;

use crate::draw::pipelines::key::{
    AirKind, Alpha, Kind, MOST_TARGETS, PartIndices, Parts, PipelineKey, Shading, StateKey,
};
use crate::draw::pipelines::programs::{HEIGHT_ENTRY, Programs};
use bare::BARE;
pub(in crate::draw) use bare::Bare;
pub use sources::DRAWABLE_PRELUDE;
use sources::*;
pub(in crate::draw) use sources::{HEIGHT_PROGRAM_PRELUDE, PROGRAM_PRELUDE};
use variant::Variant;

use convert::{bias, factor, operation, reversed, stencil_face};

use crate::gpu::{GraphicsContext, VertexFormat};
pub(in crate::draw) use crate::gpu::{MOST_COLORS, TargetFormats};
use crate::state::{PolygonMode, ResolvedState, TEXTURE_UNITS};

/// Attributes of vertices of each format, and of the one white that packed and quantized ones share.
const OF_FULL: [wgpu::VertexAttribute; 4] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x2, 2 => Snorm8x4, 3 => Unorm8x4];
const OF_PACKED: [wgpu::VertexAttribute; 3] = wgpu::vertex_attr_array![0 => Float32x3, 1 => Unorm16x2, 2 => Snorm8x4];
const OF_QUANTIZED: [wgpu::VertexAttribute; 3] =
    wgpu::vertex_attr_array![0 => Unorm16x4, 1 => Unorm16x2, 2 => Snorm8x4];
const OF_WHITE: [wgpu::VertexAttribute; 1] = wgpu::vertex_attr_array![3 => Unorm8x4];

/// More pipelines than this are not kept where some are not drawn with.
const MOST_KEPT: usize = 1024;
/// What was drawn with in so many frames stays, however many there are.
const UNUSED_FRAMES: u32 = 300;
/// So many are let go in a frame.
const DROPPED_A_FRAME: usize = 32;

/// A pipeline, and the frame in which it was last drawn with.
struct Made {
    pipeline: wgpu::RenderPipeline,
    used: u32,
}

/// Pipelines of a renderer, by key.
pub(in crate::draw) struct Pipelines {
    pub(in crate::draw) frame_layout: wgpu::BindGroupLayout,
    /// Group 2 of the fixed function without and with texture units.
    pub(in crate::draw) fixed_layout: wgpu::BindGroupLayout,
    pub(in crate::draw) textured_layout: wgpu::BindGroupLayout,
    /// Group 3 of pulled meshes: vertices and indices.
    pub(in crate::draw) pull_layout: wgpu::BindGroupLayout,
    pub(in crate::draw) programs: Programs,
    /// `None` where one was let go.
    pipelines: Vec<Option<Made>>,
    free: Vec<u32>,
    /// Counts on with each [`Self::start_frame`].
    frame: u32,
    /// Only looked up, never walked while anything is drawn.
    index_of: HashMap<PipelineKey, u32>,
    parts: Parts,
    targets: Vec<TargetFormats>,
    /// Of each target, in the order of [`Bare`]; of what was tried, `None` where it cannot be made.
    bare: Vec<[Option<Option<wgpu::RenderPipeline>>; BARE]>,
    /// Modules by the address of their source.
    modules: Vec<(&'static str, wgpu::ShaderModule)>,
    features: wgpu::Features,
    created: u32,
    /// What could not be made, once each.
    pub(in crate::draw) errors: Vec<String>,
}

impl Pipelines {
    pub(in crate::draw) fn new(ctx: &GraphicsContext) -> Self {
        let device = ctx.device();
        let buffer = |binding, visibility, ty, has_dynamic_offset| wgpu::BindGroupLayoutEntry {
            binding,
            visibility,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None },
            count: None,
        };
        let both = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let uniform = wgpu::BufferBindingType::Uniform;
        let bare = [buffer(0, both, uniform, true)];
        let mut fixed = bare.to_vec();
        let planes = [wgpu::TextureViewDimension::D2; TEXTURE_UNITS];
        let others =
            [wgpu::TextureViewDimension::Cube, wgpu::TextureViewDimension::D3, wgpu::TextureViewDimension::D2Array];
        for (unit, view_dimension) in (0u32..).zip(planes.into_iter().chain(others)) {
            let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty,
                count: None,
            };
            let sample_type = wgpu::TextureSampleType::Float { filterable: true };
            let texture = wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false };
            fixed.push(entry(1 + 2 * unit, texture));
            fixed.push(entry(2 + 2 * unit, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)));
        }
        let textured_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("fixed function with textures"),
            entries: &fixed,
        });
        let fixed_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("fixed function"),
            entries: &bare,
        });
        let storage = wgpu::BufferBindingType::Storage { read_only: true };
        let pull_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("pulled meshes"),
            entries: &[
                buffer(0, wgpu::ShaderStages::VERTEX, storage, false),
                buffer(1, wgpu::ShaderStages::VERTEX, storage, false),
            ],
        });
        Self {
            frame_layout: ctx.layouts().frame.clone(),
            fixed_layout,
            textured_layout,
            pull_layout,
            programs: Programs::default(),
            pipelines: Vec::new(),
            free: Vec::new(),
            frame: 0,
            index_of: HashMap::new(),
            parts: Parts::default(),
            targets: Vec::new(),
            bare: Vec::new(),
            modules: Vec::new(),
            features: device.features(),
            created: 0,
            errors: Vec::new(),
        }
    }

    /// Pipelines made so far.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.created
    }

    /// A pipeline by the index that [`Self::ensure`] gave.
    pub(in crate::draw) fn pipeline(&self, index: u32) -> Option<&wgpu::RenderPipeline> {
        self.pipelines.get(index as usize)?.as_ref().map(|made| &made.pipeline)
    }

    /// The pipeline part of a state.
    pub(in crate::draw) fn state_key(&mut self, state: &ResolvedState, shading: Shading, target: u8) -> StateKey {
        let (parts, changed) = self.parts.of(state, self.frame, &mut self.errors);
        if changed != PartIndices::default() {
            self.forget(|key| changed.meets(*key));
        }
        StateKey::new(state, parts, shading, target)
    }

    /// The index of a target; `None` when there are too many different ones.
    pub(in crate::draw) fn target(&mut self, key: &TargetFormats) -> Option<u8> {
        let place = match self.targets.iter().position(|t| t == key) {
            Some(place) => place,
            None if self.targets.len() < MOST_TARGETS => {
                self.targets.push(*key);
                self.bare.push([const { None }; BARE]);
                self.targets.len() - 1
            }
            None => return None,
        };
        Some(place as u8)
    }

    pub(in crate::draw) fn target_key(&self, target: u8) -> Option<&TargetFormats> {
        self.targets.get(usize::from(target))
    }

    fn module(&mut self, ctx: &GraphicsContext, label: &str, source: &'static str) -> wgpu::ShaderModule {
        if let Some((_, module)) = self.modules.iter().find(|(s, _)| std::ptr::eq(*s, source)) {
            return module.clone();
        }
        let module = ctx.device().create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(label),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        self.modules.push((source, module.clone()));
        module
    }

    /// The index of a key's pipeline; makes it unless it is there.
    pub(in crate::draw) fn ensure(&mut self, ctx: &GraphicsContext, key: PipelineKey) -> u32 {
        if let Some(index) = self.index_of.get(&key) {
            if let Some(Some(made)) = self.pipelines.get_mut(*index as usize) {
                made.used = self.frame;
            }
            return *index;
        }
        let made = self.make(ctx, key);
        self.created += 1;
        let index = match made {
            Some(pipeline) => self.keep(pipeline),
            // Drawn otherwise, so that the fault is seen; nothing at all where that cannot be made either.
            None if key.fallback() != key => self.ensure(ctx, key.fallback()),
            None => u32::MAX,
        };
        self.index_of.insert(key, index);
        index
    }

    fn keep(&mut self, pipeline: wgpu::RenderPipeline) -> u32 {
        let made = Some(Made { pipeline, used: self.frame });
        if let Some(index) = self.free.pop() {
            self.pipelines[index as usize] = made;
            return index;
        }
        self.pipelines.push(made);
        self.pipelines.len() as u32 - 1
    }

    /// Before a frame, as what is drawn holds its programs: lets what nobody needs any more go. Whether programs were among
    /// it.
    pub(in crate::draw) fn start_frame(&mut self) -> bool {
        self.frame = self.frame.wrapping_add(1);
        self.drop_unused(MOST_KEPT, UNUSED_FRAMES);
        let gone = self.programs.prune();
        if gone.is_empty() {
            return false;
        }
        self.forget(|key| matches!(key.shading(), Shading::Program(place) if gone.contains(&place)));
        true
    }

    /// Lets the pipelines of some keys go.
    fn forget(&mut self, is_gone: impl Fn(&PipelineKey) -> bool) {
        let removed: Vec<u32> = self.index_of.extract_if(|key, _| is_gone(key)).map(|(_, index)| index).collect();
        for index in removed {
            // What could not be made has another key's, or none.
            if let Some(made) = self.pipelines.get_mut(index as usize)
                && !self.index_of.values().any(|of_other| *of_other == index)
                && made.take().is_some()
            {
                self.free.push(index);
            }
        }
    }

    /// Of more than `most`, a few of those that were not drawn with for so many frames.
    fn drop_unused(&mut self, most: usize, frames: u32) {
        let over = (self.pipelines.len() - self.free.len()).saturating_sub(most);
        if over == 0 {
            return;
        }
        let is_unused = |made: &Made| self.frame.wrapping_sub(made.used) > frames;
        let unused = (0u32..).zip(&self.pipelines).filter(|(_, made)| made.as_ref().is_some_and(is_unused));
        let dropped: Vec<u32> = unused.map(|(index, _)| index).take(over.min(DROPPED_A_FRAME)).collect();
        self.index_of.retain(|_, index| !dropped.contains(index));
        for index in dropped {
            self.pipelines[index as usize] = None;
            self.free.push(index);
        }
    }

    fn make(&mut self, ctx: &GraphicsContext, key: PipelineKey) -> Option<wgpu::RenderPipeline> {
        let is_height = key.kind() == Kind::Height;
        let is_thin = matches!(key.kind(), Kind::Lines | Kind::Points);
        let target = self.targets.get(key.target()).copied()?;
        let layouts = ctx.layouts();
        let (fixed_layout, textured_layout) = (self.fixed_layout.clone(), self.textured_layout.clone());
        let pull_layout = key.is_pulled().then(|| self.pull_layout.clone());
        let (is_caster, has_shadows) = (key.is_caster(), key.has_shadows());
        // Only casters that drop parts of what they cast have a fragment shader.
        let mut discards = is_caster;
        let (module, vertex, fragment, state_layout, constants, outputs);
        match key.shading() {
            Shading::Program(place) => {
                if is_height && let Err(problem) = self.programs.ensure_heights(ctx.device(), place) {
                    self.errors.push(problem);
                }
                let program = self.programs.get(place)?;
                (module, vertex, fragment) = if is_height {
                    (program.heights.clone()?, HEIGHT_ENTRY, "fs_main")
                } else {
                    (program.module.clone(), "vs_main", "fs_main")
                };
                discards &= program.discards;
                (state_layout, outputs) = (Some(program.layout.clone()), program.outputs);
                constants = program.constants.clone();
            }
            Shading::FixedFunction | Shading::FixedTextured => {
                let is_textured = key.shading() == Shading::FixedTextured;
                let (height, mesh, layout) = match (is_textured, has_shadows) {
                    (true, false) => (TEXTURED_HEIGHT_WGSL, TEXTURED_MESH_WGSL, textured_layout),
                    (true, true) => (SHADOWED_TEXTURED_HEIGHT_WGSL, SHADOWED_TEXTURED_MESH_WGSL, textured_layout),
                    (false, false) => (FIXED_HEIGHT_WGSL, FIXED_MESH_WGSL, fixed_layout),
                    (false, true) => (SHADOWED_FIXED_HEIGHT_WGSL, SHADOWED_FIXED_MESH_WGSL, fixed_layout),
                };
                let vertex_of_mesh = if key.is_pulled() { "vs_fixed_mesh_pulled" } else { "vs_fixed_mesh" };
                let [of_height, of_mesh] = match is_caster {
                    true => ["fs_fixed_height_caster", "fs_fixed_mesh_caster"],
                    false => ["fs_fixed_height", "fs_fixed_mesh"],
                };
                (module, vertex, fragment) = match key.kind() {
                    Kind::Height => (self.module(ctx, "fixed height", height), "vs_fixed_height", of_height),
                    Kind::Triangles => (self.module(ctx, "fixed mesh", mesh), vertex_of_mesh, of_mesh),
                    _ => (self.module(ctx, "fixed mesh", mesh), "vs_fixed_mesh", "fs_fixed_thin"),
                };
                (state_layout, outputs, constants) = (Some(layout), 1, Vec::new());
            }
            Shading::Fallback => {
                let vertex_of_mesh = if key.is_pulled() { "vs_mesh_pulled" } else { "vs_mesh" };
                (module, vertex, fragment) = (self.module(ctx, "mesh", MESH_WGSL), vertex_of_mesh, "fs_fallback");
                discards = false;
                (state_layout, outputs, constants) = (None, 1, Vec::new());
            }
            Shading::Plain if is_caster => {
                let (source, label) = if is_height {
                    (SHADOWED_HEIGHT_WGSL, "shadowed height")
                } else {
                    (SHADOWED_MESH_WGSL, "shadowed mesh")
                };
                discards = key.alpha() == Alpha::Masked;
                (module, fragment) = (self.module(ctx, label, source), "fs_mesh_caster_masked");
                vertex = match () {
                    _ if is_height => "vs_height_caster",
                    _ if discards => "vs_mesh_caster_masked",
                    _ if key.is_pulled() => "vs_mesh_caster_pulled",
                    _ => "vs_mesh_caster",
                };
                (state_layout, outputs, constants) = (None, 1, Vec::new());
            }
            Shading::Plain => {
                let has_alpha = key.has_alpha_to_coverage();
                let vertex_of_mesh = if key.is_pulled() { "vs_mesh_pulled" } else { "vs_mesh" };
                (module, vertex) = match (is_height, has_shadows) {
                    (true, false) => (self.module(ctx, "height", HEIGHT_WGSL), "vs_height"),
                    (true, true) => (self.module(ctx, "shadowed height", SHADOWED_HEIGHT_WGSL), "vs_height_shadowed"),
                    (false, false) => (self.module(ctx, "mesh", MESH_WGSL), vertex_of_mesh),
                    (false, true) => (self.module(ctx, "shadowed mesh", SHADOWED_MESH_WGSL), vertex_of_mesh),
                };
                fragment = match (key.kind(), key.alpha()) {
                    (Kind::Height, _) if has_shadows => "fs_height_shadowed",
                    (Kind::Height, _) => "fs_height",
                    _ if is_thin => "fs_thin",
                    (_, Alpha::Masked) => "fs_mesh_masked",
                    (_, Alpha::MaskedBlended) => "fs_mesh_masked_blended",
                    (_, Alpha::Opaque) if !has_alpha => "fs_mesh",
                    _ => "fs_mesh_blended",
                };
                (state_layout, outputs, constants) = (None, 1, Vec::new());
            }
        }
        let mut constants: Vec<(&str, f64)> = constants.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        constants.extend_from_slice(match key.air() {
            AirKind::Atmosphere => &[],
            AirKind::Haze => &[("HAS_ATMOSPHERE", 0.0)],
            AirKind::Clear => &[("HAS_ATMOSPHERE", 0.0), ("HAS_HAZE", 0.0)],
        });
        let has_alpha = key.alpha() == Alpha::Blended || key.has_alpha_to_coverage();
        if has_alpha && matches!(fragment, "fs_height" | "fs_height_shadowed") {
            constants.push(("HAS_ALPHA", 1.0));
        }
        let fragment = if key.is_fading() { fading(fragment) } else { fragment };
        let topology = match key.kind() {
            Kind::Height | Kind::Triangles => wgpu::PrimitiveTopology::TriangleList,
            Kind::Lines => wgpu::PrimitiveTopology::LineList,
            Kind::Points => wgpu::PrimitiveTopology::PointList,
        };
        let layout = |array_stride, attributes| {
            Some(wgpu::VertexBufferLayout { array_stride, step_mode: wgpu::VertexStepMode::Vertex, attributes })
        };
        let of = |format: VertexFormat, attributes| layout(format.stride() as u64, attributes);
        let full = [of(VertexFormat::Full, &OF_FULL)];
        // The color is one for all.
        let packed = [of(VertexFormat::Packed, &OF_PACKED), layout(0, &OF_WHITE)];
        let quantized = [of(VertexFormat::Quantized, &OF_QUANTIZED), layout(0, &OF_WHITE)];
        let mut write_mask = wgpu::ColorWrites::from_bits_truncate(key.color_mask() as u32);
        write_mask.set(wgpu::ColorWrites::ALPHA, target.keeps_alpha);
        let mut label = format!("{fragment} of target {}", key.target());
        if let Shading::Program(place) = key.shading() {
            label = format!("program {place}, {label}");
        }
        let variant = Variant {
            label: &label,
            shader: &module,
            vertex,
            fragment,
            block_layout: Some(if is_height { &layouts.height_block } else { &layouts.texture_block }),
            state_layout: state_layout.as_ref(),
            pull_layout: pull_layout.as_ref(),
            constants: &constants,
            buffers: match key.vertices() {
                _ if is_height => &[],
                None => &[],
                Some(VertexFormat::Full) => &full,
                Some(VertexFormat::Packed) => &packed,
                Some(VertexFormat::Quantized) => &quantized,
            },
            topology,
            culled: match key.culled() {
                1 => Some(wgpu::Face::Back),
                2 => Some(wgpu::Face::Front),
                // Both faces are culled by never passing the depth test.
                _ => None,
            },
            front_face: if key.is_clockwise() { wgpu::FrontFace::Cw } else { wgpu::FrontFace::Ccw },
            polygon_mode: self.polygon_mode(key.polygon_mode()),
            depth_write: key.writes_depth(),
            depth_compare: if key.culled() == 3 { wgpu::CompareFunction::Never } else { reversed(key.depth_compare()) },
            stencil: self.stencil_state(key.stencil(), target.depth),
            bias: bias(self.parts.offsets.get(key.offset()).unwrap_or_default()),
            blend: self.parts.blends.get(key.blend()).map(|(func, equation)| {
                let operation = operation(equation);
                // The lesser and the greater are of the colours as they are: OpenGL does not look at factors then.
                let ignores_factors = matches!(operation, wgpu::BlendOperation::Min | wgpu::BlendOperation::Max);
                let factor = |of| if ignores_factors { wgpu::BlendFactor::One } else { factor(of) };
                let component = |source, destination| wgpu::BlendComponent {
                    src_factor: factor(source),
                    dst_factor: factor(destination),
                    operation,
                };
                wgpu::BlendState {
                    color: component(func.source, func.destination),
                    alpha: component(func.source_alpha, func.destination_alpha),
                }
            }),
            write_mask,
            outputs,
            alpha_to_coverage: key.has_alpha_to_coverage() && target.samples > 1,
            discards,
            unclipped_depth: is_caster && self.features.contains(wgpu::Features::DEPTH_CLIP_CONTROL),
            target,
        };
        self.create(ctx, &variant)
    }

    /// What the adapter cannot is filled.
    fn polygon_mode(&self, mode: PolygonMode) -> wgpu::PolygonMode {
        match mode {
            PolygonMode::Line if self.features.contains(wgpu::Features::POLYGON_MODE_LINE) => wgpu::PolygonMode::Line,
            PolygonMode::Point if self.features.contains(wgpu::Features::POLYGON_MODE_POINT) => {
                wgpu::PolygonMode::Point
            }
            _ => wgpu::PolygonMode::Fill,
        }
    }

    /// Nothing where the target has no stencil.
    fn stencil_state(&self, index: u8, depth: wgpu::TextureFormat) -> wgpu::StencilState {
        match self.parts.stencils.get(index).filter(|_| depth.has_stencil_aspect()) {
            None => wgpu::StencilState::default(),
            Some(stencil) => wgpu::StencilState {
                front: stencil_face(&stencil.front),
                back: stencil_face(&stencil.back),
                read_mask: u32::from(stencil.read_mask),
                write_mask: u32::from(stencil.write_mask),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::uniforms::fixed::{FixedUniform, StageLight, StageUniform};
    use crate::draw::uniforms::frame::{FrameUniform, LeafUniform};
    use crate::gpu::{AdapterChoice, ContextTraits};
    use crate::state::{Attribute, PolygonOffset, StateSet};

    fn parse(name: &str, source: &str) -> naga::Module {
        let module =
            naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(source)));
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .unwrap_or_else(|e| panic!("{name}: {e:?}"));
        module
    }

    fn members(module: &naga::Module, name: &str) -> (u32, Vec<(String, u32)>) {
        let found = module.types.iter().find_map(|(_, ty)| match &ty.inner {
            naga::TypeInner::Struct { members, span } if ty.name.as_deref() == Some(name) => {
                let members = members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset)).collect();
                Some((*span, members))
            }
            _ => None,
        });
        found.unwrap_or_else(|| panic!("no struct {name}"))
    }

    macro_rules! offsets {
        ($ty:ty: $($field:ident),*) => { vec![$((stringify!($field).to_string(), std::mem::offset_of!($ty, $field) as u32)),*] };
    }

    #[test]
    fn of_many_those_not_drawn_with_go() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut pipelines = Pipelines::new(&ctx);
        let mut colors = [None; MOST_COLORS];
        colors[0] = Some(wgpu::TextureFormat::Rgba8Unorm);
        let formats = TargetFormats { colors, depth: crate::gpu::DEPTH_FORMAT, samples: 1, keeps_alpha: false };
        let target = pipelines.target(&formats).unwrap();
        let keys: Vec<PipelineKey> = (0..20)
            .map(|i| {
                let offset = PolygonOffset { factor: 1.0, units: i as f32 };
                let set = StateSet::default().with(Attribute::PolygonOffset(offset));
                let state = ResolvedState::default().below(&set);
                PipelineKey::height(&pipelines.state_key(&state, Shading::Plain, target), false)
            })
            .collect();
        let there = |pipelines: &Pipelines| pipelines.pipelines.iter().flatten().count();
        for frame in 0..30 {
            pipelines.frame += 1;
            pipelines.drop_unused(10, 5);
            // All in the first frame, half of them in all.
            keys[if frame == 0 { 0 } else { 10 }..].iter().for_each(|key| _ = pipelines.ensure(&ctx, *key));
            assert_eq!(there(&pipelines), if frame < 6 { 20 } else { 10 }, "{frame}");
        }
        assert_eq!((pipelines.index_of.len(), pipelines.created()), (10, 20));
        // One that is wanted again takes a free place.
        let index = pipelines.ensure(&ctx, keys[3]);
        assert!(index < 20 && pipelines.pipeline(index).is_some() && there(&pipelines) == 11);
        // More than are kept stay while they are drawn with.
        for _ in 0..30 {
            pipelines.frame += 1;
            keys.iter().for_each(|key| _ = pipelines.ensure(&ctx, *key));
            pipelines.drop_unused(10, 5);
        }
        assert_eq!((there(&pipelines), pipelines.created()), (20, 30));
    }

    /// An offset that moves in every frame.
    #[test]
    fn parts_that_nothing_is_drawn_with_make_room() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut pipelines = Pipelines::new(&ctx);
        let mut colors = [None; MOST_COLORS];
        colors[0] = Some(wgpu::TextureFormat::Rgba8Unorm);
        let formats = TargetFormats { colors, depth: crate::gpu::DEPTH_FORMAT, samples: 1, keeps_alpha: false };
        let target = pipelines.target(&formats).unwrap();
        for frame in 0..200 {
            pipelines.start_frame();
            for units in [-1.0, 1.0 + frame as f32] {
                let set = StateSet::default().with(Attribute::PolygonOffset(PolygonOffset { factor: 1.0, units }));
                let state = ResolvedState::default().below(&set);
                let key = pipelines.state_key(&state, Shading::Plain, target);
                pipelines.ensure(&ctx, PipelineKey::height(&key, false));
            }
        }
        assert_eq!((pipelines.created(), pipelines.pipelines.iter().flatten().count()), (201, 63));
        assert!(pipelines.errors.is_empty(), "{:?}", pipelines.errors);
    }

    #[test]
    fn shaders_are_valid_and_their_structs_are_mirrored() {
        let all = [
            ("height", HEIGHT_WGSL),
            ("mesh", MESH_WGSL),
            ("fixed height", FIXED_HEIGHT_WGSL),
            ("fixed mesh", FIXED_MESH_WGSL),
            ("fixed height with textures", TEXTURED_HEIGHT_WGSL),
            ("fixed mesh with textures", TEXTURED_MESH_WGSL),
            ("sky", SKY_WGSL),
            ("water", WATER_WGSL),
            ("query", QUERY_WGSL),
            ("fill", FILL_WGSL),
            ("program", PROGRAM_PRELUDE),
            ("program of height tiles", HEIGHT_PROGRAM_PRELUDE),
            ("drawable", DRAWABLE_PRELUDE),
            ("shadowed height", SHADOWED_HEIGHT_WGSL),
            ("shadowed mesh", SHADOWED_MESH_WGSL),
            ("fixed height with shadows", SHADOWED_FIXED_HEIGHT_WGSL),
            ("fixed mesh with shadows", SHADOWED_FIXED_MESH_WGSL),
            ("fixed height with textures and shadows", SHADOWED_TEXTURED_HEIGHT_WGSL),
            ("fixed mesh with textures and shadows", SHADOWED_TEXTURED_MESH_WGSL),
            ("shadowed water", SHADOWED_WATER_WGSL),
        ];
        parse("atmosphere", crate::draw::atmosphere::ATMOSPHERE_WGSL);
        for (name, source) in all {
            let module = parse(name, source);
            let (span, fields) = members(&module, "Frame");
            assert_eq!(span as usize, size_of::<FrameUniform>(), "{name}");
            assert_eq!(
                fields,
                offsets!(FrameUniform: clip_from_eye, sun_direction, sun_color, ambient_color, up, horizon_color,
                    shape, ray, water, air, sun_top, shadow_x, shadow_y, shadow, cascade_scales, cascade_offsets)
            );
            let (span, fields) = members(&module, "Leaf");
            assert_eq!(span as usize, size_of::<LeafUniform>(), "{name}");
            let rows = std::mem::offset_of!(LeafUniform, eye_from_drawable) as u32;
            assert_eq!(fields[..3].iter().map(|f| f.1).collect::<Vec<_>>(), [rows, rows + 16, rows + 32]);
            assert_eq!(fields[3..], offsets!(LeafUniform: color, layer, flags, alpha_cutoff, side));
            let (span, fields) = members(&module, "Stage");
            assert_eq!(span as usize, size_of::<StageUniform>(), "{name}");
            assert_eq!(fields, offsets!(StageUniform: lights, clip_planes));
            let (span, fields) = members(&module, "StageLight");
            assert_eq!(span as usize, size_of::<StageLight>(), "{name}");
            assert_eq!(fields, offsets!(StageLight: position, direction, ambient, diffuse, specular, attenuation));
            if name.starts_with("fixed") {
                let (span, fields) = members(&module, "Fixed");
                assert_eq!(span as usize, size_of::<FixedUniform>(), "{name}");
                assert_eq!(
                    fields,
                    offsets!(FixedUniform: ambient, diffuse, specular, emission, fog_color, fog, model_ambient, flags,
                        units, texgens, bias, planes)
                );
            }
        }
    }

    #[test]
    fn constants_are_mirrored() {
        let header = crate::gpu::TABLE_HEADER_VECTORS;
        assert!(HEIGHT_WGSL.contains(&format!("const HEADER: u32 = {header}u;")));
        assert!(HEIGHT_WGSL.contains(&format!("n <= {}u", crate::gpu::MORPH_LEVELS)));
        use crate::draw::uniforms::frame::{BAND_SHIFT, FLAG_UNLIT, FLAG_UNTEXTURED};
        assert!(MESH_WGSL.contains(&format!("const BAND_SHIFT: u32 = {BAND_SHIFT}u;")));
        for source in [HEIGHT_WGSL, MESH_WGSL, FIXED_HEIGHT_WGSL, FIXED_MESH_WGSL, SHADOWED_HEIGHT_WGSL] {
            let entries = parse("fading", source).entry_points;
            let fragments = entries.iter().filter(|e| e.stage == naga::ShaderStage::Fragment);
            for name in fragments
                .map(|e| e.name.as_str())
                .filter(|n| !n.ends_with("_fading") && !n.contains("_caster") && *n != "fs_fallback")
            {
                let name = match name {
                    "fs_height" => fading("fs_height"),
                    "fs_height_shadowed" => fading("fs_height_shadowed"),
                    "fs_mesh" => fading("fs_mesh"),
                    "fs_mesh_masked" => fading("fs_mesh_masked"),
                    "fs_mesh_blended" => fading("fs_mesh_blended"),
                    "fs_mesh_masked_blended" => fading("fs_mesh_masked_blended"),
                    "fs_thin" => fading("fs_thin"),
                    "fs_fixed_height" => fading("fs_fixed_height"),
                    "fs_fixed_mesh" => fading("fs_fixed_mesh"),
                    "fs_fixed_thin" => fading("fs_fixed_thin"),
                    other => panic!("{other} does not fade"),
                };
                assert!(entries.iter().any(|e| e.name == name), "{name}");
            }
        }
        assert!(MESH_WGSL.contains(&format!("const FLAG_UNLIT: u32 = {FLAG_UNLIT}u;")));
        assert!(MESH_WGSL.contains(&format!("const FLAG_UNTEXTURED: u32 = {FLAG_UNTEXTURED}u;")));
        let shift = crate::draw::uniforms::frame::INDEX_COUNT_SHIFT;
        assert!(MESH_WGSL.contains(&format!("const INDEX_COUNT_SHIFT: u32 = {shift}u;")));
        assert_eq!(VertexFormat::Full.stride(), 7 * 4);
    }
}
