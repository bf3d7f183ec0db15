//! [`View`]: a master camera on a scene, its light, its input and its slave cameras. Main thread.

use glam::{DAffine3, DMat4};

use super::eyes::{EyeTargets, Eyes};
use super::set_bounds::{LocalFrame, SetBounds, ViewFrom, environment_for};
use super::shown_environment::ShownEnvironment;
use super::slaves::{CameraSlot, Slave, SlaveCamera};
use super::viewport::ViewArea;
use crate::cull::{CullCamera, PageRequest, Stereo};
use crate::draw::CameraCallbacks;
use crate::scene::{ClampProjection, CullSettings, Environment};
use crate::state::OpaqueDrawData;
use crate::viewer::AnimationPath;
use crate::viewer::camera::Camera;
use crate::viewer::clock::ReferenceClock;
use crate::viewer::ids::{ContextId, SceneId, SlaveId};
use crate::viewer::input::Input;
use crate::viewer::paging::PagedScene;
use crate::viewer::rendering::{CullTask, Lens, Rendering};

/// A scene seen by a master camera and its slaves. The main thread changes it between frames; culls get copies of its cameras.
pub struct View {
    /// The master camera. Change it between frames, or set a manipulator that moves it.
    pub camera: Camera,
    /// Sun, sky and fog. Loading a set chooses the sun's direction, the light at night, the up vector and the density of
    /// the haze.
    /// [`EnvironmentChanges`](crate::viewer::EnvironmentChanges) says when a change takes effect.
    pub environment: Environment,
    /// The environment that frames show.
    pub(in crate::viewer) shown: ShownEnvironment,
    /// The path that the camera will take, in simulation time, when the application knows it. Tiles along it are
    /// prefetched; see [`ViewerConfig::look_ahead_s`](crate::viewer::ViewerConfig::look_ahead_s).
    pub announced: Option<AnimationPath>,
    /// The direction and distance of the first pose.
    pub(in crate::viewer) from: ViewFrom,
    scene: SceneId,
    /// The slot of the master camera; `None` once its context was closed. Slaves are drawn all the same.
    pub(in crate::viewer) master: Option<CameraSlot>,
    slaves: Vec<SlaveCamera>,
    samples: u32,
    stereo: Option<Stereo>,
    /// Tiles that the master camera's last cull draws.
    tiles_drawn: u32,
    /// The eyes of the master camera.
    eyes: Eyes,
    eye_targets: EyeTargets,
    pub(in crate::viewer) input: Input,
    callbacks: Option<OpaqueDrawData>,
    clamp_projection: Option<ClampProjection>,
}

impl View {
    pub(in crate::viewer) fn new(
        scene: SceneId,
        settings: CullSettings,
        size_px: [u32; 2],
        samples: u32,
        master: CameraSlot,
        clock: ReferenceClock,
    ) -> Self {
        Self {
            camera: Camera { settings, ..Camera::default() },
            environment: Environment::default(),
            shown: ShownEnvironment::default(),
            announced: None,
            from: ViewFrom::default(),
            scene,
            master: Some(master),
            slaves: Vec::new(),
            samples,
            stereo: None,
            tiles_drawn: 0,
            eyes: Eyes::Both,
            eye_targets: EyeTargets::new(size_px),
            input: Input::new(size_px, clock),
            callbacks: None,
            clamp_projection: None,
        }
    }

    /// Returns the scene that the view shows.
    pub(in crate::viewer) fn scene(&self) -> SceneId {
        self.scene
    }

    /// Returns the size of the master camera's image in pixels. Without a context it still decides the aspect ratio of
    /// the slaves' projections.
    pub fn size_px(&self) -> [u32; 2] {
        self.eye_targets.size_px()
    }

    /// Returns the context in which the master camera is drawn; `None` once it was closed.
    pub fn context(&self) -> Option<ContextId> {
        self.master.map(|slot| ContextId(slot.context))
    }

    /// Returns the number of tiles that the master camera's image of the last frame shows, or 0 without a context. Tiles of
    /// cameras in the scene graph count, and ancestors that are drawn instead of tiles that failed to load.
    pub fn tiles_drawn(&self) -> u32 {
        if self.master.is_some() { self.tiles_drawn } else { 0 }
    }

    /// Takes the result of a cull of one of its cameras.
    pub(in crate::viewer) fn set_culled(&mut self, camera: u32, tiles_drawn: u32) {
        if self.master.is_some_and(|slot| slot.camera == camera) {
            self.tiles_drawn = tiles_drawn;
        }
    }

