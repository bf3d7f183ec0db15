//! What the passes of a frame draw into: the target of the context, or textures of cameras. Draw thread.

use std::sync::Arc;

use crate::cull::{RenderStage, StageTarget};
use crate::draw::pipelines::{Bare, MOST_COLORS, Pipelines, TargetFormats};
use crate::draw::resolve::Resolving;
use crate::draw::spread::Spreading;
use crate::draw::state::Dynamics;
use crate::gpu::{GraphicsContext, StateTextures, Transients, texture_format};
use crate::scene::{Attachment, CameraTarget};
use crate::state::{TextureFormat, TextureObject};

/// What a stage comes to.
#[derive(Default)]
pub(super) struct StagePlan {
    /// `None`: cannot be drawn.
    pub(super) target: Option<PassTarget>,
    pub(super) runs: std::ops::Range<usize>,
    /// In the batch, the first runs of its bins, where some of them are drawn by callbacks.
    pub(super) bin_starts: Option<std::ops::Range<usize>>,
    /// First run that what lies behind shines through: sky and water are drawn before it.
    pub(super) see_through: usize,
    /// Index of the statics without any state set.
    pub(super) statics: u32,
    /// Boxes to be tested, in the renderer's list.
    pub(super) queries: std::ops::Range<usize>,
    pub(super) has_sky: bool,
    /// The sea, if there is one.
    pub(super) water: Option<Bare>,
    /// What casts shadows into it and into views inside it, in the renderer's list.
    pub(super) casters: std::ops::Range<usize>,
    /// The textures of two eyes to be put together, and where it is said how.
    pub(super) eyes: Option<([Arc<TextureObject>; 2], usize)>,
    /// What its colours are cleared with, where they are.
    pub(super) clear: Option<wgpu::Color>,
    /// It has a part of its target, or shares the context's: instead of clearing, this leaf is drawn over its viewport, by
    /// this pipeline.
    pub(super) fill: Option<(u32, Bare)>,
    pub(super) is_part: bool,
    /// Colours that begin with what their textures hold are put into their multisampled buffers before.
    pub(super) spreads: bool,
}

/// Where a pass draws.
#[derive(Clone)]
pub(super) struct PassTarget {
    colors: [Option<wgpu::TextureView>; MOST_COLORS],
    /// Where multisampled colours are resolved to.
    resolves: [Option<wgpu::TextureView>; MOST_COLORS],
    /// Of those, which hold what the multisampled buffer does not.
    is_apart: [bool; MOST_COLORS],
    depth: wgpu::TextureView,
    /// The texture that multisampled depth is resolved to.
    depth_resolve: Option<wgpu::TextureView>,
    /// Which holds what the multisampled buffer does not.
    depth_is_apart: bool,
    has_stencil: bool,
    /// Its depth is sampled later, or later stages go on with it.
    keeps_depth: bool,
    pub(super) size_px: [u32; 2],
    /// Most pixels a side of a viewport.
    pub(super) most_px: u32,
    /// A pixel.
    pub(super) samples: u32,
    /// In [`Pipelines`].
    pub(super) index: u8,
    is_outermost: bool,
    /// Nothing was drawn into it in this frame yet.
    pub(super) is_begun: bool,
}

/// Targets of a renderer.
pub(super) struct Targets {
    transients: Transients,
    can_stencil: bool,
    /// Some state uses the stencil in this frame.
    has_stencil: bool,
    /// Stages follow others than pictures in the context's target: its depth is kept.
    has_followers: bool,
    /// Pictures were drawn into the context's target in this frame.
    is_begun: bool,
    /// Addresses of the targets met in this frame, each of which has a depth buffer of its own, and of attachments with
    /// level and layer, each of which has one for its samples.
    owners: Vec<(usize, u32, u32)>,
    /// Owners of multisampled colours and depths that were resolved in this frame, last of all that was drawn there.
    resolved: Vec<u32>,
}

