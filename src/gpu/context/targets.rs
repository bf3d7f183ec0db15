//! [`Targets`]: the render targets of a device, one per context that shares it. Draw thread, which draws into one after the
//! other. Targets are opened and closed while it rests.

use std::sync::Arc;

use super::open_device::OpenDevice;
use super::render_target::{Acquired, DEPTH_FORMAT, RenderTarget, drawn_format};
use super::traits::ContextTraits;
use crate::gpu::GpuError;
use crate::gpu::pools::{MAX_COLOR_ATTACHMENTS, TargetFormats};

/// Creates the surface of a window, again on another instance after a device loss.
pub(super) type SurfaceFactory = Arc<dyn Fn(&wgpu::Instance) -> Result<wgpu::Surface<'static>, GpuError> + Send + Sync>;

/// Returns the factory of a window's surfaces. It keeps the window.
pub(super) fn surface_factory(
    window: impl Into<wgpu::SurfaceTarget<'static>> + Clone + Send + Sync + 'static,
) -> SurfaceFactory {
    Arc::new(move |instance: &wgpu::Instance| {
        instance.create_surface(window.clone()).map_err(|e| GpuError::Surface { reason: e.to_string() })
    })
}

/// The order to open a target: an offscreen one without a factory.
pub(super) type TargetRequest = (ContextTraits, Option<SurfaceFactory>);

/// A render target, with all that is needed to open it again.
pub(super) struct ContextTarget {
    target: RenderTarget,
    traits: ContextTraits,
    /// Samples per pixel.
    samples: u32,
    /// `None` for offscreen targets.
    create_surface: Option<SurfaceFactory>,
}

impl ContextTarget {
    /// Opens a target on a device, in a surface of the device's instance if it is a window's.
    pub(super) fn open(
        gpu: &OpenDevice,
        (traits, create_surface): TargetRequest,
        surface: Option<wgpu::Surface<'static>>,
    ) -> Result<Self, GpuError> {
        let target = RenderTarget::new(&gpu.adapter, &gpu.device, surface, &traits)?;
        let has_stencil = gpu.device.features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8);
        let stencil = has_stencil.then_some(wgpu::TextureFormat::Depth32FloatStencil8);
        // Views may be drawn as light in half floats.
        let formats = [drawn_format(target.format()), wgpu::TextureFormat::Rgba16Float, DEPTH_FORMAT];
        let samples = gpu.samples(traits.samples, formats.into_iter().chain(stencil));
        Ok(Self { target, traits, samples, create_surface })
    }

    pub(super) fn target(&self) -> &RenderTarget {
        &self.target
    }

    pub(super) fn target_mut(&mut self) -> &mut RenderTarget {
        &mut self.target
    }

    /// Returns the screen and the position on it.
    pub(super) fn place(&self) -> (u32, [i32; 2]) {
        (self.traits.screen, self.traits.position_px)
    }

    pub(super) fn samples(&self) -> u32 {
        self.samples
    }

    /// Returns the formats for the pipelines of images drawn into this target.
    pub(super) fn formats(&self) -> TargetFormats {
        let mut colors = [None; MAX_COLOR_ATTACHMENTS];
        colors[0] = Some(drawn_format(self.target.format()));
        TargetFormats { colors, depth: DEPTH_FORMAT, samples: self.samples, keeps_alpha: false }
    }

    pub(super) fn set_vsync(&mut self, device: &wgpu::Device, vsync: bool) {
        self.traits.vsync = vsync;
        self.target.set_vsync(device, vsync);
    }

    /// Gets the image that the next frame is drawn into. Creates a lost surface again.
    pub(super) fn acquire(&mut self, gpu: &OpenDevice) -> Result<Acquired, GpuError> {
        let Self { target, create_surface, .. } = self;
        let recreate = || match &*create_surface {
            Some(create) => {
                create(&gpu.instance).and_then(|surface| match gpu.adapter.is_surface_supported(&surface) {
                    true => Ok(surface),
                    false => Err(GpuError::Surface { reason: "the adapter cannot show anything in it".to_owned() }),
                })
            }
            None => Err(GpuError::Surface { reason: "there is no window".to_owned() }),
        };
        target.acquire(&gpu.device, recreate)
    }
}

/// The targets of a device in the order opened; never empty.
pub(super) struct Targets {
    all: Vec<ContextTarget>,
    /// Index of the target that is drawn into.
    selected: usize,
}

impl Targets {
    /// Takes the first targets of a device, of which there must be one.
    pub(super) fn new(all: Vec<ContextTarget>) -> Self {
        debug_assert!(!all.is_empty(), "a device without targets");
        Self { all, selected: 0 }
    }

    pub(super) fn iter(&self) -> std::slice::Iter<'_, ContextTarget> {
        self.all.iter()
    }

    pub(super) fn push(&mut self, target: ContextTarget) {
        self.all.push(target);
    }

    /// Closes a target unless it is the last one. Those after it move up, and the first one is selected.
    pub(super) fn remove(&mut self, index: usize) {
        if self.all.len() > 1 && index < self.all.len() {
            self.all.remove(index);
            self.selected = 0;
        }
    }

    pub(super) fn select(&mut self, index: usize) {
        debug_assert!(index < self.all.len(), "there is no target {index}");
        self.selected = index.min(self.all.len() - 1);
    }

    pub(super) fn count(&self) -> usize {
        self.all.len()
    }

    pub(super) fn selected_index(&self) -> usize {
        self.selected
    }

    /// Returns the target that was added last.
    pub(super) fn last(&self) -> &ContextTarget {
        &self.all[self.all.len() - 1]
    }

    pub(super) fn selected(&self) -> &ContextTarget {
        &self.all[self.selected]
    }

    pub(super) fn selected_mut(&mut self) -> &mut ContextTarget {
        &mut self.all[self.selected]
    }

    /// Closes all targets of a lost device, and returns the requests to open them on another. Their windows are free then, as
    /// a window has one surface at a time.
    pub(super) fn close_all(&mut self) -> Vec<TargetRequest> {
        let close = |target: &mut ContextTarget| {
            let traits = ContextTraits { size_px: target.target.size_px(), ..target.traits };
            target.target.close();
            (traits, target.create_surface.clone())
        };
        self.all.iter_mut().map(close).collect()
    }
}
