//! [`HostDevice`]: a device that the application made and draws with too. Runs on the thread that opens the context.

use crate::gpu::GpuError;

/// The features that are used if the adapter has them.
const OPTIONAL_FEATURES: wgpu::Features = wgpu::Features::TIMESTAMP_QUERY
    .union(wgpu::Features::POLYGON_MODE_LINE)
    .union(wgpu::Features::POLYGON_MODE_POINT)
    .union(wgpu::Features::DEPTH32FLOAT_STENCIL8)
    .union(wgpu::Features::FLOAT32_FILTERABLE)
    .union(wgpu::Features::DEPTH_CLIP_CONTROL)
    .union(wgpu::Features::PIPELINE_CACHE)
    .union(wgpu::Features::INDIRECT_FIRST_INSTANCE)
    .union(wgpu::Features::ADDRESS_MODE_CLAMP_TO_BORDER)
    .union(wgpu::Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES)
    .union(wgpu::Features::TEXTURE_COMPRESSION_BC)
    .union(wgpu::Features::TEXTURE_COMPRESSION_ETC2)
    .union(wgpu::Features::TEXTURE_COMPRESSION_ASTC);

/// The application's own device, for contexts that draw into textures on it. The application composes these textures with
/// what it draws itself, without a copy.
///
/// The handles are reference counted by wgpu; clones name the same device. The application keeps its error and lost-device
/// callbacks: Terrane sets none on this device, and does not replace it when it is lost.
///
/// Only the thread that owns the context may submit to the queue or write textures and buffers through it. In wgpu 30.0.1,
/// writing a texture while another thread submits may deadlock (issue 9460). A viewer on such a device therefore
/// draws on the thread that calls [`Viewer::frame`](crate::viewer::Viewer::frame).
#[derive(Clone, Debug)]
pub struct HostDevice {
    /// The instance that the adapter is from.
    pub instance: wgpu::Instance,
    /// The adapter that the device is from.
    pub adapter: wgpu::Adapter,
    /// The device; its limits must not be below [`wgpu::Limits::default`].
    pub device: wgpu::Device,
    /// The device's queue.
    pub queue: wgpu::Queue,
}

impl HostDevice {
    /// Returns the features of an adapter that Terrane uses. A device without some of them draws too:
    ///
    /// | without | effect |
    /// |---|---|
    /// | `DEPTH32FLOAT_STENCIL8` | there is no stencil |
    /// | `TIMESTAMP_QUERY` | there are no GPU times |
    /// | `POLYGON_MODE_LINE`, `POLYGON_MODE_POINT` | polygons are filled |
    /// | `TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES` | targets have 1 or 4 samples |
    /// | `ADDRESS_MODE_CLAMP_TO_BORDER` | borders of textures are emulated |
    /// | all of `TEXTURE_COMPRESSION_BC`, `_ETC2`, `_ASTC` | KTX2 images take four to eight times the memory |
    /// | others | frames take longer |
    pub fn features(adapter: &wgpu::Adapter) -> wgpu::Features {
        let features = adapter.features() & OPTIONAL_FEATURES;
        // The adapter that draws nothing offers its own usages of formats, and there are none.
        let usages = adapter.get_texture_format_features(wgpu::TextureFormat::Rgba8UnormSrgb).allowed_usages;
        let is_drawn_into = usages.contains(wgpu::TextureUsages::RENDER_ATTACHMENT);
        let of_formats = wgpu::Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES;
        if is_drawn_into { features } else { features.difference(of_formats) }
    }

    /// Fails if the limits of the device are too small.
    pub(super) fn check(&self) -> Result<(), GpuError> {
        let failed = too_small(&self.device.limits());
        if failed.is_empty() {
            return Ok(());
        }
        let reason = format!("the limits of the application's device are too small: {}", failed.join(", "));
        Err(GpuError::NoDevice { adapter: self.adapter.get_info().name, reason })
    }
}

/// Returns the limits that are below those that every device of WebGPU has, with both values.
pub(super) fn too_small(limits: &wgpu::Limits) -> Vec<String> {
    let mut failed = Vec::new();
    wgpu::Limits::default().check_limits_with_fail_fn(limits, false, |name, wanted, allowed| {
        failed.push(format!("{name} is {allowed} and must be {wanted}"));
    });
    failed
}