    /// Sets the part of its context that the master camera covers.
    pub fn set_viewport(&mut self, viewport: impl Into<ViewArea>) {
        if let Some(slot) = &mut self.master {
            slot.viewport = viewport.into();
        }
        self.request_redraw();
    }

    /// Turns stereo drawing on or off, for the master camera and its slaves.
    pub fn set_stereo(&mut self, stereo: Option<Stereo>) {
        self.stereo = stereo;
        self.eye_targets.clear();
        self.slaves.iter_mut().for_each(|slave| slave.eye_targets.clear());
        self.request_redraw();
    }

    /// Sets the eyes that the master camera draws for in stereo; [`Slave::eyes`] has the slaves'.
    pub fn set_eyes(&mut self, eyes: Eyes) {
        self.eyes = eyes;
        self.request_redraw();
    }

    /// Returns the slaves in the order added.
    pub fn slaves(&self) -> impl Iterator<Item = (SlaveId, &Slave)> {
        self.slaves.iter().map(|of| (of.id, &of.slave))
    }

    /// Returns a slave for changes, and requests a frame. A change of [`Slave::context`] has no effect: remove the slave
    /// and add another.
    pub fn slave_mut(&mut self, id: SlaveId) -> Option<&mut Slave> {
        self.request_redraw();
        self.slaves.iter_mut().find(|of| of.id == id).map(|of| &mut of.slave)
    }

    /// Returns the part of its window that a slave covers as x, y, width and height in pixels, its projection, and its view
    /// offset.
    pub(in crate::viewer) fn slave_lens(&self, id: SlaveId) -> Option<([u32; 4], DMat4, DAffine3)> {
        let of = self.slaves.iter().find(|of| of.id == id)?;
        let lens = self.lens_of(&of.slave);
        let [width, height] = of.context_px;
        let part_px = of.slave.viewport.part_px(of.context_px).unwrap_or([0, 0, width, height]);
        Some((part_px, lens.clip_from_eye(self.camera.min_near_m), of.slave.view_offset))
    }

    fn lens_of(&self, slave: &Slave) -> Lens {
        Lens { camera: self.camera, size_px: self.size_px(), offset: slave.finite_projection_offset() }
    }

    /// Adds a slave whose camera was created.
    pub(in crate::viewer) fn push_slave(&mut self, slot: CameraSlot, slave: Slave) -> SlaveId {
        self.request_redraw();
        let slave = SlaveCamera::new(slot, slave);
        let id = slave.id;
        self.slaves.push(slave);
        id
    }

    /// Removes a slave; returns false when there is no such slave.
    pub(in crate::viewer) fn take_slave(&mut self, id: SlaveId) -> bool {
        let before = self.slaves.len();
        self.slaves.retain(|of| of.id != id);
        self.shown.forget_rehearsal();
        self.request_redraw();
        self.slaves.len() < before
    }

    /// Returns the numbers of its cameras, the master's first.
    pub(in crate::viewer) fn cameras(&self) -> impl Iterator<Item = u32> {
        self.master.iter().map(|slot| slot.camera).chain(self.slaves.iter().map(|of| of.id.0))
    }

    pub(in crate::viewer) fn has_camera(&self, camera: u32) -> bool {
        self.cameras().any(|of| of == camera)
    }

    /// Removes the cameras of a context that was closed.
    pub(in crate::viewer) fn context_closed(&mut self, context: u32) {
        self.master = self.master.filter(|slot| slot.context != context);
        self.slaves.retain(|of| of.slave.context.0 != context);
        self.shown.forget_rehearsal();
    }

    /// Returns the contexts of its cameras.
    pub(in crate::viewer) fn contexts(&self) -> impl Iterator<Item = ContextId> {
        self.context().into_iter().chain(self.slaves.iter().map(|of| of.slave.context))
    }

    /// Requests a frame when one of its cameras is drawn in a context.
    pub(in crate::viewer) fn redraw_in(&mut self, context: ContextId) {
        if self.contexts().any(|of| of == context) {
            self.request_redraw();
        }
    }

    /// Moves the camera to the first view of a set, and fits sun, night, air and haze to it. The rest of the environment is the
    /// application's.
    pub(in crate::viewer) fn first_sight(&mut self, bounds: &SetBounds) {
        self.camera.world_from_eye = bounds.first_camera(&self.from);
        self.camera.min_near_m = (1e-5 * bounds.sphere.radius_m).clamp(1e-4, 1.0);
        let Environment { up_in_world, fog, night_light, .. } = environment_for(bounds);
        self.environment.move_to(bounds.ellipsoid);
        self.environment.sun_direction = bounds.sun_behind(&self.camera.world_from_eye);
        self.environment.night_light = night_light;
        self.environment.up_in_world = up_in_world;
        self.environment.fog.density_per_m = fog.density_per_m;
    }

