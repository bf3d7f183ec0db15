//! Changes of environments that need pipelines: each view keeps the environment that it shows until the pipelines of the next
//! one are there. Main thread.
//!
//! ```text
//! view.environment changes       the view is drawn as before, and culled once more with the new environment
//! rehearsal, draw thread         prepares that cull as a later frame will draw it, and orders the pipelines that are missing
//! pipeline thread                creates them
//! rehearsal that lacks nothing   the next frame shows the new environment
//! ```

use crate::cull::RenderStage;
use crate::scene::Environment;
use crate::viewer::ids::ContextId;
use crate::viewer::paging::SceneList;
use crate::viewer::rendering::FrameDone;
use crate::viewer::view::{Probe, View, ViewList};

/// When a change of [`View::environment`] takes effect if it needs pipelines that do not exist: shadows or water that are
/// switched on or off, another kind of sky or haze, other tone mapping. Changes of values, such as the sun's direction, take
/// effect in the next frame.
///
/// The blocking mode of the pager never waits for pipelines in a later frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EnvironmentChanges {
    /// [`Self::WhenReady`] for views with a camera in a window, whose user would notice a frame that takes long. [`Self::AtOnce`]
    /// for views that are drawn offscreen, where the image counts.
    #[default]
    ReadyInWindows,
    /// Another thread creates the pipelines, while frames show the environment before. Then one frame shows the whole change.
    /// [`CompositeViewer::is_settled`](crate::viewer::CompositeViewer::is_settled) is false until then.
    WhenReady,
    /// The next frame shows the change and takes as long as its pipelines take: 20 to 200 ms each on many drivers.
    AtOnce,
}

/// When drawables are shown whose pipelines do not exist: nodes and state sets that the application adds to the scene graph, or
/// changes. The contents of pages have theirs before they are merged.
///
/// A first stencil or a light of number 0 changes the pipelines of all drawables of a view. Then nothing is hidden: the frame
/// creates the pipelines, as the first frame of a view does. The blocking mode of the pager hides nothing either.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NewStates {
    /// The next frame shows them and takes as long as their pipelines take, as in OpenSceneGraph: 20 to 200 ms each on many
    /// drivers.
    #[default]
    AtOnce,
    /// Another thread creates the pipelines. Until then frames leave the drawables out, also those that were shown with another
    /// state before. [`CompositeViewer::is_settled`](crate::viewer::CompositeViewer::is_settled) is false until then.
    WhenReady,
}

/// The views that a frame rehearses, each with its context.
pub(super) type Rehearsals = Vec<(u32, RenderStage, Environment)>;

/// The result of a frame's rehearsals in a context.
struct Rehearsed {
    context: ContextId,
    frame: u32,
    /// The number of pipelines that the rehearsed views lack; `None` if none was rehearsed.
    missing: Option<u32>,
    /// The number of pipelines that the device was creating.
    in_creation: u32,
    /// The number of pipelines that the frame lacked.
    awaited: u32,
}

impl Rehearsed {
    fn of(done: &FrameDone) -> Self {
        let drawn = done.stats.as_ref().ok();
        Self {
            context: ContextId(done.context),
            frame: done.frame,
            missing: done.missing_pipelines,
            in_creation: drawn.map_or(0, |drawn| drawn.pipelines_in_creation),
            awaited: drawn.map_or(0, |drawn| drawn.pipelines_awaited),
        }
    }
}

/// Decides with which environments views are drawn.
#[derive(Default)]
pub(super) struct EnvironmentRehearsals {
    /// The contexts that show their images in windows.
    windows: Vec<ContextId>,
    /// The results of rehearsals in the frames that were drawn since the last update.
    rehearsed: Vec<Rehearsed>,
}

impl EnvironmentRehearsals {
    /// Notes that a context was opened that shows its images in a window.
    pub fn window_opened(&mut self, context: ContextId) {
        self.windows.push(context);
    }

    pub fn context_closed(&mut self, context: ContextId) {
        self.windows.retain(|of| *of != context);
    }

    /// Takes the results of a drawn frame.
    pub fn take(&mut self, done: &FrameDone) {
        self.rehearsed.push(Rehearsed::of(done));
    }

    fn waits_for_pipelines(&self, changes: EnvironmentChanges, view: &View) -> bool {
        match changes {
            EnvironmentChanges::ReadyInWindows => view.contexts().any(|of| self.windows.contains(&of)),
            EnvironmentChanges::WhenReady => true,
            EnvironmentChanges::AtOnce => false,
        }
    }

    /// Decides with which environment each view is drawn in a frame that leaves out what lacks pipelines if `hides_unready`.
    /// Returns the views whose changes it rehearses.
    pub fn follow_environments(
        &mut self,
        changes: EnvironmentChanges,
        hides_unready: bool,
        frame: u32,
        views: &mut ViewList,
        scenes: &SceneList,
        probe: &mut Probe,
    ) -> Rehearsals {
        self.take_rehearsed(views);
        let mut rehearsals = Vec::new();
        for view in views.values_mut() {
            view.shown.begin_frame(frame, hides_unready, scenes[view.scene()].own_merged());
            let waits = self.waits_for_pipelines(changes, view);
            view.shown.follow(&view.environment, waits);
            if !view.shown.wants_rehearsal() {
                continue;
            }
            let paged = &scenes[view.scene()];
            let cameras: Vec<(u32, ContextId)> = view.cameras().zip(view.contexts()).collect();
            let mut contexts = Vec::new();
            for (camera, context) in cameras {
                let Some(mut task) = view.task(camera, paged, frame, Vec::new()) else { continue };
                task.environment = view.environment;
                probe.cull(task);
                rehearsals.push((context.0, probe.take_stage(), view.environment));
                contexts.push(context);
            }
            contexts.sort_unstable();
            contexts.dedup();
            view.shown.begin_rehearsal(frame, contexts.len());
        }
        rehearsals
    }

    /// Tells views what the frames that were drawn have found out about their changes.
    fn take_rehearsed(&mut self, views: &mut ViewList) {
        for Rehearsed { context, frame, missing, in_creation, awaited } in self.rehearsed.drain(..) {
            for view in views.values_mut().filter(|view| view.contexts().any(|of| of == context)) {
                view.shown.drawn(frame, missing, in_creation);
                view.shown.note_awaited(frame, awaited);
            }
        }
    }
}
