//! Pipelines made before they are needed: when a page has arrived and its drawables are about to be uploaded.

use crate::draw::pipelines::key::{PipelineKey, Shading};
use crate::draw::pipelines::{MOST_COLORS, TargetFormats};
use crate::draw::renderer::Renderer;
use crate::gpu::GraphicsContext;
use crate::scene::{DrawKind, Topology};

impl Renderer {
    /// Makes the pipelines, those of fades too, that drawables of some kinds will need where the last frame drew;
    /// before the first frame, in the context's own target. Between frames, so that no draw has to.
    pub fn foresee(&mut self, ctx: &GraphicsContext, kinds: &[DrawKind]) {
        if self.drawn_into.is_empty()
            && let Some(target) = self.own_target(ctx)
        {
            self.drawn_into.push((target, false));
        }
        for kind in kinds {
            for place in 0..self.drawn_into.len() {
                let (target, has_own_light) = self.drawn_into[place];
                self.foresee_in(ctx, kind, target, has_own_light);
            }
        }
        for error in std::mem::take(&mut self.pipelines.errors) {
            self.complain(error);
        }
    }

    fn foresee_in(&mut self, ctx: &GraphicsContext, kind: &DrawKind, target: u8, has_own_light: bool) {
        let shading = match self.shading_of(ctx, &kind.state, has_own_light) {
            Ok(shading) => shading,
            Err(problem) => {
                let name = &kind.state.name;
                let name = if name.is_empty() { "a state set" } else { name };
                self.complain(format!("{name}: {problem}"));
                Shading::Fallback
            }
        };
        let whole = self.pipelines.state_key(&kind.state, shading, target);
        for state in [whole, whole.fading()] {
            let key = match kind.topology {
                None => PipelineKey::height(&state, kind.mirrored),
                Some(topology) => PipelineKey::mesh(&state, topology, kind.is_masked, kind.double_sided, kind.mirrored),
            };
            let is_pulled =
                kind.is_small && state.can_pull && !kind.is_masked && kind.topology == Some(Topology::Triangles);
            self.pipelines.ensure(ctx, if is_pulled { key.pulled() } else { key });
        }
    }

    fn own_target(&mut self, ctx: &GraphicsContext) -> Option<u8> {
        let depth = self.targets.depth_format();
        let mut key = TargetFormats { colors: [None; MOST_COLORS], depth, samples: ctx.samples(), keeps_alpha: false };
        key.colors[0] = Some(ctx.color_format());
        self.pipelines.target(&key)
    }
}
