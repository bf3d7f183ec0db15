//! [`UploadProgress`]: the state of a device's uploads that does not depend on the thread that copies them. Draw thread.

use super::memory_shortage::MemoryShortage;
use super::operations::Operations;
use super::recorded_uploads::RecordedUploads;

/// Operations before and after their uploads, and the commands on their way to the adapter.
#[derive(Default)]
pub(super) struct UploadProgress {
    pub(super) operations: Operations,
    pub(super) recorded: RecordedUploads,
    pub(super) shortage: MemoryShortage,
}
