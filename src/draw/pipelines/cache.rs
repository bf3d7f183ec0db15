//! The pipelines of a renderer by key, and the eviction of those that are no longer drawn with. Draw thread.

use std::collections::HashMap;
use std::sync::Arc;

use super::builder::Variant;
use super::factory::Factory;
use super::key::{PipelineKey, Shading, StateKey};
use super::key_parts::PartIndices;
use super::pipeline_thread::{Order, PipelineThread};
use super::programs::Programs;
use super::target_table::TargetIndex;
use crate::gpu::{GraphicsContext, MeshPool, TargetFormats};
use crate::scene::AttributeLayout;
use crate::state::ResolvedState;

/// Pipelines kept even if they are not drawn with.
const MAX_UNUSED_KEPT: usize = 1024;
/// Pipelines drawn with in the last frames are kept, however many there are.
const UNUSED_FRAMES: u32 = 300;
/// The number of pipelines evicted in a frame.
const MAX_EVICTED_PER_FRAME: usize = 32;

/// Identifies a pipeline in [`Pipelines`] during a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) struct PipelineId(u32);

/// A pipeline, and the frame in which it was last drawn with.
struct Cached {
    pipeline: wgpu::RenderPipeline,
    used: u32,
}

/// The pipelines of a renderer.
pub(in crate::draw) struct Pipelines {
    factory: Factory,
    /// The programs of the application.
    pub(in crate::draw) programs: Programs,
    /// By id; `None` for evicted ones, whose ids are in `free`.
    pipelines: Vec<Option<Cached>>,
    free: Vec<PipelineId>,
    /// The number of the frame.
    frame: u32,
    /// `None` for keys whose pipeline cannot be created. Keys may share the pipeline of their fallback. Used for look-ups
    /// only while drawing, since its order is random.
    id_of: HashMap<PipelineKey, Option<PipelineId>>,
    /// Pipelines by key that the pipeline thread creates.
    ordered: HashMap<PipelineKey, Order<wgpu::RenderPipeline>>,
    /// Also for the pipelines of passes.
    pub(in crate::draw) pipeline_thread: PipelineThread,
}

impl Pipelines {
    pub(in crate::draw) fn new(ctx: &GraphicsContext) -> Self {
        Self {
            factory: Factory::new(ctx),
            programs: Programs::default(),
            pipelines: Vec::new(),
            free: Vec::new(),
            frame: 0,
            id_of: HashMap::new(),
            ordered: HashMap::new(),
            pipeline_thread: PipelineThread::default(),
        }
    }

