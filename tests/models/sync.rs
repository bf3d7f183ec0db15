//! The library's barriers, blocks and operation threads on shuttle's primitives.

#[path = "../../src/sync/barrier.rs"]
mod barrier;
#[path = "../../src/sync/block.rs"]
mod block;
#[path = "../../src/sync/operation.rs"]
mod operation;
#[path = "../../src/sync/operation_thread.rs"]
mod operation_thread;

pub use barrier::Barrier;
pub use block::{Block, BlockCount};
pub use operation::{Operation, OperationQueue};
pub use operation_thread::OperationThread;

pub use crate::schedules::primitives;
