//! Pipelines, made when first needed: a software adapter takes a third of a second for each at its first draw.

use std::collections::HashMap;

use super::key::{Alpha, Kind, Offsets, PipelineKey, StateKey};
use crate::gpu::{DEPTH_FORMAT, GraphicsContext};
use crate::scene::MeshVertex;
use crate::state::{BlendEquation, BlendFactor, CompareFunction, PolygonMode, PolygonOffset, ResolvedState};

const HEIGHT_WGSL: &str = concat!(include_str!("shaders/frame.wgsl"), include_str!("shaders/height.wgsl"));
const MESH_WGSL: &str = concat!(include_str!("shaders/frame.wgsl"), include_str!("shaders/mesh.wgsl"));
const SKY_WGSL: &str = concat!(include_str!("shaders/frame.wgsl"), include_str!("shaders/sky.wgsl"));

/// Pipelines of a renderer, by key.
pub(super) struct Pipelines {
    pub(super) frame_layout: wgpu::BindGroupLayout,
    pipelines: Vec<wgpu::RenderPipeline>,
    /// Only looked up, never walked.
    index_of: HashMap<PipelineKey, u32>,
    offsets: Offsets,
    sky: Option<wgpu::RenderPipeline>,
    height_shader: Option<wgpu::ShaderModule>,
    mesh_shader: Option<wgpu::ShaderModule>,
    features: wgpu::Features,
    created: u32,
}

/// The parts in which pipelines differ.
struct Variant<'a> {
    label: &'a str,
    shader: &'a wgpu::ShaderModule,
    vertex: &'a str,
    fragment: &'a str,
    block_layout: Option<&'a wgpu::BindGroupLayout>,
    buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    topology: wgpu::PrimitiveTopology,
    culled: Option<wgpu::Face>,
    front_face: wgpu::FrontFace,
    polygon_mode: wgpu::PolygonMode,
    depth_write: bool,
    depth_compare: wgpu::CompareFunction,
    bias: wgpu::DepthBiasState,
    blend: Option<wgpu::BlendState>,
    write_mask: wgpu::ColorWrites,
}

fn shader(device: &wgpu::Device, label: &str, source: &'static str) -> wgpu::ShaderModule {
    device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(label),
        source: wgpu::ShaderSource::Wgsl(source.into()),
    })
}

