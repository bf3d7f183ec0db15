//! [`OpenDevice`]: an instance, an adapter and its device, and how they are chosen. Runs on the thread that opens the
//! context.

use super::host_device::HostDevice;
use super::traits::{AdapterChoice, ContextTraits};
use crate::gpu::GpuError;

/// A device with the objects that it was created from.
pub(super) struct OpenDevice {
    pub(super) instance: wgpu::Instance,
    pub(super) adapter: wgpu::Adapter,
    pub(super) adapter_info: wgpu::AdapterInfo,
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    /// True if the device is the application's, which alone can replace it.
    pub(super) is_host_device: bool,
}

/// Creates an instance of the backends that the traits allow.
pub(super) fn create_instance(traits: &ContextTraits) -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = match traits.adapter {
        AdapterChoice::Noop => wgpu::Backends::NOOP,
        AdapterChoice::Any | AdapterChoice::Software => wgpu::Backends::all() & !wgpu::Backends::NOOP,
    };
    descriptor.backend_options.noop.enable = traits.adapter == AdapterChoice::Noop;
    descriptor.flags = if traits.validation { wgpu::InstanceFlags::debugging() } else { wgpu::InstanceFlags::empty() };
    wgpu::Instance::new(descriptor)
}

/// Returns the rank of an adapter, the best one's first: GPUs before software, native interfaces before OpenGL.
fn rank(info: &wgpu::AdapterInfo) -> (u32, u32) {
    let device = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    (device, u32::from(info.backend == wgpu::Backend::Gl))
}

/// Returns the best adapter that the traits allow and that supports all surfaces.
fn choose_adapter(
    instance: &wgpu::Instance,
    traits: &ContextTraits,
    surfaces: &[Option<wgpu::Surface<'static>>],
) -> Result<wgpu::Adapter, GpuError> {
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let found = adapters.len();
    adapters.retain(|adapter| {
        let is_cpu = adapter.get_info().device_type == wgpu::DeviceType::Cpu;
        surfaces.iter().flatten().all(|surface| adapter.is_surface_supported(surface))
            && (traits.adapter != AdapterChoice::Software || is_cpu)
    });
    adapters.sort_by_key(|adapter| rank(&adapter.get_info()));
    adapters.into_iter().next().ok_or_else(|| {
        let reason = format!("none of {found} found fits {:?}", traits.adapter);
        GpuError::NoAdapter { reason }
    })
}

/// Returns the supported number of samples for a wanted one: the least that is not smaller, or else the largest.
fn choose_samples(wanted: u32, is_supported: impl Fn(u32) -> bool) -> u32 {
    match wanted {
        0 | 1 => 1,
        // WebGPU guarantees 4, so that the adapter is not asked.
        3 | 4 => 4,
        _ => {
            let supported = || [2, 4, 8, 16].into_iter().filter(|count| *count == 4 || is_supported(*count));
            supported().find(|count| *count >= wanted).or_else(|| supported().last()).unwrap_or(4)
        }
    }
}

impl OpenDevice {
    /// Chooses an adapter and creates its device, with all optional features and limits that the adapter has.
    pub(super) fn request(
        instance: wgpu::Instance,
        traits: &ContextTraits,
        surfaces: &[Option<wgpu::Surface<'static>>],
    ) -> Result<Self, GpuError> {
        let adapter = choose_adapter(&instance, traits, surfaces)?;
        let adapter_info = adapter.get_info();
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("terrane"),
            required_features: HostDevice::features(&adapter),
            required_limits: adapter.limits(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        }))
        .map_err(|e| GpuError::NoDevice { adapter: adapter_info.name.clone(), reason: e.to_string() })?;
        Ok(Self { instance, adapter, adapter_info, device, queue, is_host_device: false })
    }

    /// Returns the samples a pixel of a target for a wanted number, see [`choose_samples`]. `formats` are those of all its
    /// attachments.
    pub(super) fn samples(&self, wanted: u32, formats: impl Iterator<Item = wgpu::TextureFormat> + Clone) -> u32 {
        let features = self.device.features();
        let flags = |format: wgpu::TextureFormat| match features
            .contains(wgpu::Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES)
        {
            true => self.adapter.get_texture_format_features(format).flags,
            false => format.guaranteed_format_features(features).flags,
        };
        choose_samples(wanted, |count| formats.clone().all(|format| flags(format).sample_count_supported(count)))
    }

    /// Takes a device of the application. Returns an error if its limits are too small.
    pub(super) fn from_host(host: HostDevice) -> Result<Self, GpuError> {
        host.check()?;
        let HostDevice { instance, adapter, device, queue } = host;
        let adapter_info = adapter.get_info();
        Ok(Self { instance, adapter, adapter_info, device, queue, is_host_device: true })
    }

    /// Returns the name of the adapter and of the interface it is driven through.
    pub(super) fn adapter_name(&self) -> String {
        format!("{} ({:?})", self.adapter_info.name, self.adapter_info.backend)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_the_next_supported_number() {
        let of =
            |supported: &[u32]| [0, 1, 2, 3, 4, 5, 8, 16, 64].map(|n| choose_samples(n, |c| supported.contains(&c)));
        assert_eq!(of(&[]), [1, 1, 4, 4, 4, 4, 4, 4, 4]);
        assert_eq!(of(&[2, 8]), [1, 1, 2, 4, 4, 8, 8, 8, 8]);
        assert_eq!(of(&[2, 4, 8, 16]), [1, 1, 2, 4, 4, 8, 8, 16, 16]);
    }
}
