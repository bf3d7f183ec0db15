//! Creates the pipeline of a key. Draw thread.

use super::builder::{PipelineBuilder, ShaderSource, Variant, VertexBuffer};
use super::convert::{bias, factor, operation, reversed, stencil_face};
use super::custom_attributes::{AttributeLayouts, bind_attributes, further_uvs};
use super::key::{AirKind, Alpha, Kind, PipelineKey, Shading};
use super::key_parts::{Blending, PartIndices, Parts};
use super::programs::{HEIGHT_ENTRY, Programs};
use super::shader_choice::ShaderChoice;
use super::target_table::TargetTable;
use crate::gpu::{GraphicsContext, VertexFormat};
use crate::scene::{AttributeLayout, added_stride};
use crate::state::{BlendEquation, BlendFunc, COLOR_LOCATIONS, PolygonMode, ResolvedState, TEXTURE_UNITS};

/// The attributes of each vertex format, and of the one colour that packed and quantized vertices share.
const FULL_ATTRIBUTES: [wgpu::VertexAttribute; 4] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x2, 2 => Snorm8x4, 3 => Unorm8x4];
const PACKED_ATTRIBUTES: [wgpu::VertexAttribute; 3] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Unorm16x2, 2 => Snorm8x4];
const QUANTIZED_ATTRIBUTES: [wgpu::VertexAttribute; 3] =
    wgpu::vertex_attr_array![0 => Unorm16x4, 1 => Unorm16x2, 2 => Snorm8x4];
const SHARED_COLOR_ATTRIBUTE: [wgpu::VertexAttribute; 1] = wgpu::vertex_attr_array![3 => Unorm8x4];

/// The layouts of bind groups that the renderer itself declares.
pub(super) struct GroupLayouts {
    /// Group 2 of the fixed function without texture units.
    pub(super) fixed: wgpu::BindGroupLayout,
    /// Group 2 of the fixed function with texture units.
    pub(super) textured: wgpu::BindGroupLayout,
    /// Group 3 of pulled meshes: vertices and indices.
    pub(super) pulled: wgpu::BindGroupLayout,
}

impl GroupLayouts {
    fn new(device: &wgpu::Device) -> Self {
        let layout = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        let buffer = |binding, visibility, ty, has_dynamic_offset| wgpu::BindGroupLayoutEntry {
            binding,
            visibility,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None },
            count: None,
        };
        let both = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let uniforms = buffer(0, both, wgpu::BufferBindingType::Uniform, true);
        let storage = wgpu::BufferBindingType::Storage { read_only: true };
        let vertices = [0, 1].map(|binding| buffer(binding, wgpu::ShaderStages::VERTEX, storage, false));
        let mut textured = vec![uniforms];
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
            textured.push(entry(1 + 2 * unit, texture));
            textured.push(entry(2 + 2 * unit, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)));
        }
        Self {
            textured: layout("fixed function with textures", &textured),
            fixed: layout("fixed function", &[uniforms]),
            pulled: layout("pulled meshes", &vertices),
        }
    }
}

/// The shader of a pipeline, with what follows from it.
struct Shader {
    source: ShaderSource,
    vertex: &'static str,
    fragment: &'static str,
    /// Layout of bind group 2.
    state_layout: Option<wgpu::BindGroupLayout>,
    /// Layout of bind group 3 of a program.
    attribute_layout: Option<wgpu::BindGroupLayout>,
    /// Values of overrides.
    constants: Vec<(String, f64)>,
    /// Bits of the locations that the fragment shader writes.
    outputs: u32,
    discards: bool,
}

/// Creates pipelines from keys. Owns the tables that the indices in keys refer to.
pub(super) struct Factory {
    pub(super) builder: PipelineBuilder,
    pub(super) layouts: GroupLayouts,
    pub(super) attribute_layouts: AttributeLayouts,
    pub(super) targets: TargetTable,
    parts: Parts,
    features: wgpu::Features,
}

impl Factory {
    pub(super) fn new(ctx: &GraphicsContext) -> Self {
        let device = ctx.device();
        Self {
            builder: PipelineBuilder::new(ctx.layouts().frame.clone()),
            layouts: GroupLayouts::new(device),
            attribute_layouts: AttributeLayouts::default(),
            targets: TargetTable::default(),
            parts: Parts::default(),
            features: device.features(),
        }
    }

    /// Returns the indices of a state's parts, and those of them that referred to other values before.
    pub(super) fn intern_parts(&mut self, state: &ResolvedState, frame: u32) -> (PartIndices, PartIndices) {
        self.parts.intern(state, frame, self.builder.errors())
    }

