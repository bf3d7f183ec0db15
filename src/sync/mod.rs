//! What threads wait for, and what they are given to do: OpenThreads' blocks and barriers and OpenSceneGraph's
//! operations, on the standard library's mutex and condition variable.
//!
//! Any thread may use these; the viewer's do, between and around cull and draw, never inside. Nothing here spins and
//! nothing wakes without a reason: each state lies behind one mutex, is changed under it, and whoever waits looks at it
//! again under it, so that no wake-up can be lost. A lock is never held while an operation runs, and no two locks of
//! this module are held at once.
//!
//! `tests/sync_models.rs` compiles these very files against shuttle's mutexes and runs them under thousands of
//! schedules; this is why they take theirs from `primitives`. So do the pagers' request lists, the compile thread and
//! the viewer's rendering stage (`tests/pager_models.rs`, `tests/compile_models.rs`, `tests/stage_models.rs`).

mod barrier;
mod block;
mod operation;
mod operation_thread;

/// Where what is model-checked takes its primitives from; the model checker puts its own in their place.
pub(crate) mod primitives {
    pub use crossbeam_channel as channel;
    pub use std::sync::{Arc, Condvar, Mutex, MutexGuard};
    pub use std::thread::{Builder, JoinHandle};
}

pub use barrier::Barrier;
pub use block::{Block, BlockCount};
pub use operation::{Operation, OperationQueue};
pub use operation_thread::{OperationThread, Panicked};
