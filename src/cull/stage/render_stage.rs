//! [`RenderStage`]: everything that one camera draws. A culling thread fills it and hands it to the thread that draws.

use std::ops::Range;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DMat4};

use super::counters::CullCounters;
use super::drawn_part::DrawnPart;
use super::leaf::RenderBin;
use super::positioned::{ClipPlane, PositionedLight, PositionedTexGen, move_light, move_plane, move_texgen};
use super::request::PageRequest;
use super::target::StageTarget;
use crate::cull::{CullCamera, StereoMode};
use crate::scene::{CameraEnvironment, ClampProjection, LocalLights, OcclusionResults, SunShadows};
use crate::state::ResolvedState;

/// Another projection and viewport inside a stage: of a Projection node or a nested camera.
#[derive(Debug)]
pub struct StageView {
    /// Reversed-Z projection.
    pub clip_from_eye: DMat4,
    /// Viewport in pixels: x, y, width, height. `None` is that of the stage.
    pub viewport_px: Option<[u32; 4]>,
    /// The camera that was culled for, before near and far were fitted.
    pub camera: CullCamera,
    /// The view around it: 0 is the stage's own, others are one more than their index in [`RenderStage::views`].
    pub above: u32,
    /// The projection is that of the view around it, with the same near and far.
    pub inherits_projection: bool,
    /// True for a nested camera that shows the scene; lights are then positioned for its own eye.
    pub shows_scene: bool,
    /// Light and air of a nested camera.
    pub environment: CameraEnvironment,
    /// Shadows on what is below a nested camera.
    pub shadows: StageShadows,
    /// Nearest and farthest depth below it in metres, as [`RenderStage::near_m`] and [`RenderStage::far_m`].
    pub range_m: [f64; 2],
}

/// An occlusion query: the visible samples of a box are counted after the opaque bins.
#[derive(Clone, Debug)]
pub struct OcclusionQuery {
    /// Receives the answer.
    pub results: Arc<OcclusionResults>,
    /// The box counts as hidden with fewer visible samples.
    pub visibility_threshold: u32,
    /// The frame of the query.
    pub frame: u32,
    /// Index into [`RenderStage::eye_from_drawable`] of the matrix that maps the cube from -1 to 1 to the box.
    pub matrix: u32,
    /// The view: 0 is the stage's own, others are one more than their index in [`RenderStage::views`].
    pub view: u32,
}

/// A shadow cascade: the casters of shadows for a part of the depths.
#[derive(Debug, Default)]
pub struct ShadowCascade {
    /// Least and greatest depth that it covers in metres in front of the eye, negative behind it. Cascades overlap.
    pub depths_m: [f64; 2],
    /// Width of a texel, metres.
    pub texel_m: f64,
    /// Reversed-Z orthographic projection along the sun's rays, from the eye space of the image.
    pub clip_from_eye: DMat4,
    /// Casters, with matrices to the eye space of the image, in one bin.
    pub stage: RenderStage,
}

/// The shadow cascades of a stage; without cascades it has no shadows.
#[derive(Debug, Default)]
pub struct StageShadows {
    /// The settings that were culled for.
    pub settings: SunShadows,
    /// Rotation whose rows are two axes across the sun's rays and the direction towards the sun.
    pub light_from_eye: DMat3,
    /// The cascades, nearest first.
    pub cascades: Vec<ShadowCascade>,
    /// Depths between which shadows fade out, metres.
    pub fade_m: [f64; 2],
}

/// Memory of bins, stages and cascades that the current frame does not need.
#[derive(Debug, Default)]
pub(in crate::cull) struct Spare {
    pub bins: Vec<RenderBin>,
    pub stages: Vec<RenderStage>,
    pub cascades: Vec<Vec<ShadowCascade>>,
}

