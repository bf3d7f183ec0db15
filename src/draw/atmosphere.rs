//! The earth's air: tables of what it scatters and lets through, computed on the adapter and read by every shader
//! (`shaders/air.wgsl`). Draw thread only.
//!
//! Three tables hold for the whole earth and are made once for a density of aerosols: what is left of sunlight, light
//! scattered more than once, the sky's light on the ground. The fourth is made when the eye's height or the sun's has
//! changed: what the air adds and takes along every direction from the eye, to 24 distances. After S. Hillaire, A Scalable
//! and Production Ready Sky and Atmosphere Rendering Technique (2020); coefficients of E. Bruneton's Precomputed
//! Atmospheric Scattering.

use std::f64::consts::PI;

use crate::cull::RenderStage;
use crate::draw::environment::Environment;
use crate::draw::uniforms::frame::{eye_height_m, sun_height};
use crate::gpu::GraphicsContext;

/// Source of the compute shaders.
pub(super) const ATMOSPHERE_WGSL: &str =
    concat!(include_str!("shaders/air.wgsl"), include_str!("shaders/atmosphere.wgsl"));

/// Radii in kilometres, as in air.wgsl.
const EARTH_KM: f64 = 6371.0;
const AIR_KM: f64 = 6471.0;
const LOWEST_KM: f64 = 6368.0;
/// Scattering of air and absorption of ozone in a kilometre at their densest, red, green and blue.
const RAYLEIGH_PER_KM: [f64; 3] = [5.802e-3, 13.558e-3, 33.1e-3];
const OZONE_PER_KM: [f64; 3] = [0.650e-3, 1.881e-3, 0.085e-3];
/// What they come to straight up: kilometres of their densest.
const RAYLEIGH_COLUMN_KM: f64 = 8.0;
const MIE_COLUMN_KM: f64 = 1.2;
const OZONE_COLUMN_KM: f64 = 15.0;
/// Thickest aerosols, extinction in a kilometre: one sees 40 m in it.
const MOST_AEROSOL_PER_KM: f64 = 100.0;

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
const SUNLIGHT_SIZE: [u32; 3] = [128, 64, 1];
const MULTIPLE_SIZE: [u32; 3] = [32, 32, 1];
const SKY_LIGHT_SIZE: [u32; 3] = [64, 1, 1];
const AIR_SIZE: [u32; 3] = [32, 64, 24];

/// What the tables are made for. Rounded, so that they depend on this frame alone and not on which frame made them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Air {
    /// Eye from the earth's centre, kilometres.
    pub(super) eye_km: f32,
    /// Cosine from the zenith of the lowest ground's horizon.
    pub(super) horizon_cosine: f32,
    /// Of the air's limb; 1 inside the air.
    pub(super) limb_cosine: f32,
    /// Of the sun.
    pub(super) sun_cosine: f32,
    /// Extinction of aerosols at height 0, in a kilometre.
    pub(super) aerosol_per_km: f32,
}

/// The ten highest bits of a number.
fn rounded(x: f64) -> f64 {
    f64::from(f32::from_bits((x as f32).to_bits() & 0xffff_e000))
}

impl Air {
    /// As a stage's eye sees it.
    pub(super) fn of(stage: &RenderStage, environment: &Environment) -> Self {
        let (height_m, _) = eye_height_m(stage, environment);
        let density = f64::from(environment.fog.density_per_m) * 1e3;
        let aerosol = if density.is_finite() { density.clamp(0.0, MOST_AEROSOL_PER_KM) } else { 0.0 };
        Self::at(rounded(height_m * 1e-3), sun_height(stage, environment), aerosol)
    }

