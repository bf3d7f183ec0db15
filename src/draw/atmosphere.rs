//! The earth's air: tables of what it scatters and lets through, computed on the adapter and read by every shader
//! (`shaders/air.wgsl`). Draw thread only.
//!
//! Three tables hold for the whole earth and are made once for a density of aerosols: what is left of sunlight, light
//! scattered more than once, the sky's light on the ground. The fourth is made when the eye's height or the sun's has
//! changed: what the air adds and takes along every direction from the eye, to 24 distances. There is a set of them for
//! each eye of a draw whose air is another one, up to eight: views, and cameras in the graph that have air of their own.
//! After S. Hillaire, A Scalable and Production Ready Sky and Atmosphere Rendering Technique (2020); coefficients of
//! E. Bruneton's Precomputed Atmospheric Scattering.

use std::f64::consts::PI;

use crate::cull::CullCamera;
use crate::draw::uniforms::frame::{eye_height_m, sun_height};
use crate::gpu::{FrameTimer, GraphicsContext, watched};
use crate::scene::{Environment, Sky};

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
    /// As a camera's eye sees it.
    pub(super) fn of(camera: &CullCamera, environment: &Environment) -> Self {
        let (height_m, _) = eye_height_m(camera, environment);
        let density = f64::from(environment.fog.density_per_m) * 1e3;
        let aerosol = if density.is_finite() { density.clamp(0.0, MOST_AEROSOL_PER_KM) } else { 0.0 };
        Self::at(rounded(height_m * 1e-3), sun_height(camera, environment), aerosol)
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

/// A clear day's, where the tables cannot be computed.
pub(super) const PLAIN_SKY: Sky = Sky::Background([0x87, 0xae, 0xd6]);

/// Sets of tables, each 0.8 MB; eyes beyond share the one that is nearest to theirs.
const MOST_SETS: usize = 8;
/// Draws after which a set that none of them needed is given back.
const KEPT_DRAWS: u32 = 120;

/// The tables of a renderer, and what computes them.
pub(super) struct Atmosphere {
    sampler: wgpu::Sampler,
    /// One texel, bound in place 0: for pictures without air.
    none: wgpu::TextureView,
    no_volume: wgpu::TextureView,
    /// In the places from 1 on.
    sets: Vec<Tables>,
    /// What computes the tables, in the order run; the last one is run for each eye. Made when there first is an atmosphere;
    /// `Some(None)` where the device refused.
    passes: Option<Option<[Pass; 4]>>,
    /// What could not be made since it was last asked.
    pub(super) errors: Vec<String>,
    draw: u32,
    /// Draws of a frame: one for each context of the device. What one of them needs it needs again in the next frame.
    draws_of_frame: u32,
}

/// The tables for an eye.
struct Tables {
    sunlight: wgpu::TextureView,
    multiple: wgpu::TextureView,
    sky_light: wgpu::TextureView,
    scattered: wgpu::TextureView,
    mie: wgpu::TextureView,
    uniform: wgpu::Buffer,
    /// Of the passes; made when they are first computed.
    groups: Option<[wgpu::BindGroup; 4]>,
    /// What they hold.
    made_for: Option<Air>,
    /// What this draw's eyes need, or the last one's that did.
    wanted: Option<Air>,
    /// The draw.
    used: u32,
}

/// `struct Air` of atmosphere.wgsl.
const UNIFORM_BYTES: u64 = 32;

/// A compute pass.
struct Pass {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    size: [u32; 3],
}

/// The tables for an eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FoundAir {
    /// 0 without any.
    pub(super) place: u8,
    /// What the set is for: another eye's where there were too many.
    pub(super) air: Air,
    pub(super) is_refused: bool,
}

impl Atmosphere {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        Self {
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("air"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
            none: table(device, "no air", [1; 3]),
            no_volume: table(device, "no air", [1, 1, 2]),
            sets: Vec::new(),
            passes: None,
            errors: Vec::new(),
            draw: 0,
            draws_of_frame: 1,
        }
    }

    /// Forgets what the last draw's eyes needed; true where sets were given back.
    pub(super) fn start_draw(&mut self, draws_of_frame: usize) -> bool {
        self.draw = self.draw.wrapping_add(1);
        self.draws_of_frame = draws_of_frame.clamp(1, KEPT_DRAWS as usize) as u32;
        let had = self.sets.len();
        let draw = self.draw;
        while self.sets.last().is_some_and(|set| draw.wrapping_sub(set.used) > KEPT_DRAWS) {
            self.sets.pop();
        }
        self.sets.len() < had
    }

    /// Places that a set may have, that of none among them.
    pub(super) fn place_count(&self) -> usize {
        1 + self.sets.len()
    }

    /// True where the device can compute tables.
    pub(super) fn can_be_made(&mut self, ctx: &GraphicsContext) -> bool {
        let errors = &mut self.errors;
        let made = self.passes.get_or_insert_with(|| {
            let (made, error) = watched(ctx.device(), || passes(ctx.device(), ctx.pipeline_cache()));
            let Some(error) = error else { return Some(made) };
            errors.push(format!("the air cannot be computed, the sky is plain: {error}"));
            None
        });
        made.is_some()
    }

