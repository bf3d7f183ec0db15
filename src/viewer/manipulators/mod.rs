//! Camera manipulators: events in, the eye's pose out. Main thread: events in the event phase, the pose in update,
//! after the callbacks that move what may be followed.
//!
//! Motion is a function of time, not of frames: what eases out does so by exponentials in closed form, what depends on
//! the place (speed over ground) is integrated in steps of at most 1/240 s. Angles are kept as such and turned into
//! matrices at the end; places are f64, so that 1 m and 40,000 km have the same precision. What is not finite is
//! never taken in.

mod animation_path;
mod drive;
mod first_person;
mod fly;
mod ground;
mod inertia;
mod key_switch;
mod node_tracker;
mod orbit;
mod terrain;
mod touch;
mod trackball;
mod walk;

pub use animation_path::AnimationPathManipulator;
pub use drive::DriveManipulator;
pub use first_person::FirstPersonManipulator;
pub use fly::FlyManipulator;
pub use ground::SceneGround;
pub use key_switch::KeySwitchManipulator;
pub use node_tracker::{NodeTrackerManipulator, TrackerMode};
pub use orbit::OrbitManipulator;
pub use terrain::TerrainManipulator;
pub use trackball::TrackballManipulator;

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::camera::Camera;
use super::camera_path::AnimationPath;
use super::events::{GuiEventAdapter, Key, Usage};
use super::home::{LocalFrame, SetBounds};
use crate::math::WGS84;
use crate::scene::Scene;

/// Where the ground is; asked by manipulators that stay above it: [`SceneGround`], or a closure.
pub trait GroundHeight {
    /// The ground on the line through `point` along `up` (unit, world): the highest where there are several. `None`
    /// where nothing is known.
    fn ground_at(&self, scene: &Scene, point: DVec3, up: DVec3) -> Option<DVec3>;
}

impl<F: Fn(&Scene, DVec3, DVec3) -> Option<DVec3>> GroundHeight for F {
    fn ground_at(&self, scene: &Scene, point: DVec3, up: DVec3) -> Option<DVec3> {
        self(scene, point, up)
    }
}

/// What a manipulator may know.
#[derive(Clone, Copy)]
pub struct ManipulatorView<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The camera as the last frame left it.
    pub camera: &'a Camera,
    /// Size of the picture.
    pub size_px: [u32; 2],
    /// Extent of what is looked at.
    pub bounds: SetBounds,
    /// Where the ground is.
    pub ground: Option<&'a dyn GroundHeight>,
}

impl ManipulatorView<'_> {
    /// The pose from which the bounds fill the picture.
    pub fn home_pose(&self) -> DAffine3 {
        self.bounds.home_camera(self.camera, self.size_px)
    }

    /// Height of the picture at a distance of 1 m, metres.
    pub fn picture_height(&self) -> f64 {
        2.0 * (0.5 * self.camera.fovy(self.size_px)).tan()
    }

    /// East, north and up at a place.
    pub fn frame_at(&self, point: DVec3) -> LocalFrame {
        LocalFrame::at(point, self.bounds.frame.georeferenced)
    }

    /// The ground below or above a place, where it is known and finite.
    pub fn ground_at(&self, point: DVec3) -> Option<DVec3> {
        let up = self.frame_at(point).up();
        self.ground?.ground_at(self.scene, point, up).filter(|p| p.is_finite())
    }

    /// Metres of a place above the ground.
    pub fn height_above_ground_m(&self, point: DVec3) -> Option<f64> {
        let ground = self.ground_at(point)?;
        Some((point - ground).dot(self.frame_at(point).up()))
    }

    /// A place so many metres further east and north, at the same height over the ellipsoid or in the plane.
    pub fn moved_over(&self, point: DVec3, east_m: f64, north_m: f64) -> DVec3 {
        let frame = self.frame_at(point);
        let offset = frame.world_from_local.matrix3 * DVec3::new(east_m, north_m, 0.0);
        let length_m = offset.length();
        if !frame.georeferenced || length_m <= 0.0 {
            return point + offset;
        }
        // Along the great circle; the ellipsoid is nearly a sphere, and the height is put right after.
        let radius_m = point.length().max(1.0);
        let (sin, cos) = (length_m / radius_m).sin_cos();
        let there = point * cos + offset / length_m * (radius_m * sin);
        let (here, mut geodetic) = (WGS84.geodetic(point), WGS84.geodetic(there));
        geodetic.height_m = here.height_m;
        WGS84.ecef(&geodetic)
    }
}

