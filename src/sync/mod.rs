//! Thread synchronisation: OpenThreads' blocks and barriers and OpenSceneGraph's operations, on the standard library's
//! mutex and condition variable.
//!
//! Any thread may use these. The viewer's threads use them between and around cull and draw, never inside. Nothing spins:
//! each state lies behind one mutex and is changed under it, and a waiting thread checks it again under it, so that no
//! wake-up is lost. No lock is held while an operation runs, and no two locks of this module are held at once.
//!
//! `tests/models/sync_models.rs` compiles these files against shuttle's mutexes and runs them under thousands of schedules, which
//! is why they import theirs from `primitives`. So do the pagers' request lists, the compile thread and the viewer's
//! rendering stage (`pager_models.rs`, `compile_models.rs` and `stage_models.rs` beside it).

mod barrier;
mod block;
mod operation;
mod operation_thread;

/// The primitives of files that are model-checked; the model checker substitutes its own.
pub(crate) mod primitives {
    pub use crossbeam_channel as channel;
    pub(crate) use pollster::block_on;
    pub use std::sync::{Arc, Condvar, Mutex, MutexGuard};
    pub use std::thread::{Builder, JoinHandle};
}

pub use barrier::Barrier;
pub use block::{Block, BlockCount};
pub use operation::{Operation, OperationQueue};
pub use operation_thread::{OperationThread, Panicked};
