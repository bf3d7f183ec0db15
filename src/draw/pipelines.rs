//! Pipelines, made when first needed: a software adapter takes a third of a second for each at its first draw.

use crate::gpu::{DEPTH_FORMAT, GraphicsContext};
use crate::scene::{AlphaMode, MeshVertex, Topology};

const HEIGHT_WGSL: &str = concat!(include_str!("shaders/frame.wgsl"), include_str!("shaders/height.wgsl"));
const MESH_WGSL: &str = concat!(include_str!("shaders/frame.wgsl"), include_str!("shaders/mesh.wgsl"));
const SKY_WGSL: &str = concat!(include_str!("shaders/frame.wgsl"), include_str!("shaders/sky.wgsl"));

/// What a pipeline is chosen by, packed: two bits of kind, two of alpha, then double-sided, no depth write,
/// wireframe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct PipelineKey(u8);

const KIND_HEIGHT: u8 = 0;
const KIND_MESH: u8 = 1;
const KIND_LINES: u8 = 2;
const KIND_POINTS: u8 = 3;
const ALPHA_OPAQUE: u8 = 0;
const ALPHA_MASK: u8 = 1 << 2;
const ALPHA_BLEND: u8 = 2 << 2;
const DOUBLE_SIDED: u8 = 1 << 4;
const NO_DEPTH_WRITE: u8 = 1 << 5;
const WIREFRAME: u8 = 1 << 6;
const KEYS: usize = 1 << 7;

impl PipelineKey {
    /// Height tiles: opaque; seen from above, or from both sides.
    pub(super) fn height(double_sided: bool, depth_write: bool, wireframe: bool) -> Self {
        let mut key = KIND_HEIGHT;
        for (is_set, bit) in [(double_sided, DOUBLE_SIDED), (!depth_write, NO_DEPTH_WRITE), (wireframe, WIREFRAME)] {
            if is_set {
                key |= bit;
            }
        }
        Self(key)
    }

    /// Meshes, lines and points. Blended ones write no depth.
    pub(super) fn mesh(
        topology: Topology,
        alpha: AlphaMode,
        double_sided: bool,
        depth_write: bool,
        wireframe: bool,
    ) -> Self {
        let kind = match topology {
            Topology::Triangles => KIND_MESH,
            Topology::Lines => KIND_LINES,
            Topology::Points => KIND_POINTS,
        };
        let is_triangles = kind == KIND_MESH;
        let alpha = match alpha {
            AlphaMode::Blend => ALPHA_BLEND,
            AlphaMode::Mask(_) if is_triangles => ALPHA_MASK,
            AlphaMode::Opaque | AlphaMode::Mask(_) => ALPHA_OPAQUE,
        };
        let mut key = kind | alpha;
        if double_sided && is_triangles {
            key |= DOUBLE_SIDED;
        }
        if !depth_write {
            key |= NO_DEPTH_WRITE;
        }
        if wireframe && is_triangles {
            key |= WIREFRAME;
        }
        Self(key)
    }

    pub(super) fn is_height(self) -> bool {
        self.0 & 3 == KIND_HEIGHT
    }

    pub(super) fn is_points(self) -> bool {
        self.0 & 3 == KIND_POINTS
    }

    pub(super) fn is_lines(self) -> bool {
        self.0 & 3 == KIND_LINES
    }

    pub(super) fn writes_depth(self) -> bool {
        self.0 & NO_DEPTH_WRITE == 0
    }
}