/// Moves a camera.
pub trait CameraManipulator: Send {
    /// Takes one event that no handler has answered; true when it means something here.
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool;

    /// The pose (world from eye) after `dt_s` more seconds. Update, once a frame.
    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3;

    /// Starts again from a pose (world from eye), at rest; as near to it as the manipulator can be.
    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>);

    /// Starts again from where the bounds fill the picture.
    fn home(&mut self, view: &ManipulatorView<'_>) {
        self.set_pose(&view.home_pose(), view);
    }

    /// False while the pose would stay as it is without events: what drawing on demand looks at.
    fn is_moving(&self) -> bool {
        true
    }

    /// True once there is nothing left of what it shows, as at the end of a path.
    fn is_finished(&self) -> bool {
        false
    }

    /// Where the eye will be (world from eye) after `seconds` more without events, where that is known: what will be
    /// wanted there is loaded ahead. `None`: as it moves now.
    fn pose_after(&self, _seconds: f64) -> Option<DAffine3> {
        None
    }

    /// Something to say to the user, once.
    fn take_notice(&mut self) -> Option<String> {
        None
    }

    /// Its keys and gestures, for the help.
    fn usage(&self) -> Vec<Usage> {
        Vec::new()
    }
}

/// Those that windows usually have, under OSG's keys: 1 trackball, 2 fly, 3 drive, 4 terrain, 5 orbit, 6 first person,
/// 7 the path if there is one. Terrain is chosen at first.
pub fn usual(path: Option<AnimationPath>) -> KeySwitchManipulator {
    let switch = KeySwitchManipulator::new()
        .with(Key::Char('1'), "trackball", TrackballManipulator::default())
        .with(Key::Char('2'), "fly", FlyManipulator::default())
        .with(Key::Char('3'), "drive", DriveManipulator::default())
        .with(Key::Char('4'), "terrain", TerrainManipulator::default())
        .with(Key::Char('5'), "orbit", OrbitManipulator::default())
        .with(Key::Char('6'), "first person", FirstPersonManipulator::default());
    let switch = match path {
        Some(path) => switch.with(Key::Char('7'), "path", AnimationPathManipulator::new(path)),
        None => switch,
    };
    switch.starting_with("terrain")
}

/// The pose of an eye that looks `heading` radians clockwise from north and `pitch` radians above the horizon; upright
/// even where it looks straight down.
pub(super) fn looking(frame: &DMat3, eye: DVec3, heading: f64, pitch: f64) -> DAffine3 {
    let (sin_h, cos_h) = heading.sin_cos();
    let (sin_p, cos_p) = pitch.sin_cos();
    let right = DVec3::new(cos_h, -sin_h, 0.0);
    let back = DVec3::new(-sin_h * cos_p, -cos_h * cos_p, -sin_p);
    DAffine3 { matrix3: *frame * DMat3::from_cols(right, back.cross(right), back), translation: eye }
}

/// Heading and pitch of a pose in a frame; of one that looks straight up or down, the heading is where the picture's
/// upper (or lower) edge points.
pub(super) fn heading_and_pitch(frame: &DMat3, pose: &DAffine3) -> (f64, f64) {
    let local = frame.transpose() * pose.matrix3;
    let direction = -local.z_axis;
    let flat = if direction.truncate().length() > 1e-9 {
        direction.truncate()
    } else {
        -local.y_axis.truncate() * direction.z.signum()
    };
    (flat.x.atan2(flat.y), direction.z.clamp(-1.0, 1.0).asin())
}

/// A heading carried from one place to another along the shortest way: north is elsewhere there.
pub(super) fn carried(heading: f64, from: &LocalFrame, to: &LocalFrame) -> f64 {
    let ahead = DQuat::from_rotation_arc(from.up(), to.up()) * from.direction(heading, 0.0);
    let local = to.world_from_local.matrix3.transpose() * ahead;
    if local.is_finite() { local.x.atan2(local.y) } else { heading }
}

/// A line of help.
fn usage(keys: &str, does: &'static str) -> Usage {
    Usage { keys: keys.to_owned(), does }
}
