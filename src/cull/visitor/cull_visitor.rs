//! [`CullVisitor`]: culls a scene for a camera, with its shadows, the cameras in the graph and both eyes in stereo. Culling
//! thread.

use std::sync::Arc;

use super::camera_queue::CameraVisit;
use super::traversal::{Traversal, TraversalMemory, TraversalOptions};
use crate::cull::fading::LodFades;
use crate::cull::occluders::Collector;
use crate::cull::shadows::ShadowLight;
use crate::cull::sorting::Sorter;
use crate::cull::stage::{CullCounters, RenderStage};
use crate::cull::views::View;
use crate::cull::{CullCamera, Stereo};
use crate::scene::{CameraTarget, ClampProjection, CullingMode, Environment, Scene};
use crate::state::{OpaqueDrawData, StateSet};

/// Culls scenes and owns the memory that is reused from frame to frame.
///
/// Each thread that culls has its own. The public fields are inputs of the next cull.
///
/// ```
/// use terrane::cull::{CullCamera, CullVisitor, RenderStage};
/// use terrane::scene::{Node, Page, Scene};
/// let mut scene = Scene::new();
/// scene.add_root(Page::from_node(Node::group(Vec::new())).unwrap());
/// let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
/// // Both are reused for the camera's next frames.
/// visitor.cull(&scene, &CullCamera::default(), &mut stage);
/// assert!(stage.bins.is_empty() && stage.requests.is_empty());
/// ```
#[derive(Debug, Default)]
pub struct CullVisitor {
    /// Viewport of the image in its target in pixels: x, y, width, height. `None` is the whole target.
    pub viewport_px: Option<[u32; 4]>,
    /// Overrides near and far of the outermost stage where its settings have them computed.
    pub clamp_projection: Option<ClampProjection>,
    /// Called while the outermost stage is drawn.
    pub callbacks: Option<OpaqueDrawData>,
    /// State above all roots; OSG's state set of a camera.
    pub state_set: Option<Arc<StateSet>>,
    /// Light and air: the direction of the sun, and the shadows it casts. Without one only cameras in the graph that
    /// have their own environment have shadows.
    pub environment: Option<Environment>,
    options: TraversalOptions,
    pub(in crate::cull) memory: TraversalMemory,
    pub(in crate::cull) sorter: Sorter,
    eyes: Eyes,
    /// Number of cameras in the graph that may still have shadows in this cull.
    pub(in crate::cull) shadow_budget: u32,
}

/// The fades of both eyes, and the eye that is culled for; the left one when there is no stereo.
#[derive(Debug, Default)]
struct Eyes {
    fades: [LodFades; 2],
    current: usize,
    /// The target of the current eye; `None` without stereo.
    target: Option<Arc<CameraTarget>>,
}

impl CullVisitor {
    /// Creates a visitor without memory; the first culls allocate it.
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates a visitor that visits the nodes of subtrees wholly inside the frustum too, so that its counters can be
    /// compared with another engine's.
    pub fn visiting_all() -> Self {
        Self { options: TraversalOptions { visits_all: true, ..TraversalOptions::default() }, ..Self::default() }
    }

    /// Creates a visitor for finding out what a frame would request. It asks no occlusion queries, since nothing is drawn
    /// that would answer them, and includes what they might hide.
    pub(crate) fn looking() -> Self {
        Self { options: TraversalOptions { is_dry_run: true, ..TraversalOptions::default() }, ..Self::default() }
    }

    /// Creates a visitor that skips the content of tiles, so that the walk of a tile tree can be timed alone.
    pub fn walking_tiles() -> Self {
        Self { options: TraversalOptions { roots_only: true, ..TraversalOptions::default() }, ..Self::default() }
    }

    /// Culls a scene for a camera: clears and refills the stage, and adds the stages of the cameras that were met.
    /// Allocates nothing once the visitor and the stage have handled a frame of the same size.
    pub fn cull(&mut self, scene: &Scene, camera: &CullCamera, stage: &mut RenderStage) {
        let _span = crate::trace::span("cull");
        self.traverse(scene, camera, stage);
        self.sort(stage);
        let environment = self.environment;
        self.shadow_budget = camera.settings.shadowed_cameras;
        let nested = self.memory.cameras.take_nested();
        if let Some((environment, shadows)) = environment.and_then(|e| Some((e, e.shadows?))) {
            self.cull_stage_shadows(scene, camera, &ShadowLight::new(&environment, shadows), None, stage);
        }
        self.cull_nested_shadows(scene, environment.as_ref(), nested, stage);
        if self.memory.cameras.deferred_count() > 0 {
            self.cull_deferred(scene, camera, environment.as_ref(), stage, 0, 0);
        }
    }