/// Pipelines of a renderer, by key.
pub(super) struct Pipelines {
    pub(super) frame_layout: wgpu::BindGroupLayout,
    pipelines: Vec<Option<wgpu::RenderPipeline>>,
    sky: Option<wgpu::RenderPipeline>,
    height_shader: Option<wgpu::ShaderModule>,
    mesh_shader: Option<wgpu::ShaderModule>,
    can_wireframe: bool,
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
    cull_back: bool,
    wireframe: bool,
    depth_write: bool,
    depth_compare: wgpu::CompareFunction,
    blend: bool,
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
            pipelines: (0..KEYS).map(|_| None).collect(),
            sky: None,
            height_shader: None,
            mesh_shader: None,
            can_wireframe: device.features().contains(wgpu::Features::POLYGON_MODE_LINE),
            created: 0,
        }
    }

    /// Pipelines made so far.
    pub(super) fn created(&self) -> u32 {
        self.created
    }

    pub(super) fn pipeline(&self, key: PipelineKey) -> Option<&wgpu::RenderPipeline> {
        self.pipelines.get(usize::from(key.0))?.as_ref()
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
                cull_back: false,
                wireframe: false,
                depth_write: false,
                // Only where nothing was drawn: the depth is still the cleared 0.
                depth_compare: wgpu::CompareFunction::GreaterEqual,
                blend: false,
            },
        ));
        self.created += 1;
    }

    /// Makes a pipeline unless it is there.
    pub(super) fn ensure(&mut self, ctx: &GraphicsContext, key: PipelineKey) {
        if self.pipeline(key).is_some() {
            return;
        }
        let is_set = |bit: u8| key.0 & bit != 0;
        let depth_write = !is_set(NO_DEPTH_WRITE);
        let wireframe = is_set(WIREFRAME) && self.can_wireframe;
        let pipeline = if key.is_height() {
            let module = self.height_shader.get_or_insert_with(|| shader(ctx.device(), "height", HEIGHT_WGSL)).clone();
            self.create(
                ctx,
                &Variant {
                    label: "height tiles",
                    shader: &module,
                    vertex: "vs_height",
                    fragment: "fs_height",
                    block_layout: Some(&ctx.layouts().height_block),
                    buffers: &[],
                    topology: wgpu::PrimitiveTopology::TriangleList,
                    // Both sides: with back faces culled, a pixel in a flight of 200 frames showed the background
                    // between two tiles, whose edges differ by the rounding of their frames.
                    cull_back: false,
                    wireframe,
                    depth_write,
                    depth_compare: wgpu::CompareFunction::Greater,
                    blend: false,
                },
            )
        } else {
            let module = self.mesh_shader.get_or_insert_with(|| shader(ctx.device(), "mesh", MESH_WGSL)).clone();
            let (topology, is_thin) = match key.0 & 3 {
                KIND_LINES => (wgpu::PrimitiveTopology::LineList, true),
                KIND_POINTS => (wgpu::PrimitiveTopology::PointList, true),
                _ => (wgpu::PrimitiveTopology::TriangleList, false),
            };
            let alpha = key.0 & (3 << 2);
            let fragment = match alpha {
                _ if is_thin => "fs_thin",
                ALPHA_MASK => "fs_mesh_masked",
                ALPHA_BLEND => "fs_mesh_blended",
                _ => "fs_mesh",
            };
            self.create(
                ctx,
                &Variant {
                    label: fragment,
                    shader: &module,
                    vertex: "vs_mesh",
                    fragment,
                    block_layout: Some(&ctx.layouts().texture_block),
                    buffers: &[Some(wgpu::VertexBufferLayout {
                        array_stride: size_of::<MeshVertex>() as u64,
                        step_mode: wgpu::VertexStepMode::Vertex,
                        attributes: &wgpu::vertex_attr_array![
                            0 => Float32x3, 1 => Float32x2, 2 => Snorm8x4, 3 => Unorm8x4
                        ],
                    })],
                    topology,
                    cull_back: !is_thin && !is_set(DOUBLE_SIDED),
                    wireframe,
                    depth_write,
                    depth_compare: wgpu::CompareFunction::Greater,
                    blend: alpha == ALPHA_BLEND,
                },
            )
        };
        self.pipelines[usize::from(key.0)] = Some(pipeline);
        self.created += 1;
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
                front_face: wgpu::FrontFace::Ccw,
                cull_mode: variant.cull_back.then_some(wgpu::Face::Back),
                polygon_mode: if variant.wireframe { wgpu::PolygonMode::Line } else { wgpu::PolygonMode::Fill },
                ..Default::default()
            },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH_FORMAT,
                depth_write_enabled: Some(variant.depth_write),
                depth_compare: Some(variant.depth_compare),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: variant.shader,
                entry_point: Some(variant.fragment),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(wgpu::ColorTargetState {
                    format: ctx.color_format(),
                    blend: variant.blend.then_some(wgpu::BlendState::ALPHA_BLENDING),
                    // Pictures stay opaque: alpha is the cleared 1.
                    write_mask: wgpu::ColorWrites::COLOR,
                })],
            }),
            multiview_mask: None,
            cache: None,
        })
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