impl Pipelines {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        let entry = |binding, visibility, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        };
        let both = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let frame_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("frame"),
            entries: &[
                entry(0, both, wgpu::BufferBindingType::Uniform),
                entry(1, both, wgpu::BufferBindingType::Storage { read_only: true }),
            ],
        });
        Self {
            frame_layout,
            pipelines: Vec::new(),
            index_of: HashMap::new(),
            offsets: Offsets::default(),
            sky: None,
            height_shader: None,
            mesh_shader: None,
            features: device.features(),
            created: 0,
        }
    }

    /// Pipelines made so far.
    pub(super) fn created(&self) -> u32 {
        self.created
    }

    /// A pipeline by the index that [`Self::ensure`] gave.
    pub(super) fn pipeline(&self, index: u32) -> Option<&wgpu::RenderPipeline> {
        self.pipelines.get(index as usize)
    }

    /// The pipeline part of a state.
    pub(super) fn state_key(&mut self, state: &ResolvedState) -> StateKey {
        StateKey::new(state, self.offsets.index_of(state.polygon_offset()))
    }

    pub(super) fn sky(&self) -> Option<&wgpu::RenderPipeline> {
        self.sky.as_ref()
    }

    /// Makes the sky's pipeline unless it is there.
    pub(super) fn ensure_sky(&mut self, ctx: &GraphicsContext) {
        if self.sky.is_some() {
            return;
        }
        let module = shader(ctx.device(), "sky", SKY_WGSL);
        self.sky = Some(self.create(
            ctx,
            &Variant {
                label: "sky",
                shader: &module,
                vertex: "vs_sky",
                fragment: "fs_sky",
                block_layout: None,
                buffers: &[],
                topology: wgpu::PrimitiveTopology::TriangleList,
                culled: None,
                front_face: wgpu::FrontFace::Ccw,
                polygon_mode: wgpu::PolygonMode::Fill,
                depth_write: false,
                // Only where nothing was drawn: the depth is still the cleared 0.
                depth_compare: wgpu::CompareFunction::GreaterEqual,
                bias: wgpu::DepthBiasState::default(),
                blend: None,
                write_mask: wgpu::ColorWrites::COLOR,
            },
        ));
        self.created += 1;
    }

    /// The index of a key's pipeline; makes it unless it is there.
    pub(super) fn ensure(&mut self, ctx: &GraphicsContext, key: PipelineKey) -> u32 {
        if let Some(index) = self.index_of.get(&key) {
            return *index;
        }
        let pipeline = self.make(ctx, key);
        let index = self.pipelines.len() as u32;
        self.pipelines.push(pipeline);
        self.index_of.insert(key, index);
        self.created += 1;
        index
    }

    fn make(&mut self, ctx: &GraphicsContext, key: PipelineKey) -> wgpu::RenderPipeline {
        let is_height = key.kind() == Kind::Height;
        let (module, vertex) = if is_height {
            (self.height_shader.get_or_insert_with(|| shader(ctx.device(), "height", HEIGHT_WGSL)), "vs_height")
        } else {
            (self.mesh_shader.get_or_insert_with(|| shader(ctx.device(), "mesh", MESH_WGSL)), "vs_mesh")
        };
        let module = module.clone();
        let fragment = match (key.kind(), key.alpha()) {
            (Kind::Height, _) => "fs_height",
            (Kind::Lines | Kind::Points, _) => "fs_thin",
            (Kind::Triangles, Alpha::Masked) => "fs_mesh_masked",
            (Kind::Triangles, Alpha::Blended) => "fs_mesh_blended",
            (Kind::Triangles, Alpha::Opaque) => "fs_mesh",
        };
        let topology = match key.kind() {
            Kind::Height | Kind::Triangles => wgpu::PrimitiveTopology::TriangleList,
            Kind::Lines => wgpu::PrimitiveTopology::LineList,
            Kind::Points => wgpu::PrimitiveTopology::PointList,
        };
        let vertices = [Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<MeshVertex>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x2, 2 => Snorm8x4, 3 => Unorm8x4],
        })];
        let layouts = ctx.layouts();
        let variant = Variant {
            label: fragment,
            shader: &module,
            vertex,
            fragment,
            block_layout: Some(if is_height { &layouts.height_block } else { &layouts.texture_block }),
            buffers: if is_height { &[] } else { &vertices },
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
            bias: bias(self.offsets.get(key.offset())),
            blend: key.blend().map(|(source, destination, equation)| {
                let component = wgpu::BlendComponent {
                    src_factor: factor(source),
                    dst_factor: factor(destination),
                    operation: operation(equation),
                };
                wgpu::BlendState { color: component, alpha: component }
            }),
            write_mask: wgpu::ColorWrites::from_bits_truncate(key.color_mask() as u32),
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

    fn create(&self, ctx: &GraphicsContext, variant: &Variant<'_>) -> wgpu::RenderPipeline {
        let device = ctx.device();
        let layouts = [Some(&self.frame_layout), variant.block_layout];
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(variant.label),
            bind_group_layouts: if variant.block_layout.is_some() { &layouts } else { &layouts[..1] },
            immediate_size: 0,
        });
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(variant.label),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: variant.shader,
                entry_point: Some(variant.vertex),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: variant.buffers,
            },
            primitive: wgpu::PrimitiveState {
                topology: variant.topology,
                front_face: variant.front_face,
                cull_mode: variant.culled,
                polygon_mode: variant.polygon_mode,
                ..Default::default()
            },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH_FORMAT,
                depth_write_enabled: Some(variant.depth_write),
                depth_compare: Some(variant.depth_compare),
                stencil: wgpu::StencilState::default(),
                bias: variant.bias,
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: variant.shader,
                entry_point: Some(variant.fragment),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(wgpu::ColorTargetState {
                    format: ctx.color_format(),
                    blend: variant.blend,
                    // Never alpha: pictures stay opaque.
                    write_mask: variant.write_mask,
                })],
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// Depths are stored reversed: nearer is greater.
fn reversed(function: CompareFunction) -> wgpu::CompareFunction {
    match function {
        CompareFunction::Never => wgpu::CompareFunction::Never,
        CompareFunction::Less => wgpu::CompareFunction::Greater,
        CompareFunction::Equal => wgpu::CompareFunction::Equal,
        CompareFunction::LessOrEqual => wgpu::CompareFunction::GreaterEqual,
        CompareFunction::Greater => wgpu::CompareFunction::Less,
        CompareFunction::NotEqual => wgpu::CompareFunction::NotEqual,
        CompareFunction::GreaterOrEqual => wgpu::CompareFunction::LessEqual,
        CompareFunction::Always => wgpu::CompareFunction::Always,
    }
}

