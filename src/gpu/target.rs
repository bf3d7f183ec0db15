//! What is drawn into: textures of our own, or the images of a window. Draw thread only.

use super::surface::{Health, Next, SurfaceAnswer};
use super::{ContextTraits, GpuError, watched};

/// Colour format of offscreen targets.
pub(super) const OFFSCREEN_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
/// Depth format of every target; reversed-Z needs a float's precision near 0.
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Outcome of asking for the frame's image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acquired {
    /// There is an image to draw into.
    Ready,
    /// The window shows nothing now (hidden, or its image is late): skip the frame.
    Skip,
}

enum Color {
    Offscreen {
        texture: wgpu::Texture,
        view: wgpu::TextureView,
    },
    Window {
        /// Stands before the surface, so that it is dropped first: wgpu panics where a surface goes while an image of it
        /// is held.
        frame: Option<Frame>,
        /// `None` while it was lost and could not be made anew.
        surface: Option<wgpu::Surface<'static>>,
        config: wgpu::SurfaceConfiguration,
    },
    /// Its device is lost.
    Closed,
}

struct Frame {
    view: wgpu::TextureView,
    image: wgpu::SurfaceTexture,
}

/// Colour of a context; depth is the renderer's.
pub(super) struct Target {
    color: Color,
    size_px: [u32; 2],
    /// Of a window's surface.
    health: Health,
}

fn extent(size_px: [u32; 2]) -> wgpu::Extent3d {
    wgpu::Extent3d { width: size_px[0], height: size_px[1], depth_or_array_layers: 1 }
}

fn check_size(device: &wgpu::Device, size_px: [u32; 2]) -> Result<(), GpuError> {
    let limit = device.limits().max_texture_dimension_2d;
    let [width, height] = size_px;
    if width == 0 || height == 0 || width > limit || height > limit {
        return Err(GpuError::TargetSize { width, height, limit });
    }
    Ok(())
}

fn offscreen_color(device: &wgpu::Device, size_px: [u32; 2]) -> Color {
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("colour"),
        size: extent(size_px),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: OFFSCREEN_FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT
            | wgpu::TextureUsages::COPY_SRC
            | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
    Color::Offscreen { texture, view }
}

/// Every platform has Fifo; what has no mode without waiting waits.
fn present_mode(vsync: bool) -> wgpu::PresentMode {
    if vsync { wgpu::PresentMode::Fifo } else { wgpu::PresentMode::AutoNoVsync }
}

/// Configures a surface; one that cannot be, as where its window is gone, is dropped: wgpu panics where a surface that is
/// not configured is asked for an image.
fn configure_or_drop(
    device: &wgpu::Device,
    surface: &mut Option<wgpu::Surface<'static>>,
    config: &wgpu::SurfaceConfiguration,
) {
    let Some(of) = surface else { return };
    if let ((), Some(error)) = watched(device, || of.configure(device, config)) {
        log::warn!("a surface cannot be configured anew: {error}");
        *surface = None;
    }
}

impl Target {
    /// A window's where there is a surface, offscreen otherwise.
    pub(super) fn new(
        adapter: &wgpu::Adapter,
        device: &wgpu::Device,
        surface: Option<wgpu::Surface<'static>>,
        traits: &ContextTraits,
    ) -> Result<Self, GpuError> {
        match surface {
            Some(surface) => Self::window(adapter, device, surface, traits.size_px, traits.vsync),
            None => Self::offscreen(device, traits.size_px),
        }
    }

    fn offscreen(device: &wgpu::Device, size_px: [u32; 2]) -> Result<Self, GpuError> {
        check_size(device, size_px)?;
        Ok(Self { color: offscreen_color(device, size_px), size_px, health: Health::default() })
    }

    fn window(
        adapter: &wgpu::Adapter,
        device: &wgpu::Device,
        surface: wgpu::Surface<'static>,
        size_px: [u32; 2],
        vsync: bool,
    ) -> Result<Self, GpuError> {
        check_size(device, size_px)?;
        let capabilities = surface.get_capabilities(adapter);
        let format = capabilities
            .formats
            .iter()
            .find(|f| f.is_srgb())
            .or(capabilities.formats.first())
            .copied()
            .ok_or_else(|| GpuError::Surface { reason: "the adapter cannot present to it".into() })?;
        // Reading back a window's image needs its images to be copyable; not every platform allows it.
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | (wgpu::TextureUsages::COPY_SRC & capabilities.usages);
        let config = wgpu::SurfaceConfiguration {
            usage,
            format,
            color_space: wgpu::SurfaceColorSpace::Auto,
            width: size_px[0],
            height: size_px[1],
            present_mode: present_mode(vsync),
            desired_maximum_frame_latency: 2,
            alpha_mode: wgpu::CompositeAlphaMode::Auto,
            view_formats: Vec::new(),
        };
        surface.configure(device, &config);
        let color = Color::Window { surface: Some(surface), config, frame: None };
        Ok(Self { color, size_px, health: Health::default() })
    }

