//! Checks of a flight: invariants of each frame, a reference image at the end, and a watchdog for panics and hangs.

pub mod invariants;
pub mod reference;
pub mod watchdog;
