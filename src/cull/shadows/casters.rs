//! Culls the casters of shadows into the cascades of stages and nested cameras. Culling thread.

use super::fit::Fit;
use super::light::ShadowLight;
use crate::cull::CullCamera;
use crate::cull::stage::{RenderStage, ShadowCascade, StageShadows};
use crate::cull::views::View;
use crate::cull::visitor::{CameraVisit, CullVisitor, NestedCamera};
use crate::scene::{Environment, Scene};

impl CullVisitor {
    /// Culls the casters of shadows into a stage that was culled before.
    pub(in crate::cull) fn cull_stage_shadows(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        light: &ShadowLight,
        graph_camera: Option<&CameraVisit>,
        stage: &mut RenderStage,
    ) {
        let into = std::mem::take(&mut stage.shadows);
        let range_m = [stage.near_m, stage.far_m];
        stage.shadows = self.cull_shadows(scene, camera, light, graph_camera, range_m, into, stage);
    }

    /// Culls the casters of shadows into the nested cameras of a stage that was culled before.
    pub(in crate::cull) fn cull_nested_shadows(
        &mut self,
        scene: &Scene,
        environment: Option<&Environment>,
        mut nested: Vec<NestedCamera>,
        stage: &mut RenderStage,
    ) {
        for NestedCamera { visit, stage_view: index, shadows } in nested.drain(..) {
            let environment = environment_of_view(stage, index as u32 + 1, environment);
            let light = environment.and_then(|e| Some(ShadowLight::new(&e, shadows.under(&e)?)));
            let (Some(light), Some(view)) = (light, stage.views.get(index)) else { continue };
            let (camera, range_m) = (view.camera, view.range_m);
            if !self.take_shadow_budget(stage) {
                continue;
            }
            let cascades = stage.spare.cascades.pop().unwrap_or_default();
            let into = StageShadows { cascades, ..StageShadows::default() };
            let shadows = self.cull_shadows(scene, &camera, &light, Some(&visit), range_m, into, stage);
            stage.views[index].shadows = shadows;
        }
        self.memory.cameras.give_back_nested(nested);
    }

    /// Culls the casters of each cascade for what a camera sees between two depths. For a camera in the graph only what is
    /// below it casts shadows. Memory comes from the stage, and counters are added to its own.
    #[allow(clippy::too_many_arguments, reason = "inputs of one cull, used once each")]
    fn cull_shadows(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        light: &ShadowLight,
        graph_camera: Option<&CameraVisit>,
        [near_m, far_m]: [f64; 2],
        mut into: StageShadows,
        stage: &mut RenderStage,
    ) -> StageShadows {
        let _span = crate::trace::span("cull shadows");
        let Some(fit) = Fit::new(camera, light, near_m, far_m) else { return into };
        (into.settings, into.fade_m, into.light_from_eye) = (light.shadows, fit.fade_m, fit.light_from_eye);
        let to_sun = fit.light_from_eye.row(2);
        for cascade in &fit.cascades[..fit.count] {
            let mut casters = stage.spare.stages.pop().unwrap_or_default();
            let view = View::casting(camera, &cascade.casters_from_eye, to_sun, light.shadows.caster_mask);
            self.traverse_stage(scene, camera, view, graph_camera, &mut casters);
            if casters.state_sets.iter().any(|s| !s.casts_shadow()) {
                self.memory.leaves.retain(|leaf| casters.state_sets[leaf.state as usize].casts_shadow());
            }
            stage.counters.shadow_leaves += self.memory.leaves.len() as u32;
            self.sorter.fill_one_bin(&mut self.memory.leaves, &mut casters);
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

/// Returns light and air of a view of a stage; 0 is the stage's own view.
fn environment_of_view(stage: &RenderStage, view: u32, own: Option<&Environment>) -> Option<Environment> {
    let Some(view) = view.checked_sub(1).and_then(|index| stage.views.get(index as usize)) else {
        return own.copied();
    };
    let above = environment_of_view(stage, view.above, own);
    view.environment.of_camera(above.as_ref(), view.camera.eye_from_world.inverse().translation)
}
