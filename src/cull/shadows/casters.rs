//! Which pictures have shadows, and the culls of what casts them. Thread that culls.

use super::{Fit, ShadowCascade, ShadowLight, StageShadows};
use crate::cull::cameras::{CameraPlace, NestedCamera};
use crate::cull::view::View;
use crate::cull::{CullCamera, CullVisitor, RenderStage};
use crate::scene::{Environment, Scene};

impl CullVisitor {
    /// Culls what casts shadows into a stage that is culled.
    pub(in crate::cull) fn cull_stage_shadows(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        light: &ShadowLight,
        met: Option<&CameraPlace>,
        stage: &mut RenderStage,
    ) {
        let into = std::mem::take(&mut stage.shadows);
        let range_m = [stage.near_m, stage.far_m];
        stage.shadows = self.cull_shadows(scene, camera, light, met, range_m, into, stage);
    }

    /// Culls what casts shadows into what is below the nested cameras of a stage that is culled.
    pub(in crate::cull) fn cull_nested_shadows(
        &mut self,
        scene: &Scene,
        environment: Option<&Environment>,
        mut nested: Vec<NestedCamera>,
        stage: &mut RenderStage,
    ) {
        for NestedCamera { met, place, shadows } in nested.drain(..) {
            let environment = environment_of_view(stage, place, environment);
            let light = environment.and_then(|e| Some(ShadowLight::new(&e, shadows.under(&e)?)));
            let index = place as usize - 1;
            let (Some(light), Some(view)) = (light, stage.views.get(index)) else { continue };
            let (camera, range_m) = (view.camera, view.range_m);
            if !self.takes_shadows(stage) {
                continue;
            }
            let cascades = stage.spare.cascades.pop().unwrap_or_default();
            let into = StageShadows { cascades, ..StageShadows::default() };
            let shadows = self.cull_shadows(scene, &camera, &light, Some(&met), range_m, into, stage);
            stage.views[index].shadows = shadows;
        }
        self.nested = nested;
    }

    /// True where another camera may have shadows; counts it otherwise.
    pub(in crate::cull) fn takes_shadows(&mut self, stage: &mut RenderStage) -> bool {
        let takes = self.shadowed_cameras > 0;
        self.shadowed_cameras = self.shadowed_cameras.saturating_sub(1);
        stage.counters.shadows_refused += u32::from(!takes);
        takes
    }

    /// Culls what casts shadows into what a camera sees between two depths, a cascade after the other: of a camera in the
    /// graph, what is below it. Memory and counters are the stage's.
    #[allow(clippy::too_many_arguments, reason = "what shadows are made of")]
    fn cull_shadows(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        light: &ShadowLight,
        met: Option<&CameraPlace>,
        [near_m, far_m]: [f64; 2],
        mut into: StageShadows,
        stage: &mut RenderStage,
    ) -> StageShadows {
        let _span = crate::timeline::span("cull shadows");
        let Some(fit) = Fit::new(camera, light, near_m, far_m) else { return into };
        (into.settings, into.fade_m, into.light_from_eye) = (light.shadows, fit.fade_m, fit.light_from_eye);
        let to_sun = fit.light_from_eye.row(2);
        for cascade in &fit.cascades[..fit.count] {
            let mut casters = stage.spare.stages.pop().unwrap_or_default();
            let view = View::casting(camera, &cascade.casters_from_eye, to_sun, light.shadows.caster_mask);
            self.traverse_stage(scene, camera, view, met, &mut casters);
            if casters.state_sets.iter().any(|s| !s.casts_shadow()) {
                self.leaves.retain(|leaf| casters.state_sets[leaf.state as usize].casts_shadow());
            }
            stage.counters.shadow_leaves += self.leaves.len() as u32;
            self.sorter.fill_one_bin(&mut self.leaves, &mut casters);
            into.cascades.push(ShadowCascade {
                depths_m: cascade.depths_m,
                texel_m: cascade.texel_m,
                clip_from_eye: cascade.clip_from_eye(&fit.light_from_eye, -casters.near_m),
                stage: casters,
            });
        }
        into
    }
}

/// Light and air of one of a stage's views, where that is known.
fn environment_of_view(stage: &RenderStage, place: u32, own: Option<&Environment>) -> Option<Environment> {
    let Some(view) = place.checked_sub(1).and_then(|index| stage.views.get(index as usize)) else {
        return own.copied();
    };
    let above = environment_of_view(stage, view.above, own);
    view.environment.of_camera(above.as_ref(), view.camera.eye_from_world.inverse().translation)
}
