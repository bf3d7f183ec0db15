//! The air pass: computes the tables of light that the air scatters and absorbs, for each eye of a draw whose air differs
//! from the others'. Runs before all render passes. Draw thread only.
//!
//! Views, and cameras in the graph with separate air, share up to eight sets of tables. An eye beyond the eighth
//! uses the set of the eye at nearly its height.

pub(in crate::draw) mod tables;

use crate::cull::CullCamera;
use crate::draw::pipelines::pipeline_thread::{Order, PipelineThread};
use crate::draw::resources::Resources;
use crate::draw::uniforms::air::AirParameters;
use crate::gpu::{FrameTimer, GraphicsContext, catch_errors};
use crate::scene::{Environment, Sky};
use tables::{AirPipelines, ReadTables, Tables, table};

/// The sky of a clear day, shown where the tables cannot be computed.
const PLAIN_SKY: Sky = Sky::Background([0x87, 0xae, 0xd6]);

/// Sets of tables, each 0.8 MB.
const MAX_SETS: usize = 8;
/// Draws after which an unused set is freed.
const KEPT_DRAWS: u32 = 120;

/// A set of tables and the eye that uses it.
struct TableSet {
    tables: Tables,
    /// The parameters that an eye of the draw `used` needs.
    wanted: Option<AirParameters>,
    /// The draw in which the set was last used.
    used: u32,
}

impl TableSet {
    /// Returns true if the set needs no recomputation of the tables that depend on aerosols.
    fn fits(&self, air: &AirParameters) -> bool {
        self.wanted.is_none_or(|wanted| wanted.aerosol_per_km == air.aerosol_per_km)
    }
}

/// The state of the compute pipelines, created for the first environment with an atmosphere.
enum Lazy {
    NotCreated,
    /// The pipeline thread creates them.
    Ordered(Order<AirPipelines>),
    Ready(AirPipelines),
    /// The device refused them; the error was reported.
    Refused,
}

/// The sets of air tables of a renderer and the compute pass that fills them.
pub(in crate::draw) struct AirPass {
    sampler: wgpu::Sampler,
    /// Textures of one texel, bound at index 0 for views without air.
    no_table: wgpu::TextureView,
    no_volume: wgpu::TextureView,
    /// Bound at the indices from 1 on.
    sets: Vec<TableSet>,
    pipelines: Lazy,
    /// How often the draw thread has created them.
    created: u32,
    draw: u32,
    /// The number of draws in a frame: one for each context of the device. A set that one of them used is needed again
    /// in the next frame.
    draws_per_frame: u32,
}

/// The air of an eye: the set of tables that it uses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::draw) struct EyeAir {
    /// Index of the set; 0 without air.
    pub(in crate::draw) set: u8,
    /// The parameters of the set. They are another eye's if all sets were in use.
    pub(in crate::draw) air: AirParameters,
    is_refused: bool,
}

impl AirPass {
    pub(in crate::draw) fn new(device: &wgpu::Device) -> Self {
        Self {
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("air"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
            no_table: table(device, "no air", [1; 3]),
            no_volume: table(device, "no air", [1, 1, 2]),
            sets: Vec::new(),
            pipelines: Lazy::NotCreated,
            created: 0,
            draw: 0,
            draws_per_frame: 1,
        }
    }

    /// Returns how often the draw thread has created the pipelines of all steps, which count as one.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.created
    }

    /// Starts a draw and frees sets that were not used for long. Returns true if sets were freed, so that the bind groups
    /// that hold them must be created again.
    pub(in crate::draw) fn start_draw(&mut self, draws_per_frame: usize) -> bool {
        self.draw = self.draw.wrapping_add(1);
        self.draws_per_frame = draws_per_frame.clamp(1, KEPT_DRAWS as usize) as u32;
        let count = self.sets.len();
        let draw = self.draw;
        while self.sets.last().is_some_and(|set| draw.wrapping_sub(set.used) > KEPT_DRAWS) {
            self.sets.pop();
        }
        self.sets.len() < count
    }

    /// Returns the number of indices that [`Self::entries`] takes, that of views without air included.
    pub(in crate::draw) fn index_count(&self) -> usize {
        1 + self.sets.len()
    }

    /// Returns the air of a camera's eye and reserves its tables. If they cannot be computed, the environment gets a
    /// plain sky.
    pub(in crate::draw) fn prepare(
        &mut self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        camera: &CullCamera,
        environment: &mut Environment,
    ) -> EyeAir {
        let air = AirParameters::of(camera, environment);
        let none = EyeAir { set: 0, air, is_refused: false };
        if environment.sky != Sky::Atmosphere {
            return none;
        }
        let thread = &mut resources.pipelines.pipeline_thread;
        if thread.is_ordering() && self.order_pipelines(ctx, thread) {
            // A rehearsal has the pipelines of an atmosphere without its tables.
            return none;
        }
        match self.find(ctx, &air, |error| resources.errors.report_once(error)) {
            Some(found) => {
                resources.stats.airs_refused += u32::from(found.is_refused);
                found
            }
            None => {
                environment.sky = PLAIN_SKY;
                none
            }
        }
    }

