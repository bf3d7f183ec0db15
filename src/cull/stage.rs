//! The output of cull: moved to the draw thread by value, and back for reuse.

use std::sync::Arc;

use glam::{DAffine3, DMat4, DVec3, DVec4};

use super::sort::Spare;
use super::{CullCamera, FadeBand, StageShadows, StereoMode};
use crate::scene::{
    CameraEnvironment, CameraShadows, CameraTarget, ClampProjection, DrawHook, DrawSlot, NodeId, OcclusionResults,
};
use crate::state::{BinDetails, Light, ResolvedState, SortMode, TexGen};

/// Something to draw; 16 bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderLeaf {
    /// Where the context keeps the drawable; `DrawSlot::NONE` is skipped by the renderer.
    pub slot: DrawSlot,
    /// Index into [`RenderStage::state_sets`].
    pub state: u32,
    /// Index into [`RenderStage::eye_from_drawable`].
    pub matrix: u32,
    /// Metres in front of the eye, of the bound's centre.
    pub depth: f32,
}

/// Leaves of one bin.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderBin {
    /// The bins it is nested in, and itself; empty for the stage's own leaves.
    pub path: Vec<BinDetails>,
    /// Which of them the application draws itself, in their places; may be shorter.
    pub callbacks: Vec<Option<DrawHook>>,
    /// The order that was asked for.
    pub sort: SortMode,
    /// Leaves in draw order.
    pub leaves: Vec<RenderLeaf>,
}

impl RenderBin {
    /// Its number inside the bin it is nested in; 0 for the stage's own.
    pub fn number(&self) -> i32 {
        self.path.last().map_or(0, |b| b.number)
    }
}

/// A page that is wanted and missing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageRequest {
    /// Where it belongs.
    pub slot: NodeId,
    /// Larger first: the error in pixels of what is shown instead, always below that of the tile above, so that
    /// coarse comes before fine; less by the squared cosine of the angle to the middle of the picture, down to a
    /// quarter. Tiles outside the frustum, needed so that their siblings can replace the parent,
    /// have a quarter. Below 0: wanted later, see [`Self::ahead`].
    pub priority: f32,
    /// Error of the tile itself, in pixels, were it shown.
    pub error_px: f32,
    /// Frames until a picture will lack it; 0 where one does.
    pub ahead_frames: u32,
}

impl PageRequest {
    /// The same for later, from where an eye will be in so many frames (one at least): it comes after all that a
    /// picture lacks now, sooner before later, in the same order else, and gets only room that nothing else needs.
    ///
    /// What is there already will be wanted too: the look is culled with as many
    /// [`CullCamera::ahead_frames`](super::CullCamera::ahead_frames), so that no page gives way to one wanted later.
    pub fn ahead(self, frames: u32) -> Self {
        let ahead_frames = frames.max(1);
        let urgency = self.priority.max(0.0) / ahead_frames as f32;
        Self { priority: -(1.0 / (1.0 + urgency)).max(f32::MIN_POSITIVE), ahead_frames, ..self }
    }
}

/// What a cull did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CullCounters {
    /// Nodes tested; those in subtrees wholly inside are not visited.
    pub nodes_visited: u32,
    /// Drawables tested or taken.
    pub drawables_tested: u32,
    /// Leaves emitted.
    pub leaves: u32,
    /// Tiles tested.
    pub tiles_visited: u32,
    /// Tiles whose content is drawn.
    pub tiles_drawn: u32,
    /// Tiles that the wanted picture lacks and that can still be loaded; 0 once it is the wanted one.
    pub wanted_missing: u32,
    /// Nodes, drawables and tiles behind occluders.
    pub occluded: u32,
    /// Leaves that cast shadows, once for each cascade.
    pub shadow_leaves: u32,
    /// Cameras in the graph that asked for shadows when there were as many as there may be.
    pub shadows_refused: u32,
    /// Tiles and Lods between two levels of detail.
    pub fading: u32,
    /// Frames since the last occlusion query that was answered was made, or the last picture that was read back was
    /// drawn, of the node or camera for which that is longest; 0 without such. `u32::MAX` where one has just been hidden or shown.
    pub answers_age: u32,
}

