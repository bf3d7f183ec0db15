//! What can go wrong between us and the graphics adapter.

/// Why a graphics call failed.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// No adapter answers the wanted choice; a test may then be skipped.
    #[error("no graphics adapter: {reason}")]
    NoAdapter {
        /// What was asked for and found.
        reason: String,
    },
    /// The adapter refused to make a device.
    #[error("adapter {adapter} made no device: {reason}")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// What it said.
        reason: String,
    },
    /// The window cannot be drawn to.
    #[error("window surface: {reason}")]
    Surface {
        /// What was wrong.
        reason: String,
    },
    /// A target larger than the adapter allows, or without pixels.
    #[error("a target of {width}x{height} pixels is not possible (1 to {limit} a side)")]
    TargetSize {
        /// Wanted width.
        width: u32,
        /// Wanted height.
        height: u32,
        /// Largest side.
        limit: u32,
    },
    /// The adapter has no memory for what a drawable needs.
    #[error("out of graphics memory: {what} of {bytes} bytes cannot be made: {reason}")]
    OutOfMemory {
        /// What was to be made.
        what: &'static str,
        /// Its size.
        bytes: u64,
        /// What the driver said.
        reason: String,
    },
    /// A mesh could not take the place of another.
    #[error("rewriting a mesh: {reason}")]
    Rewrite {
        /// What was wrong.
        reason: String,
    },
    /// The adapter's driver gives away nothing that it compiled.
    #[error("adapter {adapter} cannot keep its pipelines")]
    NoPipelineCache {
        /// Name of the adapter.
        adapter: String,
    },
    /// Kept pipelines were not used, or could not be written; they are made anew.
    #[error("pipelines in {file}: {reason}", file = file.display())]
    PipelineCache {
        /// Where they are kept.
        file: std::path::PathBuf,
        /// What was wrong.
        reason: String,
    },
    /// The picture could not be read back.
    #[error("reading the picture back: {reason}")]
    ReadBack {
        /// What was wrong.
        reason: String,
    },
    /// The compile thread could not be started.
    #[error("cannot start a compile thread: {reason}")]
    Thread {
        /// What the system said.
        reason: String,
    },
    /// The device is gone (driver reset, unplugged); the context must be made anew.
    #[error("graphics device lost: {reason}")]
    DeviceLost {
        /// What the driver said.
        reason: String,
    },
}
