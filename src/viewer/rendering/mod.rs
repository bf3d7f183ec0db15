//! The rendering stage of the frame: contexts and cameras, the threads that cull and draw them, and what these wait for.
//! Driven by the main thread.
//!
//! One frame, in the order of OSG:
//!
//! ```text
//! reset the end of dynamic draws
//! tasks to the cameras, jobs to the contexts
//! start barrier             CullDrawThreadPerContext: contexts; CullThreadPerCamera...: cameras
//! cull                      the cameras that the main thread owns
//! draw, swap                the contexts that the main thread owns
//! end barrier               CullDrawThreadPerContext: contexts
//! end of dynamic draws      DrawThreadPerContext and CullThreadPerCamera...
//! ```
//! By its end all culls have dropped the scene, so that between two frames the main thread has the only reference.
//! `tests/models/stage_models.rs` runs these files under thousands of thread schedules.

mod cores;
mod cull_side;
mod device;
mod draw_side;
mod frame_job;
mod model;
mod operations;
mod pending_uploads;
mod retained_slots;
mod stage;
mod threads;
mod upload_ticket;
mod user_operations;

pub(super) use self::cull_side::{CullOutcome, CullTask, Lens, Sight};
pub(super) use self::device::DeviceHandle;
pub(super) use self::frame_job::{FrameDone, FrameJob, millis};
pub use self::model::{THREADING_VARIABLE, ThreadingModel};
pub(super) use self::stage::{Closed, FRAMES_IN_FLIGHT, Rendering};
pub(super) use self::upload_ticket::UploadOwner;
