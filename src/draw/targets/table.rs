//! The render targets of a frame: finds or creates the attachments of each stage. Draw thread.

use std::sync::Arc;

use super::camera_target::CameraAttachments;
use super::error::TargetError;
use super::owners::Owners;
use super::pass_target::{DisplayedImage, PassTarget, Tones, depth_of};
use crate::cull::{RenderStage, StageTarget};
use crate::draw::pipelines::{MAX_COLOR_ATTACHMENTS, Pipelines, TargetFormats};
use crate::gpu::{GraphicsContext, StateTextures, TransientAttachments};
use crate::scene::{CameraTarget, ToneMapping};

const TOO_MANY_TARGETS: &str = "more kinds of targets in a frame than the 4,095 that pipelines tell apart";

/// The targets of a renderer.
pub(in crate::draw) struct Targets {
    transients: TransientAttachments,
    owners: Owners,
    supports_stencil: bool,
    /// True if some state of this frame uses the stencil.
    has_stencil: bool,
    /// True if stages other than those of views are drawn into the context's target after others, so that its depth is kept.
    keeps_depth: bool,
    /// The tones of the view that is prepared.
    tones: Tones,
    /// True once a view was drawn into the context's target in this frame.
    is_begun: bool,
}

impl Targets {
    pub(in crate::draw) fn new(device: &wgpu::Device) -> Self {
        Self {
            transients: TransientAttachments::default(),
            owners: Owners::default(),
            supports_stencil: device.features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8),
            has_stencil: false,
            keeps_depth: false,
            tones: Tones::Displayed,
            is_begun: false,
        }
    }

    /// Finds out what the stages of a frame's views need. Returns an error text if the adapter lacks it.
    pub(in crate::draw) fn start_frame<'a>(
        &mut self,
        ctx: &GraphicsContext,
        mut stages: impl Iterator<Item = &'a RenderStage> + Clone,
    ) -> Option<&'static str> {
        self.transients.start_frame(ctx.target_count());
        self.owners.start_frame();
        self.is_begun = false;
        // A camera's depth texture has its own stencil, or none.
        let uses_stencil = |stage: &RenderStage| {
            depth_of(stage).is_none() && stage.state_sets.iter().any(|state| state.stencil().is_some())
        };
        let needs_stencil = stages.clone().any(|stage| any(stage, &uses_stencil));
        self.has_stencil = needs_stencil && self.supports_stencil;
        // A view itself clears the depth of views before it.
        self.keeps_depth = stages.any(|stage| {
            let [before, after] =
                [&stage.pre_render, &stage.post_render].map(|s| s.iter().map(stages_in_context).sum::<usize>());
            before > 1 || after > 0
        });
        (needs_stencil && !self.supports_stencil)
            .then_some("the adapter has no stencil beside float depth; stencil tests pass everywhere")
    }

    /// Returns the format of depth buffers beside a stencil; `None` if the adapter lacks it.
    pub(in crate::draw) fn stencil_format(&self) -> Option<wgpu::TextureFormat> {
        self.supports_stencil.then_some(wgpu::TextureFormat::Depth32FloatStencil8)
    }

    /// Starts a view: all its stages that draw into the context's target have the same tones.
    pub(in crate::draw) fn start_view(&mut self, stage: &RenderStage, tone_mapping: ToneMapping) {
        let in_own_pass = tone_mapping == ToneMapping::InOwnPass && stage.stereo.is_none();
        self.tones = if in_own_pass { Tones::LightToDisplay } else { Tones::Displayed };
    }

    /// Returns the format that a view of some tones is drawn in on the context's target.
    pub(in crate::draw) fn drawn_format(ctx: &GraphicsContext, tones: Tones) -> wgpu::TextureFormat {
        match tones {
            Tones::LightToDisplay | Tones::Light => wgpu::TextureFormat::Rgba16Float,
            Tones::Displayed => ctx.drawn_format(),
        }
    }

    /// Returns the format of depth buffers of this frame.
    pub(in crate::draw) fn depth_format(&self) -> wgpu::TextureFormat {
        if self.has_stencil { wgpu::TextureFormat::Depth32FloatStencil8 } else { crate::gpu::DEPTH_FORMAT }
    }

    /// Returns the attachments of a stage.
    pub(in crate::draw) fn find(
        &mut self,
        ctx: &GraphicsContext,
        textures: &mut StateTextures,
        pipelines: &mut Pipelines,
        target: &StageTarget,
        is_outermost: bool,
    ) -> Result<PassTarget, TargetError> {
        match &target.camera {
            Some(camera) => self.of_camera(ctx, textures, pipelines, camera, is_outermost),
            None => self.of_context(ctx, pipelines, is_outermost),
        }
    }

    fn of_context(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        is_outermost: bool,
    ) -> Result<PassTarget, TargetError> {
        let is_begun = self.is_begun;
        self.is_begun |= is_outermost;
        let view = ctx.color_view().ok_or_else(|| "the window has no image to draw into".to_owned())?.clone();
        let (size_px, samples, depth) = (ctx.size_px(), ctx.samples(), self.depth_format());
        let format = Self::drawn_format(ctx, self.tones);
        let mut formats = TargetFormats { colors: [None; MAX_COLOR_ATTACHMENTS], depth, samples, keeps_alpha: false };
        formats.colors[0] = Some(format);
        let mut colors = [const { None }; MAX_COLOR_ATTACHMENTS];
        let mut resolves = [const { None }; MAX_COLOR_ATTACHMENTS];
        let is_displayed = self.tones != Tones::Displayed || format != ctx.color_format();
        let display = match is_displayed {
            true => {
                let image = self.transients.readable_view(ctx.memory(), size_px, format, 1, 0)?;
                Some(DisplayedImage { image, target: view.clone(), format: ctx.color_format() })
            }
            false => None,
        };
        let image = display.as_ref().map_or(view, |display| display.image.clone());
        if samples > 1 {
            colors[0] = Some(self.transients.view(ctx.memory(), size_px, format, samples, 0)?);
            resolves[0] = Some(image);
        } else {
            colors[0] = Some(image);
        }
        Ok(PassTarget {
            colors,
            resolves,
            slices: [None; MAX_COLOR_ATTACHMENTS],
            is_stale: [false; MAX_COLOR_ATTACHMENTS],
            depth: self.transients.view(ctx.memory(), size_px, depth, samples, 0)?,
            depth_resolve: None,
            depth_is_stale: false,
            has_stencil: self.has_stencil,
            keeps_depth: self.keeps_depth,
            size_px,
            max_px: ctx.device().limits().max_texture_dimension_2d,
            samples,
            tones: self.tones,
            display,
            index: pipelines.target(&formats).ok_or_else(|| TOO_MANY_TARGETS.to_owned())?,
            is_outermost,
            is_begun,
        })
    }

    fn of_camera(
        &mut self,
        ctx: &GraphicsContext,
        textures: &mut StateTextures,
        pipelines: &mut Pipelines,
        camera: &Arc<CameraTarget>,
        is_outermost: bool,
    ) -> Result<PassTarget, TargetError> {
        let camera_owner = self.owners.of_camera(camera);
        let attachments = CameraAttachments::new(ctx, textures, camera, self.depth_format())?;
        let CameraAttachments { size_px, formats, slices, .. } = attachments;
        let samples = formats.samples;
        let mut colors = [const { None }; MAX_COLOR_ATTACHMENTS];
        let mut resolves = [const { None }; MAX_COLOR_ATTACHMENTS];
        let mut owners = [None; MAX_COLOR_ATTACHMENTS];
        for (location, attachment) in camera.colors.iter().enumerate() {
            let (Some(format), Some(view)) = (formats.colors[location], attachments.colors[location].clone()) else {
                continue;
            };
            let owner = self.owners.of_attachment(attachment);
            owners[location] = Some(owner);
            if samples > 1 {
                colors[location] = Some(self.transients.view(ctx.memory(), size_px, format, samples, owner)?);
                resolves[location] = Some(view);
            } else {
                colors[location] = Some(view);
            }
        }
        let mut depth_owner = None;
        let mut depth_resolve = None;
        let depth = match (&camera.depth, attachments.depth) {
            (Some(attachment), Some(view)) => {
                let owner = self.owners.of_attachment(attachment);
                depth_owner = Some(owner);
                if samples > 1 {
                    depth_resolve = Some(view);
                    self.transients.readable_view(ctx.memory(), size_px, formats.depth, samples, owner)?
                } else {
                    view
                }
            }
            _ => self.transients.view(ctx.memory(), size_px, formats.depth, samples, camera_owner)?,
        };
        let index = pipelines.target(&formats).ok_or_else(|| TOO_MANY_TARGETS.to_owned())?;
        let mut is_stale = [false; MAX_COLOR_ATTACHMENTS];
        for (is_stale, owner) in is_stale.iter_mut().zip(owners) {
            *is_stale = owner.is_some_and(|owner| self.owners.draw_into(owner, samples));
        }
        Ok(PassTarget {
            colors,
            resolves,
            slices,
            is_stale,
            depth,
            depth_resolve,
            depth_is_stale: depth_owner.is_some_and(|owner| self.owners.draw_into(owner, samples)),
            has_stencil: formats.depth.has_stencil_aspect(),
            keeps_depth: true,
            size_px,
            max_px: ctx.device().limits().max_texture_dimension_2d,
            samples,
            tones: if formats.colors[0].is_some_and(is_float) { Tones::Light } else { Tones::Displayed },
            display: None,
            index,
            is_outermost,
            is_begun: false,
        })
    }
}

/// Returns true for formats that hold light without a limit.
fn is_float(format: wgpu::TextureFormat) -> bool {
    matches!(format, wgpu::TextureFormat::Rgba16Float | wgpu::TextureFormat::R32Float)
}

/// Returns true if something holds for a stage or one before or after it.
fn any(stage: &RenderStage, holds: &impl Fn(&RenderStage) -> bool) -> bool {
    holds(stage) || stage.pre_render.iter().chain(&stage.post_render).any(|s| any(s, holds))
}

/// Returns how many of a stage and those before and after it draw into the context's target.
fn stages_in_context(stage: &RenderStage) -> usize {
    let around = stage.pre_render.iter().chain(&stage.post_render);
    usize::from(stage.target.camera.is_none()) + around.map(stages_in_context).sum::<usize>()
}
