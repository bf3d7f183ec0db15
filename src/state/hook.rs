//! [`OpaqueDrawData`]: a callback of the draw phase, carried by scenes and state sets, which know nothing of drawing.

use std::sync::Arc;

/// An opaque value for the draw phase, which creates and reads it. Compared by identity.
#[derive(Clone)]
pub struct OpaqueDrawData(pub Arc<dyn std::any::Any + Send + Sync>);

impl PartialEq for OpaqueDrawData {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl std::fmt::Debug for OpaqueDrawData {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("OpaqueDrawData")
    }
}
