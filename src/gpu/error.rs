//! [`GpuError`]: the reasons for which a call to the graphics adapter fails.

/// The reason for which a graphics call failed.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// No adapter matches the wanted choice. Tests may be skipped then.
    #[error("no graphics adapter: {reason}")]
    NoAdapter {
        /// The wanted choice and the number of adapters found.
        reason: String,
    },
    /// No adapter could be used: a driver refused to create a device, or an adapter lacks what frames need.
    #[error("adapter {adapter} made no device: {reason}")]
    NoDevice {
        /// Name of the adapter; of several, all names.
        adapter: String,
        /// The driver's message, or what the adapter lacks; of several, each with its name.
        reason: String,
    },
    /// The window cannot be drawn to.
    #[error("window surface: {reason}")]
    Surface {
        /// The cause of the failure.
        reason: String,
    },
    /// The images of a window or a texture have too few bits of alpha.
    #[error(
        "the target has at most {found} bits of alpha, and {wanted} are wanted; lower ContextTraits::min_alpha_bits"
    )]
    AlphaBits {
        /// The wanted bits.
        wanted: u32,
        /// The most bits that a format of the target has.
        found: u32,
    },
    /// A render target is larger than the adapter allows, or has no pixels.
    #[error("a target of {width}x{height} pixels is not possible (1 to {limit} a side)")]
    TargetSize {
        /// The wanted width.
        width: u32,
        /// The wanted height.
        height: u32,
        /// The longest side that the adapter allows.
        limit: u32,
    },
    /// The adapter lacks the memory for a buffer or a texture.
    #[error("out of graphics memory: {what} of {bytes} bytes cannot be made: {reason}")]
    OutOfMemory {
        /// The use of the buffer or texture.
        what: &'static str,
        /// Its size.
        bytes: u64,
        /// The driver's message.
        reason: String,
    },
    /// The mesh of a drawable could not be replaced.
    #[error("rewriting a mesh: {reason}")]
    Rewrite {
        /// The cause of the failure.
        reason: String,
    },
    /// The adapter's driver does not export compiled pipelines.
    #[error("adapter {adapter} cannot keep its pipelines")]
    NoPipelineCache {
        /// Name of the adapter.
        adapter: String,
    },
    /// The pipeline cache on disk was not usable or could not be written. Pipelines are compiled again.
    #[error("pipelines in {file}: {reason}", file = file.display())]
    PipelineCache {
        /// The file of the cache.
        file: std::path::PathBuf,
        /// The cause of the failure.
        reason: String,
    },
    /// The image of a target could not be read back.
    #[error("reading the image back: {reason}")]
    ReadBack {
        /// The cause of the failure.
        reason: String,
    },
    /// The compile thread could not be started.
    #[error("cannot start a compile thread: {reason}")]
    Thread {
        /// The system's message.
        reason: String,
    },
    /// The device is lost (driver reset, adapter unplugged). [`GraphicsContext::reopen`](super::GraphicsContext::reopen)
    /// opens another.
    #[error("graphics device lost: {reason}")]
    DeviceLost {
        /// The driver's message.
        reason: String,
    },
}
