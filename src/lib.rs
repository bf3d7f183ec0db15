//! Terrane: a paged large-terrain streaming engine on wgpu, with OpenSceneGraph's vocabulary.
//!
//! A frame is [`viewer::Viewer::frame`]: advance, event, update, rendering. Update alone changes the [`scene::Scene`]:
//! the [`pager::DatabasePager`] merges what was loaded and takes out what is not needed. Cull reads it:
//! [`cull::CullVisitor`] turns scene and camera into a [`cull::RenderStage`], leaves sorted into bins, and a list of
//! [`cull::PageRequest`]s for what is missing. [`draw::Renderer`] executes the stage on a [`gpu::GraphicsContext`]; in most
//! threading models a separate thread does that while the next frame is already being updated.
//!
//! To follow a tile from its URI to pixels, read [`fetch`] (bytes by URI), [`formats`] (bytes to [`scene::Page`]),
//! [`pager`], [`scene`], [`cull`], [`gpu`] and [`draw`] in this order. World positions are metres in `f64`, z up
//! (ECEF where a set is georeferenced); what reaches the GPU is `f32` relative to the eye.
//! An application starts with `use terrane::prelude::*`; see [`prelude`] and [`viewer::Viewer`].

pub mod cull;
pub mod draw;
pub mod fetch;
pub mod formats;
pub mod gpu;
pub mod math;
pub mod pager;
pub mod prelude;
pub mod scene;
pub mod state;
pub mod sync;
pub mod trace;
pub mod viewer;

// The crates whose types are in public signatures, so that an application uses the same versions.
#[cfg(feature = "window")]
pub use egui;
pub use {glam, image, wgpu};

/// The code of the README and of the guide, compiled by the documentation tests.
#[cfg(doctest)]
mod documents {
    #[doc = include_str!("../README.md")]
    mod readme {}
    #[doc = include_str!("../docs/guide/getting-started.md")]
    mod getting_started {}
    #[doc = include_str!("../docs/guide/tile-sets-and-sources.md")]
    mod tile_sets_and_sources {}
    #[doc = include_str!("../docs/guide/viewer-and-windows.md")]
    mod viewer_and_windows {}
    #[doc = include_str!("../docs/guide/3d-tiles.md")]
    mod tiles_3d {}
    #[doc = include_str!("../docs/guide/gltf.md")]
    mod gltf {}
    #[doc = include_str!("../docs/guide/paging-and-budgets.md")]
    mod paging_and_budgets {}
    #[doc = include_str!("../docs/guide/state-and-shading.md")]
    mod state_and_shading {}
    #[doc = include_str!("../docs/guide/overlays.md")]
    mod overlays {}
    #[doc = include_str!("../docs/guide/callbacks-and-picking.md")]
    mod callbacks_and_picking {}
}