impl Targets {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        Self {
            transients: Transients::default(),
            can_stencil: device.features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8),
            has_stencil: false,
            has_followers: false,
            is_begun: false,
            owners: Vec::new(),
            resolved: Vec::new(),
        }
    }

    /// Looks what the stages of the frame's pictures need; says what the adapter lacks.
    pub(super) fn start_frame<'a>(
        &mut self,
        ctx: &GraphicsContext,
        mut stages: impl Iterator<Item = &'a RenderStage> + Clone,
    ) -> Option<String> {
        self.transients.start_frame(ctx.face_count());
        self.owners.clear();
        self.resolved.clear();
        self.is_begun = false;
        // Depth textures have their own, or none.
        let needs_stencil = |stage: &RenderStage| {
            depth_of(stage).is_none() && stage.state_sets.iter().any(|state| state.stencil().is_some())
        };
        let needs_stencil = stages.clone().any(|stage| any(stage, &needs_stencil));
        self.has_stencil = needs_stencil && self.can_stencil;
        // A picture clears the depth of those before it.
        self.has_followers = stages.any(|stage| {
            let [before, after] =
                [&stage.pre_render, &stage.post_render].map(|s| s.iter().map(in_context).sum::<usize>());
            before > 1 || after > 0
        });
        (needs_stencil && !self.can_stencil)
            .then(|| "the adapter has no stencil beside float depth; stencil tests pass everywhere".into())
    }

    pub(super) fn depth_format(&self) -> wgpu::TextureFormat {
        if self.has_stencil { wgpu::TextureFormat::Depth32FloatStencil8 } else { crate::gpu::DEPTH_FORMAT }
    }

    /// Where a stage draws; why it cannot.
    pub(super) fn of(
        &mut self,
        ctx: &GraphicsContext,
        textures: &mut StateTextures,
        pipelines: &mut Pipelines,
        target: &StageTarget,
        is_outermost: bool,
    ) -> Result<PassTarget, String> {
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
    ) -> Result<PassTarget, String> {
        let is_begun = self.is_begun;
        self.is_begun |= is_outermost;
        let view = ctx.color_view().ok_or("the window has no image to draw into")?.clone();
        let (size_px, samples, depth) = (ctx.size_px(), ctx.samples(), self.depth_format());
        let format = ctx.color_format();
        let mut key = TargetFormats { colors: [None; MOST_COLORS], depth, samples, keeps_alpha: false };
        key.colors[0] = Some(format);
        let mut colors = [const { None }; MOST_COLORS];
        let mut resolves = [const { None }; MOST_COLORS];
        if samples > 1 {
            colors[0] = Some(self.transients.view(ctx.memory(), size_px, format, samples, 0)?);
            resolves[0] = Some(view);
        } else {
            colors[0] = Some(view);
        }
        Ok(PassTarget {
            colors,
            resolves,
            is_apart: [false; MOST_COLORS],
            depth: self.transients.view(ctx.memory(), size_px, depth, samples, 0)?,
            depth_resolve: None,
            depth_is_apart: false,
            has_stencil: self.has_stencil,
            keeps_depth: self.has_followers,
            size_px,
            most_px: ctx.device().limits().max_texture_dimension_2d,
            samples,
            index: pipelines.target(&key).ok_or("more different targets than there can be")?,
            is_outermost,
            is_begun,
        })
    }

    /// The number of a camera's target or of an attachment's level and layer, by address, in this frame.
    fn owner(&mut self, of: (usize, u32, u32)) -> u32 {
        let place = self.owners.iter().position(|owner| *owner == of).unwrap_or_else(|| {
            self.owners.push(of);
            self.owners.len() - 1
        });
        place as u32 + 1
    }

    /// Whether the multisampled buffer of an owner lacks what its texture holds; notes that it is drawn into.
    fn is_apart(&mut self, owner: u32, samples: u32) -> bool {
        let known = self.resolved.iter().position(|resolved| *resolved == owner);
        match (samples > 1, known) {
            (true, None) => self.resolved.push(owner),
            (false, Some(place)) => drop(self.resolved.swap_remove(place)),
            _ => {}
        }
        samples > 1 && known.is_none()
    }

    fn of_camera(
        &mut self,
        ctx: &GraphicsContext,
        textures: &mut StateTextures,
        pipelines: &mut Pipelines,
        camera: &Arc<CameraTarget>,
        is_outermost: bool,
    ) -> Result<PassTarget, String> {
        let device = ctx.device();
        let samples = if camera.samples > 1 { 4 } else { 1 };
        let owner = self.owner((Arc::as_ptr(camera) as usize, 0, 0));
        if camera.colors.len() > MOST_COLORS {
            return Err(format!("a camera has {} colour attachments; {MOST_COLORS} are possible", camera.colors.len()));
        }
        let mut size_px = None;
        let mut check = |attachment: &Attachment| -> Result<(), String> {
            let [width, height, _] = attachment.texture.level_size(attachment.level);
            let name = &attachment.texture.name;
            if *size_px.get_or_insert([width, height]) != [width, height] {
                return Err(format!("texture {name:?} has another size than the camera's other attachments"));
            }
            Ok(())
        };
        for attachment in camera.colors.iter().chain(&camera.depth) {
            check(attachment)?;
        }
        let size_px = size_px.ok_or("a camera without attachments")?;
        let mut view = |attachment: &Attachment| -> Result<wgpu::TextureView, String> {
            let texture = &attachment.texture;
            let name = &texture.name;
            if !texture.texels.is_empty() {
                return Err(format!("texture {name:?} has contents and is no target to draw into"));
            }
            // What was wrong with it has been said.
            textures.ensure(device, ctx.queue(), texture)?.ok_or_else(String::new)?;
            let (level, layer) = (attachment.level, attachment.layer);
            textures
                .attachment(texture, level, layer)
                .ok_or_else(|| format!("texture {name:?} has no level {level} of layer {layer} to draw into"))
        };
        let mut key =
            TargetFormats { colors: [None; MOST_COLORS], depth: self.depth_format(), samples, keeps_alpha: true };
        let mut colors = [const { None }; MOST_COLORS];
        let mut resolves = [const { None }; MOST_COLORS];
        let mut owners = [None; MOST_COLORS];
        for (location, attachment) in camera.colors.iter().enumerate() {
            let Attachment { texture, level, layer } = attachment;
            let is_it = |a: &Attachment| Arc::ptr_eq(&a.texture, texture) && (a.level, a.layer) == (*level, *layer);
            if camera.colors[..location].iter().any(is_it) {
                return Err(format!("texture {:?} is attached twice: level {level} of layer {layer}", texture.name));
            }
            let format = texture.format;
            if format.is_depth() {
                return Err(format!("texture {:?} holds depth and is attached as colour", texture.name));
            }
            if format == TextureFormat::R32Float && samples > 1 {
                let name = &texture.name;
                return Err(format!("texture {name:?} holds numbers of 32 bits, of which samples cannot be resolved"));
            }
            let format = texture_format(format);
            key.colors[location] = Some(format);
            let into = view(attachment)?;
            // Of what is drawn into, whichever camera does: it goes there as a whole.
            let owner = self.owner((Arc::as_ptr(texture) as usize, *level, *layer));
            owners[location] = Some(owner);
            if samples > 1 {
                colors[location] = Some(self.transients.view(ctx.memory(), size_px, format, samples, owner)?);
                resolves[location] = Some(into);
            } else {
                colors[location] = Some(into);
            }
        }
        let mut depth_owner = None;
        let mut depth_resolve = None;
        let depth = match &camera.depth {
            Some(attachment) if !attachment.texture.format.is_depth() => {
                return Err(format!("texture {:?} holds colour and is attached as depth", attachment.texture.name));
            }
            Some(attachment) => {
                let Attachment { texture, level, layer } = attachment;
                key.depth = texture_format(texture.format);
                let into = view(attachment)?;
                let owner = self.owner((Arc::as_ptr(texture) as usize, *level, *layer));
                depth_owner = Some(owner);
                if samples > 1 {
                    depth_resolve = Some(into);
                    self.transients.readable_view(ctx.memory(), size_px, key.depth, samples, owner)?
                } else {
                    into
                }
            }
            None => self.transients.view(ctx.memory(), size_px, key.depth, samples, owner)?,
        };
        let index = pipelines.target(&key).ok_or("more different targets than there can be")?;
        let mut is_apart = [false; MOST_COLORS];
        for (is_apart, owner) in is_apart.iter_mut().zip(owners) {
            *is_apart = owner.is_some_and(|owner| self.is_apart(owner, samples));
        }
        let depth_is_apart = depth_owner.is_some_and(|owner| self.is_apart(owner, samples));
        Ok(PassTarget {
            colors,
            resolves,
            is_apart,
            depth,
            depth_resolve,
            depth_is_apart,
            has_stencil: key.depth.has_stencil_aspect(),
            keeps_depth: true,
            size_px,
            most_px: device.limits().max_texture_dimension_2d,
            samples,
            index,
            is_outermost,
            is_begun: false,
        })
    }
}

