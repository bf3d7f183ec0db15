//! The background of a stage: the colour that its target is cleared with, or a triangle over the part of a target that
//! the stage draws into. Draw thread.

use super::stage_input::LitStage;
use crate::draw::pipelines::builtin_pipelines::{Builtin, BuiltinPipelines};
use crate::draw::recorder::{DrawSources, PassRecorder};
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::{PassTarget, wgpu_color};
use crate::draw::uniforms::frame::LeafUniform;

/// The attachments that a filling triangle writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fill {
    ColorAndDepth,
    Color,
    Depth,
}

/// How the background of a stage is drawn.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::draw) struct Background {
    /// The colour with which the pass clears all of its colour attachments; `None` if it keeps them.
    pub(in crate::draw) clear_color: Option<wgpu::Color>,
    /// The triangle that fills a part of the target, and the leaf with its colour.
    fill: Option<(Fill, u32)>,
}

/// The pipelines that fill a part of a target.
pub(in crate::draw) struct BackgroundPass {
    color_and_depth: BuiltinPipelines,
    color: BuiltinPipelines,
    depth: BuiltinPipelines,
}

impl Default for BackgroundPass {
    fn default() -> Self {
        let [color_and_depth, color, depth] =
            [Builtin::Fill, Builtin::FillColor, Builtin::FillDepth].map(BuiltinPipelines::new);
        Self { color_and_depth, color, depth }
    }
}

impl BackgroundPass {
    fn pipelines(&mut self, fill: Fill) -> &mut BuiltinPipelines {
        match fill {
            Fill::ColorAndDepth => &mut self.color_and_depth,
            Fill::Color => &mut self.color,
            Fill::Depth => &mut self.depth,
        }
    }

    /// Decides how the background is drawn, and appends the leaf of its triangle. `sky_color` is the clear colour of a
    /// whole view; `has_sky` means that the sky covers all of the background.
    pub(in crate::draw) fn prepare(
        &mut self,
        resources: &mut Resources,
        lit: &LitStage<'_>,
        sky_color: wgpu::Color,
        has_sky: bool,
    ) -> Background {
        let (stage, target, around) = (lit.input.stage, lit.input.target, lit.around);
        let own_color = if around.is_whole { Some(sky_color) } else { stage.target.clear_color.map(wgpu_color) };
        let has_part = target.is_part(stage);
        // Views after the first in the same target must not clear the others.
        let is_later_view = around.is_whole && around.is_outermost && target.is_begun;
        let is_part = own_color.is_some() && (has_part || is_later_view);
        let clear_color = match stage.clear_node {
            _ if is_part => (around.is_outermost && !target.is_begun).then_some(wgpu::Color::BLACK),
            Some(color) => color.map(wgpu_color),
            None => own_color,
        };
        let fill_color = match stage.clear_node {
            _ if !is_part || has_sky => None,
            Some(color) => color.map(wgpu_color),
            None => own_color,
        };
        let exposure = around.environment.exposure.unwrap_or(0.0);
        let [clear_color, fill_color] =
            [clear_color, fill_color].map(|color| color.map(|color| target.tones.displayed(color, exposure)));
        let fills_depth = has_part && !around.is_outermost && stage.target.clear_depth;
        let fill = match (fill_color, fills_depth) {
            (Some(_), true) => Some(Fill::ColorAndDepth),
            (Some(_), false) => Some(Fill::Color),
            (None, true) => Some(Fill::Depth),
            (None, false) => None,
        };
        let fill = fill.and_then(|fill| {
            let leaf = self.prepare_fill(resources, lit, fill, fill_color.unwrap_or_default())?;
            Some((fill, leaf))
        });
        Background { clear_color, fill }
    }

    /// Appends a leaf with the colour of the triangle and returns its index; `None` if the leaf buffer is full.
    fn prepare_fill(
        &mut self,
        resources: &mut Resources,
        lit: &LitStage<'_>,
        fill: Fill,
        color: wgpu::Color,
    ) -> Option<u32> {
        let leaf = resources.batch.leaves().len();
        if leaf >= resources.leaf_buffer.room() {
            return None;
        }
        self.pipelines(fill).ensure(lit.input.ctx, &mut resources.pipelines, lit.input.target.index);
        let color = [color.r, color.g, color.b, color.a].map(|c| c as f32);
        resources.batch.push_leaf(LeafUniform { color, ..LeafUniform::EMPTY });
        Some(leaf as u32)
    }

    /// Records the triangle of a background that has one.
    pub(in crate::draw) fn record(
        &self,
        recorder: &mut PassRecorder<'_, '_>,
        sources: &DrawSources<'_>,
        target: &PassTarget,
        background: &Background,
        base_index: u32,
    ) {
        let Some((fill, leaf)) = background.fill else { return };
        let pipelines = match fill {
            Fill::ColorAndDepth => &self.color_and_depth,
            Fill::Color => &self.color,
            Fill::Depth => &self.depth,
        };
        if let Some(pipeline) = pipelines.get(target.index) {
            recorder.apply(sources, base_index);
            recorder.draw_builtin(pipeline, 3, leaf..leaf + 1);
        }
    }
}
