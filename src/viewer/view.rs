//! [`View`]: a camera on a scene, its light, what moves it, and the slave cameras that go with it. Main thread.

use std::sync::Arc;

use glam::{DAffine3, DMat4};

use super::camera::Camera;
use super::camera_path::AnimationPath;
use super::home::{LocalFrame, SetBounds, ViewFrom, environment_for};
use super::input::Input;
use super::look_ahead::LookAhead;
use super::paged_scene::PagedScene;
use super::rendering::{CullTask, Lens, Rendering, Sight};
use super::viewport::Viewport;
use crate::cull::{CullCamera, CullSettings, PageRequest, Stereo, StereoMode};
use crate::draw::CameraCallbacks;
use crate::draw::Environment;
use crate::scene::{Attachment, CameraTarget, ClampProjection, Inherit, OpaqueDrawData};
use crate::state::{TextureFormat, TextureObject};

/// A graphics context of a viewer; never the same again once it was closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ContextId(pub(super) u32);

/// A slave camera of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SlaveId(pub(super) u32);

/// Which eyes a camera draws for while its view is drawn for two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Eyes {
    /// Both, put together in the camera's own picture as the view's stereo mode has it.
    #[default]
    Both,
    /// The left one alone: a window or a screen for each eye.
    Left,
    /// The right one alone.
    Right,
    /// None: from between them.
    Middle,
}

impl Eyes {
    /// Those that are seen where the pictures are put together so: of both the one that is shown, where it is one alone.
    fn shown(self, mode: StereoMode) -> Self {
        match (self, mode) {
            (Self::Both, StereoMode::LeftEye) => Self::Left,
            (Self::Both, StereoMode::RightEye) => Self::Right,
            _ => self,
        }
    }
}

/// A camera that goes with the master camera of its view: another eye of it, another window, another part of one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slave {
    /// Where it is drawn.
    pub context: ContextId,
    /// Which part of that.
    pub viewport: Viewport,
    /// Applied to the master's clip space: a shift of 2 in x shows what is beside the master's picture.
    pub projection_offset: DMat4,
    /// Applied to the master's eye space: from the master's eye to the slave's.
    pub view_offset: DAffine3,
    /// Its eyes, where the view is drawn for two.
    pub eyes: Eyes,
    /// Its own settings.
    pub settings: CullSettings,
    /// Which of the settings are the master's instead.
    pub inherit: Inherit,
}

impl Slave {
    /// A camera that sees what the master sees, in all of a context.
    pub fn new(context: ContextId) -> Self {
        Self {
            context,
            viewport: Viewport::Whole,
            projection_offset: DMat4::IDENTITY,
            view_offset: DAffine3::IDENTITY,
            eyes: Eyes::Both,
            settings: CullSettings::default(),
            inherit: Inherit::ALL,
        }
    }
}

/// Where a camera is drawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Number of the camera.
    pub(super) camera: u32,
    pub(super) context: u32,
    /// Number of the context's device, by which slots are known.
    pub(super) device: u32,
    pub(super) viewport: Viewport,
    /// Size of the context, as it was last looked at.
    pub(super) context_px: [u32; 2],
}

impl Place {
    /// Which part of the context it is, `None`: all of it.
    pub(super) fn part_px(&self) -> Option<[u32; 4]> {
        self.viewport.part_px(self.context_px)
    }
}

struct SlaveCamera {
    /// Number of the camera.
    camera: u32,
    /// Number of its context's device.
    device: u32,
    /// Of its picture.
    size_px: [u32; 2],
    /// Of its context.
    context_px: [u32; 2],
    slave: Slave,
    /// What its eyes' pictures are drawn into; made anew when their size changes.
    targets: Option<[Arc<CameraTarget>; 2]>,
}

