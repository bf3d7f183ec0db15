//! [`MetadataBudget`]: the bytes of metadata of one file or page. Small files can ask for much: each tile has the defaults of its
//! class, and rows of a table may be the same long array. Decode threads.

use std::sync::Arc;

use crate::scene::Metadata;

/// The maximum bytes of metadata of the tiles of a file or page.
const MAX_BYTES: usize = 128 << 20;

/// Counts metadata that is kept.
#[derive(Debug)]
pub(in crate::formats) struct MetadataBudget {
    left: usize,
}

impl Default for MetadataBudget {
    fn default() -> Self {
        Self { left: MAX_BYTES }
    }
}

impl MetadataBudget {
    /// Returns the metadata if there is room for it; otherwise `note` gets the reason.
    pub fn keep(&mut self, metadata: Arc<Metadata>, note: &dyn Fn(&'static str)) -> Option<Arc<Metadata>> {
        match self.left.checked_sub(metadata.size_bytes()) {
            Some(left) => {
                self.left = left;
                Some(metadata)
            }
            None => {
                note("metadata beyond 128 MiB of one file or page");
                None
            }
        }
    }
}
