//! Textures and samplers of state sets, and of what cameras draw into. Draw thread only.
//!
//! Kept by identity: a texture lives as long as somebody holds its [`TextureObject`]. Texels are uploaded when a
//! texture is first met.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::texture_pool::{ImageSize, Rows, write_rows};
use super::watched;
use crate::scene::Texture;
use crate::state::{CompareFunction, FilterMode, Sampler, TextureDimension, TextureFormat, TextureObject, WrapMode};

struct Entry {
    /// Also keeps the address from being used again.
    object: Weak<TextureObject>,
    made: Option<Made>,
    /// Unlike that of any texture before.
    serial: u32,
}

struct Made {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    /// Views of one level and layer.
    attachments: Vec<(u32, u32, wgpu::TextureView)>,
}

/// Textures of state sets by identity, and samplers by value.
pub(crate) struct StateTextures {
    /// By address; only looked up.
    entries: HashMap<usize, Entry>,
    samplers: Vec<(Sampler, wgpu::Sampler)>,
    next_serial: u32,
    can_filter_floats: bool,
}

/// A white texel for units without a texture; of depth, one at which nothing is.
pub(crate) struct White {
    pub(crate) plane: wgpu::TextureView,
    pub(crate) cube: wgpu::TextureView,
    pub(crate) volume: wgpu::TextureView,
    pub(crate) layers: wgpu::TextureView,
    depth_plane: wgpu::TextureView,
    depth_cube: wgpu::TextureView,
    depth_layers: wgpu::TextureView,
}

pub(crate) fn texture_format(format: TextureFormat) -> wgpu::TextureFormat {
    match format {
        TextureFormat::Rgba8Srgb => wgpu::TextureFormat::Rgba8UnormSrgb,
        TextureFormat::Rgba8 => wgpu::TextureFormat::Rgba8Unorm,
        TextureFormat::Rgba16Float => wgpu::TextureFormat::Rgba16Float,
        TextureFormat::R8 => wgpu::TextureFormat::R8Unorm,
        TextureFormat::R32Float => wgpu::TextureFormat::R32Float,
        TextureFormat::Depth32 => wgpu::TextureFormat::Depth32Float,
        TextureFormat::Depth24Stencil8 => wgpu::TextureFormat::Depth24PlusStencil8,
        TextureFormat::Depth32Stencil8 => wgpu::TextureFormat::Depth32FloatStencil8,
    }
}

pub(crate) fn view_dimension(dimension: TextureDimension) -> wgpu::TextureViewDimension {
    match dimension {
        // One-dimensional textures have no mips in wgpu: a row of a plane samples alike.
        TextureDimension::D1 | TextureDimension::D2 => wgpu::TextureViewDimension::D2,
        TextureDimension::D2Array => wgpu::TextureViewDimension::D2Array,
        TextureDimension::Cube => wgpu::TextureViewDimension::Cube,
        TextureDimension::D3 => wgpu::TextureViewDimension::D3,
    }
}

impl StateTextures {
    pub(crate) fn new(device: &wgpu::Device) -> Self {
        Self {
            entries: HashMap::new(),
            samplers: Vec::new(),
            next_serial: 1,
            can_filter_floats: device.features().contains(wgpu::Features::FLOAT32_FILTERABLE),
        }
    }

    /// Whether samplers that interpolate may read the format.
    pub(crate) fn is_filterable(&self, format: TextureFormat) -> bool {
        match format {
            TextureFormat::R32Float => self.can_filter_floats,
            _ => !format.is_depth(),
        }
    }