/// A scene seen by a master camera and its slaves.
pub struct View {
    /// The eye; change it between frames, or set a manipulator.
    pub camera: Camera,
    /// Sun, sky and fog. The first sight of a set gives the sun's direction, up and the density of the haze.
    pub environment: Environment,
    /// The path that the camera will take, in simulation time, where the application knows: what will be wanted along
    /// it is loaded ahead (see [`ViewerConfig::look_ahead_s`](super::ViewerConfig::look_ahead_s)).
    pub announced: Option<AnimationPath>,
    /// Where it looks from at first.
    pub(super) from: ViewFrom,
    /// Place of the scene in the viewer's.
    pub(super) scene: usize,
    pub(super) look_ahead: LookAhead,
    /// Where the master camera is drawn; `None`: nowhere, only its slaves are.
    pub(super) master: Option<Place>,
    slaves: Vec<SlaveCamera>,
    size_px: [u32; 2],
    samples: u32,
    stereo: Option<Stereo>,
    /// By the master camera's last cull.
    tiles_drawn: u32,
    /// Of the master camera.
    eyes: Eyes,
    /// What its eyes' pictures are drawn into; made anew when their size changes.
    targets: Option<[Arc<CameraTarget>; 2]>,
    pub(super) input: Input,
    callbacks: Option<OpaqueDrawData>,
    clamp_projection: Option<ClampProjection>,
}

impl View {
    pub(super) fn new(scene: usize, settings: CullSettings, size_px: [u32; 2], samples: u32) -> Self {
        Self {
            camera: Camera { settings, ..Camera::default() },
            environment: Environment::default(),
            announced: None,
            from: ViewFrom::default(),
            scene,
            look_ahead: LookAhead::default(),
            master: None,
            slaves: Vec::new(),
            size_px,
            samples,
            stereo: None,
            tiles_drawn: 0,
            eyes: Eyes::Both,
            targets: None,
            input: Input::new(size_px),
            callbacks: None,
            clamp_projection: None,
        }
    }

    /// Size of the master camera's picture in pixels. Without a context of its own it decides the aspect of the
    /// slaves' projections.
    pub fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// Where the master camera is drawn; `None` once its context was closed.
    pub fn context(&self) -> Option<ContextId> {
        self.master.map(|place| ContextId(place.context))
    }

    /// Tiles whose content the master camera's picture of the last frame has, those of cameras in it too; 0 without one.
    pub fn tiles_drawn(&self) -> u32 {
        if self.master.is_some() { self.tiles_drawn } else { 0 }
    }

    /// One of its cameras was culled and draws so many tiles.
    pub(super) fn was_culled(&mut self, camera: u32, tiles_drawn: u32) {
        if self.master.is_some_and(|place| place.camera == camera) {
            self.tiles_drawn = tiles_drawn;
        }
    }

    /// Part of the context that the master camera has.
    pub fn set_viewport(&mut self, viewport: impl Into<Viewport>) {
        if let Some(place) = &mut self.master {
            place.viewport = viewport.into();
        }
        self.request_redraw();
    }

    /// Draws the master camera and its slaves for two eyes from now on, or for one.
    pub fn set_stereo(&mut self, stereo: Option<Stereo>) {
        self.stereo = stereo;
        self.targets = None;
        self.slaves.iter_mut().for_each(|s| s.targets = None);
        self.request_redraw();
    }

    /// Which eyes the master camera draws for where there are two; [`Slave::eyes`] has the slaves'.
    pub fn set_eyes(&mut self, eyes: Eyes) {
        self.eyes = eyes;
        self.request_redraw();
    }

    /// The slaves in the order added.
    pub fn slaves(&self) -> impl Iterator<Item = (SlaveId, &Slave)> {
        self.slaves.iter().map(|s| (SlaveId(s.camera), &s.slave))
    }

    /// A slave, to change everything but its context: that stays what it was added with. The next frame is drawn.
    pub fn slave_mut(&mut self, id: SlaveId) -> Option<&mut Slave> {
        self.request_redraw();
        self.slaves.iter_mut().find(|s| s.camera == id.0).map(|s| &mut s.slave)
    }

