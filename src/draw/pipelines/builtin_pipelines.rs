//! Built-in pipelines: those of passes that draw without a state of the scene. Draw thread.

use super::builder::{ShaderSource, Variant};
use super::cache::Pipelines;
use super::convert::zeroed;
use super::pipeline_thread::Order;
use super::sources::{FILL_WGSL, QUERY_WGSL, SHADOWED_WATER_WGSL, SKY_WGSL, WATER_WGSL};
use crate::gpu::{GraphicsContext, MAX_COLOR_ATTACHMENTS, TargetFormats};

/// The kinds of built-in pipelines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Builtin {
    /// The sky behind opaque runs.
    Sky,
    /// The sea.
    Water,
    /// The sea with the sun's shadows on it.
    ShadowedWater,
    /// Boxes of occlusion queries.
    Query,
    /// A triangle that fills a part of a target with a colour and the farthest depth.
    Fill,
    /// The same for the colour alone.
    FillColor,
    /// The same for the depth alone.
    FillDepth,
}

/// The result of creating a pipeline for a target.
enum Attempt {
    /// Ordered from the pipeline thread, or not.
    NotCreated(Option<Order<wgpu::RenderPipeline>>),
    Created(wgpu::RenderPipeline),
    /// The device refused it; it is not tried again.
    Refused,
}

/// The pipelines of one kind, one for each target.
pub(in crate::draw) struct BuiltinPipelines {
    kind: Builtin,
    /// By index of the target, with the formats that it had: the index may become that of another kind.
    by_target: Vec<(Option<TargetFormats>, Attempt)>,
}

impl BuiltinPipelines {
    pub(in crate::draw) fn new(kind: Builtin) -> Self {
        Self { kind, by_target: Vec::new() }
    }

    /// Returns the pipeline of a target, if [`Self::ensure`] has created it.
    pub(in crate::draw) fn get(&self, target: u16) -> Option<&wgpu::RenderPipeline> {
        match &self.by_target.get(usize::from(target))?.1 {
            Attempt::Created(pipeline) => Some(pipeline),
            Attempt::NotCreated(_) | Attempt::Refused => None,
        }
    }

    /// Creates or orders the pipeline of a target at the first call for it.
    pub(in crate::draw) fn ensure(&mut self, ctx: &GraphicsContext, pipelines: &mut Pipelines, target: u16) {
        let Some(formats) = pipelines.target_formats(target).copied() else { return };
        let index = usize::from(target);
        if self.by_target.len() <= index {
            self.by_target.resize_with(index + 1, || (None, Attempt::NotCreated(None)));
        }
        if self.by_target[index].0 != Some(formats) {
            self.by_target[index] = (Some(formats), Attempt::NotCreated(None));
        }
        if let Attempt::NotCreated(order) = &mut self.by_target[index].1
            && let Some(tried) = pipelines.try_builtin(ctx, order, || variant(self.kind, formats))
        {
            self.by_target[index].1 = tried.map_or(Attempt::Refused, Attempt::Created);
        }
    }
}

/// Returns the properties of a pipeline for a target.
fn variant(kind: Builtin, formats: TargetFormats) -> Variant {
    let (label, source, entries) = match kind {
        Builtin::Sky => ("sky", SKY_WGSL, ["vs_sky", "fs_sky"]),
        Builtin::Water => ("water", WATER_WGSL, ["vs_sky", "fs_water"]),
        Builtin::ShadowedWater => ("shadowed water", SHADOWED_WATER_WGSL, ["vs_sky", "fs_water"]),
        Builtin::Query => ("query", QUERY_WGSL, ["vs_query", "fs_query"]),
        Builtin::Fill | Builtin::FillColor | Builtin::FillDepth => ("fill", FILL_WGSL, ["vs_fill", "fs_fill"]),
    };
    let mut variant = Variant::new(label.to_owned(), ShaderSource::Own(label, source), entries, formats);
    match kind {
        Builtin::Sky => {}
        Builtin::Water | Builtin::ShadowedWater => {
            variant.depth_write = true;
            variant.blends[0] = Some(wgpu::BlendState::ALPHA_BLENDING);
        }
        Builtin::Query => variant.write_masks = [wgpu::ColorWrites::empty(); MAX_COLOR_ATTACHMENTS],
        Builtin::Fill | Builtin::FillColor | Builtin::FillDepth => {
            variant.depth_compare = wgpu::CompareFunction::Always;
            variant.outputs = u32::MAX;
            let mask = match kind {
                Builtin::FillDepth => wgpu::ColorWrites::empty(),
                _ if formats.keeps_alpha => wgpu::ColorWrites::ALL,
                _ => wgpu::ColorWrites::COLOR,
            };
            variant.write_masks = [mask; MAX_COLOR_ATTACHMENTS];
            if kind != Builtin::FillColor {
                variant.depth_write = true;
                variant.stencil = zeroed(formats.depth);
            }
        }
    }
    variant
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, DEPTH_FORMAT};

    /// Regression test: it was tried again, and its error logged, in each frame.
    #[test]
    fn refused_pipeline_is_tried_once() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut pipelines = Pipelines::new(&ctx);
        let mut sky = BuiltinPipelines::new(Builtin::Sky);
        let mut ensure = |samples| {
            let mut colors = [None; MAX_COLOR_ATTACHMENTS];
            colors[0] = Some(wgpu::TextureFormat::Rgba8Unorm);
            let formats = TargetFormats { colors, depth: DEPTH_FORMAT, samples, keeps_alpha: false };
            let target = pipelines.target(&formats).unwrap();
            (0..3).for_each(|_| sky.ensure(&ctx, &mut pipelines, target));
            (sky.get(target).is_some(), pipelines.created(), pipelines.take_errors())
        };
        assert_eq!(ensure(1), (true, 1, Vec::new()));
        let (is_created, created, errors) = ensure(3);
        assert!(!is_created && matches!(&errors[..], [e] if e.contains("sky")), "{errors:?}");
        assert_eq!(created, 2);
    }
}
