//! [`OpenDevice`]: an instance, an adapter and its device, and how they are chosen. Runs on the thread that opens the
//! context.

use super::host_device::{HostDevice, too_small};
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

/// Creates an instance of the backends that the traits allow. Without windows it has OpenGL only where an adapter may need it:
/// its libraries take time to load, and complain on standard error about a display that is not there.
pub(super) fn create_instance(traits: &ContextTraits, has_windows: bool) -> wgpu::Instance {
    let all = match traits.adapter {
        AdapterChoice::Noop => return instance_of(wgpu::Backends::NOOP, traits),
        AdapterChoice::Any | AdapterChoice::Software => wgpu::Backends::all() & !wgpu::Backends::NOOP,
    };
    if !has_windows {
        let native = instance_of(all & !wgpu::Backends::GL, traits);
        let adapters = pollster::block_on(native.enumerate_adapters(wgpu::Backends::all()));
        let is_headless = cfg!(target_os = "linux") && std::env::var_os("XDG_RUNTIME_DIR").is_none();
        let suffices = |adapter: &wgpu::Adapter| match adapter.get_info().device_type {
            // OpenGL may reach a GPU that has no driver for the others.
            wgpu::DeviceType::Cpu => is_headless || traits.adapter == AdapterChoice::Software,
            _ => traits.adapter == AdapterChoice::Any,
        };
        if adapters.iter().any(suffices) {
            return native;
        }
    }
    instance_of(all, traits)
}

fn instance_of(backends: wgpu::Backends, traits: &ContextTraits) -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = backends;
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

/// The abilities that frames need and that not every adapter has.
const REQUIRED: wgpu::DownlevelFlags = wgpu::DownlevelFlags::VERTEX_STORAGE
    .union(wgpu::DownlevelFlags::FRAGMENT_STORAGE)
    .union(wgpu::DownlevelFlags::COMPUTE_SHADERS)
    .union(wgpu::DownlevelFlags::BASE_VERTEX)
    .union(wgpu::DownlevelFlags::COMPARISON_SAMPLERS)
    .union(wgpu::DownlevelFlags::INDEPENDENT_BLEND)
    .union(wgpu::DownlevelFlags::FULL_DRAW_INDEX_UINT32);

/// Returns what an adapter lacks without which frames would be wrong; `None` if it lacks nothing.
fn lacks(flags: wgpu::DownlevelFlags, limits: &wgpu::Limits) -> Option<String> {
    let missing = (REQUIRED - flags).iter_names().map(|(name, _)| format!("it lacks {name}"));
    let missing: Vec<String> = missing.chain(too_small(limits)).collect();
    (!missing.is_empty()).then(|| missing.join(", "))
}

