//! Manipulators that move the eye itself: flying, walking and driving. Main thread.

mod drive;
mod first_person;
mod fly;
mod look;
mod move_keys;

pub use drive::DriveManipulator;
pub use first_person::FirstPersonManipulator;
pub use fly::FlyManipulator;