/// Away from the eye is less, reversed.
fn bias(offset: PolygonOffset) -> wgpu::DepthBiasState {
    wgpu::DepthBiasState { constant: -(offset.units as i32), slope_scale: -offset.factor, clamp: 0.0 }
}

fn factor(factor: BlendFactor) -> wgpu::BlendFactor {
    match factor {
        BlendFactor::Zero => wgpu::BlendFactor::Zero,
        BlendFactor::One => wgpu::BlendFactor::One,
        BlendFactor::SrcColor => wgpu::BlendFactor::Src,
        BlendFactor::OneMinusSrcColor => wgpu::BlendFactor::OneMinusSrc,
        BlendFactor::SrcAlpha => wgpu::BlendFactor::SrcAlpha,
        BlendFactor::OneMinusSrcAlpha => wgpu::BlendFactor::OneMinusSrcAlpha,
        BlendFactor::DstColor => wgpu::BlendFactor::Dst,
        BlendFactor::OneMinusDstColor => wgpu::BlendFactor::OneMinusDst,
        BlendFactor::DstAlpha => wgpu::BlendFactor::DstAlpha,
        BlendFactor::OneMinusDstAlpha => wgpu::BlendFactor::OneMinusDstAlpha,
        BlendFactor::SrcAlphaSaturate => wgpu::BlendFactor::SrcAlphaSaturated,
        BlendFactor::ConstantColor => wgpu::BlendFactor::Constant,
        BlendFactor::OneMinusConstantColor => wgpu::BlendFactor::OneMinusConstant,
    }
}

fn operation(equation: BlendEquation) -> wgpu::BlendOperation {
    match equation {
        BlendEquation::Add => wgpu::BlendOperation::Add,
        BlendEquation::Subtract => wgpu::BlendOperation::Subtract,
        BlendEquation::ReverseSubtract => wgpu::BlendOperation::ReverseSubtract,
        BlendEquation::Min => wgpu::BlendOperation::Min,
        BlendEquation::Max => wgpu::BlendOperation::Max,
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame::{FrameUniform, LeafUniform};
    use super::*;

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
    fn shaders_are_valid_and_their_structs_are_mirrored() {
        for (name, source) in [("height", HEIGHT_WGSL), ("mesh", MESH_WGSL), ("sky", SKY_WGSL)] {
            let module = parse(name, source);
            let (span, fields) = members(&module, "Frame");
            assert_eq!(span as usize, size_of::<FrameUniform>(), "{name}");
            assert_eq!(
                fields,
                offsets!(FrameUniform: clip_from_eye, sun_direction, sun_color, ambient_color, up, horizon_color,
                    zenith_color, ray, horizon)
            );
            let (span, fields) = members(&module, "Leaf");
            assert_eq!(span as usize, size_of::<LeafUniform>(), "{name}");
            let rows = std::mem::offset_of!(LeafUniform, eye_from_drawable) as u32;
            assert_eq!(fields[..3].iter().map(|f| f.1).collect::<Vec<_>>(), [rows, rows + 16, rows + 32]);
            assert_eq!(fields[3..], offsets!(LeafUniform: color, layer, flags, alpha_cutoff, side));
        }
    }

    #[test]
    fn constants_are_mirrored() {
        let header = crate::gpu::TABLE_HEADER_VECTORS;
        assert!(HEIGHT_WGSL.contains(&format!("const HEADER: u32 = {header}u;")));
        assert!(HEIGHT_WGSL.contains(&format!("n <= {}u", crate::gpu::MORPH_LEVELS)));
        assert!(MESH_WGSL.contains(&format!("const FLAG_UNLIT: u32 = {}u;", super::super::frame::FLAG_UNLIT)));
    }
}
