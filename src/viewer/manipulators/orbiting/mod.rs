//! Manipulators that look at a point and orbit it.

mod node_tracker;
mod orbit;
mod orbit_state;
mod terrain;
mod trackball;

pub use node_tracker::{NodeTrackerManipulator, TrackerMode};
pub use orbit::OrbitManipulator;
pub use terrain::TerrainManipulator;
pub use trackball::TrackballManipulator;
