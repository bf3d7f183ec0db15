//! The views inside a stage: what lights each of them, and its uniforms. Runs on the draw thread, as all of the renderer.

use glam::{DAffine3, DMat4};

use super::Renderer;
use super::shadows::Casting;
use crate::cull::{CullCamera, MAX_CASCADES, RenderStage, StageShadows};
use crate::draw::atmosphere::{Air, FoundAir, PLAIN_SKY};
use crate::draw::pipelines::key::AirKind;
use crate::draw::plan::PassTarget;
use crate::draw::shadow_maps::ShadowMaps;
use crate::draw::uniforms::fixed::StageUniform;
use crate::draw::uniforms::frame::{FrameUniform, clear_color};
use crate::gpu::GraphicsContext;
use crate::scene::{CameraEnvironment, Environment, Sky, SunShadows};

/// What is around what a stage shows.
#[derive(Clone, Copy)]
pub(super) struct Surroundings {
    pub(super) environment: Environment,
    pub(super) shadows: Option<SunShadows>,
    pub(super) air: FoundAir,
    /// A picture of the frame, or an eye's.
    pub(super) is_outermost: bool,
    /// With background, sky and water.
    pub(super) is_whole: bool,
}

/// A view inside a stage, and what lights it.
#[derive(Clone, Copy)]
pub(super) struct LitView {
    /// With the eye by which it is lit.
    camera: CullCamera,
    around: Surroundings,
    /// Of its shadow maps, where it has any.
    first_layer: Option<usize>,
}

/// What the leaves of a view are drawn with.
#[derive(Clone, Copy)]
pub(super) struct ViewFrame {
    /// Places of the uniforms.
    pub(super) uniform: u32,
    pub(super) positioned: u32,
    /// Set of the air's tables.
    pub(super) air: u8,
    pub(super) air_kind: AirKind,
    pub(super) has_shadows: bool,
}

/// The projection of a view inside a stage.
pub(super) fn clip_of_view(stage: &RenderStage, view: u32) -> &DMat4 {
    let inner = (view as usize).checked_sub(1);
    inner.and_then(|place| stage.views.get(place)).map_or(&stage.camera.clip_from_eye, |view| &view.clip_from_eye)
}

impl Renderer {
    /// The tables of the air as a camera's eye sees it. Where they cannot be there is a plain sky instead.
    pub(super) fn air_of(
        &mut self,
        ctx: &GraphicsContext,
        camera: &CullCamera,
        environment: &mut Environment,
    ) -> FoundAir {
        let air = Air::of(camera, environment);
        let none = FoundAir { place: 0, air, is_refused: false };
        if environment.sky != Sky::Atmosphere {
            return none;
        }
        let can_be_made = self.atmosphere.can_be_made(ctx);
        let Some(found) = can_be_made.then(|| self.atmosphere.find(ctx, &air)).flatten() else {
            environment.sky = PLAIN_SKY;
            return none;
        };
        self.airs_refused += u32::from(found.is_refused);
        found
    }

    /// What is around a camera in the graph that hangs in a picture.
    fn surroundings_of(
        &mut self,
        ctx: &GraphicsContext,
        said: &CameraEnvironment,
        camera: &CullCamera,
        above: &Surroundings,
    ) -> Surroundings {
        let eye_in_world = camera.eye_from_world.inverse().translation;
        let mut environment = said.of_camera(Some(&above.environment), eye_in_world).unwrap_or(above.environment);
        let air = if said.is_whole() { self.air_of(ctx, camera, &mut environment) } else { above.air };
        Surroundings { shadows: None, air, environment, is_outermost: false, is_whole: false }
    }

    /// The same for one that has a stage.
    pub(super) fn surroundings_of_stage(
        &mut self,
        ctx: &GraphicsContext,
        stage: &RenderStage,
        above: &Surroundings,
    ) -> Surroundings {
        let said = &stage.target.environment;
        let around = self.surroundings_of(ctx, said, &stage.camera, above);
        Surroundings {
            shadows: stage.target.shadows.under(&around.environment),
            is_whole: said.is_whole() && stage.target.clear_color.is_some(),
            ..around
        }
    }

