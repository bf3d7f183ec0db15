//! The attachments that a stage draws into. Plain values of the draw thread.

use std::sync::Arc;

use crate::cull::RenderStage;
use crate::draw::bound_state::DynamicState;
use crate::draw::pipelines::{MAX_COLOR_ATTACHMENTS, TargetFormats};
use crate::state::TextureObject;

/// A multisampled colour buffer and the texture that it is resolved into.
#[derive(Clone, Copy)]
pub(in crate::draw) struct ColorSamples<'a> {
    pub(in crate::draw) texture: &'a wgpu::TextureView,
    pub(in crate::draw) samples: &'a wgpu::TextureView,
    pub(in crate::draw) format: wgpu::TextureFormat,
    pub(in crate::draw) sample_count: u32,
}

/// A multisampled depth buffer and the texture that it is resolved into.
#[derive(Clone, Copy)]
pub(in crate::draw) struct DepthSamples<'a> {
    pub(in crate::draw) samples: &'a wgpu::TextureView,
    pub(in crate::draw) texture: &'a wgpu::TextureView,
    /// The part that the stage draws: x, y, width, height in pixels.
    pub(in crate::draw) part_px: [u32; 4],
}

/// The meaning of the colours that fragments write into a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Tones {
    /// Colours of a display: shaders map the tones.
    Displayed,
    /// Light, which is not mapped: the float texture of a camera.
    Light,
    /// Light that the display pass maps.
    LightToDisplay,
}

impl Tones {
    /// Returns the exposure as the frame uniform has it: 0 without tone mapping, negative if a later pass maps tones.
    pub(in crate::draw) fn exposure(self, exposure: f32) -> f32 {
        match self {
            Self::Displayed => exposure,
            Self::Light => 0.0,
            Self::LightToDisplay => -exposure,
        }
    }

    /// Returns the value to write for a background's colour; the function `displayed` of frame.wgsl.
    pub(in crate::draw) fn displayed(self, color: wgpu::Color, exposure: f32) -> wgpu::Color {
        if self != Self::LightToDisplay || exposure <= 0.0 {
            return color;
        }
        let wgpu::Color { r, g, b, a } = color;
        let [r, g, b] = [r, g, b].map(|channel| channel / f64::from(exposure));
        wgpu::Color { r, g, b, a }
    }
}

/// The image of a stage that is not drawn into the target itself, and the target that the display pass shows it in.
#[derive(Clone)]
pub(in crate::draw) struct DisplayedImage {
    pub(in crate::draw) image: wgpu::TextureView,
    pub(in crate::draw) target: wgpu::TextureView,
    pub(in crate::draw) format: wgpu::TextureFormat,
}

/// The attachments of a stage's render pass. More than 16 fields: one for each list of views that wgpu's descriptor borrows, and
/// one for each way in which passes into the target differ.
#[derive(Clone)]
pub(in crate::draw) struct PassTarget {
    pub(super) colors: [Option<wgpu::TextureView>; MAX_COLOR_ATTACHMENTS],
    /// The textures that multisampled colours are resolved into.
    pub(super) resolves: [Option<wgpu::TextureView>; MAX_COLOR_ATTACHMENTS],
    /// By location, the slice of a volume.
    pub(super) slices: [Option<u32>; MAX_COLOR_ATTACHMENTS],
    /// For each resolved one, true if the multisampled buffer lacks the texture's contents.
    pub(super) is_stale: [bool; MAX_COLOR_ATTACHMENTS],
    pub(super) depth: wgpu::TextureView,
    /// The texture that multisampled depth is resolved into.
    pub(super) depth_resolve: Option<wgpu::TextureView>,
    /// True if the multisampled depth buffer lacks the texture's contents.
    pub(super) depth_is_stale: bool,
    pub(super) has_stencil: bool,
    /// True if the depth is sampled later, or tested by later stages.
    pub(super) keeps_depth: bool,
    pub(in crate::draw) size_px: [u32; 2],
    /// The largest side of a viewport in pixels.
    pub(super) max_px: u32,
    /// Samples a pixel.
    pub(in crate::draw) samples: u32,
    pub(in crate::draw) tones: Tones,
    /// `None` for stages that draw into their target itself.
    pub(in crate::draw) display: Option<DisplayedImage>,
    /// Index of its formats in [`Pipelines`](crate::draw::pipelines::Pipelines).
    pub(in crate::draw) index: u16,
    pub(super) is_outermost: bool,
    /// True if an earlier view of this frame was drawn into the same target.
    pub(in crate::draw) is_begun: bool,
}

/// Returns the depth texture of the camera of a stage.
pub(super) fn depth_of(stage: &RenderStage) -> Option<&Arc<TextureObject>> {
    stage.target.camera.as_ref()?.depth.as_ref().map(|depth| &depth.texture)
}

impl PassTarget {
    /// Returns the dynamic state without any state set.
    pub(in crate::draw) fn dynamics(&self, viewport_px: Option<[u32; 4]>) -> DynamicState {
        let [width, height] = self.size_px;
        let rect = viewport_px.unwrap_or([0, 0, width, height]).map(|v| v as f32);
        let [x, y, w, h] = self.viewport(rect);
        DynamicState {
            viewport: [x, y, w, h, 0.0, 1.0],
            scissor: [0, 0, width, height],
            stencil_reference: 0,
            blend_color: None,
        }
    }

