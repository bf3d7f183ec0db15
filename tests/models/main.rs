//! Models of threads under shuttle: the library's own files with shuttle's locks, threads and channels, in schedules
//! that switch threads at every step.
//!
//! Files of the library are included by path. Their imports `crate::...` are the modules of this file: types of the
//! library that are only passed on, and stand-ins that check the hand-over otherwise.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
#![allow(
    dead_code,
    unused_imports,
    unreachable_pub,
    missing_docs,
    reason = "the library's files, of which each test uses a part"
)]

mod budget_models;
mod compile_models;
#[cfg(feature = "http")]
mod pager_models;
mod schedules;
mod stage_models;
mod stand_ins;
mod sync;
mod sync_models;
mod viewer;

use stand_ins::{cull, draw, gpu, pager};

mod scene {
    pub use terrane::scene::{
        BlockFormats, CameraTarget, ClampProjection, ComputeNearFar, DrawKind, DrawSlot, Drawable, Environment, Mesh,
    };

    pub use crate::stand_ins::Scene;
}

mod state {
    pub use terrane::state::{DataVariance, OpaqueDrawData, StateSet};
}

mod trace {
    pub use terrane::trace::{span, ticket_source};
}

#[cfg(feature = "http")]
mod fetch {
    pub use terrane::fetch::{HttpClient, IoError, is_remote};

    pub fn server(uri: &str) -> &str {
        let end = uri.match_indices('/').nth(2).map_or(uri.len(), |(end, _)| end);
        &uri[..end]
    }
}