    /// The set for an eye, made in this draw unless it is there; `None` where there is no memory even for one.
    pub(super) fn find(&mut self, ctx: &GraphicsContext, air: &Air) -> Option<FoundAir> {
        let draw = self.draw;
        let same = self.sets.iter().position(|set| set.wanted.as_ref() == Some(air));
        let age = |set: &Tables| draw.wrapping_sub(set.used);
        let fits = |set: &Tables| set.wanted.is_none_or(|w| w.aerosol_per_km == air.aerosol_per_km);
        // Of another eye of the frame before, or none's; the first of them, so that the last ones can be given back.
        let is_free = |set: &Tables| set.wanted.is_none() || age(set) >= self.draws_of_frame;
        let free = || self.sets.iter().position(|set| is_free(set) && fits(set));
        let index = match same.or_else(free) {
            Some(index) => index,
            None if self.sets.len() < MOST_SETS => {
                match ctx.memory().make("air", Tables::bytes(), Tables::new) {
                    Ok(set) => self.sets.push(set),
                    Err(error) => {
                        self.errors.push(error);
                        return self.nearest(air);
                    }
                }
                self.sets.len() - 1
            }
            None => {
                let others = self.sets.iter().enumerate().filter(|(_, set)| age(set) > 0);
                match others.max_by_key(|(_, set)| (fits(set), age(set))) {
                    Some((index, _)) => index,
                    None => return self.nearest(air),
                }
            }
        };
        let set = &mut self.sets[index];
        (set.wanted, set.used) = (Some(*air), draw);
        Some(FoundAir { place: 1 + index as u8, air: *air, is_refused: false })
    }

    /// The set of this draw whose eye is at nearly the same height.
    fn nearest(&self, air: &Air) -> Option<FoundAir> {
        let found = (1..).zip(&self.sets).filter_map(|(place, set)| Some((place, set.wanted?)));
        let away = |other: &Air| (other.eye_km - air.eye_km).abs();
        let (place, air) = found.min_by(|(_, a), (_, b)| away(a).total_cmp(&away(b)))?;
        Some(FoundAir { place, air, is_refused: true })
    }

    /// What shaders read of a set, from binding 3 of group 0 on.
    pub(super) fn entries(&self, place: usize) -> [wgpu::BindGroupEntry<'_>; 5] {
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let set = place.checked_sub(1).and_then(|index| self.sets.get(index));
        let (plane, volume) = ([&self.none; 2], [&self.no_volume; 2]);
        let [sunlight, sky_light] = set.map_or(plane, |set| [&set.sunlight, &set.sky_light]);
        let [scattered, mie] = set.map_or(volume, |set| [&set.scattered, &set.mie]);
        [
            entry(3, wgpu::BindingResource::Sampler(&self.sampler)),
            entry(4, wgpu::BindingResource::TextureView(sunlight)),
            entry(5, wgpu::BindingResource::TextureView(sky_light)),
            entry(6, wgpu::BindingResource::TextureView(scattered)),
            entry(7, wgpu::BindingResource::TextureView(mie)),
        ]
    }

    /// Computes what has changed, before the passes of a draw.
    pub(super) fn record(
        &mut self,
        ctx: &GraphicsContext,
        encoder: &mut wgpu::CommandEncoder,
        timer: Option<&mut FrameTimer>,
    ) {
        let draw = self.draw;
        let needs = |set: &Tables| set.used == draw && set.made_for != set.wanted;
        if !self.sets.iter().any(needs) {
            return;
        }
        let Some(Some(passes)) = &self.passes else { return };
        let timestamp_writes = timer.and_then(|timer| timer.compute_pass("air"));
        let mut pass =
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("air"), timestamp_writes });
        for set in self.sets.iter_mut().filter(|set| needs(set)) {
            set.record(ctx, &mut pass, passes, &self.sampler);
        }
    }
}

impl Tables {
    /// Of a set.
    fn bytes() -> u64 {
        let texels = [SUNLIGHT_SIZE, MULTIPLE_SIZE, SKY_LIGHT_SIZE, AIR_SIZE, AIR_SIZE];
        texels.map(|size| 8 * size.map(u64::from).iter().product::<u64>()).iter().sum::<u64>() + UNIFORM_BYTES
    }

