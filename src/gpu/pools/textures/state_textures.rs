//! [`StateTextures`]: the textures and samplers of state sets, and the textures that cameras draw into. Draw thread.
//!
//! A texture is found by the address of its [`TextureObject`] and lives as long as that object.
//!
//! Textures of a page's state sets are announced with the page. The compile queue uploads them before the page's drawables,
//! so that they are complete when the page is merged. A frame uploads a texture whole that was not announced, as
//! OpenSceneGraph does without pre-compile. A texture that was announced and is not complete is white.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::image_size::ImageSize;
use super::texture_rows::write_rows;
use crate::gpu::error_scope::catch_errors;
use crate::gpu::memory::block_formats;
use crate::gpu::pools::wgpu_enums::{
    TexelEncoding, address_mode, border_color, compare_function, filter_mode, mipmap_filter_mode, texture_format,
    view_dimension,
};
use crate::scene::Texture;
use crate::state::{FilterMode, Sampler, TextureDimension, TextureFormat, TextureObject, WrapMode};

/// Sizes of textures of state sets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct StateTextureBytes {
    pub all: u64,
    /// The size of the textures that the pager counts with their pages.
    pub of_pages: u64,
}

struct Entry {
    /// Keeps the address from being reused while the entry exists.
    object: Weak<TextureObject>,
    /// `None` after a failure, which was reported.
    created: Option<CreatedTexture>,
    /// Unique over all textures that the renderer has had.
    serial: u32,
    /// True while the compile queue uploads it.
    is_uploading: bool,
    /// A page was announced that has it in its state sets.
    is_of_page: bool,
}

struct CreatedTexture {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    /// Views of single levels and layers, to draw into.
    attachments: Vec<(u32, u32, wgpu::TextureView)>,
}

/// Textures by identity, and samplers by value.
pub(crate) struct StateTextures {
    /// By address. Never iterated in an order that matters.
    entries: HashMap<usize, Entry>,
    samplers: Vec<(Sampler, wgpu::Sampler)>,
    next_serial: u32,
    /// Textures whose first level is complete and whose other levels must be computed.
    without_levels: Vec<Arc<TextureObject>>,
    can_filter_floats: bool,
    has_borders: bool,
}

impl StateTextures {
    pub(crate) fn new(device: &wgpu::Device) -> Self {
        Self {
            entries: HashMap::new(),
            samplers: Vec::new(),
            next_serial: 1,
            without_levels: Vec::new(),
            can_filter_floats: device.features().contains(wgpu::Features::FLOAT32_FILTERABLE),
            has_borders: device.features().contains(wgpu::Features::ADDRESS_MODE_CLAMP_TO_BORDER),
        }
    }

    /// Returns true if samplers that interpolate may read the format.
    pub(crate) fn is_filterable(&self, format: TextureFormat) -> bool {
        match format {
            TextureFormat::R32Float => self.can_filter_floats,
            _ => !format.is_depth(),
        }
    }

    /// Returns true if a sampler has a border colour that the adapter does not have: its edges are clamped.
    pub(crate) fn emulates_border(&self, sampler: &Sampler) -> bool {
        let has_border = sampler.wrap.contains(&WrapMode::ClampToBorder);
        has_border && !(self.has_borders && border_color(sampler.border_color).is_some())
    }

    /// Creates a texture if necessary, and returns its serial number. Returns an error the first time that a texture
    /// cannot be created, and `Ok(None)` from then on.
    pub(crate) fn ensure(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        object: &Arc<TextureObject>,
    ) -> Result<Option<u32>, String> {
        let key = Arc::as_ptr(object) as usize;
        if let Some(entry) = self.entries.get(&key) {
            return Ok((entry.created.is_some() && !entry.is_uploading).then_some(entry.serial));
        }
        let created = create_or_refuse(device, object);
        if let Ok(created) = &created {
            write_texels(queue, &created.texture, object);
            self.note_complete(object);
        }
        let (created, result) = match created {
            Ok(created) => (Some(created), Ok(Some(self.next_serial))),
            Err(problem) => (None, Err(problem)),
        };
        self.insert(object, created, false);
        result
    }

    fn insert(&mut self, object: &Arc<TextureObject>, created: Option<CreatedTexture>, is_uploading: bool) {
        let is_of_page = is_uploading;
        let entry =
            Entry { object: Arc::downgrade(object), created, serial: self.next_serial, is_uploading, is_of_page };
        self.entries.insert(Arc::as_ptr(object) as usize, entry);
        self.next_serial += 1;
    }

    fn note_complete(&mut self, object: &Arc<TextureObject>) {
        if object.computes_levels() {
            self.without_levels.push(object.clone());
        }
    }

