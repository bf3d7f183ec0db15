//! Statistics over the image: frame rate, phases, draw counters and pager counters. Main thread, in the event phase.

#[cfg(feature = "window")]
mod fit;
mod handler;
#[cfg(feature = "window")]
mod page;
#[cfg(feature = "window")]
mod phases;
mod selection;
#[cfg(feature = "window")]
mod tables;

pub use handler::StatsHandler;
pub use selection::StatsPage;
