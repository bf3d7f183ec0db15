//! Camera manipulators: they turn events into the eye's pose. Main thread.
//!
//! Events arrive in the event phase. The pose is taken in the update phase, after the update callbacks, which may move a
//! node that a manipulator follows.
//!
//! Motion depends on time, not on the frame rate. Exponential decay is computed in closed form; motion that depends on the
//! position (speed above ground) is integrated in steps of at most 1/240 s. Angles are stored as angles and converted to
//! matrices at the end. Positions are f64, so that 1 m and 40,000 km have the same relative precision. Input that is not
//! finite is ignored.

mod animation_path;
mod ground;
mod key_switch;
mod manipulator;
mod motion;
mod orbiting;
mod pose;
mod travel;
mod usual;

pub use animation_path::AnimationPathManipulator;
pub use ground::SceneGround;
pub use key_switch::KeySwitchManipulator;
pub use manipulator::{CameraManipulator, GroundHeight, ManipulatorView};
pub use orbiting::{NodeTrackerManipulator, OrbitManipulator, TerrainManipulator, TrackballManipulator, TrackerMode};
pub use travel::{DriveManipulator, FirstPersonManipulator, FlyManipulator};
pub use usual::usual;
