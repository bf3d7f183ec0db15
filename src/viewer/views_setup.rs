//! [`ViewsSetup`]: several views in windows, as a file names them, and how a [`CompositeViewer`] is made of them. Main
//! thread, before the first frame.

use super::ViewerError;
use super::composite::{CompositeViewer, SceneId, ViewId};
use super::config::{CameraSetup, ViewCamera, ViewSetup, ViewsSetup, WindowSetup};
use super::home::LoadedRoot;
use super::view::{ContextId, Slave};
use super::viewer::ViewerConfig;
use crate::draw::Sky;
use crate::gpu::{ContextTraits, GraphicsContext};
use crate::pager::PagerConfig;

impl ViewsSetup {
    /// Reads the roots of the scenes; blocks until they are there. Any thread.
    pub fn read_roots(&self, config: &PagerConfig) -> Result<Vec<LoadedRoot>, ViewerError> {
        self.scenes.iter().map(|scene| LoadedRoot::read(&scene.source, config)).collect()
    }

    /// What the context of a window shall be.
    pub(super) fn traits(&self, config: &ViewerConfig, window: &WindowSetup, size_px: [u32; 2]) -> ContextTraits {
        ContextTraits {
            size_px,
            samples: window.samples.unwrap_or(config.samples),
            vsync: window.vsync.unwrap_or(config.vsync),
            ..config.traits()
        }
    }
}

/// A [`CompositeViewer`] as a [`ViewsSetup`] has it.
pub struct ArrangedViews {
    /// The viewer.
    pub viewer: CompositeViewer,
    /// By place of the window.
    pub contexts: Vec<ContextId>,
    /// By place of the view.
    pub views: Vec<ViewId>,
    /// That of the views without one; `None` where all have one.
    pub own_scene: Option<SceneId>,
}

impl ArrangedViews {
    /// With an offscreen context for each window. `roots` are the scenes' as [`ViewsSetup::read_roots`] gives them,
    /// `own` is the root of the application's scene where it has one already.
    pub fn new_offscreen(
        setup: &ViewsSetup,
        config: &ViewerConfig,
        roots: Vec<LoadedRoot>,
        own: Option<LoadedRoot>,
    ) -> Result<Self, ViewerError> {
        Self::new(setup, config, roots, own, |viewer, place, window| {
            let traits = setup.traits(config, window, window.size_px.unwrap_or(config.size_px));
            let first = viewer.contexts().next().filter(|_| window.shares_device && place > 0);
            match first {
                Some(first) => viewer.open_offscreen_on(first, &traits),
                None => viewer.open_context(GraphicsContext::new_offscreen(&traits)?),
            }
        })
    }

    /// `open` makes the context of each window.
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
    // Also where the scene is filled later.
    view.from = setup.from.unwrap_or_default();
    if let Some(bounds) = &bounds {
        view.first_sight(bounds);
    }
    if let Some(color) = setup.background {
        view.environment.sky = Sky::Background(color);
        view.environment.fog.enabled = false;
    }
    for slave in slaves {
        let CameraSetup { viewport, projection_offset, view_offset, eyes, .. } = slave.camera;
        let slave = Slave { viewport, projection_offset, view_offset, eyes, ..Slave::new(context(slave)?) };
        viewer.add_slave(id, slave)?;
    }
    Ok(id)
}