    pub(super) fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// Frees what it has of its device, and of its window, for another to come.
    pub(super) fn close(&mut self) {
        self.color = Color::Closed;
    }

    /// Waits for the screen, or not; nothing offscreen.
    pub(super) fn set_vsync(&mut self, device: &wgpu::Device, vsync: bool) {
        if let Color::Window { surface, config, frame } = &mut self.color
            && config.present_mode != present_mode(vsync)
        {
            *frame = None;
            config.present_mode = present_mode(vsync);
            configure_or_drop(device, surface, config);
        }
    }

    pub(super) fn format(&self) -> wgpu::TextureFormat {
        match &self.color {
            Color::Offscreen { .. } | Color::Closed => OFFSCREEN_FORMAT,
            Color::Window { config, .. } => config.format,
        }
    }

    pub(super) fn resize(&mut self, device: &wgpu::Device, size_px: [u32; 2]) -> Result<(), GpuError> {
        if size_px == self.size_px {
            return Ok(());
        }
        check_size(device, size_px)?;
        match &mut self.color {
            Color::Offscreen { .. } => self.color = offscreen_color(device, size_px),
            Color::Window { surface, config, frame } => {
                *frame = None;
                [config.width, config.height] = size_px;
                self.health.resized();
                configure_or_drop(device, surface, config);
            }
            Color::Closed => {}
        }
        self.size_px = size_px;
        Ok(())
    }

    /// Gets the window's next image unless one is held already; an offscreen target always has one. `remake` makes the
    /// window's surface once more.
    pub(super) fn acquire(
        &mut self,
        device: &wgpu::Device,
        remake: impl Fn() -> Result<wgpu::Surface<'static>, GpuError>,
    ) -> Result<Acquired, GpuError> {
        let health = &mut self.health;
        let Color::Window { surface, config, frame } = &mut self.color else { return Ok(Acquired::Ready) };
        if frame.is_some() {
            return Ok(Acquired::Ready);
        }
        if health.wants_configure() {
            configure_or_drop(device, surface, config);
        }
        // What fails twice is for the next frame.
        for is_again in [false, true] {
            let (answer, image) = match (health.pretended.pop_front(), &*surface) {
                (Some(answer @ (SurfaceAnswer::Optimal | SurfaceAnswer::Suboptimal)), Some(surface)) => {
                    (answer, SurfaceAnswer::split(surface.get_current_texture()).1)
                }
                (Some(answer), _) => (answer, None),
                (None, Some(surface)) => SurfaceAnswer::split(surface.get_current_texture()),
                (None, None) => (SurfaceAnswer::Lost, None),
            };
            match health.next(answer, is_again)? {
                Next::Draw => {
                    let Some(image) = image else { return Ok(Acquired::Skip) };
                    let view = image.texture.create_view(&wgpu::TextureViewDescriptor::default());
                    *frame = Some(Frame { image, view });
                    return Ok(Acquired::Ready);
                }
                Next::Skip => return Ok(Acquired::Skip),
                Next::Configure => configure_or_drop(device, surface, config),
                Next::Remake => {
                    log::warn!("the surface of a window is lost; another takes its place");
                    if !cfg!(target_vendor = "apple") {
                        // A window has one surface at a time. Apple's are made on the main thread alone.
                        *surface = None;
                        match remake() {
                            Ok(made) => *surface = Some(made),
                            Err(error) => log::warn!("{error}"),
                        }
                    }
                    configure_or_drop(device, surface, config);
                }
            }
        }
        Ok(Acquired::Skip)
    }

    /// What a window's surface answers next, instead of being asked.
    #[cfg(feature = "testing")]
    pub(super) fn pretend(&mut self, answers: &[SurfaceAnswer]) {
        if matches!(self.color, Color::Window { .. }) {
            self.health.pretended.extend(answers);
        }
    }

    pub(super) fn color_view(&self) -> Option<&wgpu::TextureView> {
        match &self.color {
            Color::Offscreen { view, .. } => Some(view),
            Color::Window { frame, .. } => frame.as_ref().map(|f| &f.view),
            Color::Closed => None,
        }
    }

    pub(super) fn color_texture(&self) -> Option<&wgpu::Texture> {
        match &self.color {
            Color::Offscreen { texture, .. } => Some(texture),
            Color::Window { frame, .. } => frame.as_ref().map(|f| &f.image.texture),
            Color::Closed => None,
        }
    }

    pub(super) fn present(&mut self, queue: &wgpu::Queue) {
        if let Color::Window { frame, .. } = &mut self.color
            && let Some(frame) = frame.take()
        {
            queue.present(frame.image);
        }
    }
}