/// Everything that is drawn for one camera.
///
/// More than 16 fields, all public: draw reads each list in another pass, and tests and applications read them too.
#[derive(Debug, Default)]
pub struct RenderStage {
    /// The camera that was culled for.
    pub camera: CullCamera,
    /// Affine maps as three rows, which leaves share by index.
    pub eye_from_drawable: Vec<[[f32; 4]; 3]>,
    /// States with leaves, in the order in which they were first met; indexed by `RenderLeaf::state`.
    pub state_sets: Vec<Arc<ResolvedState>>,
    /// By state: the view. 0 is the stage's own, others are one more than their index in `views`.
    pub view_of_state: Vec<u32>,
    /// By state: the part of its leaves that is drawn. 0 draws all, others are one more than their index in `parts`.
    pub part_of_state: Vec<u32>,
    /// By state: the group of local lights. 0 has none, others are one more than their index in `light_groups`.
    pub lights_of_state: Vec<u32>,
    /// Dither bands of levels of detail that fade, and volumes that stand-ins for failed tiles are cut to.
    pub parts: Vec<DrawnPart>,
    /// Other projections, in the order in which they were met.
    pub views: Vec<StageView>,
    /// Bins in draw order: negative numbers, then the stage's own leaves, then numbers from 0 on. Nested bins follow the
    /// same order inside the bin around them.
    pub bins: Vec<RenderBin>,
    /// Missing pages in the order in which they were met. The outermost stage holds those of all stages.
    pub requests: Vec<PageRequest>,
    /// Lights in the order in which they were met.
    pub lights: Vec<PositionedLight>,
    /// Lights that shine on the leaves of some states alone.
    pub local_lights: Vec<PositionedLight>,
    /// Ranges of `local_lights`, at most [`LocalLights::MAX`] each.
    pub light_groups: Vec<Range<usize>>,
    /// Clip planes in the order in which they were met.
    pub clip_planes: Vec<ClipPlane>,
    /// Generators of texture coordinates, in the order in which they were met.
    pub texgens: Vec<PositionedTexGen>,
    /// The colour of the last ClearNode: `Some(None)` keeps the contents of the target, `None` if there was no such node.
    pub clear_node: Option<Option<[f32; 4]>>,
    /// Occlusion queries to ask.
    pub queries: Vec<OcclusionQuery>,
    /// The image that it is drawn into.
    pub target: StageTarget,
    /// Stages drawn before this one, in order.
    pub pre_render: Vec<RenderStage>,
    /// Stages drawn after this one, in order.
    pub post_render: Vec<RenderStage>,
    /// The mode in which the first two stages of `pre_render`, the images of the eyes, are combined. The stage has no bins
    /// then.
    pub stereo: Option<StereoMode>,
    /// Pixels between the two images of split stereo modes.
    pub stereo_gap_px: u32,
    /// Shadows on what the stage draws.
    pub shadows: StageShadows,
    /// Nearest depth of the leaves in metres: of their bounds, or of their visible primitives where the camera's settings
    /// ask for that. At least 0, except for parallel rays that start behind the eye; 0 without leaves.
    pub near_m: f64,
    /// Farthest depth of the leaves in metres, measured like `near_m`; 0 without leaves.
    pub far_m: f64,
    /// Counts of the cull, with those of the stages before and after it.
    pub counters: CullCounters,
    /// Overrides the near and far depths that were found.
    pub(in crate::cull) clamp_projection: Option<ClampProjection>,
    pub(in crate::cull) spare: Spare,
}

impl RenderStage {
    /// Creates a stage without memory; the first culls allocate it.
    pub fn new() -> Self {
        Self::default()
    }

    /// Empties the stage for another cull and keeps its memory.
    pub(in crate::cull) fn clear(&mut self, camera: &CullCamera) {
        self.camera = *camera;
        self.eye_from_drawable.clear();
        // `state_sets` is overwritten and truncated to the length of `view_of_state`, so that states that stay the same from
        // frame to frame keep their reference counts untouched.
        self.view_of_state.clear();
        self.part_of_state.clear();
        self.lights_of_state.clear();
        self.parts.clear();
        self.requests.clear();
        self.lights.clear();
        self.local_lights.clear();
        self.light_groups.clear();
        self.clip_planes.clear();
        self.texgens.clear();
        self.clear_node = None;
        self.stereo = None;
        self.stereo_gap_px = 0;
        self.queries.clear();
        self.target = StageTarget::default();
        for mut view in self.views.drain(..) {
            self.shadows.cascades.append(&mut view.shadows.cascades);
            if view.shadows.cascades.capacity() > 0 {
                self.spare.cascades.push(view.shadows.cascades);
            }
        }
        let cascades = self.shadows.cascades.drain(..).map(|c| c.stage);
        for mut stage in self.pre_render.drain(..).chain(self.post_render.drain(..)).chain(cascades) {
            // Spare stages keep memory, but no references.
            stage.clear(camera);
            stage.state_sets.clear();
            self.spare.stages.push(stage);
        }
    }

