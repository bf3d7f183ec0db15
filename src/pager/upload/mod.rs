//! Upload: pages that have arrived pass through the compile queues of the graphics contexts to their merge. Update thread.

mod arrivals;
pub(super) mod context;
pub(super) mod merge_order;

pub(super) use arrivals::{Arrivals, Uploaded};