    /// Makes a texture unless it is there, and returns its serial number; what is wrong with it only the first time,
    /// `Ok(None)` after.
    pub(crate) fn ensure(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        object: &Arc<TextureObject>,
    ) -> Result<Option<u32>, String> {
        let key = Arc::as_ptr(object) as usize;
        if let Some(entry) = self.entries.get(&key) {
            return Ok(entry.made.is_some().then_some(entry.serial));
        }
        let (made, error) = watched(device, || make(device, queue, object));
        let refused = |error| Err(format!("texture {:?} cannot be made: {error}", object.name));
        let made = made.and_then(|made| error.map_or(Ok(made), refused));
        let serial = self.next_serial;
        self.next_serial += 1;
        let (made, result) = match made {
            Ok(made) => (Some(made), Ok(Some(serial))),
            Err(problem) => (None, Err(problem)),
        };
        self.entries.insert(key, Entry { object: Arc::downgrade(object), made, serial });
        result
    }

    /// Writes an image to a texture, which takes its size; true when it is another texture than before, whose bind
    /// groups are to be made anew.
    pub(crate) fn show(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        object: &Arc<TextureObject>,
        image: &Texture,
    ) -> Result<bool, String> {
        let limits = device.limits();
        let size = ImageSize::of(image, &limits).map_err(|problem| format!("texture {:?}: {problem}", object.name))?;
        let fits = |made: &Made| {
            let t = &made.texture;
            [t.width(), t.height(), t.mip_level_count()] == [size.width, size.height, size.mips]
                && t.format() == wgpu::TextureFormat::Rgba8UnormSrgb
                && t.usage().contains(wgpu::TextureUsages::COPY_DST)
        };
        let key = Arc::as_ptr(object) as usize;
        let known = self.entries.get(&key).and_then(|e| e.made.as_ref()).is_some_and(fits);
        if !known {
            let (texture, error) = watched(device, || size.create(device, &object.name, 1));
            if let Some(error) = error {
                return Err(format!("texture {:?} cannot be made: {error}", object.name));
            }
            let view = texture.create_view(&wgpu::TextureViewDescriptor {
                label: Some(&object.name),
                dimension: Some(wgpu::TextureViewDimension::D2),
                ..Default::default()
            });
            let made = Some(Made { texture, view, attachments: Vec::new() });
            self.entries.insert(key, Entry { object: Arc::downgrade(object), made, serial: self.next_serial });
            self.next_serial += 1;
        }
        let Some(made) = self.entries.get(&key).and_then(|e| e.made.as_ref()) else { return Ok(!known) };
        for (level, texels) in (0u32..).zip(&image.mips) {
            let [width, height] = size.level(level);
            write_rows(queue, &made.texture, &Rows { layer: 0, level, first: 0, count: height, width }, texels);
        }
        Ok(!known)
    }

    fn made(&self, object: &Arc<TextureObject>) -> Option<&Made> {
        self.entries.get(&(Arc::as_ptr(object) as usize))?.made.as_ref()
    }

    /// All of a texture.
    pub(crate) fn view(&self, object: &Arc<TextureObject>) -> Option<&wgpu::TextureView> {
        self.made(object).map(|m| &m.view)
    }

    pub(crate) fn texture(&self, object: &Arc<TextureObject>) -> Option<&wgpu::Texture> {
        self.made(object).map(|m| &m.texture)
    }

    /// A level of a layer, to draw into; makes the view when it is first asked for.
    pub(crate) fn attachment(
        &mut self,
        object: &Arc<TextureObject>,
        level: u32,
        layer: u32,
    ) -> Option<wgpu::TextureView> {
        let entry = self.entries.get_mut(&(Arc::as_ptr(object) as usize))?;
        let made = entry.made.as_mut()?;
        if level >= object.levels || layer >= object.size[2] || object.dimension == TextureDimension::D3 {
            return None;
        }
        if let Some((.., view)) = made.attachments.iter().find(|(l, a, _)| (*l, *a) == (level, layer)) {
            return Some(view.clone());
        }
        let view = made.texture.create_view(&wgpu::TextureViewDescriptor {
            label: Some("attachment"),
            dimension: Some(wgpu::TextureViewDimension::D2),
            base_mip_level: level,
            mip_level_count: Some(1),
            base_array_layer: layer,
            array_layer_count: Some(1),
            ..Default::default()
        });
        made.attachments.push((level, layer, view.clone()));
        Some(view)
    }