impl CullCounters {
    pub(crate) fn add(&mut self, other: &Self) {
        self.nodes_visited += other.nodes_visited;
        self.drawables_tested += other.drawables_tested;
        self.leaves += other.leaves;
        self.tiles_visited += other.tiles_visited;
        self.tiles_drawn += other.tiles_drawn;
        self.wanted_missing += other.wanted_missing;
        self.occluded += other.occluded;
        self.shadow_leaves += other.shadow_leaves;
        self.shadows_refused += other.shadows_refused;
        self.fading += other.fading;
        self.answers_age = self.answers_age.max(other.answers_age);
    }
}

/// Another projection and viewport inside a stage, of a Projection node or a nested camera.
#[derive(Debug)]
pub struct StageView {
    /// Reversed-Z projection.
    pub clip_from_eye: DMat4,
    /// x, y, width and height; `None`: that of the stage.
    pub viewport_px: Option<[u32; 4]>,
    /// What was culled for, before near and far were fitted.
    pub camera: CullCamera,
    /// The view that it hangs in: 0 is the stage's own, others are one more than their index in [`RenderStage::views`].
    pub above: u32,
    /// Its projection is that of the view that it hangs in, with the same near and far.
    pub is_of_above: bool,
    /// Of a nested camera that shows the scene: it is lit as its own eye has the lights.
    pub shows_scene: bool,
    /// Light and air of a nested camera.
    pub environment: CameraEnvironment,
    /// What casts shadows into what is below a nested camera.
    pub shadows: StageShadows,
    /// Nearest and farthest depth below it, metres; as those of the stage.
    pub range_m: [f64; 2],
}

/// A light where it shines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionedLight {
    /// Its position and direction are in the eye space of its view.
    pub light: Light,
    /// The view that it was met in: 0 is the stage's own, others are one more than their index in
    /// [`RenderStage::views`].
    pub view: u32,
}

/// A light in another frame; places get w = 1.
pub(crate) fn moved(to_from: &DAffine3, light: &Light) -> Light {
    let [x, y, z, w] = light.position;
    let (position, w) = if w == 0.0 {
        (to_from.transform_vector3(DVec3::new(x, y, z)), 0.0)
    } else {
        (to_from.transform_point3(DVec3::new(x, y, z) / w), 1.0)
    };
    Light {
        position: position.extend(w).to_array(),
        direction: to_from.transform_vector3(DVec3::from_array(light.direction)).to_array(),
        ..*light
    }
}

/// A plane `normal . p + d` in another frame; one that cuts nothing where that cannot be said.
pub(crate) fn plane_moved(to_from: &DAffine3, plane: DVec4) -> DVec4 {
    let from_to = to_from.inverse();
    let normal = from_to.matrix3.transpose() * plane.truncate();
    let moved = normal.extend(plane.truncate().dot(from_to.translation) + plane.w);
    if moved.is_finite() { moved } else { DVec4::new(0.0, 0.0, 0.0, 1.0) }
}

/// A plane that cuts leaves whose state has it on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipPlane {
    /// 0 to 5.
    pub number: u8,
    /// In the eye space of its view: kept is what has `normal . p + d >= 0`.
    pub plane: DVec4,
    /// As that of a [`PositionedLight`].
    pub view: u32,
}

/// Texture coordinates that a TexGenNode makes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionedTexGen {
    /// The texture unit.
    pub unit: u8,
    /// Planes that are linear in the eye are in the eye space of the view.
    pub texgen: TexGen,
    /// As that of a [`PositionedLight`].
    pub view: u32,
}

impl PositionedTexGen {
    /// In another eye.
    pub(crate) fn moved(&self, to_from: &DAffine3) -> TexGen {
        texgen_moved(to_from, self.texgen)
    }
}

/// Planes that are linear in the eye, in another frame.
pub(super) fn texgen_moved(to_from: &DAffine3, texgen: TexGen) -> TexGen {
    match texgen {
        TexGen::EyeLinear(planes) => TexGen::EyeLinear(planes.map(|plane| {
            let plane = DVec4::from_array(plane.map(f64::from));
            plane_moved(to_from, plane).as_vec4().to_array()
        })),
        other => other,
    }
}

