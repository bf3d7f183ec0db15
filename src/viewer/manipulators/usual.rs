//! [`usual`]: the manipulators of a window, switched by keys.

use super::animation_path::AnimationPathManipulator;
use super::key_switch::KeySwitchManipulator;
use super::orbiting::{OrbitManipulator, TerrainManipulator, TrackballManipulator};
use super::travel::{DriveManipulator, FirstPersonManipulator, FlyManipulator};
use crate::viewer::camera_path::AnimationPath;
use crate::viewer::events::Key;

/// Returns the manipulators of a window under OSG's keys: 1 trackball, 2 fly, 3 drive, 4 terrain, 5 orbit, 6 first person,
/// and 7 the path if one is given. It starts with terrain.
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
