//! The attachments of a camera's target, checked and created. Draw thread.

use std::sync::Arc;

use super::error::TargetError;
use crate::draw::pipelines::{MAX_COLOR_ATTACHMENTS, TargetFormats};
use crate::gpu::{GraphicsContext, StateTextures, texture_format};
use crate::scene::{Attachment, CameraTarget};
use crate::state::{TextureDimension, TextureFormat};

/// The textures that a camera draws into, as views.
pub(super) struct CameraAttachments {
    pub(super) size_px: [u32; 2],
    pub(super) formats: TargetFormats,
    pub(super) colors: [Option<wgpu::TextureView>; MAX_COLOR_ATTACHMENTS],
    /// The slices of volumes, by location.
    pub(super) slices: [Option<u32>; MAX_COLOR_ATTACHMENTS],
    pub(super) depth: Option<wgpu::TextureView>,
}

impl CameraAttachments {
    /// Checks the attachments of a camera, chooses its samples per pixel and creates the textures. `depth_format` is that of a
    /// depth buffer, for cameras without a depth texture.
    pub(super) fn new(
        ctx: &GraphicsContext,
        textures: &mut StateTextures,
        camera: &CameraTarget,
        depth_format: wgpu::TextureFormat,
    ) -> Result<Self, TargetError> {
        if camera.colors.len() > MAX_COLOR_ATTACHMENTS {
            let count = camera.colors.len();
            return Err(format!("a camera has {count} colour attachments; {MAX_COLOR_ATTACHMENTS} are possible").into());
        }
        let size_px = common_size(camera)?;
        let mut formats =
            TargetFormats { colors: [None; MAX_COLOR_ATTACHMENTS], depth: depth_format, samples: 1, keeps_alpha: true };
        let mut colors = [const { None }; MAX_COLOR_ATTACHMENTS];
        let mut slices = [None; MAX_COLOR_ATTACHMENTS];
        for (location, attachment) in camera.colors.iter().enumerate() {
            formats.colors[location] = Some(color_format(camera, location)?);
            colors[location] = Some(view(ctx, textures, attachment)?);
            let is_volume = attachment.texture.dimension == TextureDimension::D3;
            slices[location] = is_volume.then_some(attachment.layer);
        }
        check_bytes(ctx, &formats)?;
        let depth = match &camera.depth {
            Some(attachment) if !attachment.texture.format.is_depth() => {
                let name = &attachment.texture.name;
                return Err(format!("texture {name:?} holds colour and is attached as depth").into());
            }
            Some(attachment) => {
                formats.depth = texture_format(attachment.texture.format);
                Some(view(ctx, textures, attachment)?)
            }
            None => None,
        };
        let all_formats = formats.colors.into_iter().flatten().chain([formats.depth]);
        formats.samples = ctx.samples_of(camera.samples, all_formats);
        Ok(Self { size_px, formats, colors, slices, depth })
    }
}

/// Returns the size of all attachments in pixels, which must be the same.
fn common_size(camera: &CameraTarget) -> Result<[u32; 2], String> {
    let mut size_px = None;
    for Attachment { texture, level, .. } in camera.colors.iter().chain(&camera.depth) {
        let [width, height, _] = texture.level_size(*level);
        if *size_px.get_or_insert([width, height]) != [width, height] {
            return Err(format!("texture {:?} has another size than the camera's other attachments", texture.name));
        }
    }
    size_px.ok_or_else(|| "a camera without attachments".to_owned())
}

/// Checks a colour attachment and returns its format.
fn color_format(camera: &CameraTarget, location: usize) -> Result<wgpu::TextureFormat, String> {
    let Attachment { texture, level, layer, .. } = &camera.colors[location];
    let (name, format) = (&texture.name, texture.format);
    let is_same = |a: &Attachment| Arc::ptr_eq(&a.texture, texture) && (a.level, a.layer) == (*level, *layer);
    if camera.colors[..location].iter().any(is_same) {
        return Err(format!("texture {name:?} is attached twice: level {level} of layer {layer}"));
    }
    if format.is_depth() {
        return Err(format!("texture {name:?} holds depth and is attached as colour"));
    }
    if format == TextureFormat::R32Float && camera.samples > 1 {
        return Err(format!("texture {name:?} holds 32-bit floats, which cannot be resolved from several samples"));
    }
    if texture.dimension == TextureDimension::D3 && camera.samples > 1 {
        return Err(format!("texture {name:?} is a volume, into whose slices several samples cannot be resolved"));
    }
    Ok(texture_format(format))
}

/// Returns an error if a pixel of all colours takes more bytes than the adapter allows, by the rules of WebGPU.
fn check_bytes(ctx: &GraphicsContext, formats: &TargetFormats) -> Result<(), String> {
    let limit = ctx.device().limits().max_color_attachment_bytes_per_sample;
    let mut bytes = 0u32;
    for format in formats.colors.into_iter().flatten() {
        let alignment = format.target_component_alignment().unwrap_or(1);
        bytes = bytes.next_multiple_of(alignment) + format.target_pixel_byte_cost().unwrap_or(0);
    }
    if bytes <= limit {
        return Ok(());
    }
    Err(format!("the colour attachments of a camera take {bytes} bytes a pixel; {limit} are possible on this adapter"))
}

/// Creates the texture of an attachment if needed, and returns the view of its level and layer.
fn view(
    ctx: &GraphicsContext,
    textures: &mut StateTextures,
    attachment: &Attachment,
) -> Result<wgpu::TextureView, TargetError> {
    let Attachment { texture, level, layer, .. } = attachment;
    let name = &texture.name;
    if !texture.texels.is_empty() {
        return Err(format!("texture {name:?} has contents and cannot be drawn into").into());
    }
    textures.ensure(ctx.device(), ctx.queue(), texture)?.ok_or(TargetError::Reported)?;
    let view = textures.attachment(texture, *level, *layer);
    Ok(view.ok_or_else(|| format!("texture {name:?} has no level {level} of layer {layer} to draw into"))?)
}