    fn at(height_km: f64, sun_cosine: f64, aerosol_per_km: f64) -> Self {
        // Shaders have the radius as f32, half a metre apart.
        let eye_km = (EARTH_KM + height_km) as f32;
        let r = f64::from(eye_km);
        let limb = |radius: f64| -(((r - radius) * (r + radius)).max(0.0)).sqrt() / r;
        Self {
            eye_km,
            horizon_cosine: limb(LOWEST_KM) as f32,
            limb_cosine: if r > AIR_KM { limb(AIR_KM) as f32 } else { 1.0 },
            sun_cosine: ((sun_cosine * 8192.0).round() / 8192.0).clamp(-1.0, 1.0) as f32,
            aerosol_per_km: rounded(aerosol_per_km) as f32,
        }
    }

    /// Irradiance of the sun outside the air whose light on the ground, straight down, has a colour (which is over pi).
    pub(super) fn sun_irradiance(&self, color_on_ground: [f32; 3]) -> [f32; 3] {
        let left = self.sunlight_from_zenith();
        [0, 1, 2].map(|i| (f64::from(color_on_ground[i]) * PI / left[i]) as f32)
    }

    /// Share of sunlight from the zenith that reaches height 0. Never 0: thick haze would ask for an endless sun.
    fn sunlight_from_zenith(&self) -> [f64; 3] {
        [0, 1, 2].map(|i| {
            let depth = RAYLEIGH_PER_KM[i] * RAYLEIGH_COLUMN_KM
                + f64::from(self.aerosol_per_km) * MIE_COLUMN_KM
                + OZONE_PER_KM[i] * OZONE_COLUMN_KM;
            (-depth).exp().max(0.05)
        })
    }
}