    /// The place of a sampler; made when first met.
    pub(crate) fn ensure_sampler(&mut self, device: &wgpu::Device, sampler: &Sampler) -> u32 {
        let sampler = without_bias(sampler);
        let place = self.samplers.iter().position(|(s, _)| *s == sampler).unwrap_or_else(|| {
            self.samplers.push((sampler, make_sampler(device, &sampler)));
            self.samplers.len() - 1
        });
        place as u32
    }

    /// A sampler that was made.
    pub(crate) fn known_sampler(&self, sampler: &Sampler) -> Option<&wgpu::Sampler> {
        let sampler = without_bias(sampler);
        self.samplers.iter().find(|(s, _)| *s == sampler).map(|(_, s)| s)
    }

    pub(crate) fn sampler(&self, place: u32) -> Option<&wgpu::Sampler> {
        self.samplers.get(place as usize).map(|(_, s)| s)
    }

    /// Frees what nobody holds any more; true when there was something.
    pub(crate) fn prune(&mut self) -> bool {
        let before = self.entries.len();
        self.entries.retain(|_, e| e.object.strong_count() > 0);
        self.entries.len() != before
    }
}

fn make(device: &wgpu::Device, queue: &wgpu::Queue, object: &TextureObject) -> Result<Made, String> {
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
    // What is sampled is one aspect.
    let aspect = if object.format.has_stencil() { wgpu::TextureAspect::DepthOnly } else { wgpu::TextureAspect::All };
    let view = texture.create_view(&wgpu::TextureViewDescriptor {
        label: Some(&object.name),
        dimension: Some(view_dimension(object.dimension)),
        aspect,
        ..Default::default()
    });
    Ok(Made { texture, view, attachments: Vec::new() })
}

fn filter(mode: FilterMode) -> wgpu::FilterMode {
    match mode {
        FilterMode::Nearest => wgpu::FilterMode::Nearest,
        FilterMode::Linear => wgpu::FilterMode::Linear,
    }
}

pub(super) fn address_mode(mode: WrapMode) -> wgpu::AddressMode {
    match mode {
        WrapMode::ClampToEdge => wgpu::AddressMode::ClampToEdge,
        WrapMode::Repeat => wgpu::AddressMode::Repeat,
        WrapMode::Mirror => wgpu::AddressMode::MirrorRepeat,
    }
}

/// The bias is no part of an adapter's sampler.
fn without_bias(sampler: &Sampler) -> Sampler {
    Sampler { mip_bias: 0.0, ..*sampler }
}

fn make_sampler(device: &wgpu::Device, sampler: &Sampler) -> wgpu::Sampler {
    let [u, v, w] = sampler.wrap.map(address_mode);
    let all_linear = [sampler.min_filter, sampler.mag_filter, sampler.mip_filter] == [FilterMode::Linear; 3];
    device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("state set"),
        address_mode_u: u,
        address_mode_v: v,
        address_mode_w: w,
        mag_filter: filter(sampler.mag_filter),
        min_filter: filter(sampler.min_filter),
        mipmap_filter: match sampler.mip_filter {
            FilterMode::Nearest => wgpu::MipmapFilterMode::Nearest,
            FilterMode::Linear => wgpu::MipmapFilterMode::Linear,
        },
        compare: sampler.compare.map(compare_function),
        // WebGPU allows anisotropy with linear filters only.
        anisotropy_clamp: if all_linear { u16::from(sampler.max_anisotropy.clamp(1, 16)) } else { 1 },
        ..Default::default()
    })
}

