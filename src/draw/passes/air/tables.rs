//! The tables of light scattered and absorbed by the air for one eye, and the compute pipelines that fill them
//! (`shaders/passes/atmosphere.wgsl`; the layout is in `shaders/shared/air.wgsl`). Draw thread.
//!
//! Three tables hold for the whole earth, and are computed once for a density of aerosols:
//!
//! - the share of sunlight that is left
//! - light scattered more than once
//! - the sky's light on the ground, relative to that under a sun in the zenith
//!
//! The fourth table has the light that the air adds and absorbs along every direction from the eye, up to 24 distances. It is
//! computed when the eye's height or the sun's elevation has changed.
//!
//! After S. Hillaire, A Scalable and Production Ready Sky and Atmosphere Rendering Technique (2020).

use crate::draw::uniforms::air::AirParameters;
use crate::gpu::GraphicsContext;

/// The source of the compute shaders.
pub(in crate::draw) const ATMOSPHERE_WGSL: &str =
    concat!(include_str!("../../shaders/shared/air.wgsl"), include_str!("../../shaders/passes/atmosphere.wgsl"));

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Sizes of the tables in texels.
const SUNLIGHT_SIZE: [u32; 3] = [128, 64, 1];
const MULTIPLE_SIZE: [u32; 3] = [32, 32, 1];
const SKY_LIGHT_SIZE: [u32; 3] = [64, 1, 1];
const AIR_SIZE: [u32; 3] = [32, 64, 24];

/// The size in bytes of `struct Air` in atmosphere.wgsl.
const UNIFORM_BYTES: u64 = 32;

/// Creates a texture for a table: three-dimensional if it has several layers.
pub(super) fn table(device: &wgpu::Device, label: &str, size: [u32; 3]) -> wgpu::TextureView {
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: size[2] },
        mip_level_count: 1,
        sample_count: 1,
        dimension: if size[2] > 1 { wgpu::TextureDimension::D3 } else { wgpu::TextureDimension::D2 },
        format: FORMAT,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::STORAGE_BINDING,
        view_formats: &[],
    });
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

/// The tables that the render passes read.
pub(super) struct ReadTables<'a> {
    pub(super) sunlight: &'a wgpu::TextureView,
    pub(super) sky_light: &'a wgpu::TextureView,
    pub(super) scattered: &'a wgpu::TextureView,
    pub(super) mie: &'a wgpu::TextureView,
}

/// The tables for one eye, 0.8 MB.
pub(super) struct Tables {
    sunlight: wgpu::TextureView,
    multiple: wgpu::TextureView,
    sky_light: wgpu::TextureView,
    scattered: wgpu::TextureView,
    mie: wgpu::TextureView,
    uniform: wgpu::Buffer,
    /// The bind groups of the compute steps; created when the tables are first computed.
    groups: Option<[wgpu::BindGroup; 4]>,
    /// The parameters that the tables were computed for.
    computed_for: Option<AirParameters>,
}

/// A compute step: fills one table, or the two of the fourth step.
#[derive(Clone)]
struct Step {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    size: [u32; 3],
}

/// The compute pipelines of all steps in the order in which they run. The last one runs for each eye.
#[derive(Clone)]
pub(super) struct AirPipelines([Step; 4]);

impl Tables {
    /// Returns the GPU memory of a set of tables in bytes.
    pub(super) fn bytes() -> u64 {
        let texels = [SUNLIGHT_SIZE, MULTIPLE_SIZE, SKY_LIGHT_SIZE, AIR_SIZE, AIR_SIZE];
        texels.map(|size| 8 * size.map(u64::from).iter().product::<u64>()).iter().sum::<u64>() + UNIFORM_BYTES
    }

    pub(super) fn new(device: &wgpu::Device) -> Self {
        let table = |label, size| table(device, label, size);
        Self {
            sunlight: table("sunlight", SUNLIGHT_SIZE),
            multiple: table("light scattered more than once", MULTIPLE_SIZE),
            sky_light: table("sky light", SKY_LIGHT_SIZE),
            scattered: table("air", AIR_SIZE),
            mie: table("aerosols", AIR_SIZE),
            uniform: device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("air"),
                size: UNIFORM_BYTES,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            groups: None,
            computed_for: None,
        }
    }

    /// Returns the parameters that the tables were computed for.
    pub(super) fn computed_for(&self) -> Option<AirParameters> {
        self.computed_for
    }

