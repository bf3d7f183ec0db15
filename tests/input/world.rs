//! Worlds without a GPU, and scripted input that moves a manipulator in them.

use glam::{DAffine3, DVec2, DVec3};
use terrane::math::{Aabb, BoundingSphere, BoundingVolume, OrientedBox, Region, WGS84};
use terrane::scene::Scene;
use terrane::viewer::manipulators::{
    AnimationPathManipulator, CameraManipulator, DriveManipulator, FirstPersonManipulator, FlyManipulator,
    GroundHeight, ManipulatorView, OrbitManipulator, TerrainManipulator, TrackballManipulator, usual,
};
use terrane::viewer::{
    AnimationPath, Camera, ControlPoint, EventQueue, GuiEventAdapter, Key, MouseButton, SetBounds, TouchPhase,
};

pub const SIZE_PX: [u32; 2] = [1280, 720];

pub struct World {
    pub scene: Scene,
    pub camera: Camera,
    pub bounds: SetBounds,
    pub ground: Option<Box<dyn GroundHeight>>,
}

impl World {
    pub fn view(&self) -> ManipulatorView<'_> {
        ManipulatorView {
            scene: &self.scene,
            camera: &self.camera,
            size_px: SIZE_PX,
            bounds: self.bounds,
            ground: self.ground.as_deref(),
        }
    }

    /// Returns 2 km of a plane at the origin, without ground.
    pub fn plane() -> Self {
        let around = Aabb { min: DVec3::new(-1e3, -1e3, 0.0), max: DVec3::new(1e3, 1e3, 200.0) };
        let volume = OrientedBox { center: around.center(), half_axes: glam::DMat3::from_diagonal(around.half_size()) };
        let sphere = BoundingSphere::new(around.center(), around.half_size().length());
        Self::new(SetBounds::new(sphere, Some(BoundingVolume::Box(volume))))
    }

    /// Returns half a degree of the Alps on the ellipsoid, with hills as ground.
    pub fn alps() -> Self {
        let region = Region {
            west: 0.139,
            south: 0.81,
            east: 0.147,
            north: 0.818,
            min_height_m: 300.0,
            max_height_m: 4000.0,
            ellipsoid: WGS84,
        };
        let volume = BoundingVolume::Region(region);
        let mut world = Self::new(SetBounds::new(volume.bounding_sphere(), Some(volume)));
        world.ground = Some(Box::new(|_: &Scene, point: DVec3, _: DVec3| {
            let mut g = WGS84.geodetic(point);
            g.height_m = hill(g.longitude, g.latitude);
            Some(WGS84.ecef(&g))
        }));
        world
    }

    /// Returns the whole earth.
    pub fn globe() -> Self {
        Self::new(SetBounds::from_sphere(BoundingSphere::new(DVec3::new(0.0, 0.0, 1.1e6), 6.4e6)))
    }

    pub fn new(bounds: SetBounds) -> Self {
        Self { scene: Scene::new(), camera: Camera::default(), bounds, ground: None }
    }

    pub fn height_m(&self, point: DVec3) -> f64 {
        self.view().height_above_ground_m(point).unwrap()
    }
}

fn hill(longitude: f64, latitude: f64) -> f64 {
    2000.0 + 1500.0 * (longitude * 4000.0).sin() * (latitude * 3000.0).cos()
}

pub fn all() -> Vec<(&'static str, Box<dyn CameraManipulator>)> {
    let path = AnimationPath::new(vec![ControlPoint::from_pose(0.0, &DAffine3::IDENTITY)]).unwrap();
    vec![
        ("trackball", Box::new(TrackballManipulator::default())),
        ("orbit", Box::new(OrbitManipulator::default())),
        ("terrain", Box::new(TerrainManipulator::default())),
        ("fly", Box::new(FlyManipulator::default())),
        ("drive", Box::new(DriveManipulator::default())),
        ("first person", Box::new(FirstPersonManipulator::default())),
        ("path", Box::new(AnimationPathManipulator::new(path))),
        ("switch", Box::new(usual(None))),
    ]
}

/// An input of the user.
#[derive(Clone, Debug)]
pub enum Act {
    Press(MouseButton),
    Release(MouseButton),
    Move(f64, f64),
    Scroll(f64),
    Down(Key),
    Up(Key),
    Touch(u64, TouchPhase, f64, f64),
}

/// Plays inputs at their times in seconds, with `rate` frames per second, and returns the last pose.
pub fn play(
    manipulator: &mut dyn CameraManipulator,
    world: &World,
    acts: &[(f64, Act)],
    end_s: f64,
    rate: u32,
) -> DAffine3 {
    play_on(&mut queue(), manipulator, world, acts, end_s, rate)
}

/// Returns the event queue of a window.
pub fn queue() -> EventQueue {
    let mut queue = EventQueue::default();
    queue.window_resize(SIZE_PX, 0.0);
    queue
}

/// Plays inputs like [`play`] on a given queue.
pub fn play_on(
    queue: &mut EventQueue,
    manipulator: &mut dyn CameraManipulator,
    world: &World,
    acts: &[(f64, Act)],
    end_s: f64,
    rate: u32,
) -> DAffine3 {
    let mut events: Vec<GuiEventAdapter> = Vec::new();
    let mut pose = DAffine3::NAN;
    let mut acts = acts.iter().peekable();
    let frames = (end_s * f64::from(rate)).round() as u32;
    let dt_s = end_s / f64::from(frames);
    for frame in 1..=frames {
        // The order is that of the viewer: first the events before the frame, then the time of the frame.
        let now_s = f64::from(frame - 1) * dt_s;
        while let Some((at_s, act)) = acts.next_if(|(at_s, _)| *at_s <= now_s + 1e-9) {
            match act {
                Act::Press(button) => queue.mouse_button_press(*button, *at_s),
                Act::Release(button) => queue.mouse_button_release(*button, *at_s),
                Act::Move(x, y) => queue.mouse_motion(DVec2::new(*x, *y), *at_s),
                Act::Scroll(notches) => queue.mouse_scroll(DVec2::new(0.0, *notches), *at_s),
                Act::Down(key) => queue.key_press(*key, *key, *at_s),
                Act::Touch(id, phase, x, y) => queue.touch(*id, *phase, DVec2::new(*x, *y), *at_s),
                Act::Up(key) => queue.key_release(*key, *key, *at_s),
            }
        }
        queue.take_frame(&mut events, now_s);
        for event in &events {
            manipulator.handle(event, &world.view());
        }
        pose = manipulator.advance(dt_s, &world.view());
    }
    pose
}

pub fn home(manipulator: &mut dyn CameraManipulator, world: &World) -> DAffine3 {
    manipulator.home(&world.view());
    manipulator.advance(0.0, &world.view())
}
