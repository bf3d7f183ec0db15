//! Requests: the table of contents that are wanted and not merged, and the order in which they are loaded. Update thread.

pub(super) mod entry;
pub(super) mod fairness;
pub(super) mod forced;
mod list_changes;
pub(super) mod retry_policy;
pub(super) mod scheduler;
pub(super) mod state;
pub(super) mod table;
mod waiting;
