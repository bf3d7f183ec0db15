//! The shadow pass: draws what casts the sun's shadows into the shadow maps, one render pass for each cascade, right
//! before the stage that receives them. Draw thread.

use std::ops::Range;

use super::maps::{FORMAT, MapSize, ShadowMaps};
use crate::cull::{CullCamera, DrawnPart, FadeBand, RenderStage, StageShadows};
use crate::draw::batch::state_entry::StateEntry;
use crate::draw::bound_state::{BoundState, DynamicState};
use crate::draw::passes::shading::{Shaded, choose_shading, shade};
use crate::draw::passes::stage_input::{LitView, StageInput};
use crate::draw::pipelines::key::{Shading, StateKey};
use crate::draw::pipelines::{MAX_COLOR_ATTACHMENTS, Pipelines, TargetFormats};
use crate::draw::recorder::{DrawSources, PassRecorder};
use crate::draw::resources::Resources;
use crate::draw::uniforms::air::AirParameters;
use crate::draw::uniforms::frame::FrameUniform;
use crate::draw::uniforms::frame_groups::ShadowEntries;
use crate::gpu::GraphicsContext;
use crate::scene::{CameraEnvironment, CameraShadows, Environment, MAX_CASCADES, SunShadows, has_parallel_rays};
use crate::state::{CLIP_PLANES, Mode, ResolvedState, TEXTURE_UNITS};

/// The runs of the cascades of one view, in the frame's batch.
#[derive(Clone, Default)]
struct CascadeRuns {
    /// By cascade.
    runs: [Range<usize>; MAX_CASCADES],
    count: usize,
    first_layer: usize,
}

/// A view and the shadows that fall into it.
#[derive(Clone, Copy)]
pub(in crate::draw) struct ShadowedView<'a> {
    pub(in crate::draw) shadows: &'a StageShadows,
    pub(in crate::draw) view: &'a LitView,
    /// The number of the view in the stage.
    pub(in crate::draw) number: u32,
    pub(in crate::draw) first_layer: usize,
    /// Byte offset of the view's stage uniform: its lights and clip planes.
    pub(in crate::draw) positioned: u32,
}

/// Hands out the layers of the shadow maps to the views of a stage.
#[derive(Debug, Default)]
pub(in crate::draw) struct LayerAllocator {
    next: usize,
}

/// The shadow maps of a renderer and the casters of the current frame.
pub(in crate::draw) struct ShadowPass {
    maps: ShadowMaps,
    /// The views of all stages that have shadows.
    views: Vec<CascadeRuns>,
}

impl ShadowPass {
    pub(in crate::draw) fn new(device: &wgpu::Device) -> Self {
        Self { maps: ShadowMaps::new(device), views: Vec::new() }
    }

    pub(in crate::draw) fn start_frame(&mut self) {
        self.views.clear();
    }