    /// Adds lights, clip planes and texture planes of the stage around, moved to this stage's eye. The last one with a
    /// number wins, so that they are put before the stage's own.
    pub(in crate::cull) fn inherit_positioned(&mut self, above: &Self) {
        let eye_from_world = self.camera.eye_from_world;
        let below_from = |view: u32| {
            Some(eye_from_world * above.camera_of(view).eye_from_world.inverse()).filter(DAffine3::is_finite)
        };
        let own = [self.lights.len(), self.clip_planes.len(), self.texgens.len()];
        for PositionedLight { light, view } in &above.lights {
            let Some(to_from) = below_from(*view) else { continue };
            self.lights.push(PositionedLight { light: move_light(&to_from, light), view: 0 });
        }
        for clip in &above.clip_planes {
            let Some(to_from) = below_from(clip.view) else { continue };
            self.clip_planes.push(ClipPlane { plane: move_plane(&to_from, clip.plane), view: 0, ..*clip });
        }
        for PositionedTexGen { unit, texgen, view } in &above.texgens {
            let Some(to_from) = below_from(*view) else { continue };
            self.texgens.push(PositionedTexGen { unit: *unit, texgen: move_texgen(&to_from, *texgen), view: 0 });
        }
        self.lights.rotate_left(own[0]);
        self.clip_planes.rotate_left(own[1]);
        self.texgens.rotate_left(own[2]);
    }

    /// Returns a part by its number in [`Self::part_of_state`]; `None` if the leaves are drawn whole.
    pub(crate) fn part(&self, number: u32) -> Option<DrawnPart> {
        self.parts.get((number as usize).checked_sub(1)?).copied()
    }

    /// Adds a group of local lights: some own ones, then those of the group `above`, which is numbered as in
    /// [`Self::lights_of_state`]. Returns its number.
    pub(in crate::cull) fn push_light_group(&mut self, above: u32, own: impl Iterator<Item = PositionedLight>) -> u32 {
        let first = self.local_lights.len();
        let inherited = (above as usize).checked_sub(1).and_then(|above| self.light_groups.get(above).cloned());
        self.local_lights.extend(own.take(LocalLights::MAX));
        let room = LocalLights::MAX - (self.local_lights.len() - first);
        let inherited = inherited.unwrap_or_default();
        self.local_lights.extend_from_within(inherited.start..inherited.end.min(inherited.start + room));
        self.light_groups.push(first..self.local_lights.len());
        self.light_groups.len() as u32
    }

    /// Widens near and far by a stage that is drawn with the same projection.
    pub(in crate::cull) fn widen(&mut self, other: &Self) {
        let of = |stage: &Self| Some([stage.near_m, stage.far_m]).filter(|depths| *depths != [0.0; 2]);
        if let Some([near_m, far_m]) = of(other) {
            let own = of(self).unwrap_or([near_m, far_m]);
            (self.near_m, self.far_m) = (own[0].min(near_m), own[1].max(far_m));
        }
    }

    /// Replaces the projection of the stage and of all that share it: views inside and stages after it.
    pub(crate) fn set_projection(&mut self, clip_from_eye: DMat4) {
        self.camera.clip_from_eye = clip_from_eye;
        for index in 0..self.views.len() {
            if self.views[index].inherits_projection {
                let above = (self.views[index].above as usize).checked_sub(1);
                self.views[index].clip_from_eye = above.map_or(clip_from_eye, |above| self.views[above].clip_from_eye);
            }
        }
        for after in self.post_render.iter_mut().filter(|after| after.target.keeps_projection) {
            after.set_projection(clip_from_eye);
        }
    }

    /// Returns the camera of a view: 0 is the stage's own, others are one more than their index in [`Self::views`].
    pub fn camera_of(&self, view: u32) -> &CullCamera {
        self.views.get((view as usize).wrapping_sub(1)).map_or(&self.camera, |view| &view.camera)
    }

    /// Returns the number of leaves in all bins.
    pub fn leaf_count(&self) -> usize {
        self.bins.iter().map(|b| b.leaves.len()).sum()
    }
}
