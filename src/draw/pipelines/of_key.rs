//! The pipeline that a key stands for. Draw thread.

use super::Pipelines;
use super::convert::{bias, factor, operation, reversed, stencil_face};
use super::key::{AirKind, Alpha, Kind, PipelineKey, Shading};
use super::programs::HEIGHT_ENTRY;
use super::sources::*;
use super::variant::Variant;
use crate::gpu::{GraphicsContext, VertexFormat};
use crate::scene::added_stride;
use crate::state::PolygonMode;

/// Attributes of vertices of each format, and of the one white that packed and quantized ones share.
const OF_FULL: [wgpu::VertexAttribute; 4] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x2, 2 => Snorm8x4, 3 => Unorm8x4];
const OF_PACKED: [wgpu::VertexAttribute; 3] = wgpu::vertex_attr_array![0 => Float32x3, 1 => Unorm16x2, 2 => Snorm8x4];
const OF_QUANTIZED: [wgpu::VertexAttribute; 3] =
    wgpu::vertex_attr_array![0 => Unorm16x4, 1 => Unorm16x2, 2 => Snorm8x4];
const OF_WHITE: [wgpu::VertexAttribute; 1] = wgpu::vertex_attr_array![3 => Unorm8x4];

impl Pipelines {
    /// `None`, and an error kept, where it cannot be made.
    pub(super) fn make(&mut self, ctx: &GraphicsContext, key: PipelineKey) -> Option<wgpu::RenderPipeline> {
        let is_height = key.kind() == Kind::Height;
        let is_thin = matches!(key.kind(), Kind::Lines | Kind::Points);
        let target = self.targets.get(key.target()).copied()?;
        let layouts = ctx.layouts();
        let (fixed_layout, textured_layout) = (self.fixed_layout.clone(), self.textured_layout.clone());
        let further = self.further_attributes(key).map_err(|problem| self.errors.push(problem)).ok()?;
        let pull_layout = key.is_pulled().then(|| self.pull_layout.clone());
        let (is_caster, has_shadows) = (key.is_caster(), key.has_shadows());
        // Where there are no colours, only what drops parts of what it draws has a fragment shader.
        let mut discards = true;
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
                discards = matches!(key.alpha(), Alpha::Masked | Alpha::MaskedBlended) || key.is_fading();
                fragment = match (key.kind(), key.alpha()) {
                    (Kind::Height, _) if has_shadows => "fs_height_shadowed",
                    (Kind::Height, _) => "fs_height",
                    _ if is_thin => "fs_thin",
                    (_, Alpha::Masked) if !has_alpha => "fs_mesh_masked",
                    (_, Alpha::Masked | Alpha::MaskedBlended) => "fs_mesh_masked_blended",
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
        let of_full = [&OF_FULL[..], &further].concat();
        let full = [layout((VertexFormat::Full.stride() + added_stride(self.layouts.of(key))) as u64, &of_full[..])];
        // The color is one for all.
        let packed = [of(VertexFormat::Packed, &OF_PACKED), layout(0, &OF_WHITE)];
        let quantized = [of(VertexFormat::Quantized, &OF_QUANTIZED), layout(0, &OF_WHITE)];
        let mut write_mask = wgpu::ColorWrites::from_bits_truncate(key.color_mask() as u32);
        write_mask.set(wgpu::ColorWrites::ALPHA, target.keeps_alpha);
        let mut label = format!("{fragment} of target {}", key.target());
        if let Shading::Program(place) = key.shading() {
            label = format!("program {:?}, {label}", self.programs.name(place).unwrap_or_default());
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
            // Nor do they fail it: what is culled marks nothing.
            stencil: self.stencil_state(if key.culled() == 3 { 0 } else { key.stencil() }, target.depth),
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