    /// Makes the maps large enough for the stages of a frame, given with their environments. Reports shadow settings
    /// that are invalid or that the adapter has no maps for. Returns true if the texture was replaced.
    pub(in crate::draw) fn prepare_maps<'a>(
        &mut self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        views: impl Iterator<Item = (&'a RenderStage, &'a Environment)>,
    ) -> bool {
        let max_px = self.maps.max_px();
        let mut wanted = MapSize::default();
        for (stage, environment) in views {
            let mut add = |stage: &RenderStage, settings: Option<SunShadows>| match settings
                .map_or(Ok(()), |settings| settings.check())
            {
                Err(problem) => resources.errors.report_once(problem),
                Ok(()) if settings.is_some_and(|s| s.resolution_px > max_px) => resources
                    .errors
                    .report_once(format!("the adapter has no shadow maps of more than {max_px} texels a side")),
                Ok(()) => wanted.add(stage, max_px),
            };
            add(stage, environment.shadows);
            for_each_stage_around(stage, &mut add);
        }
        match self.maps.ensure(ctx.memory(), wanted) {
            Ok(is_new) => is_new,
            Err(error) => {
                resources.errors.report_once(error);
                false
            }
        }
    }

    /// Returns the first layer for the cascades of a view; `None` if it has no shadows or the maps have no room.
    pub(in crate::draw) fn allocate_layers(
        &self,
        layers: &mut LayerAllocator,
        shadows: &StageShadows,
    ) -> Option<usize> {
        let first = layers.next;
        self.maps.has_room(shadows, first).then(|| {
            layers.next += shadows.cascades.len().min(MAX_CASCADES);
            first
        })
    }

    /// Returns the side of the maps in texels.
    pub(in crate::draw) fn map_px(&self) -> u32 {
        self.maps.size_px()
    }

    /// Returns the number of views prepared so far.
    pub(in crate::draw) fn view_count(&self) -> usize {
        self.views.len()
    }

    /// Returns the bindings 8 and 9 of group 0. `is_target` is true for passes that draw into the maps.
    pub(in crate::draw) fn entries(&self, is_target: bool) -> ShadowEntries<'_> {
        self.maps.entries(is_target)
    }

    /// Builds the runs of the casters of a view, in the room that the views' own leaves leave.
    pub(in crate::draw) fn prepare(
        &mut self,
        resources: &mut Resources,
        input: &StageInput<'_>,
        shadowed: &ShadowedView<'_>,
    ) {
        let Some(map_target) = map_target(&mut resources.pipelines) else { return };
        let ShadowedView { shadows, view: LitView { camera, around, .. }, number, first_layer, positioned } = *shadowed;
        let size_px = shadows.settings.resolution_px;
        debug_assert!(size_px <= self.maps.size_px());
        let count = shadows.cascades.len().min(MAX_CASCADES);
        let mut view = CascadeRuns { count, first_layer, ..Default::default() };
        for (runs, cascade) in view.runs.iter_mut().zip(&shadows.cascades) {
            let frame = resources.state_groups.push(&caster_uniform(
                camera,
                &cascade.clip_from_eye,
                &around.environment,
                &around.air.air,
            ));
            let base = BoundState {
                dynamics: whole_map(size_px),
                frame: [frame, positioned],
                air: 0,
                group: None,
                attribute: None,
            };
            let plain = resources.bound_states.push(base);
            let mut states = resources.batch.take_states();
            for state in &cascade.stage.state_sets {
                let drops = drops_parts(state);
                let Shaded { shading, group, attribute } = if drops || has_own_shader(state) {
                    shade(resources, input, number, state, drops)
                } else {
                    Shaded::PLAIN
                };
                let bound = match group {
                    None => plain,
                    Some(_) => resources.bound_states.push(BoundState { group, attribute, ..base }),
                };
                let key = StateKey::caster(state, shading, drops, map_target);
                states.push(StateEntry::new(key, bound, state, DrawnPart::Band(FadeBand::FULL)));
            }
            resources.batch.put_states(states);
            let (first_run, before) = (resources.batch.runs().len(), resources.batch.leaves().len());
            let limit = resources.leaf_buffer.caster_limit(before);
            let built = resources.batch.build(input.ctx, &mut resources.pipelines, &cascade.stage, limit);
            let taken = resources.batch.leaves().len() - before;
            resources.leaf_buffer.take_caster_room(taken);
            resources.stats.shadow_leaves += taken as u32;
            resources.stats.shadow_leaves_dropped += built.dropped as u32;
            *runs = first_run..resources.batch.runs().len();
        }
        self.views.push(view);
    }

    /// Records a render pass for each cascade of the views of a stage.
    pub(in crate::draw) fn record(
        &self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        encoder: &mut wgpu::CommandEncoder,
        views: Range<usize>,
    ) {
        for view in self.views.get(views).unwrap_or_default() {
            for (layer, runs) in (view.first_layer..).zip(&view.runs[..view.count]) {
                let Some(layer) = self.maps.layer(layer) else { return };
                let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some("shadows"),
                    color_attachments: &[],
                    depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                        view: layer,
                        // Depths are reversed: 0 is infinitely far, so that nothing is between there and the sun.
                        depth_ops: Some(wgpu::Operations {
                            load: wgpu::LoadOp::Clear(0.0),
                            store: wgpu::StoreOp::Store,
                        }),
                        stencil_ops: None,
                    }),
                    timestamp_writes: resources.timer.as_mut().and_then(|timer| timer.pass("shadows")),
                    occlusion_query_set: None,
                    multiview_mask: None,
                });
                let sources =
                    DrawSources { ctx, resources, frame_groups: resources.frame_groups.casters(), pass: None };
                let mut recorder = PassRecorder::new(&mut pass, whole_map(self.maps.size_px()));
                recorder.draw_runs(&sources, runs.clone());
                let stats = recorder.finish().0;
                drop(pass);
                resources.stats.add_shadow_pass(&stats);
            }
        }
    }
}