    /// Creates the compute pipelines before an environment needs them.
    pub(in crate::draw) fn prewarm(&mut self, ctx: &GraphicsContext, resources: &mut Resources) {
        self.ensure_pipelines(ctx, &mut |error| resources.errors.report_once(error));
    }

    /// Orders the compute pipelines at the first call; returns true while they are missing.
    fn order_pipelines(&mut self, ctx: &GraphicsContext, thread: &mut PipelineThread) -> bool {
        if matches!(&self.pipelines, Lazy::NotCreated) {
            let cache = ctx.pipeline_cache().cloned();
            let create = move |device: &wgpu::Device| AirPipelines::new(device, cache.as_ref());
            self.pipelines = Lazy::Ordered(thread.order(ctx.device(), "air".to_owned(), create));
        }
        let Lazy::Ordered(order) = &self.pipelines else { return false };
        match thread.take(order) {
            None => true,
            Some(Ok(created)) => {
                self.pipelines = Lazy::Ready(created);
                false
            }
            // The frame that needs them tries again, and reports the error.
            Some(Err(_)) => {
                self.pipelines = Lazy::NotCreated;
                false
            }
        }
    }

    /// Creates the compute pipelines at the first call; returns true if the device has them.
    fn ensure_pipelines(&mut self, ctx: &GraphicsContext, report: &mut impl FnMut(String)) -> bool {
        if matches!(self.pipelines, Lazy::NotCreated | Lazy::Ordered(_)) {
            let (created, error) = catch_errors(ctx.device(), || AirPipelines::new(ctx.device(), ctx.pipeline_cache()));
            self.created += 1;
            self.pipelines = match error {
                None => Lazy::Ready(created),
                Some(error) => {
                    report(format!("the air cannot be computed, the sky is plain: {error}"));
                    Lazy::Refused
                }
            };
        }
        matches!(self.pipelines, Lazy::Ready(_))
    }

    /// Finds or creates the set of tables for an eye. Returns `None` if the device cannot compute any, or has no memory
    /// for the first set.
    fn find(&mut self, ctx: &GraphicsContext, air: &AirParameters, mut report: impl FnMut(String)) -> Option<EyeAir> {
        if !self.ensure_pipelines(ctx, &mut report) {
            return None;
        }
        let draw = self.draw;
        let age = |set: &TableSet| draw.wrapping_sub(set.used);
        let same = self.sets.iter().position(|set| set.wanted.as_ref() == Some(air));
        // The first free set is taken, so that the last ones can be freed.
        let is_free = |set: &TableSet| set.wanted.is_none() || age(set) >= self.draws_per_frame;
        let free = || self.sets.iter().position(|set| is_free(set) && set.fits(air));
        let index = match same.or_else(free) {
            Some(index) => index,
            None if self.sets.len() < MAX_SETS => {
                match ctx.memory().allocate("air", Tables::bytes(), Tables::new) {
                    Ok(tables) => self.sets.push(TableSet { tables, wanted: None, used: 0 }),
                    Err(error) => {
                        report(error);
                        return self.nearest(air);
                    }
                }
                self.sets.len() - 1
            }
            None => {
                let others = self.sets.iter().enumerate().filter(|(_, set)| age(set) > 0);
                match others.max_by_key(|(_, set)| (set.fits(air), age(set))) {
                    Some((index, _)) => index,
                    None => return self.nearest(air),
                }
            }
        };
        let set = &mut self.sets[index];
        (set.wanted, set.used) = (Some(*air), draw);
        Some(EyeAir { set: 1 + index as u8, air: *air, is_refused: false })
    }