/// A box whose visible samples are counted after the opaque bins.
#[derive(Clone, Debug)]
pub struct OcclusionQuery {
    /// Where the answer goes.
    pub results: Arc<OcclusionResults>,
    /// Fewer samples count as hidden.
    pub visibility_threshold: u32,
    /// When it is asked.
    pub frame: u32,
    /// Maps the cube from -1 to 1 onto the box; index into [`RenderStage::eye_from_drawable`].
    pub matrix: u32,
    /// Projection: 0 is the camera's, others are one more than their index in [`RenderStage::views`].
    pub view: u32,
}

/// Where a stage is drawn, and how it is begun.
#[derive(Clone, Debug, Default)]
pub struct StageTarget {
    /// `None`: the target of the context.
    pub camera: Option<Arc<CameraTarget>>,
    /// It is that of the stage around this one.
    pub is_shared: bool,
    /// What is drawn is compared with the depths there, in the projection of the stage around.
    pub keeps_projection: bool,
    /// x, y, width and height in the target; `None`: all of it.
    pub viewport_px: Option<[u32; 4]>,
    /// Linear colour to clear with; `None` keeps what is there. Of a camera in the graph.
    pub clear_color: Option<[f32; 4]>,
    /// Depth is cleared to infinitely far.
    pub clear_depth: bool,
    /// Render order number among the stages before or after the same one.
    pub order: i32,
    /// Called while it is drawn.
    pub callbacks: Option<DrawHook>,
    /// Its light and air, of a camera in the graph.
    pub environment: CameraEnvironment,
    /// Its shadows, of a camera in the graph.
    pub shadows: CameraShadows,
}

impl StageTarget {
    /// Without attachments of its own a camera draws where the stage does that it was met in, unless it says which part.
    pub(super) fn within(self, around: &Self) -> Self {
        match self.camera {
            Some(_) => self,
            None => Self {
                camera: around.camera.clone(),
                is_shared: true,
                viewport_px: self.viewport_px.or(around.viewport_px),
                ..self
            },
        }
    }
}

/// What is drawn for a camera.
#[derive(Debug, Default)]
pub struct RenderStage {
    /// The camera that was culled for.
    pub camera: CullCamera,
    /// Rows of 3x4 affine maps, shared by index.
    pub eye_from_drawable: Vec<[[f32; 4]; 3]>,
    /// States that have leaves, in the order first met; indexed by [`RenderLeaf::state`].
    pub state_sets: Vec<Arc<ResolvedState>>,
    /// By state: 0 is the camera's projection, others are one more than their index in `views`.
    pub view_of_state: Vec<u32>,
    /// By state: 0 is drawn in every pixel, others are one more than their index in `fades`.
    pub fade_of_state: Vec<u32>,
    /// Parts of the screen's pixels in which levels of detail are drawn that give way to one another.
    pub fades: Vec<FadeBand>,
    /// Other projections, in the order met.
    pub views: Vec<StageView>,
    /// In draw order: bins with negative numbers, a bin's own leaves, bins from 0 on; nested ones inside theirs.
    pub bins: Vec<RenderBin>,
    /// Missing pages, in the order met; those of all stages are in the outermost.
    pub requests: Vec<PageRequest>,
    /// Lights in the order met.
    pub lights: Vec<PositionedLight>,
    /// Clip planes in the order met.
    pub clip_planes: Vec<ClipPlane>,
    /// Frames of generated texture coordinates by unit, in eye space.
    pub texgens: Vec<PositionedTexGen>,
    /// What a ClearNode said: the colour to clear with, `None` to keep what is there.
    pub clear_node: Option<Option<[f32; 4]>>,
    /// Boxes to be tested for visibility.
    pub queries: Vec<OcclusionQuery>,
    /// Where it is drawn; the context's target for the outermost stage.
    pub target: StageTarget,
    /// Stages drawn before this one, in order.
    pub pre_render: Vec<RenderStage>,
    /// Stages drawn after this one, in order.
    pub post_render: Vec<RenderStage>,
    /// The first two stages of `pre_render` are the eyes' pictures, to be put together like this; there are no bins.
    pub stereo: Option<StereoMode>,
    /// Pixels between the pictures of split modes.
    pub stereo_gap_px: u32,
    /// What casts shadows into its picture.
    pub shadows: StageShadows,
    /// Nearest depth of any leaf's bound, or of what is seen of its primitives where the camera's settings ask for it;
    /// at least 0, but of parallel rays that begin behind the eye; 0 without leaves.
    pub near_m: f64,
    /// Farthest depth, alike; 0 without leaves.
    pub far_m: f64,
    /// What the cull did; stages before and after it included.
    pub counters: CullCounters,
    /// Says near and far instead of what is found.
    pub(super) clamp_projection: Option<ClampProjection>,
    pub(super) spare: Spare,
}