    /// Creates the pipeline of a key. Returns `None` and keeps an error, with the name of the state that needs it, if that
    /// is impossible.
    pub(super) fn create(
        &mut self,
        ctx: &GraphicsContext,
        programs: &mut Programs,
        key: PipelineKey,
        state: Option<&ResolvedState>,
    ) -> Option<wgpu::RenderPipeline> {
        let first_error = self.builder.errors().len();
        let pipeline = self.describe(ctx, programs, key).and_then(|variant| self.builder.create(ctx, &variant));
        self.name_errors(first_error, state);
        pipeline
    }

    /// Puts the name of a state before the errors from an index on.
    pub(super) fn name_errors(&mut self, first: usize, state: Option<&ResolvedState>) {
        let Some(state) = state else { return };
        let name = if state.name.is_empty() { "a state set" } else { state.name.as_str() };
        for error in &mut self.builder.errors()[first..] {
            *error = format!("{name}: {error}");
        }
    }

    /// Returns the properties of the pipeline of a key. Returns `None` and keeps an error if there can be none.
    pub(super) fn describe(
        &mut self,
        ctx: &GraphicsContext,
        programs: &mut Programs,
        key: PipelineKey,
    ) -> Option<Variant> {
        let is_height = key.kind() == Kind::Height;
        let target = *self.targets.formats(key.target())?;
        let layout = self.attribute_layouts.get(key.layout());
        let custom_attributes = match bind_attributes(programs, key, layout) {
            Ok(attributes) => attributes,
            Err(problem) => {
                self.builder.errors().push(problem);
                return None;
            }
        };
        let buffers = vertex_buffers(key, layout, &custom_attributes);
        let shader = match key.shading() {
            Shading::Program(index) => self.program_shader(ctx, programs, index, is_height)?,
            _ => self.own_shader(key)?,
        };
        let mut label = format!("{} of target {}", shader.fragment, key.target());
        if let Shading::Program(index) = key.shading() {
            label = format!("program {:?}, {label}", programs.name(index).unwrap_or_default());
        }
        let blending = self.parts.blending(key.blending());
        let Blending { blends, masks } = blending
            .unwrap_or(Blending { blends: [None; COLOR_LOCATIONS], masks: [key.color_mask(); COLOR_LOCATIONS] });
        let opaque = if target.keeps_alpha { wgpu::ColorWrites::empty() } else { wgpu::ColorWrites::ALPHA };
        let samples = self.parts.samples(key.samples()).filter(|_| target.samples > 1);
        // Both faces are culled by a depth test that never passes. A culled face marks no stencil either.
        let culls_all = key.culled() == 3;
        let block_layout = match () {
            _ if is_height => &ctx.layouts().height_block,
            _ if key.has_layered_surface() => &ctx.layouts().layered_set,
            _ if key.is_splats() => &ctx.layouts().splats,
            _ if key.has_surface() => &ctx.layouts().surface_set,
            _ => &ctx.layouts().texture_block,
        };
        Some(Variant {
            block_layout: Some(block_layout.clone()),
            state_layout: shader.state_layout,
            third_layout: if key.is_pulled() { Some(self.layouts.pulled.clone()) } else { shader.attribute_layout },
            constants: shader.constants,
            buffers,
            topology: topology(key),
            culled: match key.culled() {
                1 => Some(wgpu::Face::Back),
                2 => Some(wgpu::Face::Front),
                _ => None,
            },
            front_face: if key.is_clockwise() { wgpu::FrontFace::Cw } else { wgpu::FrontFace::Ccw },
            polygon_mode: self.polygon_mode(key.polygon_mode()),
            depth_write: key.writes_depth(),
            depth_compare: if culls_all { wgpu::CompareFunction::Never } else { reversed(key.depth_compare()) },
            stencil: self.stencil_state(if culls_all { 0 } else { key.stencil() }, target.depth),
            bias: bias(self.parts.offset(key.offset()).unwrap_or_default()),
            blends: blends.map(|blend| blend.map(|(func, equation)| blend_state(func, equation))),
            write_masks: masks.map(|mask| wgpu::ColorWrites::from_bits_truncate(mask.into()) - opaque),
            sample_mask: samples.map_or(!0, |mask| mask.bits(target.samples).into()),
            outputs: shader.outputs,
            alpha_to_coverage: key.has_alpha_to_coverage() && target.samples > 1,
            discards: shader.discards,
            unclipped_depth: key.is_caster() && self.features.contains(wgpu::Features::DEPTH_CLIP_CONTROL),
            ..Variant::new(label, shader.source, [shader.vertex, shader.fragment], target)
        })
    }

    /// Returns the shader of one of the application's programs; `None` if it cannot be used.
    fn program_shader(
        &mut self,
        ctx: &GraphicsContext,
        programs: &mut Programs,
        index: u16,
        is_height: bool,
    ) -> Option<Shader> {
        if is_height && let Err(problem) = programs.ensure_heights(ctx.device(), index) {
            self.builder.errors().push(problem);
        }
        let program = programs.get(index)?;
        let (module, vertex) = match is_height {
            true => (program.heights.clone()?, HEIGHT_ENTRY),
            false => (program.module.clone(), "vs_main"),
        };
        Some(Shader {
            source: ShaderSource::Module(module),
            vertex,
            fragment: "fs_main",
            state_layout: Some(program.layout.clone()),
            attribute_layout: program.attribute_layout.clone(),
            constants: program.constants.clone(),
            outputs: program.outputs,
            discards: program.discards,
        })
    }