fn table(device: &wgpu::Device, label: &str, size: [u32; 3]) -> wgpu::TextureView {
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

/// The tables of a renderer, and what computes them.
pub(super) struct Atmosphere {
    sampler: wgpu::Sampler,
    sunlight: wgpu::TextureView,
    multiple: wgpu::TextureView,
    sky_light: wgpu::TextureView,
    scattered: wgpu::TextureView,
    mie: wgpu::TextureView,
    /// Made when there first is an atmosphere.
    maker: Option<Maker>,
    /// What the tables hold.
    made_for: Option<Air>,
}

/// `struct Air` of atmosphere.wgsl.
const UNIFORM_BYTES: u64 = 32;

fn wanted_buffer(device: &wgpu::Device, pictures: u64) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("wanted air"),
        size: pictures * UNIFORM_BYTES,
        usage: wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// What computes the tables.
struct Maker {
    /// What the frame's pictures want, each at its place; copied into the uniform before a picture is drawn.
    wanted: wgpu::Buffer,
    uniform: wgpu::Buffer,
    /// In the order run; the last one is run for each eye.
    runs: [Run; 4],
}

struct Run {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    size: [u32; 3],
}

impl Atmosphere {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        let table = |label, size| table(device, label, size);
        Self {
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("air"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
            sunlight: table("sunlight", SUNLIGHT_SIZE),
            multiple: table("light scattered more than once", MULTIPLE_SIZE),
            sky_light: table("sky light", SKY_LIGHT_SIZE),
            scattered: table("air", AIR_SIZE),
            mie: table("aerosols", AIR_SIZE),
            maker: None,
            made_for: None,
        }
    }

    /// What shaders read, from binding 3 of group 0 on.
    pub(super) fn entries(&self) -> [wgpu::BindGroupEntry<'_>; 5] {
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        [
            entry(3, wgpu::BindingResource::Sampler(&self.sampler)),
            entry(4, wgpu::BindingResource::TextureView(&self.sunlight)),
            entry(5, wgpu::BindingResource::TextureView(&self.sky_light)),
            entry(6, wgpu::BindingResource::TextureView(&self.scattered)),
            entry(7, wgpu::BindingResource::TextureView(&self.mie)),
        ]
    }

    /// Computes what has changed, before the passes of a picture; `place` is the picture's in the frame.
    pub(super) fn record(&mut self, ctx: &GraphicsContext, encoder: &mut wgpu::CommandEncoder, place: u64, air: &Air) {
        if self.made_for.as_ref() == Some(air) {
            return;
        }
        let same_aerosol = self.made_for.is_some_and(|made| made.aerosol_per_km == air.aerosol_per_km);
        if self.maker.is_none() {
            self.maker = Some(self.maker(ctx.device(), ctx.pipeline_cache()));
        }
        let Some(maker) = &mut self.maker else { return };
        let words =
            [air.eye_km, air.horizon_cosine, air.limb_cosine, air.sun_cosine, air.aerosol_per_km, 0.0, 0.0, 0.0];
        if maker.wanted.size() < (place + 1) * UNIFORM_BYTES {
            maker.wanted = wanted_buffer(ctx.device(), place + 1);
        }
        ctx.queue().write_buffer(&maker.wanted, place * UNIFORM_BYTES, bytemuck::cast_slice(&words));
        encoder.copy_buffer_to_buffer(&maker.wanted, place * UNIFORM_BYTES, &maker.uniform, 0, UNIFORM_BYTES);
        let first = if same_aerosol { maker.runs.len() - 1 } else { 0 };
        let mut pass =
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("air"), ..Default::default() });
        for run in &maker.runs[first..] {
            pass.set_pipeline(&run.pipeline);
            pass.set_bind_group(0, &run.group, &[]);
            // One invocation a column of the table.
            pass.dispatch_workgroups(run.size[0].div_ceil(8), run.size[1].div_ceil(8), 1);
        }
        self.made_for = Some(*air);
    }

    fn maker(&self, device: &wgpu::Device, cache: Option<&wgpu::PipelineCache>) -> Maker {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("atmosphere"),
            source: wgpu::ShaderSource::Wgsl(ATMOSPHERE_WGSL.into()),
        });
        let uniform = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("air"),
            size: UNIFORM_BYTES,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let uniform_type = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let run = |entry_point, read: &[(u32, &wgpu::TextureView)], written: &[(u32, &wgpu::TextureView)], size| {
            let dimension =
                if size == AIR_SIZE { wgpu::TextureViewDimension::D3 } else { wgpu::TextureViewDimension::D2 };
            let written_type = wgpu::BindingType::StorageTexture {
                access: wgpu::StorageTextureAccess::WriteOnly,
                format: FORMAT,
                view_dimension: dimension,
            };
            let read_type = wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable: true },
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            };
            let mut bindings = vec![
                (0, uniform_type, uniform.as_entire_binding()),
                (
                    1,
                    wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                    wgpu::BindingResource::Sampler(&self.sampler),
                ),
            ];
            let tables = read.iter().map(|table| (table, read_type));
            for ((binding, table), ty) in tables.chain(written.iter().map(|table| (table, written_type))) {
                bindings.push((*binding, ty, wgpu::BindingResource::TextureView(table)));
            }
            let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("air"),
                entries: &bindings
                    .iter()
                    .map(|&(binding, ty, _)| wgpu::BindGroupLayoutEntry {
                        binding,
                        visibility: wgpu::ShaderStages::COMPUTE,
                        ty,
                        count: None,
                    })
                    .collect::<Vec<_>>(),
            });
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("air"),
                layout: &layout,
                entries: &bindings
                    .into_iter()
                    .map(|(binding, _, resource)| wgpu::BindGroupEntry { binding, resource })
                    .collect::<Vec<_>>(),
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
            Run { pipeline, group, size }
        };
        let (sunlight, multiple) = ((2, &self.sunlight), (3, &self.multiple));
        Maker {
            runs: [
                run("cs_sunlight", &[], &[(4, &self.sunlight)], SUNLIGHT_SIZE),
                run("cs_multiple", &[sunlight], &[(4, &self.multiple)], MULTIPLE_SIZE),
                run("cs_sky_light", &[sunlight, multiple], &[(4, &self.sky_light)], SKY_LIGHT_SIZE),
                run("cs_air", &[sunlight, multiple], &[(5, &self.scattered), (6, &self.mie)], AIR_SIZE),
            ],
            wanted: wanted_buffer(device, 1),
            uniform,
        }
    }
}