    /// Creates a texture whose texels the caller uploads; [`Self::uploaded`] ends that. Returns `None` for textures that exist,
    /// have no texels or change. Errors come up when a frame uses the texture.
    pub(crate) fn announce(&mut self, device: &wgpu::Device, object: &Arc<TextureObject>) -> Option<wgpu::Texture> {
        if !object.is_uploaded_once() {
            return None;
        }
        if let Some(known) = self.entries.get_mut(&(Arc::as_ptr(object) as usize)) {
            known.is_of_page = true;
            return None;
        }
        let created = create_or_refuse(device, object).ok()?;
        let texture = created.texture.clone();
        self.insert(object, Some(created), true);
        Some(texture)
    }

    /// Notes that an announced texture is complete in the next frame.
    pub(crate) fn uploaded(&mut self, object: &Arc<TextureObject>) {
        if let Some(entry) = self.entries.get_mut(&(Arc::as_ptr(object) as usize)).filter(|entry| entry.is_uploading) {
            entry.is_uploading = false;
            self.note_complete(object);
        }
    }

    /// Takes the textures whose levels below the first must be computed in the next frame.
    pub(crate) fn take_without_levels(&mut self) -> Vec<Arc<TextureObject>> {
        std::mem::take(&mut self.without_levels)
    }

    /// Returns the sizes of the textures, without those that cameras draw into.
    pub(crate) fn bytes(&self) -> StateTextureBytes {
        let textures = self.entries.values().filter_map(|entry| Some((entry.created.as_ref()?, entry.is_of_page)));
        let written = textures.filter(|(created, _)| created.texture.usage().contains(wgpu::TextureUsages::COPY_DST));
        let mut sum = StateTextureBytes::default();
        for (created, is_of_page) in written {
            let bytes = texture_bytes(&created.texture);
            sum.all += bytes;
            sum.of_pages += if is_of_page { bytes } else { 0 };
        }
        sum
    }

    /// Writes an image to a texture. Returns true if the texture was replaced by one of the image's size, so that its bind
    /// groups must be created again.
    pub(crate) fn show(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        object: &Arc<TextureObject>,
        image: &Texture,
    ) -> Result<bool, String> {
        let limits = device.limits();
        let size = ImageSize::of(image, &limits, block_formats(device.features()))
            .map_err(|problem| format!("texture {:?}: {problem}", object.name))?;
        let fits = |created: &CreatedTexture| {
            let texture = &created.texture;
            size.is_size_of(texture, TexelEncoding::Srgb) && texture.usage().contains(wgpu::TextureUsages::COPY_DST)
        };
        let key = Arc::as_ptr(object) as usize;
        let known = self.entries.get(&key).and_then(|e| e.created.as_ref()).is_some_and(fits);
        if !known {
            let (texture, error) = catch_errors(device, || size.create(device, &object.name, 1, TexelEncoding::Srgb));
            if let Some(error) = error {
                return Err(format!("texture {:?} cannot be made: {error}", object.name));
            }
            let view = texture.create_view(&wgpu::TextureViewDescriptor {
                label: Some(&object.name),
                dimension: Some(wgpu::TextureViewDimension::D2),
                ..Default::default()
            });
            self.insert(object, Some(CreatedTexture { texture, view, attachments: Vec::new() }), false);
        }
        let Some(created) = self.entries.get(&key).and_then(|e| e.created.as_ref()) else { return Ok(!known) };
        for (level, texels) in (0u32..).zip(&image.mips) {
            write_rows(queue, &created.texture, &size.rows_of(level), texels);
        }
        Ok(!known)
    }

    fn created(&self, object: &Arc<TextureObject>) -> Option<&CreatedTexture> {
        self.entries.get(&(Arc::as_ptr(object) as usize))?.created.as_ref()
    }

    /// Returns the view of a whole texture; `None` before [`Self::ensure`].
    pub(crate) fn view(&self, object: &Arc<TextureObject>) -> Option<&wgpu::TextureView> {
        self.created(object).map(|created| &created.view)
    }

    pub(crate) fn texture(&self, object: &Arc<TextureObject>) -> Option<&wgpu::Texture> {
        self.created(object).map(|created| &created.texture)
    }