/// Returns the frame uniform of a cascade: the view's own eye and levels of detail, seen along the sun's rays.
fn caster_uniform(
    camera: &CullCamera,
    clip_from_eye: &glam::DMat4,
    environment: &Environment,
    air: &AirParameters,
) -> FrameUniform {
    let mut uniform = FrameUniform::new(camera, clip_from_eye, environment, air);
    // Heights morph as they do in the view, although the sun's own rays are parallel.
    uniform.air[3] = if has_parallel_rays(&camera.clip_from_eye) { 1.0 } else { 0.0 };
    uniform
}

/// Returns the pipelines' index of the shadow maps as a target; `None` if there are too many targets.
pub(in crate::draw) fn map_target(pipelines: &mut Pipelines) -> Option<u16> {
    pipelines.target(&TargetFormats {
        colors: [None; MAX_COLOR_ATTACHMENTS],
        depth: FORMAT,
        samples: 1,
        keeps_alpha: false,
    })
}

/// Returns the pipeline part of what casts shadows under a state, for prewarming; `None` if it casts none.
pub(in crate::draw) fn caster_key(
    pipelines: &mut Pipelines,
    device: &wgpu::Device,
    state: &ResolvedState,
) -> Result<Option<StateKey>, String> {
    let Some(target) = map_target(pipelines).filter(|_| state.casts_shadow()) else { return Ok(None) };
    let drops = drops_parts(state);
    let needs_shader = drops || has_own_shader(state);
    let shading =
        if needs_shader { choose_shading(&mut pipelines.programs, device, state, drops)? } else { Shading::Plain };
    Ok(Some(StateKey::caster(state, shading, drops, target)))
}

/// Calls a function for the stages before and after one, with the shadows that their cameras have themselves.
fn for_each_stage_around(stage: &RenderStage, call: &mut impl FnMut(&RenderStage, Option<SunShadows>)) {
    for other in stage.pre_render.iter().chain(&stage.post_render) {
        let environment = match &other.target.environment {
            CameraEnvironment::Own(own) => own.shadows,
            _ => None,
        };
        let settings = match other.target.shadows {
            CameraShadows::None => None,
            CameraShadows::Environment => environment,
            CameraShadows::Own(own) => Some(own),
        };
        call(other, settings);
        for_each_stage_around(other, call);
    }
}

/// Returns the dynamic state that covers a square map, or the used square of a larger one.
fn whole_map(size_px: u32) -> DynamicState {
    let side = size_px as f32;
    DynamicState {
        viewport: [0.0, 0.0, side, side, 0.0, 1.0],
        scissor: [0, 0, size_px, size_px],
        stencil_reference: 0,
        blend_color: None,
    }
}

/// Returns true if an alpha test or clip planes drop parts of what casts.
fn drops_parts(state: &ResolvedState) -> bool {
    state.alpha_func().is_some() || state.mode_bits(Mode::ClipPlane(0), CLIP_PLANES) != 0
}

/// Returns true if the vertices or alphas of a state's own program or textures decide what casts.
fn has_own_shader(state: &ResolvedState) -> bool {
    state.program().is_some() || (0..TEXTURE_UNITS).any(|unit| state.texture(unit).is_some())
}