/// The depth texture of the camera that a stage is of.
fn depth_of(stage: &RenderStage) -> Option<&Arc<TextureObject>> {
    stage.target.camera.as_ref()?.depth.as_ref().map(|depth| &depth.texture)
}

/// True when something holds for a stage or one around it.
fn any(stage: &RenderStage, holds: &impl Fn(&RenderStage) -> bool) -> bool {
    holds(stage) || stage.pre_render.iter().chain(&stage.post_render).any(|s| any(s, holds))
}

/// How many of a stage and those around it draw into the context's target.
fn in_context(stage: &RenderStage) -> usize {
    let around = stage.pre_render.iter().chain(&stage.post_render);
    usize::from(stage.target.camera.is_none()) + around.map(in_context).sum::<usize>()
}

impl PassTarget {
    /// What holds without any state set.
    pub(super) fn dynamics(&self, viewport_px: Option<[u32; 4]>) -> Dynamics {
        let [width, height] = self.size_px;
        let rect = viewport_px.unwrap_or([0, 0, width, height]).map(|v| v as f32);
        let [x, y, w, h] = self.viewport(rect);
        Dynamics {
            viewport: [x, y, w, h, 0.0, 1.0],
            scissor: [0, 0, width, height],
            stencil_reference: 0,
            blend_color: None,
        }
    }