    /// Gives a texture the size and format of an image that will be copied into it. Returns true if it was replaced, so that
    /// its bind groups must be created again.
    pub(crate) fn ensure_copy(
        &mut self,
        device: &wgpu::Device,
        object: &Arc<TextureObject>,
        [width, height]: [u32; 2],
        format: wgpu::TextureFormat,
    ) -> Result<bool, String> {
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        let fits = |created: &CreatedTexture| {
            let texture = &created.texture;
            texture.size() == size
                && texture.format() == format
                && texture.mip_level_count() == 1
                && texture.usage().contains(wgpu::TextureUsages::COPY_DST)
        };
        if self.created(object).is_some_and(fits) {
            return Ok(false);
        }
        let descriptor = wgpu::TextureDescriptor {
            label: Some(&object.name),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        };
        let (texture, error) = catch_errors(device, || device.create_texture(&descriptor));
        if let Some(error) = error {
            return Err(format!("texture {:?} cannot be made: {error}", object.name));
        }
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        self.insert(object, Some(CreatedTexture { texture, view, attachments: Vec::new() }), false);
        Ok(true)
    }

    /// Returns a view of one level of one layer, to draw into and to sample; of a volume, the view of all slices of the level.
    /// `None` if the texture has no such level or layer.
    pub(crate) fn attachment(
        &mut self,
        object: &Arc<TextureObject>,
        level: u32,
        layer: u32,
    ) -> Option<wgpu::TextureView> {
        let entry = self.entries.get_mut(&(Arc::as_ptr(object) as usize))?;
        let created = entry.created.as_mut()?;
        if level >= object.levels || layer >= object.level_size(level)[2] {
            return None;
        }
        let is_volume = object.dimension == TextureDimension::D3;
        let layer = if is_volume { 0 } else { layer };
        if let Some((.., view)) = created.attachments.iter().find(|(l, a, _)| (*l, *a) == (level, layer)) {
            return Some(view.clone());
        }
        let view = created.texture.create_view(&wgpu::TextureViewDescriptor {
            label: Some("attachment"),
            dimension: Some(if is_volume { wgpu::TextureViewDimension::D3 } else { wgpu::TextureViewDimension::D2 }),
            base_mip_level: level,
            mip_level_count: Some(1),
            base_array_layer: layer,
            array_layer_count: Some(1),
            ..Default::default()
        });
        created.attachments.push((level, layer, view.clone()));
        Some(view)
    }

    /// Returns the index of a sampler, which is created if necessary.
    pub(crate) fn ensure_sampler(&mut self, device: &wgpu::Device, sampler: &Sampler) -> u32 {
        let sampler = self.of_adapter(sampler);
        let index = self.samplers.iter().position(|(s, _)| *s == sampler).unwrap_or_else(|| {
            self.samplers.push((sampler, create_sampler(device, &sampler)));
            self.samplers.len() - 1
        });
        index as u32
    }

    /// Returns a sampler by value; `None` before [`Self::ensure_sampler`].
    pub(crate) fn existing_sampler(&self, sampler: &Sampler) -> Option<&wgpu::Sampler> {
        let sampler = self.of_adapter(sampler);
        self.samplers.iter().find(|(s, _)| *s == sampler).map(|(_, s)| s)
    }

    /// Returns a sampler as the adapter has it: without its bias, which shaders apply, and without a border colour that it
    /// does not have.
    fn of_adapter(&self, sampler: &Sampler) -> Sampler {
        let is_clamped = self.emulates_border(sampler);
        let wrap = sampler.wrap.map(|mode| match mode {
            WrapMode::ClampToBorder if is_clamped => WrapMode::ClampToEdge,
            mode => mode,
        });
        let has_border = wrap.contains(&WrapMode::ClampToBorder);
        let border_color = if has_border { sampler.border_color } else { [0.0; 4] };
        Sampler { mip_bias: 0.0, wrap, border_color, ..*sampler }
    }

    pub(crate) fn sampler(&self, index: u32) -> Option<&wgpu::Sampler> {
        self.samplers.get(index as usize).map(|(_, s)| s)
    }

    /// Frees textures whose objects were dropped; passes their serial numbers to a function, in no order.
    pub(crate) fn prune(&mut self, mut freed: impl FnMut(u32)) {
        self.entries.retain(|_, entry| {
            let is_held = entry.object.strong_count() > 0;
            if !is_held {
                freed(entry.serial);
            }
            is_held
        });
    }
}

/// Returns the size of all levels of a texture in bytes.
fn texture_bytes(texture: &wgpu::Texture) -> u64 {
    let is_volume = texture.dimension() == wgpu::TextureDimension::D3;
    let (block_width, block_height) = texture.format().block_dimensions();
    let block_bytes = u64::from(texture.format().block_copy_size(None).unwrap_or(8));
    let of_level = |level: u32| {
        let side = |side: u32| (side >> level).max(1);
        let depth = if is_volume { side(texture.depth_or_array_layers()) } else { texture.depth_or_array_layers() };
        let blocks =
            [side(texture.width()).div_ceil(block_width), side(texture.height()).div_ceil(block_height), depth];
        blocks.into_iter().map(u64::from).product::<u64>() * block_bytes
    };
    (0..texture.mip_level_count()).map(of_level).sum()
}

