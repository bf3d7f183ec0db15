//! Jobs that walk a whole tile set: summary, verification, filling the cache. Blocking; for tools, not for frames.

#[cfg(feature = "http")]
mod fill;
mod info;
mod metadata;
mod model;
mod overlay;
mod region;
mod report;
mod terrain;
mod tree;
mod verify;

#[cfg(feature = "http")]
pub use fill::{FillOptions, Filled, fill};
#[cfg(feature = "http")]
pub use info::inspect_with;
pub use info::{BoundsInfo, Info, LevelInfo, inspect};
pub use metadata::MetadataInfo;
pub use model::ModelInfo;
pub(super) use region::{is_on_earth, overlaps};
pub use report::InfoError;
pub(super) use tree::{load, read_companions};
#[cfg(feature = "http")]
pub use verify::verify_with;
pub use verify::{Verified, verify};
