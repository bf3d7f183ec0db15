//! Manipulators that look at a point and orbit it. Main thread.
//!
//! They share the angles, the distance and the handling of drags in `orbit_state`, and differ in the frame of the angles and
//! in what keeps the point in place: the ground, a node, or nothing.

mod node_tracker;
mod orbit;
mod orbit_state;
mod terrain;
mod trackball;

pub use node_tracker::{NodeTrackerManipulator, TrackerMode};
pub use orbit::OrbitManipulator;
pub use terrain::TerrainManipulator;
pub use trackball::TrackballManipulator;
