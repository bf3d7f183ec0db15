//! [`RenderTarget`]: the colour image that a context draws into, a texture or the images of a window. Draw thread.

use super::surface_health::{SurfaceAction, SurfaceAnswer, SurfaceHealth};
use super::traits::ContextTraits;
use crate::gpu::GpuError;
use crate::gpu::error_scope::catch_errors;

/// Colour format of offscreen targets.
const OFFSCREEN_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
/// Depth format of all targets. Reversed depth needs the precision of floats near 0.
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// The result of a request for the frame's image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acquired {
    /// An image is ready to be drawn into.
    Ready,
    /// The window has no image, since it is hidden or its image is late. The frame should be skipped.
    Skip,
}

enum Color {
    Offscreen {
        texture: wgpu::Texture,
        view: wgpu::TextureView,
    },
    Window {
        /// Dropped before the surface: wgpu panics if a surface is dropped while an image of it exists.
        frame: Option<SurfaceFrame>,
        /// `None` after a loss, until it can be created again.
        surface: Option<wgpu::Surface<'static>>,
        config: wgpu::SurfaceConfiguration,
    },
    /// The device is lost.
    Closed,
}

/// An image of a window that is not presented yet.
struct SurfaceFrame {
    view: wgpu::TextureView,
    image: wgpu::SurfaceTexture,
}

/// The colour image of a context. The depth buffer belongs to the renderer.
pub(super) struct RenderTarget {
    color: Color,
    size_px: [u32; 2],
    /// The state of a window's surface.
    health: SurfaceHealth,
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

fn offscreen_color(device: &wgpu::Device, format: wgpu::TextureFormat, size_px: [u32; 2]) -> Color {
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("colour"),
        size: extent(size_px),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT
            | wgpu::TextureUsages::COPY_SRC
            | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
    Color::Offscreen { texture, view }
}

/// Returns the present mode. All platforms have Fifo; those without an unsynchronized mode wait all the same.
fn present_mode(vsync: bool) -> wgpu::PresentMode {
    if vsync { wgpu::PresentMode::Fifo } else { wgpu::PresentMode::AutoNoVsync }
}

/// Configures a surface. Drops it on failure, for example after its window was closed: wgpu panics if an image is requested
/// from a surface that is not configured.
fn configure_or_drop(
    device: &wgpu::Device,
    surface: &mut Option<wgpu::Surface<'static>>,
    config: &wgpu::SurfaceConfiguration,
) {
    let Some(configured) = surface else { return };
    if let ((), Some(error)) = catch_errors(device, || configured.configure(device, config)) {
        log::warn!("a window's surface cannot be configured: {error}");
        *surface = None;
    }
}

/// Returns the bits of alpha in a colour format.
fn alpha_bits(format: wgpu::TextureFormat) -> u32 {
    use wgpu::TextureFormat as F;
    match format {
        F::Rgba8Unorm | F::Rgba8UnormSrgb | F::Bgra8Unorm | F::Bgra8UnormSrgb => 8,
        F::Rgba16Float | F::Rgba16Unorm => 16,
        F::Rgb10a2Unorm => 2,
        _ => 0,
    }
}

/// Returns true if a format holds encoded colours and the adapter does not encode them.
pub(crate) fn is_encoded_by_shader(format: wgpu::TextureFormat) -> bool {
    use wgpu::TextureFormat as F;
    !format.is_srgb() && !matches!(format, F::Rgba16Float | F::Rgba32Float | F::Rg11b10Ufloat)
}

/// Returns the format in which frames for a target are drawn. It is the target's own format unless a shader must encode the
/// colours; then it is one whose image is encoded afterwards.
pub(super) fn drawn_format(format: wgpu::TextureFormat) -> wgpu::TextureFormat {
    use wgpu::TextureFormat as F;
    match format {
        F::Rgba8Unorm | F::Bgra8Unorm => F::Rgba8UnormSrgb,
        format if is_encoded_by_shader(format) => F::Rgba16Float,
        format => format,
    }
}

/// Fails if a format has too few bits of alpha.
fn enough_alpha(format: wgpu::TextureFormat, wanted: u32) -> Result<(), GpuError> {
    let found = alpha_bits(format);
    if found < wanted { Err(GpuError::AlphaBits { wanted, found }) } else { Ok(()) }
}

/// Returns the format of a window's images: the first sRGB format, or the first of all, that has enough bits of alpha.
fn window_format(formats: &[wgpu::TextureFormat], min_alpha_bits: u32) -> Result<wgpu::TextureFormat, GpuError> {
    let enough = || formats.iter().copied().filter(|format| alpha_bits(*format) >= min_alpha_bits);
    if let Some(format) = enough().find(|format| format.is_srgb()).or_else(|| enough().next()) {
        return Ok(format);
    }
    let Some(found) = formats.iter().copied().map(alpha_bits).max() else {
        return Err(GpuError::Surface { reason: "the adapter cannot present to it".into() });
    };
    Err(GpuError::AlphaBits { wanted: min_alpha_bits, found })
}

impl RenderTarget {
    /// Creates the target of a window, or an offscreen one if there is no surface.
    pub(super) fn new(
        adapter: &wgpu::Adapter,
        device: &wgpu::Device,
        surface: Option<wgpu::Surface<'static>>,
        traits: &ContextTraits,
    ) -> Result<Self, GpuError> {
        match surface {
            Some(surface) => Self::window(adapter, device, surface, traits),
            None => {
                enough_alpha(OFFSCREEN_FORMAT, traits.min_alpha_bits)?;
                Self::offscreen(device, traits.size_px)
            }
        }
    }

