//! The views inside a stage: the light and air of each of them, and its uniforms. Draw thread.

use glam::DAffine3;

use crate::cull::{CullCamera, RenderStage};
use crate::draw::passes::Passes;
use crate::draw::passes::shadows::casters::{LayerAllocator, ShadowedView};
use crate::draw::passes::stage_input::{LitView, StageInput, Surroundings, ViewFrame};
use crate::draw::pipelines::key::AirKind;
use crate::draw::resources::Resources;
use crate::draw::uniforms::frame::{FrameUniform, clear_color};
use crate::draw::uniforms::stage::{StageUniform, has_own_uniform};
use crate::gpu::GraphicsContext;
use crate::scene::CameraEnvironment;

/// The views of the stage that is being prepared, its own first. The memory is kept for the next stage.
#[derive(Default)]
pub(super) struct StageViews {
    lit: Vec<LitView>,
    frames: Vec<ViewFrame>,
    /// By state of the stage; empty without local lights and lights or planes of states.
    positioned_of_state: Vec<u32>,
}

impl StageViews {
    /// Returns what the views' leaves are drawn with. There is at least one view once a stage was prepared.
    pub(super) fn frames(&self) -> &[ViewFrame] {
        &self.frames
    }

    /// Returns the byte offset of the stage uniform of each state. States whose leaves have local lights, separate lights and
    /// clip planes, or a volume to be cut to have separate uniforms. The list is empty if no state has any of these.
    pub(super) fn positioned_of_state(&self) -> &[u32] {
        &self.positioned_of_state
    }

    /// Prepares the uniforms of states with local lights, of those with separate lights and clip planes, and of those whose
    /// leaves are cut to a volume.
    fn prepare_states(&mut self, resources: &mut Resources, stage: &RenderStage) {
        let Self { lit, frames, positioned_of_state } = self;
        positioned_of_state.clear();
        let has_volumes = stage.parts.iter().any(|part| part.volume().is_some());
        let has_own = || stage.state_sets.iter().any(|state| has_own_uniform(state));
        if stage.light_groups.is_empty() && !has_volumes && !has_own() {
            return;
        }
        // States of one group are mostly neighbours, which share a uniform.
        let mut last = None;
        let states = stage.state_sets.iter().zip(&stage.view_of_state);
        let groups = stage.lights_of_state.iter().zip(&stage.part_of_state);
        for ((state, view), (group, part)) in states.zip(groups) {
            let own = has_own_uniform(state).then_some(state);
            let range = (*group as usize).checked_sub(1).and_then(|index| stage.light_groups.get(index));
            let lights = range.and_then(|range| stage.local_lights.get(range.clone()));
            let volume = stage.part(*part).and_then(|drawn| Some((*part, *drawn.volume()?)));
            let of = (*view, *group, volume.map(|(part, _)| part));
            let positioned = match last {
                _ if lights.is_none() && own.is_none() && volume.is_none() => {
                    frames.get(*view as usize).unwrap_or(&frames[0]).positioned
                }
                Some((last, positioned)) if last == of && own.is_none() => positioned,
                _ => {
                    let camera = &lit.get(*view as usize).unwrap_or(&lit[0]).camera;
                    let light_from = |from: u32| eye_from_view(camera, lit, from);
                    let mut uniform = StageUniform::new(stage, *view, light_from);
                    if let Some(lights) = lights {
                        uniform = uniform.with_local_lights(lights, light_from);
                    }
                    if let Some((_, volume)) = &volume {
                        uniform = uniform.with_volume(volume);
                    }
                    if let Some(state) = own {
                        uniform = uniform.with_own(state);
                    }
                    resources.state_groups.push(&uniform)
                }
            };
            last = own.is_none().then_some((of, positioned));
            positioned_of_state.push(positioned);
        }
    }

    /// Finds the light, air and shadow maps of each view.
    fn light(
        &mut self,
        ctx: &GraphicsContext,
        passes: &mut Passes,
        resources: &mut Resources,
        stage: &RenderStage,
        around: &Surroundings,
    ) {
        self.lit.clear();
        let mut layers = LayerAllocator::default();
        let own_shadows = around.shadows.map(|_| &stage.shadows);
        let first_layer = own_shadows.and_then(|shadows| passes.shadows.allocate_layers(&mut layers, shadows));
        self.lit.push(LitView { camera: stage.camera, around: *around, first_layer });
        for view in &stage.views {
            let above = *self.lit.get(view.above as usize).unwrap_or(&self.lit[0]);
            let first_layer = passes.shadows.allocate_layers(&mut layers, &view.shadows);
            let (camera, around) = if view.environment.is_whole() {
                let around =
                    surroundings_of_camera(ctx, passes, resources, &view.environment, &view.camera, &above.around);
                (view.camera, around)
            } else if first_layer.is_some() || view.shows_scene {
                (view.camera, above.around)
            } else {
                // The view is lit like the view above it, as seen from that view's eye.
                (CullCamera { eye_from_world: above.camera.eye_from_world, ..view.camera }, above.around)
            };
            self.lit.push(LitView { camera, around, first_layer });
        }
    }

