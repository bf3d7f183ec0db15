//! Uploads: drawables that the pager loaded become drawable in small steps, so that no frame takes longer for them. OSG's
//! `IncrementalCompileOperation`.
//!
//! The draw thread runs the queue between draws. It gives each drawable of an operation its slots and queues the uploads to
//! them. Without a compile thread it then uploads slice by slice until the frame's budget is spent, and continues in the
//! next frame. With a compile thread that thread fills staging buffers, and the draw thread submits its commands before the
//! next frame.
//!
//! ```text
//! CompileOperation -> Operations: slots from the pools, by `placement`
//!                  -> DrawThreadUploads, or CompileThreadUploads: bytes into staging buffers, copies recorded
//!                  -> RecordedUploads: submitted with the next frame, staging buffers mapped again
//!                  -> Compiled { slots }
//! ```

mod budget;
mod compile_operation;
mod compile_thread;
mod compile_thread_uploads;
mod draw_thread_uploads;
mod memory_shortage;
mod operations;
mod placement;
mod recorded_uploads;
mod resource_upload;
mod staging;
mod upload_progress;
mod upload_queue;

// The compile thread imports these from its parent, so that its model test can substitute them.
use super::memory::Memory;

pub use budget::{CompileBudget, CompilePace};
pub use compile_operation::{CompileOperation, CompileStats, Compiled};
pub(super) use placement::rewrite_mesh;
pub(super) use upload_queue::UploadQueue;