    fn offscreen(device: &wgpu::Device, size_px: [u32; 2]) -> Result<Self, GpuError> {
        check_size(device, size_px)?;
        Ok(Self {
            color: offscreen_color(device, OFFSCREEN_FORMAT, size_px),
            size_px,
            health: SurfaceHealth::default(),
        })
    }

    fn window(
        adapter: &wgpu::Adapter,
        device: &wgpu::Device,
        surface: wgpu::Surface<'static>,
        traits: &ContextTraits,
    ) -> Result<Self, GpuError> {
        let ContextTraits { size_px, vsync, .. } = *traits;
        check_size(device, size_px)?;
        let capabilities = surface.get_capabilities(adapter);
        let format = window_format(&capabilities.formats, traits.min_alpha_bits)?;
        // Reading a window's image back needs images that can be copied, which not all platforms allow.
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
        Ok(Self { color, size_px, health: SurfaceHealth::default() })
    }

    pub(super) fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    pub(super) fn is_window(&self) -> bool {
        matches!(self.color, Color::Window { .. })
    }

    /// Frees everything of a lost device and of the window, so that both can be opened again.
    pub(super) fn close(&mut self) {
        self.color = Color::Closed;
    }

    /// Sets whether a window's images wait for the vertical blank. Does nothing offscreen.
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
            Color::Offscreen { texture, .. } => texture.format(),
            Color::Closed => OFFSCREEN_FORMAT,
            Color::Window { config, .. } => config.format,
        }
    }

    pub(super) fn resize(&mut self, device: &wgpu::Device, size_px: [u32; 2]) -> Result<(), GpuError> {
        if size_px == self.size_px {
            return Ok(());
        }
        check_size(device, size_px)?;
        match &mut self.color {
            Color::Offscreen { texture, .. } => self.color = offscreen_color(device, texture.format(), size_px),
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

    /// Gets the window's next image, unless one was acquired and not presented. An offscreen target always has one.
    /// `recreate` creates the window's surface again.
    pub(super) fn acquire(
        &mut self,
        device: &wgpu::Device,
        recreate: impl Fn() -> Result<wgpu::Surface<'static>, GpuError>,
    ) -> Result<Acquired, GpuError> {
        let health = &mut self.health;
        let Color::Window { surface, config, frame } = &mut self.color else { return Ok(Acquired::Ready) };
        if frame.is_some() {
            return Ok(Acquired::Ready);
        }
        if health.take_configure() {
            configure_or_drop(device, surface, config);
        }
        // After a second failure the next frame tries again.
        for is_retry in [false, true] {
            let (answer, image) = match (health.pretended.pop_front(), &*surface) {
                (Some(answer @ (SurfaceAnswer::Optimal | SurfaceAnswer::Suboptimal)), Some(surface)) => {
                    (answer, SurfaceAnswer::split(surface.get_current_texture()).1)
                }
                (Some(answer), _) => (answer, None),
                (None, Some(surface)) => SurfaceAnswer::split(surface.get_current_texture()),
                (None, None) => (SurfaceAnswer::Lost, None),
            };
            match health.next(answer, is_retry)? {
                SurfaceAction::Draw => {
                    let Some(image) = image else { return Ok(Acquired::Skip) };
                    let view = image.texture.create_view(&wgpu::TextureViewDescriptor::default());
                    *frame = Some(SurfaceFrame { image, view });
                    return Ok(Acquired::Ready);
                }
                SurfaceAction::Skip => return Ok(Acquired::Skip),
                SurfaceAction::Configure => configure_or_drop(device, surface, config),
                SurfaceAction::Recreate => {
                    log::warn!("a window's surface is lost and is created again");
                    if !cfg!(target_vendor = "apple") {
                        // A window has one surface at a time. On Apple's systems only the main thread can create one.
                        *surface = None;
                        match recreate() {
                            Ok(created) => *surface = Some(created),
                            Err(error) => log::warn!("{error}"),
                        }
                    }
                    configure_or_drop(device, surface, config);
                }
            }
        }
        Ok(Acquired::Skip)
    }

    /// Gives an offscreen target another format, such as those of windows without sRGB.
    #[cfg(feature = "testing")]
    pub(super) fn pretend_format(&mut self, device: &wgpu::Device, format: wgpu::TextureFormat) {
        self.color = offscreen_color(device, format, self.size_px);
    }

    /// Sets the next answers of a window's surface.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_that_adapters_do_not_encode_are_drawn_in_others() {
        use wgpu::TextureFormat as F;
        let formats = [F::Bgra8UnormSrgb, F::Bgra8Unorm, F::Rgba8Unorm, F::Rgb10a2Unorm, F::Rgba16Float];
        let drawn = [F::Bgra8UnormSrgb, F::Rgba8UnormSrgb, F::Rgba8UnormSrgb, F::Rgba16Float, F::Rgba16Float];
        assert_eq!(formats.map(drawn_format), drawn);
        assert_eq!(formats.map(is_encoded_by_shader), [false, true, true, true, false]);
    }

    #[test]
    fn window_takes_a_format_with_enough_alpha() {
        use wgpu::TextureFormat as F;
        let formats = [F::Rgb10a2Unorm, F::Rgba16Float, F::Bgra8Unorm, F::Bgra8UnormSrgb];
        assert_eq!(window_format(&formats, 0).ok(), Some(F::Bgra8UnormSrgb));
        assert_eq!(window_format(&formats[..3], 0).ok(), Some(F::Rgb10a2Unorm));
        assert_eq!(window_format(&formats[..3], 8).ok(), Some(F::Rgba16Float));
        let few = window_format(&formats[..1], 8);
        assert!(matches!(few, Err(GpuError::AlphaBits { wanted: 8, found: 2 })), "{few:?}");
        assert!(matches!(window_format(&[], 0), Err(GpuError::Surface { .. })));
        assert!(enough_alpha(OFFSCREEN_FORMAT, 8).is_ok() && enough_alpha(OFFSCREEN_FORMAT, 9).is_err());
    }
}
