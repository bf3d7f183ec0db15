//! [`GraphicsContext`]: a device with its queue, its render targets, its pools and its uploads. Owned by the draw thread.

mod adapter_clock;
mod device_status;
mod frame_timer;
mod graphics_context;
mod host_device;
mod open_device;
mod pipeline_cache;
mod read_back;
mod render_target;
mod surface_health;
mod targets;
mod traits;
mod transient_attachments;

pub(crate) use frame_timer::FrameTimer;
pub use graphics_context::GraphicsContext;
pub use host_device::HostDevice;
pub use render_target::Acquired;
pub(crate) use render_target::{DEPTH_FORMAT, is_encoded_by_shader};
#[cfg(feature = "testing")]
pub use surface_health::SurfaceAnswer;
pub use traits::{AdapterChoice, ContextTraits};
pub(crate) use transient_attachments::TransientAttachments;