    /// Returns a viewport that wgpu accepts: finite, not empty, not too large. It may reach beyond the target, whose edge
    /// then clips the drawing.
    pub(in crate::draw) fn viewport(&self, rect: [f32; 4]) -> [f32; 4] {
        let max = self.max_px as f32;
        let [x, y, width, height] = rect.map(|v| if v.is_finite() { v } else { 0.0 });
        let [width, height] = [width, height].map(|side| side.clamp(1.0, max));
        // wgpu requires that it lies between -2 max and 2 max - 1; one more pixel is left for rounding.
        let (x, y) = (x.clamp(-max, 2.0 * max - width - 2.0), y.clamp(-max, 2.0 * max - height - 2.0));
        [x, y, width, height]
    }

    /// Returns true for textures that the stage itself draws into.
    pub(in crate::draw) fn has_attachment(&self, stage: &RenderStage, texture: &Arc<TextureObject>) -> bool {
        let attachments = stage.target.camera.iter().flat_map(|c| c.colors.iter().chain(&c.depth));
        attachments.into_iter().any(|a| Arc::ptr_eq(&a.texture, texture))
    }

    /// Returns the depth texture of a stage, if it has one without a stencil.
    pub(in crate::draw) fn depth_without_stencil<'a>(&self, stage: &'a RenderStage) -> Option<&'a Arc<TextureObject>> {
        depth_of(stage).filter(|_| !self.has_stencil)
    }

    /// Returns true for a view of the frame and for the image of an eye.
    pub(in crate::draw) fn is_outermost(&self) -> bool {
        self.is_outermost
    }

    /// Returns true if a stage draws into a part of the target only.
    pub(in crate::draw) fn is_part(&self, stage: &RenderStage) -> bool {
        let [width, height] = self.size_px;
        stage.target.viewport_px.is_some_and(|rect| rect != [0, 0, width, height])
    }

    /// Returns the number of colour attachments, unused locations before the last included.
    pub(in crate::draw) fn color_count(&self) -> usize {
        self.colors.iter().rposition(Option::is_some).map_or(0, |last| last + 1)
    }

    /// Returns the multisampled colours that lack the contents of their textures, by location. `formats` are the target's.
    pub(in crate::draw) fn stale_colors<'a>(
        &'a self,
        formats: &'a TargetFormats,
    ) -> impl Iterator<Item = ColorSamples<'a>> {
        let colors = self.is_stale.iter().zip(&self.colors).zip(&self.resolves).zip(formats.colors);
        colors.filter_map(|(((is_stale, samples), texture), format)| {
            let (samples, texture, format) = (samples.as_ref()?, texture.as_ref()?, format?);
            is_stale.then_some(ColorSamples { texture, samples, format, sample_count: formats.samples })
        })
    }

    /// Returns the multisampled depth that is resolved into a texture once a stage is drawn.
    pub(in crate::draw) fn resolved_depth(&self, stage: &RenderStage) -> Option<DepthSamples<'_>> {
        let [width, height] = self.size_px;
        let [left, top, across, down] = stage.target.viewport_px.unwrap_or([0, 0, width, height]);
        let (x, y) = (left.min(width), top.min(height));
        let part_px = [x, y, across.min(width - x), down.min(height - y)];
        self.depth_resolve.as_ref().map(|texture| DepthSamples { samples: &self.depth, texture, part_px })
    }

    /// Returns the colour attachments of a pass that clears them with a colour, or keeps them.
    pub(in crate::draw) fn color_attachments(
        &self,
        clear_color: Option<wgpu::Color>,
    ) -> [Option<wgpu::RenderPassColorAttachment<'_>>; MAX_COLOR_ATTACHMENTS] {
        let load = clear_color.map_or(wgpu::LoadOp::Load, wgpu::LoadOp::Clear);
        let mut attachments = [const { None }; MAX_COLOR_ATTACHMENTS];
        let views = self.colors.iter().zip(&self.resolves).zip(self.slices);
        for (attachment, ((view, resolve), depth_slice)) in attachments.iter_mut().zip(views) {
            *attachment = view.as_ref().map(|view| wgpu::RenderPassColorAttachment {
                view,
                depth_slice,
                resolve_target: resolve.as_ref(),
                ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
            });
        }
        attachments
    }

    /// Returns the depth attachment of a stage's pass.
    pub(in crate::draw) fn depth_attachment(&self, stage: &RenderStage) -> wgpu::RenderPassDepthStencilAttachment<'_> {
        // The depth of a part is filled by a triangle. Multisampled depth cannot be restored and is cleared.
        let clears = self.is_outermost || self.depth_is_stale || stage.target.clear_depth && !self.is_part(stage);
        let store = if self.keeps_depth { wgpu::StoreOp::Store } else { wgpu::StoreOp::Discard };
        // Depths are reversed: 0 is infinitely far.
        let load = if clears { wgpu::LoadOp::Clear(0.0) } else { wgpu::LoadOp::Load };
        let stencil_load = if clears { wgpu::LoadOp::Clear(0) } else { wgpu::LoadOp::Load };
        wgpu::RenderPassDepthStencilAttachment {
            view: &self.depth,
            depth_ops: Some(wgpu::Operations { load, store }),
            stencil_ops: self.has_stencil.then_some(wgpu::Operations { load: stencil_load, store }),
        }
    }
}

/// Converts a linear colour to wgpu's type.
pub(in crate::draw) fn wgpu_color([r, g, b, a]: [f32; 4]) -> wgpu::Color {
    let [r, g, b, a] = [r, g, b, a].map(f64::from);
    wgpu::Color { r, g, b, a }
}