/// Returns the adapters that the traits allow and that support all surfaces, the best first.
fn candidates(
    instance: &wgpu::Instance,
    traits: &ContextTraits,
    surfaces: &[Option<wgpu::Surface<'static>>],
) -> Result<Vec<wgpu::Adapter>, GpuError> {
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let found = adapters.len();
    adapters.retain(|adapter| {
        let is_cpu = adapter.get_info().device_type == wgpu::DeviceType::Cpu;
        surfaces.iter().flatten().all(|surface| adapter.is_surface_supported(surface))
            && (traits.adapter != AdapterChoice::Software || is_cpu)
    });
    adapters.sort_by_key(|adapter| rank(&adapter.get_info()));
    if adapters.is_empty() {
        let reason = match found {
            0 => {
                "no driver was found; on Linux install a Vulkan driver, such as Mesa's (mesa-vulkan-drivers)".to_owned()
            }
            _ => format!("none of {found} found fits {:?} and the windows", traits.adapter),
        };
        return Err(GpuError::NoAdapter { reason });
    }
    Ok(adapters)
}

/// Returns the first that opens. If none does, the error has all their names, and the reason of each.
fn first_that_opens<A, T>(
    adapters: impl IntoIterator<Item = A>,
    name: impl Fn(&A) -> String,
    open: impl Fn(A) -> Result<T, String>,
) -> Result<T, GpuError> {
    let mut refused: Vec<(String, String)> = Vec::new();
    for adapter in adapters {
        let name = name(&adapter);
        match open(adapter) {
            Ok(opened) => return Ok(opened),
            Err(reason) => {
                log::warn!("adapter {name} is not used: {reason}");
                refused.push((name, reason));
            }
        }
    }
    let reason = match &refused[..] {
        [(_, reason)] => reason.clone(),
        all => all.iter().map(|(name, reason)| format!("{name}: {reason}")).collect::<Vec<_>>().join("; "),
    };
    let names: Vec<String> = refused.into_iter().map(|(name, _)| name).collect();
    Err(GpuError::NoDevice { adapter: names.join(" and "), reason })
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
    /// Creates the device of the best adapter that has what frames need, with all optional features and limits that it has. If
    /// its driver refuses, the next one is tried.
    pub(super) fn request(
        instance: wgpu::Instance,
        traits: &ContextTraits,
        surfaces: &[Option<wgpu::Surface<'static>>],
    ) -> Result<Self, GpuError> {
        let adapters = candidates(&instance, traits, surfaces)?;
        let name = |adapter: &wgpu::Adapter| adapter_name(&adapter.get_info());
        let (adapter, device, queue) = first_that_opens(adapters, name, |adapter| {
            // The backend that draws nothing claims no abilities.
            let is_noop = traits.adapter == AdapterChoice::Noop;
            let flags = adapter.get_downlevel_capabilities().flags;
            if let Some(lacks) = lacks(flags, &adapter.limits()).filter(|_| !is_noop) {
                return Err(lacks);
            }
            let descriptor = wgpu::DeviceDescriptor {
                label: Some("terrane"),
                required_features: HostDevice::features(&adapter),
                required_limits: adapter.limits(),
                memory_hints: wgpu::MemoryHints::Performance,
                ..Default::default()
            };
            let opened = pollster::block_on(adapter.request_device(&descriptor));
            let (device, queue) = opened.map_err(|e| e.to_string())?;
            Ok((adapter, device, queue))
        })?;
        let adapter_info = adapter.get_info();
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
        adapter_name(&self.adapter_info)
    }
}

fn adapter_name(info: &wgpu::AdapterInfo) -> String {
    format!("{} ({:?})", info.name, info.backend)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adapters_without_what_frames_need_are_named() {
        let limits = wgpu::Limits::default();
        assert_eq!(lacks(wgpu::DownlevelFlags::all(), &limits), None);
        let flags = wgpu::DownlevelFlags::all() - wgpu::DownlevelFlags::VERTEX_STORAGE;
        assert_eq!(lacks(flags, &limits).as_deref(), Some("it lacks VERTEX_STORAGE"));
        let small = lacks(wgpu::DownlevelFlags::all(), &wgpu::Limits { max_bind_groups: 1, ..limits }).unwrap();
        assert!(small.contains("max_bind_groups is 1 and must be 4"), "{small}");
    }

    /// Regression: only the first adapter by type was tried.
    #[test]
    fn next_adapter_is_tried_and_all_reasons_are_told() {
        let open = |works: &'static str| {
            move |name: &str| if name == works { Ok(name.len()) } else { Err("broken".to_owned()) }
        };
        let all = ["first", "second"];
        assert_eq!(first_that_opens(all, |a| (*a).to_owned(), open("second")).ok(), Some(6));
        let refused = first_that_opens(all, |a| (*a).to_owned(), open("none")).unwrap_err();
        let text = refused.to_string();
        assert!(text.contains("first and second") && text.contains("first: broken; second: broken"), "{text}");
        let refused = first_that_opens(["only"], |a| (*a).to_owned(), open("none")).unwrap_err();
        assert_eq!(refused.to_string(), "adapter only made no device: broken");
    }

    #[test]
    fn samples_are_the_next_supported_number() {
        let of =
            |supported: &[u32]| [0, 1, 2, 3, 4, 5, 8, 16, 64].map(|n| choose_samples(n, |c| supported.contains(&c)));
        assert_eq!(of(&[]), [1, 1, 4, 4, 4, 4, 4, 4, 4]);
        assert_eq!(of(&[2, 8]), [1, 1, 2, 4, 4, 8, 8, 8, 8]);
        assert_eq!(of(&[2, 4, 8, 16]), [1, 1, 2, 4, 4, 8, 8, 16, 16]);
    }
}