    /// A viewport that wgpu takes: finite, not empty, not too large. It may reach beyond the target, which cuts off what
    /// is drawn there.
    pub(super) fn viewport(&self, rect: [f32; 4]) -> [f32; 4] {
        let most = self.most_px as f32;
        let [x, y, width, height] = rect.map(|v| if v.is_finite() { v } else { 0.0 });
        let [width, height] = [width, height].map(|side| side.clamp(1.0, most));
        // It wholly lies between -2 and 2 times the most; less one as wgpu has it, and one for what is rounded.
        let (x, y) = (x.clamp(-most, 2.0 * most - width - 2.0), y.clamp(-most, 2.0 * most - height - 2.0));
        [x, y, width, height]
    }

    /// True for textures that the stage itself draws into.
    pub(super) fn draws_into(&self, stage: &RenderStage, texture: &Arc<TextureObject>) -> bool {
        let attachments = stage.target.camera.iter().flat_map(|c| c.colors.iter().chain(&c.depth));
        attachments.into_iter().any(|a| Arc::ptr_eq(&a.texture, texture))
    }

    /// The depth texture of a stage where it has no stencil.
    pub(super) fn depth_without_stencil<'a>(&self, stage: &'a RenderStage) -> Option<&'a Arc<TextureObject>> {
        depth_of(stage).filter(|_| !self.has_stencil)
    }

    /// A whole picture is drawn, or an eye's.
    pub(super) fn is_outermost(&self) -> bool {
        self.is_outermost
    }

    /// A stage draws into a part of it only.
    pub(super) fn is_part(&self, stage: &RenderStage) -> bool {
        let [width, height] = self.size_px;
        stage.target.viewport_px.is_some_and(|rect| rect != [0, 0, width, height])
    }

    pub(super) fn color_count(&self) -> usize {
        self.colors.iter().rposition(Option::is_some).map_or(0, |last| last + 1)
    }

    /// With what all of its colours begin; `None`: with what is there.
    pub(super) fn clear_color(&self, stage: &RenderStage, plan: &StagePlan) -> Option<wgpu::Color> {
        match stage.clear_node {
            _ if plan.is_part => (self.is_outermost && !self.is_begun).then_some(wgpu::Color::BLACK),
            Some(said) => said.map(color),
            None => plan.clear,
        }
    }

    /// Multisampled colours whose textures hold what they do not, by location; `formats` are the target's.
    pub(super) fn spreading<'a>(&'a self, formats: &'a TargetFormats) -> impl Iterator<Item = Spreading<'a>> {
        let apart = self.is_apart.iter().zip(&self.colors).zip(&self.resolves).zip(formats.colors);
        apart.filter_map(|(((is_apart, samples), texture), format)| {
            let (samples, texture, format) = (samples.as_ref()?, texture.as_ref()?, format?);
            is_apart.then_some(Spreading { texture, samples, kind: (format, formats.samples) })
        })
    }

    /// Multisampled depth that a texture gets once a stage is drawn.
    pub(super) fn resolving(&self, stage: &RenderStage) -> Option<Resolving<'_>> {
        let [width, height] = self.size_px;
        let [left, top, across, down] = stage.target.viewport_px.unwrap_or([0, 0, width, height]);
        let (x, y) = (left.min(width), top.min(height));
        let part_px = [x, y, across.min(width - x), down.min(height - y)];
        self.depth_resolve.as_ref().map(|texture| Resolving { samples: &self.depth, texture, part_px })
    }

    pub(super) fn color_attachments<'a>(
        &'a self,
        stage: &RenderStage,
        plan: &StagePlan,
    ) -> [Option<wgpu::RenderPassColorAttachment<'a>>; MOST_COLORS] {
        let clear = self.clear_color(stage, plan);
        let load = clear.map_or(wgpu::LoadOp::Load, wgpu::LoadOp::Clear);
        let mut attachments = [const { None }; MOST_COLORS];
        for ((attachment, view), resolve) in attachments.iter_mut().zip(&self.colors).zip(&self.resolves) {
            *attachment = view.as_ref().map(|view| wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: resolve.as_ref(),
                ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
            });
        }
        attachments
    }

    pub(super) fn depth_attachment(&self, stage: &RenderStage) -> wgpu::RenderPassDepthStencilAttachment<'_> {
        // The depth of a part is filled. Several samples begin anew in each frame.
        let clears = self.is_outermost || self.depth_is_apart || stage.target.clear_depth && !self.is_part(stage);
        let store = if self.keeps_depth { wgpu::StoreOp::Store } else { wgpu::StoreOp::Discard };
        // Reversed-Z: infinitely far is 0.
        let load = if clears { wgpu::LoadOp::Clear(0.0) } else { wgpu::LoadOp::Load };
        let stencil_load = if clears { wgpu::LoadOp::Clear(0) } else { wgpu::LoadOp::Load };
        wgpu::RenderPassDepthStencilAttachment {
            view: &self.depth,
            depth_ops: Some(wgpu::Operations { load, store }),
            stencil_ops: self.has_stencil.then_some(wgpu::Operations { load: stencil_load, store }),
        }
    }
}

pub(super) fn color([r, g, b, a]: [f32; 4]) -> wgpu::Color {
    let [r, g, b, a] = [r, g, b, a].map(f64::from);
    wgpu::Color { r, g, b, a }
}