    /// Follows the sizes of its contexts and the camera's position, before it is culled.
    pub(in crate::viewer) fn prepare(&mut self, rendering: &Rendering, bounds: Option<&SetBounds>) {
        if let Some(slot) = &mut self.master {
            slot.context_px = rendering.size_px(slot.context).unwrap_or(slot.context_px);
        }
        let size_px = self.master.map_or(self.size_px(), |slot| slot.viewport.image_px(slot.context_px));
        if self.eye_targets.set_size(size_px) {
            self.input.resized(size_px);
        }
        for of in &mut self.slaves {
            of.context_px = rendering.size_px(of.slave.context.0).unwrap_or(of.context_px);
            of.eye_targets.set_size(of.slave.viewport.image_px(of.context_px));
        }
        if let Some(bounds) = bounds {
            self.environment.ellipsoid = bounds.ellipsoid;
        }
        // On a globe, the up vector depends on the camera's position.
        if let Some(ellipsoid) = bounds.and_then(|bounds| bounds.frame.ellipsoid) {
            self.environment.up_in_world = LocalFrame::at(self.camera.eye(), Some(ellipsoid)).up();
        }
        let Some(stereo) = &self.stereo else { return };
        self.eye_targets.prepare(self.eyes, stereo, self.samples);
        for of in &mut self.slaves {
            of.eye_targets.prepare(of.slave.eyes, stereo, self.samples);
        }
    }

    /// Sets callbacks that run while each of the view's cameras is drawn (for each eye, in stereo), on the thread that
    /// draws.
    pub fn set_draw_callbacks(&mut self, callbacks: Option<CameraCallbacks>) {
        self.callbacks = callbacks.map(CameraCallbacks::hook);
        self.request_redraw();
    }

    /// Sets a function that adjusts near and far where the camera's [`CullSettings::compute_near_far`] computes them. It is
    /// called with the values that cull found, on the thread that culls.
    pub fn set_clamp_projection(&mut self, clamp: Option<ClampProjection>) {
        self.clamp_projection = clamp;
        self.request_redraw();
    }

    /// Returns the announced pose of the master camera, `seconds` of wall time after a simulation time that passes at `rate`;
    /// `None` when nothing was announced.
    pub(in crate::viewer) fn pose_after(&self, simulation_time_s: f64, rate: f64, seconds: f64) -> Option<DAffine3> {
        match &self.announced {
            Some(path) => Some(path.world_from_eye(simulation_time_s + rate * seconds)),
            None => self.manipulator()?.pose_after(seconds),
        }
    }

    /// Returns the cull task of one of its cameras; `None` when the camera is another view's. `requests` is an empty
    /// vector whose memory is used again.
    pub(in crate::viewer) fn task(
        &self,
        camera: u32,
        paged: &PagedScene,
        frame: u32,
        requests: Vec<PageRequest>,
    ) -> Option<CullTask> {
        let horizon = paged.horizon();
        let master = |device| CullCamera { horizon, ..self.camera.cull_camera(self.size_px(), frame, device) };
        let lens = Lens { camera: self.camera, size_px: self.size_px(), offset: DMat4::IDENTITY };
        let (camera, lens, sight, viewport_px) = match self.master.filter(|slot| slot.camera == camera) {
            Some(slot) => {
                let sight = self.eye_targets.sight(self.eyes, self.stereo);
                (master(slot.device), lens, sight, slot.part_px())
            }
            None => {
                let SlaveCamera { context_px, slave, device, eye_targets, .. } =
                    self.slaves.iter().find(|of| of.id.0 == camera)?;
                let lens = self.lens_of(slave);
                let clip_from_eye = lens.clip_from_eye(self.camera.min_near_m);
                let camera = slave.cull_camera(master(*device), clip_from_eye, eye_targets.size_px());
                let sight = eye_targets.sight(slave.eyes, self.stereo);
                (camera, lens, sight, slave.viewport.part_px(*context_px))
            }
        };
        Some(CullTask {
            scene: paged.shared(),
            camera,
            lens,
            sight,
            environment: self.shown.of(&self.environment),
            state_set: self.input.state_set.clone(),
            callbacks: self.callbacks.clone(),
            clamp_projection: self.clamp_projection,
            viewport_px,
            is_dynamic: false,
            requests,
        })
    }
}