    /// Prepares the views inside a stage and the shadows that fall into them. Returns the clear colour of the stage's own
    /// view.
    pub(super) fn prepare(
        &mut self,
        passes: &mut Passes,
        resources: &mut Resources,
        input: &StageInput<'_>,
        around: &Surroundings,
        hides_unready: bool,
    ) -> wgpu::Color {
        let stage = input.stage;
        self.light(input.ctx, passes, resources, stage, around);
        let Self { lit, frames, .. } = self;
        frames.clear();
        let mut background = wgpu::Color::BLACK;
        for (number, view) in (0u32..).zip(lit.iter()) {
            let LitView { camera, around: Surroundings { environment, air, .. }, first_layer } = view;
            let inner = (number as usize).checked_sub(1).and_then(|inner| stage.views.get(inner));
            let (clip_from_eye, shadows) =
                inner.map_or((&stage.camera.clip_from_eye, &stage.shadows), |v| (&v.clip_from_eye, &v.shadows));
            let mut uniform = FrameUniform::new(camera, clip_from_eye, environment, &air.air);
            if number == 0 {
                background = clear_color(environment, &uniform);
            }
            uniform.shape[1] = input.target.tones.exposure(uniform.shape[1]);
            // Without lights and planes, the uniforms of all views are the same.
            let has_positioned = !stage.lights.is_empty() || !stage.clip_planes.is_empty();
            let shared = frames.first().filter(|_| !has_positioned).map(|own| own.positioned);
            let positioned = shared.unwrap_or_else(|| {
                let light_from = |from: u32| eye_from_view(camera, lit, from);
                resources.state_groups.push(&StageUniform::new(stage, number, light_from))
            });
            if let Some(first_layer) = *first_layer {
                uniform = uniform.with_shadows(shadows, passes.shadows.map_px(), first_layer);
                let shadowed = ShadowedView { shadows, view, number, first_layer, positioned };
                resources.hide_unready(hides_unready, |resources| passes.shadows.prepare(resources, input, &shadowed));
            }
            frames.push(ViewFrame {
                uniform: resources.state_groups.push(&uniform),
                positioned,
                air: air.set,
                air_kind: AirKind::of(environment),
                has_shadows: first_layer.is_some(),
            });
        }
        self.prepare_states(resources, stage);
        background
    }
}

/// Returns the transform to a camera's eye from the lit eye of a view; the identity if it is not finite.
fn eye_from_view(camera: &CullCamera, lit: &[LitView], from: u32) -> DAffine3 {
    let from = lit.get(from as usize).unwrap_or(&lit[0]);
    let to_from = camera.eye_from_world * from.camera.eye_from_world.inverse();
    if to_from.is_finite() { to_from } else { DAffine3::IDENTITY }
}

/// Returns the surroundings of a camera in the graph below the camera of a view.
fn surroundings_of_camera(
    ctx: &GraphicsContext,
    passes: &mut Passes,
    resources: &mut Resources,
    own: &CameraEnvironment,
    camera: &CullCamera,
    above: &Surroundings,
) -> Surroundings {
    let eye_in_world = camera.eye_from_world.inverse().translation;
    let mut environment = own.of_camera(Some(&above.environment), eye_in_world).unwrap_or(above.environment);
    let air = if own.is_whole() { passes.air.prepare(ctx, resources, camera, &mut environment) } else { above.air };
    Surroundings { shadows: None, air, environment, is_outermost: false, is_whole: false }
}

/// Returns the surroundings of a camera that has a separate stage.
pub(super) fn surroundings_of_stage(
    ctx: &GraphicsContext,
    passes: &mut Passes,
    resources: &mut Resources,
    stage: &RenderStage,
    above: &Surroundings,
) -> Surroundings {
    let own = &stage.target.environment;
    let around = surroundings_of_camera(ctx, passes, resources, own, &stage.camera, above);
    Surroundings {
        shadows: stage.target.shadows.under(&around.environment),
        is_whole: own.is_whole() && stage.target.clear_color.is_some(),
        ..around
    }
}
