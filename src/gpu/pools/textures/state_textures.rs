//! [`StateTextures`]: the textures and samplers of state sets, and the textures that cameras draw into. Draw thread.
//!
//! A texture is found by the address of its [`TextureObject`] and lives as long as that object. Its texels are uploaded
//! when a frame uses it for the first time.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::image_size::ImageSize;
use super::texture_rows::write_rows;
use super::wgpu_enums::{
    TexelEncoding, address_mode, block_formats, border_color, compare_function, filter_mode, mipmap_filter_mode,
    texture_format, view_dimension,
};
use crate::gpu::error_scope::catch_errors;
use crate::scene::Texture;
use crate::state::{FilterMode, Sampler, TextureDimension, TextureFormat, TextureObject, WrapMode};

struct Entry {
    /// Keeps the address from being reused while the entry exists.
    object: Weak<TextureObject>,
    /// `None` after a failure, which was reported.
    created: Option<CreatedTexture>,
    /// Unique over all textures that the renderer has had.
    serial: u32,
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
    can_filter_floats: bool,
    has_borders: bool,
}

impl StateTextures {
    pub(crate) fn new(device: &wgpu::Device) -> Self {
        Self {
            entries: HashMap::new(),
            samplers: Vec::new(),
            next_serial: 1,
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
            return Ok(entry.created.is_some().then_some(entry.serial));
        }
        let (created, error) = catch_errors(device, || create_texture(device, queue, object));
        let refused = |error| Err(format!("texture {:?} cannot be made: {error}", object.name));
        let created = created.and_then(|created| error.map_or(Ok(created), refused));
        let serial = self.next_serial;
        self.next_serial += 1;
        let (created, result) = match created {
            Ok(created) => (Some(created), Ok(Some(serial))),
            Err(problem) => (None, Err(problem)),
        };
        self.entries.insert(key, Entry { object: Arc::downgrade(object), created, serial });
        result
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
            let created = Some(CreatedTexture { texture, view, attachments: Vec::new() });
            self.entries.insert(key, Entry { object: Arc::downgrade(object), created, serial: self.next_serial });
            self.next_serial += 1;
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
        let created = Some(CreatedTexture { texture, view, attachments: Vec::new() });
        let key = Arc::as_ptr(object) as usize;
        self.entries.insert(key, Entry { object: Arc::downgrade(object), created, serial: self.next_serial });
        self.next_serial += 1;
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

fn create_texture(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    object: &TextureObject,
) -> Result<CreatedTexture, String> {
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
        wgpu::TextureUsages::COPY_DST
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
