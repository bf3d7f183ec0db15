//! [`DrawHook`]: what the draw phase calls back, carried by scenes and state sets that know nothing of drawing.

use std::sync::Arc;

/// Something for the draw phase that is only carried: made by and given back to `draw`. Equal where it is the same one.
#[derive(Clone)]
pub struct DrawHook(pub Arc<dyn std::any::Any + Send + Sync>);

impl PartialEq for DrawHook {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl std::fmt::Debug for DrawHook {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("DrawHook")
    }
}