    /// What lights the views inside a stage, the stage's own first.
    fn light_views(&mut self, ctx: &GraphicsContext, stage: &RenderStage, around: &Surroundings) {
        let mut views = std::mem::take(&mut self.views);
        views.clear();
        let mut next_layer = 0;
        let mut layers_of = |shadows: &StageShadows, maps: &ShadowMaps| {
            let first_layer = next_layer;
            let has_room = maps.has_room(shadows, first_layer);
            next_layer += if has_room { shadows.cascades.len().min(MAX_CASCADES) } else { 0 };
            has_room.then_some(first_layer)
        };
        let first_layer = around.shadows.and_then(|_| layers_of(&stage.shadows, &self.shadow_maps));
        views.push(LitView { camera: stage.camera, around: *around, first_layer });
        for view in &stage.views {
            let above = *views.get(view.above as usize).unwrap_or(&views[0]);
            let first_layer = layers_of(&view.shadows, &self.shadow_maps);
            let (camera, around) = if view.environment.is_whole() {
                (view.camera, self.surroundings_of(ctx, &view.environment, &view.camera, &above.around))
            } else if first_layer.is_some() || view.shows_scene {
                (view.camera, above.around)
            } else {
                (CullCamera { eye_from_world: above.camera.eye_from_world, ..view.camera }, above.around)
            };
            views.push(LitView { camera, around, first_layer });
        }
        self.views = views;
    }

    /// Puts the views inside a stage, its own first, into `frames`, and prepares what casts shadows into all of them; the
    /// background of its own.
    pub(super) fn prepare_views(
        &mut self,
        ctx: &GraphicsContext,
        stage: &RenderStage,
        around: &Surroundings,
        target: &PassTarget,
        frames: &mut Vec<ViewFrame>,
    ) -> wgpu::Color {
        self.light_views(ctx, stage, around);
        let views = std::mem::take(&mut self.views);
        let is_positioned = !stage.lights.is_empty() || !stage.clip_planes.is_empty();
        frames.clear();
        let mut background = wgpu::Color::BLACK;
        for (place, view) in views.iter().enumerate() {
            let LitView { camera, around: Surroundings { environment, air, .. }, first_layer } = view;
            let inner = stage.views.get(place.wrapping_sub(1));
            let (clip_from_eye, shadows) =
                inner.map_or((&stage.camera.clip_from_eye, &stage.shadows), |v| (&v.clip_from_eye, &v.shadows));
            let mut uniform = FrameUniform::new(camera, clip_from_eye, environment, &air.air);
            if place == 0 {
                background = clear_color(environment, &uniform);
            }
            let shared = frames.first().filter(|_| !is_positioned).map(|own| own.positioned);
            let positioned = shared.unwrap_or_else(|| {
                let eye_from = |from: u32| {
                    let from = views.get(from as usize).unwrap_or(&views[0]);
                    let to_from = camera.eye_from_world * from.camera.eye_from_world.inverse();
                    if to_from.is_finite() { to_from } else { DAffine3::IDENTITY }
                };
                self.groups.push(&StageUniform::new(stage, place as u32, eye_from))
            });
            if let Some(first_layer) = *first_layer {
                uniform = uniform.with_shadows(shadows, self.shadow_maps.size_px(), first_layer);
                let (air, view) = (&air.air, place as u32);
                let casting = Casting { shadows, camera, environment, air, first_layer, view, positioned };
                self.prepare_casters(ctx, stage, &casting, target);
            }
            let has_shadows = first_layer.is_some();
            let (uniform, air_kind) = (self.groups.push(&uniform), AirKind::of(environment));
            frames.push(ViewFrame { uniform, positioned, air: air.place, air_kind, has_shadows });
        }
        self.views = views;
        background
    }
}