    /// Adds a slave whose camera was made.
    pub(super) fn push_slave(&mut self, place: Place, slave: Slave) -> SlaveId {
        self.request_redraw();
        let Place { camera, device, context_px, .. } = place;
        let size_px = slave.viewport.picture_px(context_px);
        self.slaves.push(SlaveCamera { camera, device, size_px, context_px, slave, targets: None });
        SlaveId(camera)
    }

    /// Takes a slave out; false when there is none.
    pub(super) fn take_slave(&mut self, id: SlaveId) -> bool {
        let before = self.slaves.len();
        self.slaves.retain(|s| s.camera != id.0);
        self.request_redraw();
        self.slaves.len() < before
    }

    /// Numbers of its cameras.
    pub(super) fn cameras(&self) -> impl Iterator<Item = u32> {
        self.master.iter().map(|place| place.camera).chain(self.slaves.iter().map(|s| s.camera))
    }

    pub(super) fn has_camera(&self, camera: u32) -> bool {
        self.cameras().any(|c| c == camera)
    }

    /// Forgets cameras of a context that is gone.
    pub(super) fn context_closed(&mut self, context: u32) {
        self.master = self.master.filter(|place| place.context != context);
        self.slaves.retain(|s| s.slave.context.0 != context);
    }

    /// Of its cameras.
    pub(super) fn contexts(&self) -> impl Iterator<Item = ContextId> {
        self.context().into_iter().chain(self.slaves.iter().map(|s| s.slave.context))
    }

    /// The next frame is to be drawn where one of its cameras is in a context.
    pub(super) fn redraw_in(&mut self, context: ContextId) {
        if self.contexts().any(|of| of == context) {
            self.request_redraw();
        }
    }

    /// The first sight of a set: the camera before it, sun and haze to its place and size. What else there is of light
    /// and air is the application's.
    pub(super) fn first_sight(&mut self, bounds: &SetBounds) {
        self.camera.world_from_eye = bounds.first_camera(&self.from);
        self.camera.min_near_m = (1e-5 * bounds.sphere.radius_m).clamp(1e-4, 1.0);
        let Environment { sun_direction, up_in_world, fog, .. } = environment_for(bounds);
        self.environment.sun_direction = sun_direction;
        self.environment.up_in_world = up_in_world;
        self.environment.fog.density_per_m = fog.density_per_m;
    }

    /// What follows from contexts and camera, before it is culled.
    pub(super) fn prepare(&mut self, rendering: &Rendering, bounds: Option<&SetBounds>) {
        if let Some(place) = &mut self.master {
            place.context_px = rendering.size_px(place.context).unwrap_or(place.context_px);
        }
        let size_px = self.master.map_or(self.size_px, |place| place.viewport.picture_px(place.context_px));
        if self.size_px != size_px {
            self.size_px = size_px;
            self.targets = None;
            self.input.resized(size_px);
        }
        for s in &mut self.slaves {
            s.context_px = rendering.size_px(s.slave.context.0).unwrap_or(s.context_px);
            let of_slave = s.slave.viewport.picture_px(s.context_px);
            if s.size_px != of_slave {
                s.size_px = of_slave;
                s.targets = None;
            }
        }
        // Over a globe, up is a matter of where one is.
        if let Some(bounds) = bounds.filter(|b| b.frame.georeferenced) {
            self.environment.up_in_world = LocalFrame::at(self.camera.eye(), bounds.frame.georeferenced).up();
        }
        let Some(stereo) = &self.stereo else { return };
        let of_master = (self.eyes, size_px, &mut self.targets);
        let of_slaves = self.slaves.iter_mut().map(|s| (s.slave.eyes, s.size_px, &mut s.targets));
        for (eyes, size_px, targets) in std::iter::once(of_master).chain(of_slaves) {
            match eyes.shown(stereo.mode) {
                Eyes::Both => {
                    targets.get_or_insert_with(|| eye_targets(stereo.eye_size_px(size_px), self.samples));
                }
                Eyes::Left | Eyes::Right | Eyes::Middle => *targets = None,
            }
        }
    }