/// A comparison of plain values (not of depths, which are stored reversed).
pub(crate) fn compare_function(function: CompareFunction) -> wgpu::CompareFunction {
    match function {
        CompareFunction::Never => wgpu::CompareFunction::Never,
        CompareFunction::Less => wgpu::CompareFunction::Less,
        CompareFunction::Equal => wgpu::CompareFunction::Equal,
        CompareFunction::LessOrEqual => wgpu::CompareFunction::LessEqual,
        CompareFunction::Greater => wgpu::CompareFunction::Greater,
        CompareFunction::NotEqual => wgpu::CompareFunction::NotEqual,
        CompareFunction::GreaterOrEqual => wgpu::CompareFunction::GreaterEqual,
        CompareFunction::Always => wgpu::CompareFunction::Always,
    }
}

impl White {
    pub(crate) fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Self {
        let view = |layers: u32, dimension: wgpu::TextureDimension, view: wgpu::TextureViewDimension| {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some("white"),
                size: wgpu::Extent3d { width: 1, height: 1, depth_or_array_layers: layers },
                mip_level_count: 1,
                sample_count: 1,
                dimension,
                format: wgpu::TextureFormat::Rgba8Unorm,
                usage: wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            });
            let texels = vec![255u8; 4 * layers as usize];
            queue.write_texture(
                texture.as_image_copy(),
                &texels,
                wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4), rows_per_image: Some(1) },
                texture.size(),
            );
            texture.create_view(&wgpu::TextureViewDescriptor { dimension: Some(view), ..Default::default() })
        };
        // What is not written is 0: the far end of depth.
        let depth = |layers: u32, view: wgpu::TextureViewDimension| {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some("no depth"),
                size: wgpu::Extent3d { width: 1, height: 1, depth_or_array_layers: layers },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::Depth32Float,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            });
            texture.create_view(&wgpu::TextureViewDescriptor { dimension: Some(view), ..Default::default() })
        };
        let plane = wgpu::TextureDimension::D2;
        Self {
            plane: view(1, plane, wgpu::TextureViewDimension::D2),
            cube: view(6, plane, wgpu::TextureViewDimension::Cube),
            volume: view(1, wgpu::TextureDimension::D3, wgpu::TextureViewDimension::D3),
            layers: view(1, plane, wgpu::TextureViewDimension::D2Array),
            depth_plane: depth(1, wgpu::TextureViewDimension::D2),
            depth_cube: depth(6, wgpu::TextureViewDimension::Cube),
            depth_layers: depth(1, wgpu::TextureViewDimension::D2Array),
        }
    }

    /// What a program reads that declares such a texture.
    pub(crate) fn of(&self, dimension: wgpu::TextureViewDimension, is_depth: bool) -> &wgpu::TextureView {
        match (dimension, is_depth) {
            (wgpu::TextureViewDimension::Cube, false) => &self.cube,
            (wgpu::TextureViewDimension::Cube, true) => &self.depth_cube,
            (wgpu::TextureViewDimension::D3, _) => &self.volume,
            (wgpu::TextureViewDimension::D2Array, false) => &self.layers,
            (wgpu::TextureViewDimension::D2Array, true) => &self.depth_layers,
            (_, false) => &self.plane,
            (_, true) => &self.depth_plane,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    /// Each made one, and one that is no number made one each frame.
    #[test]
    fn a_bias_makes_no_sampler() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut textures = StateTextures::new(ctx.device());
        for mip_bias in [0.0, 0.1, 0.2, -3.0, f32::NAN, f32::NAN, f32::INFINITY] {
            let sampler = Sampler { mip_bias, ..Sampler::default() };
            assert_eq!(textures.ensure_sampler(ctx.device(), &sampler), 0, "{mip_bias}");
            assert!(textures.known_sampler(&sampler).is_some(), "{mip_bias}");
        }
        let nearest = Sampler { mag_filter: FilterMode::Nearest, ..Sampler::default() };
        assert_eq!(textures.ensure_sampler(ctx.device(), &nearest), 1, "what the adapter's has makes another");
    }
}