    /// Returns the renderer's own shader for a key.
    fn own_shader(&self, key: PipelineKey) -> Option<Shader> {
        let choice = ShaderChoice::of(key)?;
        let mut constants = Vec::new();
        let mut disable = |name: &str| constants.push((name.to_owned(), 0.0));
        match key.air() {
            AirKind::Atmosphere => {}
            AirKind::Haze => disable("HAS_ATMOSPHERE"),
            AirKind::Clear => ["HAS_ATMOSPHERE", "HAS_HAZE"].into_iter().for_each(&mut disable),
        }
        if key.has_local_lights() {
            constants.push(("HAS_LOCAL_LIGHTS".to_owned(), 1.0));
        }
        if key.combines_textures() {
            constants.push(("HAS_COMBINATIONS".to_owned(), 1.0));
        }
        let uses_alpha = key.alpha() == Alpha::Blended || key.has_alpha_to_coverage();
        if uses_alpha && choice.fragment.has_alpha_override() {
            constants.push(("HAS_ALPHA".to_owned(), 1.0));
        }
        Some(Shader {
            source: ShaderSource::Own(choice.label, choice.source),
            vertex: choice.vertex.name(),
            fragment: choice.fragment.name(key.is_fading()),
            state_layout: match key.shading() {
                Shading::FixedFunction => Some(self.layouts.fixed.clone()),
                Shading::FixedTextured => Some(self.layouts.textured.clone()),
                _ => None,
            },
            attribute_layout: None,
            constants,
            outputs: 1,
            discards: choice.discards,
        })
    }

    /// Returns the polygon mode; triangles are filled if the adapter lacks it.
    fn polygon_mode(&self, mode: PolygonMode) -> wgpu::PolygonMode {
        match mode {
            PolygonMode::Line if self.features.contains(wgpu::Features::POLYGON_MODE_LINE) => wgpu::PolygonMode::Line,
            PolygonMode::Point if self.features.contains(wgpu::Features::POLYGON_MODE_POINT) => {
                wgpu::PolygonMode::Point
            }
            _ => wgpu::PolygonMode::Fill,
        }
    }

    /// Returns the stencil test of an index; none if the depth format has no stencil.
    fn stencil_state(&self, index: u16, depth: wgpu::TextureFormat) -> wgpu::StencilState {
        match self.parts.stencil(index).filter(|_| depth.has_stencil_aspect()) {
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

/// Returns the vertex buffers of a key, with the custom attributes that its program reads. Shaders read height tiles and splats
/// from other buffers.
fn vertex_buffers(key: PipelineKey, layout: &AttributeLayout, custom: &[wgpu::VertexAttribute]) -> Vec<VertexBuffer> {
    let is_drawn_without = key.kind() == Kind::Height || key.is_splats();
    let Some(format) = key.vertices().filter(|_| !is_drawn_without) else { return Vec::new() };
    let mut attributes = match format {
        VertexFormat::Full => [&FULL_ATTRIBUTES[..], custom].concat(),
        VertexFormat::Packed => PACKED_ATTRIBUTES.to_vec(),
        VertexFormat::Quantized => QUANTIZED_ATTRIBUTES.to_vec(),
    };
    attributes.extend(further_uvs(key, layout, &attributes));
    match format {
        VertexFormat::Full => {
            vec![VertexBuffer { stride: (format.stride() + added_stride(layout)) as u64, attributes }]
        }
        // A format without colours: the vertices, and the one colour that all share.
        VertexFormat::Packed | VertexFormat::Quantized => {
            let color = VertexBuffer { stride: 0, attributes: SHARED_COLOR_ATTRIBUTE.to_vec() };
            vec![VertexBuffer { stride: format.stride() as u64, attributes }, color]
        }
    }
}

fn topology(key: PipelineKey) -> wgpu::PrimitiveTopology {
    match key.kind() {
        _ if key.is_square() || key.is_splats() => wgpu::PrimitiveTopology::TriangleList,
        Kind::Height | Kind::Triangles => wgpu::PrimitiveTopology::TriangleList,
        Kind::Lines => wgpu::PrimitiveTopology::LineList,
        Kind::Points => wgpu::PrimitiveTopology::PointList,
    }
}

fn blend_state(func: BlendFunc, equation: BlendEquation) -> wgpu::BlendState {
    let operation = operation(equation);
    // OpenGL takes the least and the greatest of the colours without their factors.
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
}