    pub(super) fn read(&self) -> ReadTables<'_> {
        let Self { sunlight, sky_light, scattered, mie, .. } = self;
        ReadTables { sunlight, sky_light, scattered, mie }
    }

    /// Records the steps that compute the tables for some parameters. The first three are skipped if the density of
    /// aerosols is the same as before.
    pub(super) fn record(
        &mut self,
        ctx: &GraphicsContext,
        pass: &mut wgpu::ComputePass<'_>,
        pipelines: &AirPipelines,
        sampler: &wgpu::Sampler,
        air: AirParameters,
    ) {
        let same_aerosol = self.computed_for.is_some_and(|computed| computed.aerosol_per_km == air.aerosol_per_km);
        let steps = &pipelines.0;
        let groups = self.groups.take().unwrap_or_else(|| self.bind_groups(ctx.device(), steps, sampler));
        let words =
            [air.eye_km, air.horizon_cosine, air.limb_cosine, air.sun_cosine, air.aerosol_per_km, 0.0, 0.0, 0.0];
        ctx.queue().write_buffer(&self.uniform, 0, bytemuck::cast_slice(&words));
        let first = if same_aerosol { steps.len() - 1 } else { 0 };
        for (step, group) in steps.iter().zip(&groups).skip(first) {
            pass.set_pipeline(&step.pipeline);
            pass.set_bind_group(0, group, &[]);
            // One invocation computes a column of the table; a workgroup has 8 by 8 of them.
            pass.dispatch_workgroups(step.size[0].div_ceil(8), step.size[1].div_ceil(8), 1);
        }
        (self.groups, self.computed_for) = (Some(groups), Some(air));
    }

    fn bind_groups(&self, device: &wgpu::Device, steps: &[Step; 4], sampler: &wgpu::Sampler) -> [wgpu::BindGroup; 4] {
        let group = |step: usize, tables: &[(u32, &wgpu::TextureView)]| {
            let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
            let common =
                [entry(0, self.uniform.as_entire_binding()), entry(1, wgpu::BindingResource::Sampler(sampler))];
            let tables =
                tables.iter().map(|(binding, table)| entry(*binding, wgpu::BindingResource::TextureView(table)));
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("air"),
                layout: &steps[step].layout,
                entries: &common.into_iter().chain(tables).collect::<Vec<_>>(),
            })
        };
        let (sunlight, multiple) = ((2, &self.sunlight), (3, &self.multiple));
        [
            group(0, &[(4, &self.sunlight)]),
            group(1, &[sunlight, (4, &self.multiple)]),
            group(2, &[sunlight, multiple, (4, &self.sky_light)]),
            group(3, &[sunlight, multiple, (5, &self.scattered), (6, &self.mie)]),
        ]
    }
}

impl AirPipelines {
    /// Creates the pipelines. Tables that a step reads are bound from 2 on, tables that it writes from 4 on.
    pub(super) fn new(device: &wgpu::Device, cache: Option<&wgpu::PipelineCache>) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("atmosphere"),
            source: wgpu::ShaderSource::Wgsl(ATMOSPHERE_WGSL.into()),
        });
        let uniform = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
        let read = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let step = |entry_point, reads: &[u32], writes: &[u32], size| {
            let dimension =
                if size == AIR_SIZE { wgpu::TextureViewDimension::D3 } else { wgpu::TextureViewDimension::D2 };
            let written = wgpu::BindingType::StorageTexture {
                access: wgpu::StorageTextureAccess::WriteOnly,
                format: FORMAT,
                view_dimension: dimension,
            };
            let tables =
                reads.iter().map(|binding| (*binding, read)).chain(writes.iter().map(|binding| (*binding, written)));
            let entry = |(binding, ty)| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty,
                count: None,
            };
            let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("air"),
                entries: &[(0, uniform), (1, sampler)].into_iter().chain(tables).map(entry).collect::<Vec<_>>(),
            });
            let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry_point),
                layout: Some(&device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                    label: Some("air"),
                    bind_group_layouts: &[Some(&layout)],
                    ..Default::default()
                })),
                module: &module,
                entry_point: Some(entry_point),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache,
            });
            Step { pipeline, layout, size }
        };
        Self([
            step("cs_sunlight", &[], &[4], SUNLIGHT_SIZE),
            step("cs_multiple", &[2], &[4], MULTIPLE_SIZE),
            step("cs_sky_light", &[2, 3], &[4], SKY_LIGHT_SIZE),
            step("cs_air", &[2, 3], &[5, 6], AIR_SIZE),
        ])
    }
}