impl RenderStage {
    /// A stage without memory; the first culls make it.
    pub fn new() -> Self {
        Self::default()
    }

    /// Empties it for another cull, keeping its memory.
    pub(super) fn clear(&mut self, camera: &CullCamera) {
        self.camera = *camera;
        self.eye_from_drawable.clear();
        // `state_sets` is overwritten and cut to the length of this one.
        self.view_of_state.clear();
        self.fade_of_state.clear();
        self.fades.clear();
        self.requests.clear();
        self.lights.clear();
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
            // Memory is kept, what it holds is not.
            stage.clear(camera);
            stage.state_sets.clear();
            self.spare.stages.push(stage);
        }
    }

    /// Takes lights, clip planes and texture planes of the stage it was met in, moved to its own eye. Of two with the same
    /// number the last counts, so that its own come after them.
    pub(super) fn inherit_positioned(&mut self, above: &Self) {
        let eye_from_world = self.camera.eye_from_world;
        let below_from = |view: u32| {
            Some(eye_from_world * above.camera_of(view).eye_from_world.inverse()).filter(DAffine3::is_finite)
        };
        let own = [self.lights.len(), self.clip_planes.len(), self.texgens.len()];
        for PositionedLight { light, view } in &above.lights {
            let Some(to_from) = below_from(*view) else { continue };
            self.lights.push(PositionedLight { light: moved(&to_from, light), view: 0 });
        }
        for clip in &above.clip_planes {
            let Some(to_from) = below_from(clip.view) else { continue };
            self.clip_planes.push(ClipPlane { plane: plane_moved(&to_from, clip.plane), view: 0, ..*clip });
        }
        for PositionedTexGen { unit, texgen, view } in &above.texgens {
            let Some(to_from) = below_from(*view) else { continue };
            self.texgens.push(PositionedTexGen { unit: *unit, texgen: texgen_moved(&to_from, *texgen), view: 0 });
        }
        self.lights.rotate_left(own[0]);
        self.clip_planes.rotate_left(own[1]);
        self.texgens.rotate_left(own[2]);
    }

    /// Takes up near and far of what is drawn with its projection.
    pub(super) fn widen(&mut self, other: &Self) {
        let of = |stage: &Self| Some([stage.near_m, stage.far_m]).filter(|depths| *depths != [0.0; 2]);
        if let Some([near_m, far_m]) = of(other) {
            let own = of(self).unwrap_or([near_m, far_m]);
            (self.near_m, self.far_m) = (own[0].min(near_m), own[1].max(far_m));
        }
    }

    /// Gives it another projection, and what is drawn with the same: views inside it and stages after it.
    pub(crate) fn set_projection(&mut self, clip_from_eye: DMat4) {
        self.camera.clip_from_eye = clip_from_eye;
        for index in 0..self.views.len() {
            if self.views[index].is_of_above {
                let above = (self.views[index].above as usize).checked_sub(1);
                self.views[index].clip_from_eye = above.map_or(clip_from_eye, |above| self.views[above].clip_from_eye);
            }
        }
        for after in self.post_render.iter_mut().filter(|after| after.target.keeps_projection) {
            after.set_projection(clip_from_eye);
        }
    }

    /// The camera of a view: 0 is the stage's own, others are one more than their index in [`Self::views`].
    pub fn camera_of(&self, view: u32) -> &CullCamera {
        self.views.get((view as usize).wrapping_sub(1)).map_or(&self.camera, |view| &view.camera)
    }

    /// Leaves of all its bins.
    pub fn leaf_count(&self) -> usize {
        self.bins.iter().map(|b| b.leaves.len()).sum()
    }
}
