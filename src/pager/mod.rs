//! The DatabasePager: from cull's requests to merged pages, and out again.
//!
//! ```text
//! main     update_scene_graph: results -> compile queues -> merge -> expire -> request list
//! file n x read local files          |
//! http 1 x one async runtime, many   | -> decode n x: io::decode -> results (back to main)
//!          requests in flight        |
//! reaper   drops expired pages
//! ```
//! Cull takes no lock: its requests are data. The threads share one request list behind one mutex, rewritten by
//! update once a frame; every other hand-over is a bounded channel that cannot fill (see `list.rs`).

mod arrivals;
mod config;
mod entry;
mod expiry;
#[cfg(feature = "http")]
mod flow;
mod held;
#[cfg(feature = "http")]
mod http;
mod images;
mod job;
mod list;
mod look_ahead;
mod motion;
mod requests;
mod residents;
mod scenes;
mod shares;
mod states;
mod stats;
mod threads;
mod tries;
mod turns;
mod update;

pub use config::{CompileContext, PagerConfig, PagerError};
pub use images::{
    ImagePager, ImagePagerConfig, ImagePagerStats, ImageSequence, LoopingMode, SequenceImage, SequenceMode,
    StreamStatus,
};
pub use look_ahead::{PathLooks, frames_until};
pub(crate) use motion::turn_between;
pub use motion::{EyeMotion, MotionLooks};
pub use scenes::Scenes;
pub use states::RequestState;
pub use stats::{ErrorRecord, PagerStats};
pub use update::DatabasePager;

pub(crate) use images::ImageChange;
