//! [`ArrangedViews`]: creates a [`CompositeViewer`] with the windows, scenes and views of a [`ViewsSetup`]. Main thread, before
//! the first frame.

use super::ViewerError;
use super::composite::CompositeViewer;
use super::config::{ViewCamera, ViewSetup, ViewsSetup, WindowSetup};
use super::frame::ViewerConfig;
use super::ids::{ContextId, SceneId, ViewId};
use super::paging::LoadedRoot;
use crate::gpu::GraphicsContext;
use crate::pager::PagerConfig;
use crate::scene::Sky;

impl ViewsSetup {
    /// Reads the roots of all scenes; blocks until they are read. Any thread.
    pub fn read_roots(&self, config: &PagerConfig) -> Result<Vec<LoadedRoot>, ViewerError> {
        self.scenes.iter().map(|scene| LoadedRoot::read(&scene.source, config)).collect()
    }
}

/// A [`CompositeViewer`] with the windows, scenes and views of a [`ViewsSetup`].
pub struct ArrangedViews {
    /// The viewer.
    pub viewer: CompositeViewer,
    /// The contexts, in the order of [`ViewsSetup::windows`].
    pub contexts: Vec<ContextId>,
    /// The views, in the order of [`ViewsSetup::views`].
    pub views: Vec<ViewId>,
    /// The scene of the views that name none; `None` when all name one.
    pub own_scene: Option<SceneId>,
}

impl ArrangedViews {
    /// Creates an offscreen context for each window. `roots` are the result of [`ViewsSetup::read_roots`], `own` is the root
    /// of the application's scene if it has one already.
    pub fn new_offscreen(
        setup: &ViewsSetup,
        config: &ViewerConfig,
        roots: Vec<LoadedRoot>,
        own: Option<LoadedRoot>,
    ) -> Result<Self, ViewerError> {
        Self::new(setup, config, roots, own, |viewer, place, window| {
            let traits = window.traits(config, window.size_px.unwrap_or(config.size_px));
            let first = viewer.contexts().next().filter(|_| window.shares_device && place > 0);
            match first {
                Some(first) => viewer.open_offscreen_on(first, &traits),
                None => viewer.open_context(GraphicsContext::new_offscreen(&traits)?),
            }
        })
    }

    /// Creates the viewer; `open` creates the context of each window.
    pub(super) fn new(
        setup: &ViewsSetup,
        config: &ViewerConfig,
        roots: Vec<LoadedRoot>,
        own: Option<LoadedRoot>,
        mut open: impl FnMut(&mut CompositeViewer, usize, &WindowSetup) -> Result<ContextId, ViewerError>,
    ) -> Result<Self, ViewerError> {
        let max_contexts = config.max_contexts.max(setup.windows.len());
        let mut viewer = CompositeViewer::new(&ViewerConfig { max_contexts, ..config.clone() })?;
        let mut contexts = Vec::with_capacity(setup.windows.len());
        for (place, window) in setup.windows.iter().enumerate() {
            contexts.push(open(&mut viewer, place, window)?);
        }
        let mut scenes = Vec::with_capacity(roots.len());
        let add_scene = |viewer: &mut CompositeViewer, first: Option<SceneId>| match first {
            Some(first) if setup.share_pager => viewer.add_scene_with_pager_of(first),
            _ => viewer.add_scene(),
        };
        for root in roots {
            let scene = add_scene(&mut viewer, scenes.first().copied())?;
            viewer.set_root(scene, root)?;
            scenes.push(scene);
        }
        let own_scene = setup.needs_root().then(|| add_scene(&mut viewer, scenes.first().copied())).transpose()?;
        if let (Some(scene), Some(root)) = (own_scene, own) {
            viewer.set_root(scene, root)?;
        }
        let mut views = Vec::with_capacity(setup.views.len());
        for view in &setup.views {
            views.push(add_view(&mut viewer, view, &contexts, &scenes, own_scene)?);
        }
        Ok(Self { viewer, contexts, views, own_scene })
    }
}

fn add_view(
    viewer: &mut CompositeViewer,
    setup: &ViewSetup,
    contexts: &[ContextId],
    scenes: &[SceneId],
    own: Option<SceneId>,
) -> Result<ViewId, ViewerError> {
    let missing = |what: &str| ViewerError::Setting(format!("a view has no such {what}"));
    let scene = setup.scene.map_or(own, |place| scenes.get(place).copied()).ok_or_else(|| missing("scene"))?;
    let context = |camera: &ViewCamera| contexts.get(camera.window).copied().ok_or_else(|| missing("window"));
    let (master, slaves) = setup.cameras.split_first().ok_or_else(|| missing("camera"))?;
    let id = viewer.add_view(scene, context(master)?, master.camera.viewport)?;
    let bounds = viewer.bounds(scene)?.copied();
    let view = viewer.view_mut(id)?;
    view.set_eyes(master.camera.eyes);
    if let Some(policy) = master.camera.resize {
        view.camera.set_resize_policy(policy, view.size_px());
    }
    // Kept for scenes that are filled later.
    view.from = setup.from.unwrap_or_default();
    if let Some(bounds) = &bounds {
        view.first_sight(bounds);
    }
    if let Some(color) = setup.background {
        view.environment.sky = Sky::Background(color);
        view.environment.fog.enabled = false;
    }
    for slave in slaves {
        viewer.add_slave(id, slave.camera.slave_in(context(slave)?))?;
    }
    Ok(id)
}