    /// Returns the number of pipelines created on the draw thread so far.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.factory.builder.created()
    }

    /// Returns the errors since the last call.
    pub(in crate::draw) fn take_errors(&mut self) -> Vec<String> {
        self.factory.builder.take_errors()
    }

    /// Returns the layout of bind group 0.
    pub(in crate::draw) fn frame_layout(&self) -> &wgpu::BindGroupLayout {
        self.factory.builder.frame_layout()
    }

    /// Returns the layout of bind group 2 for the fixed function without texture units.
    pub(in crate::draw) fn fixed_layout(&self) -> &wgpu::BindGroupLayout {
        &self.factory.layouts.fixed
    }

    /// Returns the layout of bind group 2 for the fixed function with texture units.
    pub(in crate::draw) fn textured_layout(&self) -> &wgpu::BindGroupLayout {
        &self.factory.layouts.textured
    }

    /// Returns the layout of bind group 3, for pulled meshes.
    pub(in crate::draw) fn pull_layout(&self) -> &wgpu::BindGroupLayout {
        &self.factory.layouts.pulled
    }

    /// Tries to create a built-in pipeline. Returns `None` while it is ordered, `Some(None)` if the device has refused it.
    pub(super) fn try_builtin(
        &mut self,
        ctx: &GraphicsContext,
        order: &mut Option<Order<wgpu::RenderPipeline>>,
        describe: impl Fn() -> Variant,
    ) -> Option<Option<wgpu::RenderPipeline>> {
        let builder = &mut self.factory.builder;
        if self.pipeline_thread.is_ordering() && order.as_ref().is_none_or(Order::is_abandoned) {
            let (maker, variant) = (builder.maker(ctx), describe());
            let label = format!("pipeline {}", variant.label);
            *order =
                Some(self.pipeline_thread.order(ctx.device(), label, move |device| maker.create(device, &variant)));
        }
        match order.as_ref().and_then(|order| self.pipeline_thread.take(order)) {
            Some(created) => Some(builder.accept(created)),
            None if self.pipeline_thread.is_ordering() => None,
            None => Some(builder.create(ctx, &describe())),
        }
    }

    /// Returns a pipeline by the id that [`Self::ensure`] returned in this frame.
    pub(in crate::draw) fn pipeline(&self, id: PipelineId) -> Option<&wgpu::RenderPipeline> {
        self.pipelines.get(id.0 as usize)?.as_ref().map(|cached| &cached.pipeline)
    }

    /// Returns the part of keys that follows from a state.
    pub(in crate::draw) fn state_key(&mut self, state: &ResolvedState, shading: Shading, target: u16) -> StateKey {
        let (parts, replaced) = self.factory.intern_parts(state, self.frame);
        if replaced != PartIndices::default() {
            self.evict(|key| key.has_any(replaced));
        }
        StateKey::new(state, parts, shading, target)
    }

    /// Returns the index of a target's formats; `None` if too many different ones are in use. If the index was that of
    /// another kind, the pipelines of that kind are evicted.
    pub(in crate::draw) fn target(&mut self, formats: &TargetFormats) -> Option<u16> {
        match self.factory.targets.index_of(formats, self.frame)? {
            TargetIndex::Known(index) => Some(index),
            TargetIndex::Replaced(index) => {
                self.evict(|key| key.target() == index);
                Some(index)
            }
        }
    }

    /// Returns the formats of a target by index.
    pub(in crate::draw) fn target_formats(&self, target: u16) -> Option<&TargetFormats> {
        self.factory.targets.formats(target)
    }

    /// Returns the key with the vertex format of a chunk of the mesh pool.
    pub(in crate::draw) fn with_vertices(&mut self, key: PipelineKey, meshes: &MeshPool, chunk: u32) -> PipelineKey {
        match meshes.attribute_layout_of(chunk) {
            None => key.with_vertices(meshes.format_of(chunk)),
            Some((index, layout)) => self.with_layout(key, index, layout),
        }
    }

    /// Returns the key of vertices with custom attributes. If the index of the layout was reused for another layout, the
    /// pipelines of the old one are evicted.
    pub(in crate::draw) fn with_layout(
        &mut self,
        key: PipelineKey,
        index: u32,
        layout: &Arc<AttributeLayout>,
    ) -> PipelineKey {
        if self.factory.attribute_layouts.replace(index, layout) {
            self.evict(|key| key.layout() == index);
        }
        key.with_layout(index)
    }

    /// Returns the pipeline of a key and creates it if needed. A key whose pipeline cannot be created gets that of its
    /// fallback, so that the fault is visible, or none. Errors are named after the state that needs the pipeline.
    ///
    /// While missing pipelines are ordered, returns `None` for one that is not there.
    pub(in crate::draw) fn ensure(
        &mut self,
        ctx: &GraphicsContext,
        key: PipelineKey,
        state: Option<&ResolvedState>,
    ) -> Option<PipelineId> {
        if let Some(id) = self.id_of.get(&key) {
            let cached = id.and_then(|id| self.pipelines.get_mut(id.0 as usize)?.as_mut());
            if let Some(cached) = cached {
                cached.used = self.frame;
            }
            return *id;
        }
        let created = match self.take_ordered(ctx, key, state) {
            Some(created) => created,
            None if self.pipeline_thread.is_ordering() => return None,
            None => self.factory.create(ctx, &mut self.programs, key, state),
        };
        let id = match created {
            Some(pipeline) => Some(self.insert(pipeline)),
            None if key.fallback() != key => match self.ensure(ctx, key.fallback(), state) {
                // Once the fallback is there.
                None if self.pipeline_thread.is_ordering() => return None,
                fallback => fallback,
            },
            None => None,
        };
        self.id_of.insert(key, id);
        id
    }

    /// Returns the ordered pipeline of a key, once the thread has tried; `Some(None)` if there can be none. Orders it while
    /// missing pipelines are ordered.
    fn take_ordered(
        &mut self,
        ctx: &GraphicsContext,
        key: PipelineKey,
        state: Option<&ResolvedState>,
    ) -> Option<Option<wgpu::RenderPipeline>> {
        let first_error = self.factory.builder.errors().len();
        let order = match self.ordered.remove(&key).filter(|order| !order.is_abandoned()) {
            Some(order) => order,
            None if !self.pipeline_thread.is_ordering() => return None,
            None => {
                let Some(variant) = self.factory.describe(ctx, &mut self.programs, key) else {
                    self.factory.name_errors(first_error, state);
                    return Some(None);
                };
                let maker = self.factory.builder.maker(ctx);
                let label = format!("pipeline {}", variant.label);
                self.pipeline_thread.order(ctx.device(), label, move |device| maker.create(device, &variant))
            }
        };
        let Some(created) = self.pipeline_thread.take(&order) else {
            // A frame that cannot wait creates the pipeline itself.
            if self.pipeline_thread.is_ordering() {
                self.ordered.insert(key, order);
            }
            return None;
        };
        let pipeline = self.factory.builder.accept(created);
        self.factory.name_errors(first_error, state);
        Some(pipeline)
    }

    /// Creates pipelines for keys that follow from those of the existing pipelines, in the order of the keys.
    pub(in crate::draw) fn ensure_derived(
        &mut self,
        ctx: &GraphicsContext,
        derive: impl Fn(PipelineKey) -> Option<PipelineKey>,
    ) {
        let mut keys: Vec<PipelineKey> = self.id_of.keys().filter_map(|key| derive(*key)).collect();
        keys.sort_unstable();
        keys.dedup();
        keys.into_iter().for_each(|key| _ = self.ensure(ctx, key, None));
    }

    fn insert(&mut self, pipeline: wgpu::RenderPipeline) -> PipelineId {
        let cached = Some(Cached { pipeline, used: self.frame });
        if let Some(id) = self.free.pop() {
            self.pipelines[id.0 as usize] = cached;
            return id;
        }
        self.pipelines.push(cached);
        PipelineId(self.pipelines.len() as u32 - 1)
    }

    /// Starts a frame: drops programs that the application has dropped, and evicts unused pipelines. Must be called
    /// before the frame's keys are made, since the draw holds its programs. Returns true if programs were dropped, so that
    /// their indices may be reused.
    pub(in crate::draw) fn start_frame(&mut self) -> bool {
        self.frame = self.frame.wrapping_add(1);
        self.evict_unused(MAX_UNUSED_KEPT, UNUSED_FRAMES);
        let dropped = self.programs.prune();
        if dropped.is_empty() {
            return false;
        }
        self.evict(|key| matches!(key.shading(), Shading::Program(index) if dropped.contains(&index)));
        true
    }

    /// Evicts the pipelines of some keys.
    fn evict(&mut self, is_evicted: impl Fn(&PipelineKey) -> bool) {
        self.ordered.retain(|key, _| !is_evicted(key));
        let removed: Vec<PipelineId> =
            self.id_of.extract_if(|key, _| is_evicted(key)).filter_map(|(_, id)| id).collect();
        for id in removed {
            // Other keys may have the same pipeline as their fallback.
            if let Some(cached) = self.pipelines.get_mut(id.0 as usize)
                && !self.id_of.values().any(|other| *other == Some(id))
                && cached.take().is_some()
            {
                self.free.push(id);
            }
        }
    }

    /// Evicts some of the pipelines beyond `max_kept` that were not drawn with for more than `frames` frames.
    fn evict_unused(&mut self, max_kept: usize, frames: u32) {
        let over = (self.pipelines.len() - self.free.len()).saturating_sub(max_kept);
        if over == 0 {
            return;
        }
        let is_unused = |cached: &Cached| self.frame.wrapping_sub(cached.used) > frames;
        let unused = (0u32..).zip(&self.pipelines).filter(|(_, cached)| cached.as_ref().is_some_and(is_unused));
        let evicted: Vec<PipelineId> =
            unused.map(|(index, _)| PipelineId(index)).take(over.min(MAX_EVICTED_PER_FRAME)).collect();
        self.id_of.retain(|_, id| id.is_none_or(|id| !evicted.contains(&id)));
        for id in evicted {
            self.pipelines[id.0 as usize] = None;
            self.free.push(id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, MAX_COLOR_ATTACHMENTS};
    use crate::state::{Attribute, PolygonOffset, StateSet};

    fn context() -> GraphicsContext {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        GraphicsContext::new_offscreen(&traits).unwrap()
    }

    fn target(pipelines: &mut Pipelines) -> u16 {
        let mut colors = [None; MAX_COLOR_ATTACHMENTS];
        colors[0] = Some(wgpu::TextureFormat::Rgba8Unorm);
        let formats = TargetFormats { colors, depth: crate::gpu::DEPTH_FORMAT, samples: 1, keeps_alpha: false };
        pipelines.target(&formats).unwrap()
    }

    fn key(pipelines: &mut Pipelines, target: u16, units: f32) -> PipelineKey {
        let set = StateSet::default().with(Attribute::PolygonOffset(PolygonOffset { factor: 1.0, units }));
        let state = ResolvedState::default().below(&set);
        PipelineKey::height(&pipelines.state_key(&state, Shading::Plain, target), false)
    }

    #[test]
    fn unused_pipelines_are_evicted_beyond_a_number() {
        let ctx = context();
        let mut pipelines = Pipelines::new(&ctx);
        let target = target(&mut pipelines);
        let keys: Vec<PipelineKey> = (0..20).map(|i| key(&mut pipelines, target, i as f32)).collect();
        let count = |pipelines: &Pipelines| pipelines.pipelines.iter().flatten().count();
        for frame in 0..30 {
            pipelines.frame += 1;
            pipelines.evict_unused(10, 5);
            // All keys are used in the first frame, and half of them in the others.
            keys[if frame == 0 { 0 } else { 10 }..].iter().for_each(|key| _ = pipelines.ensure(&ctx, *key, None));
            assert_eq!(count(&pipelines), if frame < 6 { 20 } else { 10 }, "{frame}");
        }
        assert_eq!((pipelines.id_of.len(), pipelines.created()), (10, 20));
        // An evicted pipeline that is needed again reuses a free id.
        let id = pipelines.ensure(&ctx, keys[3], None).unwrap();
        assert!(id.0 < 20 && pipelines.pipeline(id).is_some() && count(&pipelines) == 11);
        // Pipelines in use are kept beyond the number.
        for _ in 0..30 {
            pipelines.frame += 1;
            keys.iter().for_each(|key| _ = pipelines.ensure(&ctx, *key, None));
            pipelines.evict_unused(10, 5);
        }
        assert_eq!((count(&pipelines), pipelines.created()), (20, 30));
    }

    /// A polygon offset that changes in every frame must not exhaust the indices of offsets.
    #[test]
    fn unused_parts_of_keys_are_replaced_and_their_pipelines_evicted() {
        let ctx = context();
        let mut pipelines = Pipelines::new(&ctx);
        let target = target(&mut pipelines);
        for frame in 0..1_100 {
            pipelines.start_frame();
            for units in [-1.0, 1.0 + frame as f32] {
                let key = key(&mut pipelines, target, units);
                pipelines.ensure(&ctx, key, None);
            }
        }
        assert_eq!((pipelines.created(), pipelines.pipelines.iter().flatten().count()), (1_101, 1_023));
        let errors = pipelines.take_errors();
        assert!(errors.is_empty(), "{errors:?}");
    }
}
