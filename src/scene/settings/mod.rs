//! Settings that the application gives cameras and frames: culling, levels of detail, light and air. Plain values.

mod cull_settings;
mod environment;
mod lod_ranges;
mod sun_shadows;
mod tone_mapping;

pub use cull_settings::{ComputeNearFar, CullSettings, CullingMode, Inherit, SMALL_FEATURE_PX};
pub use environment::{CameraEnvironment, CameraShadows, DistanceFog, Environment, Sky, Water};
pub use sun_shadows::{MAX_CASCADES, ShadowError, SunShadows};
pub use tone_mapping::ToneMapping;

pub(crate) use lod_ranges::{LodRanges, LodRecord, MORPH_START, has_parallel_rays, px_per_radian};
