//! Pipelines of what is drawn without a state of the scene's. Draw thread.

use super::Pipelines;
use super::convert::zeroed;
use super::sources::{FILL_WGSL, QUERY_WGSL, SHADOWED_WATER_WGSL, SKY_WGSL, WATER_WGSL};
use crate::gpu::GraphicsContext;

/// What is drawn without a state of the scene's, one pipeline a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Bare {
    /// Behind what is opaque.
    Sky,
    /// The sea.
    Water,
    /// Boxes of occlusion queries.
    Query,
    /// The background of a part of a target, with its depth.
    Fill,
    /// The same without depth.
    FillColor,
    /// The depth of a part of a target alone.
    FillDepth,
    /// The sea with the sun's shadows on it.
    ShadowedWater,
}

/// How many there are.
pub(super) const BARE: usize = 7;

impl Pipelines {
    /// A pipeline that [`Self::ensure_bare`] has made.
    pub(in crate::draw) fn bare(&self, what: Bare, target: u8) -> Option<&wgpu::RenderPipeline> {
        self.bare.get(usize::from(target))?[what as usize].as_ref()?.as_ref()
    }

    /// Makes a pipeline without a state for a target unless it was tried.
    pub(in crate::draw) fn ensure_bare(&mut self, ctx: &GraphicsContext, what: Bare, target: u8) {
        let Some(key) = self.targets.get(usize::from(target)).copied() else { return };
        if self.bare[usize::from(target)][what as usize].is_some() {
            return;
        }
        let (label, source, entries) = match what {
            Bare::Sky => ("sky", SKY_WGSL, ["vs_sky", "fs_sky"]),
            Bare::Water => ("water", WATER_WGSL, ["vs_sky", "fs_water"]),
            Bare::ShadowedWater => ("shadowed water", SHADOWED_WATER_WGSL, ["vs_sky", "fs_water"]),
            Bare::Query => ("query", QUERY_WGSL, ["vs_query", "fs_query"]),
            Bare::Fill | Bare::FillColor | Bare::FillDepth => ("fill", FILL_WGSL, ["vs_fill", "fs_fill"]),
        };
        let module = self.module(ctx, label, source);
        let mut variant = Self::variant(label, &module, entries, key);
        match what {
            Bare::Water | Bare::ShadowedWater => {
                (variant.depth_write, variant.blend) = (true, Some(wgpu::BlendState::ALPHA_BLENDING));
            }
            Bare::Query => variant.write_mask = wgpu::ColorWrites::empty(),
            Bare::Sky => {}
            Bare::Fill | Bare::FillColor | Bare::FillDepth => {
                variant.depth_compare = wgpu::CompareFunction::Always;
                variant.outputs = u32::MAX;
                variant.write_mask.set(wgpu::ColorWrites::ALPHA, key.keeps_alpha);
                if what == Bare::FillDepth {
                    variant.write_mask = wgpu::ColorWrites::empty();
                }
                if what != Bare::FillColor {
                    variant.depth_write = true;
                    variant.stencil = zeroed(key.depth);
                }
            }
        }
        self.bare[usize::from(target)][what as usize] = Some(self.create(ctx, &variant));
        self.created += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, DEPTH_FORMAT, MOST_COLORS, TargetFormats};

    /// It was tried again, and said in the log, in each frame.
    #[test]
    fn what_cannot_be_made_is_tried_once() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut pipelines = Pipelines::new(&ctx);
        let mut pipelines_of = |samples| {
            let mut colors = [None; MOST_COLORS];
            colors[0] = Some(wgpu::TextureFormat::Rgba8Unorm);
            let key = TargetFormats { colors, depth: DEPTH_FORMAT, samples, keeps_alpha: false };
            let target = pipelines.target(&key).unwrap();
            (0..3).for_each(|_| pipelines.ensure_bare(&ctx, Bare::Sky, target));
            let is_there = pipelines.bare(Bare::Sky, target).is_some();
            (is_there, pipelines.created(), std::mem::take(&mut pipelines.errors))
        };
        assert_eq!(pipelines_of(1), (true, 1, Vec::new()));
        let (is_there, created, errors) = pipelines_of(3);
        assert!(!is_there && matches!(&errors[..], [e] if e.contains("sky")), "{errors:?}");
        assert_eq!(created, 2);
    }
}
