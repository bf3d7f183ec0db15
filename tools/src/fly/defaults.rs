//! Defaults of options that depend on the source or the adapter.

/// Default number of frames of a flight.
pub const DEFAULT_FRAMES: u32 = 300;
/// Default number of frames on a software driver, which takes about 30 ms per frame.
pub const DEFAULT_SOFTWARE_FRAMES: u32 = 100;
/// Default screen-space error of height tiles in pixels. Their error is that of heights only: at CesiumJS's 16 pixels,
/// ridges visibly change shape as they morph. At 3 the image hardly changes, with about four times the triangles.
pub const HEIGHT_SSE_PX: f64 = 3.0;
/// Default screen-space error of all other sets in pixels, that of CesiumJS.
pub const MESH_SSE_PX: f64 = 16.0;