    /// Culls a scene for the two eyes of a camera, each into its own stage and target.
    pub fn cull_stereo(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        stereo: &Stereo,
        targets: &[Arc<CameraTarget>; 2],
        stage: &mut RenderStage,
    ) {
        stage.clear(camera);
        stage.bins.clear();
        stage.state_sets.clear();
        stage.target.viewport_px = self.viewport_px;
        stage.stereo = Some(stereo.mode);
        stage.stereo_gap_px = stereo.separation_px;
        stage.counters = CullCounters::default();
        (stage.near_m, stage.far_m) = (f64::INFINITY, 0.0);
        for (index, (eye, target)) in stereo.eyes(camera).iter().zip(targets).enumerate() {
            let mut eye_stage = stage.spare.stages.pop().unwrap_or_default();
            (self.eyes.current, self.eyes.target) = (index, Some(target.clone()));
            self.cull(scene, eye, &mut eye_stage);
            (self.eyes.current, self.eyes.target) = (0, None);
            stage.requests.append(&mut eye_stage.requests);
            stage.counters.add(&eye_stage.counters);
            stage.near_m = stage.near_m.min(eye_stage.near_m);
            stage.far_m = stage.far_m.max(eye_stage.far_m);
            stage.pre_render.push(eye_stage);
        }
    }

    /// Forgets the resolved states that are kept from cull to cull, with their references to textures and programs; OSG's
    /// `StateGraph::prune`. Without it, states that are no longer met are kept until there are many, and those of dropped
    /// state sets for 16 culls.
    pub fn prune_states(&mut self) {
        self.memory.states.prune();
    }

    /// Runs the first half of [`Self::cull`]: everything but the bins and the cameras in the graph. For benches that time
    /// the halves separately.
    #[doc(hidden)]
    pub fn traverse(&mut self, scene: &Scene, camera: &CullCamera, stage: &mut RenderStage) {
        let _span = crate::trace::span("traverse");
        self.memory.states.start_frame();
        self.eyes.fades[self.eyes.current].start(camera.simulation_time_s);
        self.memory.cameras.start_frame();
        let view = View { clamp_projection: self.clamp_projection, ..View::new(camera) };
        self.traverse_stage(scene, camera, view, None, stage);
        stage.target.callbacks = self.callbacks.clone();
        stage.target.camera = self.eyes.target.clone();
        stage.target.viewport_px = self.viewport_px.filter(|_| self.eyes.target.is_none());
    }

    /// Runs the second half of [`Self::cull`]: fills and sorts the bins.
    #[doc(hidden)]
    pub fn sort(&mut self, stage: &mut RenderStage) {
        let _span = crate::trace::span("sort");
        self.sorter.fill_bins(&mut self.memory.leaves, stage);
    }

    /// Culls one stage: of the scene, or of a camera in the graph. Its leaves are left in traversal order.
    pub(in crate::cull) fn traverse_stage(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        view: View,
        graph_camera: Option<&CameraVisit>,
        stage: &mut RenderStage,
    ) {
        let fades = &mut self.eyes.fades[self.eyes.current];
        let collector = Collector {
            scene,
            view: &view,
            camera: graph_camera.filter(|camera| !camera.shows_scene),
            fades,
            frame: camera.frame,
        };
        let has_occluders = view.camera.settings.culling.contains(CullingMode::SHADOW_OCCLUSION);
        self.memory.occlusion.start_stage(has_occluders.then_some(&collector));
        let mut traversal = Traversal::new(scene, camera, view, self.options, &mut self.memory, fades, stage);
        match graph_camera {
            None => {
                let state = traversal.root_state(self.state_set.as_ref());
                traversal.queue_roots(state);
            }
            Some(graph_camera) => traversal.visit_graph_camera(graph_camera),
        }
        traversal.visit_queue();
        traversal.finish();
    }

    /// Returns true if another camera in the graph may have shadows; counts a refusal otherwise.
    pub(in crate::cull) fn take_shadow_budget(&mut self, stage: &mut RenderStage) -> bool {
        let is_left = self.shadow_budget > 0;
        self.shadow_budget = self.shadow_budget.saturating_sub(1);
        stage.counters.shadows_refused += u32::from(!is_left);
        is_left
    }
}