/// Creates a texture without its texels. Returns an error text if the device refuses it.
fn create_or_refuse(device: &wgpu::Device, object: &TextureObject) -> Result<CreatedTexture, String> {
    let (created, error) = catch_errors(device, || create_texture(device, object));
    let refused = |error| Err(format!("texture {:?} cannot be made: {error}", object.name));
    created.and_then(|created| error.map_or(Ok(created), refused))
}

fn create_texture(device: &wgpu::Device, object: &TextureObject) -> Result<CreatedTexture, String> {
    if let Some(problem) = object.problem() {
        return Err(problem);
    }
    let limits = device.limits();
    let [width, height, depth] = object.size;
    let is_volume = object.dimension == TextureDimension::D3;
    let side = if is_volume { limits.max_texture_dimension_3d } else { limits.max_texture_dimension_2d };
    let layers = if is_volume { side } else { limits.max_texture_array_layers };
    if width > side || height > side || depth > layers {
        return Err(format!("texture {:?}: {width} x {height} x {depth} is more than the adapter takes", object.name));
    }
    let is_target = object.texels.is_empty();
    let use_as = if is_target {
        wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC
    } else {
        let drawn = if object.computes_levels() {
            wgpu::TextureUsages::RENDER_ATTACHMENT
        } else {
            wgpu::TextureUsages::empty()
        };
        wgpu::TextureUsages::COPY_DST | drawn
    };
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some(&object.name),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: depth },
        mip_level_count: object.levels,
        sample_count: 1,
        dimension: if is_volume { wgpu::TextureDimension::D3 } else { wgpu::TextureDimension::D2 },
        format: texture_format(object.format),
        usage: use_as | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    // Shaders sample one aspect.
    let aspect = if object.format.has_stencil() { wgpu::TextureAspect::DepthOnly } else { wgpu::TextureAspect::All };
    let view = texture.create_view(&wgpu::TextureViewDescriptor {
        label: Some(&object.name),
        dimension: Some(view_dimension(object.dimension)),
        aspect,
        ..Default::default()
    });
    Ok(CreatedTexture { texture, view, attachments: Vec::new() })
}

/// Writes all texels of a texture by the queue.
fn write_texels(queue: &wgpu::Queue, texture: &wgpu::Texture, object: &TextureObject) {
    for (level, texels) in (0u32..).zip(&object.texels) {
        let [width, height, depth] = object.level_size(level);
        queue.write_texture(
            wgpu::TexelCopyTextureInfo { mip_level: level, ..texture.as_image_copy() },
            texels,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(width * object.format.texel_bytes() as u32),
                rows_per_image: Some(height),
            },
            wgpu::Extent3d { width, height, depth_or_array_layers: depth },
        );
    }
}

fn create_sampler(device: &wgpu::Device, sampler: &Sampler) -> wgpu::Sampler {
    let [u, v, w] = sampler.wrap.map(address_mode);
    let all_linear = [sampler.min_filter, sampler.mag_filter, sampler.mip_filter] == [FilterMode::Linear; 3];
    device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("state set"),
        address_mode_u: u,
        address_mode_v: v,
        address_mode_w: w,
        mag_filter: filter_mode(sampler.mag_filter),
        min_filter: filter_mode(sampler.min_filter),
        mipmap_filter: mipmap_filter_mode(sampler.mip_filter),
        compare: sampler.compare.map(compare_function),
        // WebGPU allows anisotropy with linear filters only.
        border_color: sampler
            .wrap
            .contains(&WrapMode::ClampToBorder)
            .then(|| border_color(sampler.border_color))
            .flatten(),
        anisotropy_clamp: if all_linear { u16::from(sampler.max_anisotropy.clamp(1, 16)) } else { 1 },
        ..Default::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    /// Regression: each bias had a sampler, and NaN a new one each frame.
    #[test]
    fn samplers_of_different_bias_are_one() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut textures = StateTextures::new(ctx.device());
        for mip_bias in [0.0, 0.1, 0.2, -3.0, f32::NAN, f32::NAN, f32::INFINITY] {
            let sampler = Sampler { mip_bias, ..Sampler::default() };
            assert_eq!(textures.ensure_sampler(ctx.device(), &sampler), 0, "{mip_bias}");
            assert!(textures.existing_sampler(&sampler).is_some(), "{mip_bias}");
        }
        let nearest = Sampler { mag_filter: FilterMode::Nearest, ..Sampler::default() };
        assert_eq!(textures.ensure_sampler(ctx.device(), &nearest), 1, "a filter is part of the adapter's sampler");
    }
}
