//! Pipelines, made when first needed: a software adapter takes a third of a second for each at its first draw.

mod bare;
pub(in crate::draw) mod convert;
mod further;
pub(in crate::draw) mod key;
mod of_key;
pub(in crate::draw) mod programs;
mod sources;
mod variant;

use std::collections::HashMap;

use bare::BARE;
pub(in crate::draw) use bare::Bare;
use further::Layouts;
use key::{MOST_TARGETS, PartIndices, Parts, PipelineKey, Shading, StateKey};
use programs::Programs;
pub use sources::DRAWABLE_PRELUDE;
pub(in crate::draw) use sources::{HEIGHT_PROGRAM_PRELUDE, PROGRAM_PRELUDE};

use crate::gpu::GraphicsContext;
pub(in crate::draw) use crate::gpu::{MOST_COLORS, TargetFormats};
use crate::state::{ResolvedState, TEXTURE_UNITS};

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
    layouts: Layouts,
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
            layouts: Layouts::default(),
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

    /// The same for a state; what cannot be made is said with the name of the one that first needed it.
    pub(in crate::draw) fn ensure_for(
        &mut self,
        ctx: &GraphicsContext,
        key: PipelineKey,
        state: &ResolvedState,
    ) -> u32 {
        let said = self.errors.len();
        let index = self.ensure(ctx, key);
        for error in &mut self.errors[said..] {
            let name = if state.name.is_empty() { "a state set" } else { state.name.as_str() };
            *error = format!("{name}: {error}");
        }
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits};
    use crate::state::{Attribute, PolygonOffset, StateSet};

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
}
