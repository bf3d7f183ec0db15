//! The report of a flight: one JSON document with a stable schema, written after the last frame on the main thread.

mod from_frames;
mod holes;
mod of_viewer;
mod schema;

pub use holes::{HoleCheck, KEY_COLOR, coverage};
pub use schema::{Bytes, DrawMedians, FrameTimes, Images, Phases, Report, ReportError, Settled, Sharing, Tiles, Times};