    fn new(device: &wgpu::Device) -> Self {
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
            made_for: None,
            wanted: None,
            used: 0,
        }
    }

    fn record(
        &mut self,
        ctx: &GraphicsContext,
        pass: &mut wgpu::ComputePass<'_>,
        passes: &[Pass; 4],
        sampler: &wgpu::Sampler,
    ) {
        let Some(air) = self.wanted else { return };
        let same_aerosol = self.made_for.is_some_and(|made| made.aerosol_per_km == air.aerosol_per_km);
        let groups = self.groups.take().unwrap_or_else(|| self.bind_groups(ctx.device(), passes, sampler));
        let words =
            [air.eye_km, air.horizon_cosine, air.limb_cosine, air.sun_cosine, air.aerosol_per_km, 0.0, 0.0, 0.0];
        ctx.queue().write_buffer(&self.uniform, 0, bytemuck::cast_slice(&words));
        let first = if same_aerosol { passes.len() - 1 } else { 0 };
        for (of, group) in passes.iter().zip(&groups).skip(first) {
            pass.set_pipeline(&of.pipeline);
            pass.set_bind_group(0, group, &[]);
            // One invocation a column of the table.
            pass.dispatch_workgroups(of.size[0].div_ceil(8), of.size[1].div_ceil(8), 1);
        }
        (self.groups, self.made_for) = (Some(groups), Some(air));
    }

    fn bind_groups(&self, device: &wgpu::Device, passes: &[Pass; 4], sampler: &wgpu::Sampler) -> [wgpu::BindGroup; 4] {
        let group = |pass: usize, tables: &[(u32, &wgpu::TextureView)]| {
            let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
            let ends = [entry(0, self.uniform.as_entire_binding()), entry(1, wgpu::BindingResource::Sampler(sampler))];
            let tables =
                tables.iter().map(|(binding, table)| entry(*binding, wgpu::BindingResource::TextureView(table)));
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("air"),
                layout: &passes[pass].layout,
                entries: &ends.into_iter().chain(tables).collect::<Vec<_>>(),
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

/// The passes: what they read is bound from 2 on, what they write from 4 on.
fn passes(device: &wgpu::Device, cache: Option<&wgpu::PipelineCache>) -> [Pass; 4] {
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
    let pass = |entry_point, reads: &[u32], writes: &[u32], size| {
        let dimension = if size == AIR_SIZE { wgpu::TextureViewDimension::D3 } else { wgpu::TextureViewDimension::D2 };
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
        Pass { pipeline, layout, size }
    };
    [
        pass("cs_sunlight", &[], &[4], SUNLIGHT_SIZE),
        pass("cs_multiple", &[2], &[4], MULTIPLE_SIZE),
        pass("cs_sky_light", &[2, 3], &[4], SKY_LIGHT_SIZE),
        pass("cs_air", &[2, 3], &[5, 6], AIR_SIZE),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits};

    #[test]
    fn each_context_of_a_device_has_its_own_tables() {
        let traits = ContextTraits { adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let places = |draws_of_frame: usize, eyes_km: [f64; 2]| {
            let mut atmosphere = Atmosphere::new(ctx.device());
            let mut found = Vec::new();
            for frame in 0..4 {
                for height_km in eyes_km {
                    atmosphere.start_draw(draws_of_frame);
                    // Eyes move.
                    let air = Air::at(height_km + 0.01 * f64::from(frame), 0.5, 0.1);
                    found.push(atmosphere.find(&ctx, &air).unwrap().place);
                }
            }
            found
        };
        assert_eq!(places(2, [1.0, 9.0]), [1, 2, 1, 2, 1, 2, 1, 2]);
        assert_eq!(places(1, [1.0, 9.0]), [1; 8], "one after the other");
        // More than there can be sets: the longest unused go.
        let mut atmosphere = Atmosphere::new(ctx.device());
        for draw in 0..40 {
            atmosphere.start_draw(20);
            let found = atmosphere.find(&ctx, &Air::at(1.0 + f64::from(draw), 0.5, 0.1)).unwrap();
            assert!(!found.is_refused && atmosphere.sets.len() <= MOST_SETS, "draw {draw}");
        }
        // None is kept for pictures without air.
        let given_back = (0..2 * KEPT_DRAWS).filter(|_| atmosphere.start_draw(1)).count();
        assert!(given_back > 0 && atmosphere.place_count() == 1);
    }

    /// The device's handler had it, and with the tables all that was drawn was invalid.
    #[test]
    fn eyes_that_there_is_no_memory_for_share_the_air_of_others() {
        let traits = ContextTraits { adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut atmosphere = Atmosphere::new(ctx.device());
        assert!(atmosphere.can_be_made(&ctx));
        let eyes = [1.0, 5.0, 9.0].map(|height_km| Air::at(height_km, 0.5, 0.1));
        atmosphere.start_draw(1);
        ctx.pretend_frame_memory(Some(Tables::bytes() - 1));
        assert_eq!(atmosphere.find(&ctx, &eyes[0]), None);
        ctx.pretend_frame_memory(Some(3 * Tables::bytes() - 1));
        let found = eyes.map(|air| atmosphere.find(&ctx, &air));
        let places = found.map(|f| f.map(|f| (f.place, f.is_refused)));
        assert_eq!(places, [Some((1, false)), Some((2, false)), Some((2, true))]);
        let is_of_air = |e: &String| e.starts_with("out of graphics memory: air of");
        assert!(atmosphere.errors.len() == 2 && atmosphere.errors.iter().all(is_of_air), "{:?}", atmosphere.errors);
        let mut encoder = ctx.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        atmosphere.record(&ctx, &mut encoder, None);
        assert_eq!(atmosphere.sets.iter().map(|set| set.made_for).collect::<Vec<_>>(), [Some(eyes[0]), Some(eyes[1])]);
        ctx.queue().submit([encoder.finish()]);
        assert!(ctx.take_device_errors().is_empty());
    }
}
