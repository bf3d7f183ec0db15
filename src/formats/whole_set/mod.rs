//! Jobs that walk a whole tile set: summary, verification with measures, filling the cache. Blocking; for tools, not for frames.

#[cfg(feature = "http")]
mod fill;
mod info;
mod inspect;
mod measure;
mod metadata;
mod model;
mod overlay;
mod region;
mod report;
mod survey;
mod terrain;
mod tree;
mod verified;

#[cfg(feature = "http")]
pub use fill::{FillOptions, Filled, fill};
pub use info::{BoundsInfo, Info, LevelInfo};
pub use inspect::inspect;
#[cfg(feature = "http")]
pub use inspect::{inspect_root_with, inspect_with};
pub use measure::{LevelMeasures, MapFrame, Problem, Spread, SurveyedTile};
pub use metadata::MetadataInfo;
pub use model::ModelInfo;
pub(super) use region::{is_on_body, overlaps};
pub use report::InfoError;
pub(super) use report::too_many;
#[cfg(feature = "http")]
pub use survey::verify_with;
pub use survey::{SurveyOptions, survey, verify};
pub(super) use tree::{load, read_companions};
pub use verified::{SurveyEvent, Verified};