    /// What is called while the picture of the view is drawn, by its cameras each (by each eye, where it is drawn for two):
    /// on the thread that draws.
    pub fn set_draw_callbacks(&mut self, callbacks: Option<CameraCallbacks>) {
        self.callbacks = callbacks.map(CameraCallbacks::hook);
        self.request_redraw();
    }

    /// Sets near and far anew, where the camera's [`CullSettings::compute_near_far`] has them computed: called with what
    /// cull found, on the thread that culls.
    pub fn set_clamp_projection(&mut self, clamp: Option<ClampProjection>) {
        self.clamp_projection = clamp;
        self.request_redraw();
    }

    /// Where the master camera will be some seconds after a simulation time that passes at a rate, where that was
    /// announced.
    pub(super) fn pose_after(&self, simulation_time_s: f64, rate: f64, seconds: f64) -> Option<DAffine3> {
        match &self.announced {
            Some(path) => Some(path.world_from_eye(simulation_time_s + rate * seconds)),
            None => self.manipulator()?.pose_after(seconds),
        }
    }

    /// With which eyes a camera of the view is culled.
    fn sight(&self, eyes: Eyes, targets: Option<&[Arc<CameraTarget>; 2]>) -> Sight {
        let Some(stereo) = self.stereo else { return Sight::Middle };
        match (eyes.shown(stereo.mode), targets) {
            (Eyes::Both, Some(targets)) => Sight::Both(stereo, targets.clone()),
            (Eyes::Left, _) => Sight::One(stereo, 0),
            (Eyes::Right, _) => Sight::One(stereo, 1),
            (Eyes::Both, None) | (Eyes::Middle, _) => Sight::Middle,
        }
    }

    /// What culling one of its cameras is told; `None` where the camera is another view's.
    pub(super) fn task(
        &self,
        camera: u32,
        paged: &PagedScene,
        frame: u32,
        requests: Vec<PageRequest>,
    ) -> Option<CullTask> {
        let horizon = paged.horizon();
        let master = |device| CullCamera { horizon, ..self.camera.cull_camera(self.size_px, frame, device) };
        let lens = Lens { camera: self.camera, size_px: self.size_px, offset: DMat4::IDENTITY };
        let (camera, lens, sight, viewport_px) = match self.master.filter(|place| place.camera == camera) {
            Some(place) => (master(place.device), lens, self.sight(self.eyes, self.targets.as_ref()), place.part_px()),
            None => {
                let SlaveCamera { size_px, context_px, slave, device, targets, .. } =
                    self.slaves.iter().find(|s| s.camera == camera)?;
                let offset = slave.projection_offset;
                let lens = Lens { offset: if offset.is_finite() { offset } else { DMat4::IDENTITY }, ..lens };
                let of_view = slave.view_offset;
                let of_view = if of_view.is_finite() { of_view } else { DAffine3::IDENTITY };
                let above = master(*device);
                let camera = CullCamera {
                    eye_from_world: of_view * above.eye_from_world,
                    clip_from_eye: lens.clip_from_eye(self.camera.min_near_m),
                    viewport_px: *size_px,
                    settings: slave.settings.inheriting(&above.settings, slave.inherit),
                    ..above
                };
                (camera, lens, self.sight(slave.eyes, targets.as_ref()), slave.viewport.part_px(*context_px))
            }
        };
        Some(CullTask {
            scene: paged.shared(),
            camera,
            lens,
            sight,
            environment: self.environment,
            state_set: self.input.state_set.clone(),
            callbacks: self.callbacks.clone(),
            clamp_projection: self.clamp_projection,
            viewport_px,
            is_dynamic: false,
            requests,
        })
    }
}

/// A texture for each eye.
fn eye_targets(size_px: [u32; 2], samples: u32) -> [Arc<CameraTarget>; 2] {
    ["left eye", "right eye"].map(|name| {
        let texture = TextureObject::target(name, size_px, TextureFormat::Rgba8Srgb);
        Arc::new(CameraTarget { colors: vec![Attachment::new(texture)], samples, ..CameraTarget::default() })
    })
}