    /// Returns the set whose eye is at nearly the same height.
    fn nearest(&self, air: &AirParameters) -> Option<EyeAir> {
        let found = (1..).zip(&self.sets).filter_map(|(index, set)| Some((index, set.wanted?)));
        let distance = |other: &AirParameters| (other.eye_km - air.eye_km).abs();
        let (set, air) = found.min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b)))?;
        Some(EyeAir { set, air, is_refused: true })
    }

    /// Returns the bindings of a set in group 0, from binding 3 on.
    pub(in crate::draw) fn entries(&self, index: usize) -> [wgpu::BindGroupEntry<'_>; 5] {
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let (plane, volume) = (&self.no_table, &self.no_volume);
        let none = ReadTables { sunlight: plane, sky_light: plane, scattered: volume, mie: volume };
        let set = index.checked_sub(1).and_then(|index| self.sets.get(index));
        let read = set.map_or(none, |set| set.tables.read());
        [
            entry(3, wgpu::BindingResource::Sampler(&self.sampler)),
            entry(4, wgpu::BindingResource::TextureView(read.sunlight)),
            entry(5, wgpu::BindingResource::TextureView(read.sky_light)),
            entry(6, wgpu::BindingResource::TextureView(read.scattered)),
            entry(7, wgpu::BindingResource::TextureView(read.mie)),
        ]
    }

    /// Records the computation of the tables that this draw uses and whose parameters have changed.
    pub(in crate::draw) fn record(
        &mut self,
        ctx: &GraphicsContext,
        encoder: &mut wgpu::CommandEncoder,
        timer: Option<&mut FrameTimer>,
    ) {
        let draw = self.draw;
        let needs = |set: &TableSet| set.used == draw && set.tables.computed_for() != set.wanted;
        if !self.sets.iter().any(needs) {
            return;
        }
        let Lazy::Ready(pipelines) = &self.pipelines else { return };
        let timestamp_writes = timer.and_then(|timer| timer.compute_pass("air"));
        let mut pass =
            encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("air"), timestamp_writes });
        for set in self.sets.iter_mut().filter(|set| needs(set)) {
            let Some(air) = set.wanted else { continue };
            set.tables.record(ctx, &mut pass, pipelines, &self.sampler, air);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits};

    fn ignore(_: String) {}

    #[test]
    fn each_context_of_a_device_keeps_its_own_tables() {
        let traits = ContextTraits { adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let sets = |draws_per_frame: usize, eyes_km: [f64; 2]| {
            let mut pass = AirPass::new(ctx.device());
            let mut found = Vec::new();
            for frame in 0..4 {
                for height_km in eyes_km {
                    pass.start_draw(draws_per_frame);
                    // Eyes move.
                    let air = AirParameters::at(height_km + 0.01 * f64::from(frame), 0.5, 0.1);
                    found.push(pass.find(&ctx, &air, ignore).unwrap().set);
                }
            }
            found
        };
        assert_eq!(sets(2, [1.0, 9.0]), [1, 2, 1, 2, 1, 2, 1, 2]);
        assert_eq!(sets(1, [1.0, 9.0]), [1; 8], "one draw after the other");
        // With more eyes than sets, the set that was unused for longest is replaced.
        let mut pass = AirPass::new(ctx.device());
        for draw in 0..40 {
            pass.start_draw(20);
            let found = pass.find(&ctx, &AirParameters::at(1.0 + f64::from(draw), 0.5, 0.1), ignore).unwrap();
            assert!(!found.is_refused && pass.sets.len() <= MAX_SETS, "draw {draw}");
        }
        // All sets are freed once no view has air.
        let freed = (0..2 * KEPT_DRAWS).filter(|_| pass.start_draw(1)).count();
        assert!(freed > 0 && pass.index_count() == 1);
    }

    /// Regression test: the device's own error handler got the failure, and every draw with the tables was invalid.
    #[test]
    fn eyes_without_memory_for_tables_share_those_of_others() {
        let traits = ContextTraits { adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut pass = AirPass::new(ctx.device());
        let mut errors = Vec::new();
        assert!(pass.ensure_pipelines(&ctx, &mut ignore));
        let eyes = [1.0, 5.0, 9.0].map(|height_km| AirParameters::at(height_km, 0.5, 0.1));
        pass.start_draw(1);
        ctx.pretend_frame_memory(Some(Tables::bytes() - 1));
        assert_eq!(pass.find(&ctx, &eyes[0], |e| errors.push(e)), None);
        ctx.pretend_frame_memory(Some(3 * Tables::bytes() - 1));
        let found = eyes.map(|air| pass.find(&ctx, &air, |e| errors.push(e)));
        let sets = found.map(|f| f.map(|f| (f.set, f.is_refused)));
        assert_eq!(sets, [Some((1, false)), Some((2, false)), Some((2, true))]);
        let is_of_air = |e: &String| e.starts_with("out of graphics memory: air of");
        assert!(errors.len() == 2 && errors.iter().all(is_of_air), "{errors:?}");
        let mut encoder = ctx.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        pass.record(&ctx, &mut encoder, None);
        let computed: Vec<_> = pass.sets.iter().map(|set| set.tables.computed_for()).collect();
        assert_eq!(computed, [Some(eyes[0]), Some(eyes[1])]);
        ctx.queue().submit([encoder.finish()]);
        assert!(ctx.take_device_errors().is_empty());
    }
}
