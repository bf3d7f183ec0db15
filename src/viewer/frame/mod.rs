//! The frame that [`Viewer`](super::Viewer) and [`CompositeViewer`](super::CompositeViewer) share. Main thread.
//!
//! [`FrameLoop`] runs it: event, update, cull and draw. Each of its parts keeps one kind of state:
//!
//! - `FrameTimer`: the number and the times of frames
//! - `PictureRequests`: images that are read back
//! - `DrawResults`: statistics and errors
//! - `DeviceLoss`: lost devices and their replacement
//! - `QueryAnswers`: results of occlusion queries that are awaited
//! - `EnvironmentRehearsals`: the environments that views show

mod changes;
mod collect;
mod config;
mod contexts;
mod device_loss;
mod draw_results;
mod frame_loop;
mod pictures;
mod query_answers;
mod snapshot;
mod stats;

pub use self::changes::{EnvironmentChanges, NewStates};
pub use self::config::ViewerConfig;
pub(super) use self::frame_loop::FrameLoop;
pub use self::stats::{FrameStats, Samples, StatsHistory};
