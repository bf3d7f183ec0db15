//! The data about a stage that its passes are prepared from. Plain values of the draw thread.

use crate::cull::{CullCamera, RenderStage};
use crate::draw::bound_state::BoundState;
use crate::draw::callbacks::info::FrameClock;
use crate::draw::passes::air::EyeAir;
use crate::draw::pipelines::key::AirKind;
use crate::draw::targets::pass_target::PassTarget;
use crate::gpu::GraphicsContext;
use crate::scene::{Environment, SunShadows};

/// A stage and the target that it is drawn into.
#[derive(Clone, Copy)]
pub(in crate::draw) struct StageInput<'a> {
    pub(in crate::draw) ctx: &'a GraphicsContext,
    pub(in crate::draw) stage: &'a RenderStage,
    pub(in crate::draw) target: &'a PassTarget,
    pub(in crate::draw) clock: FrameClock,
}

/// The light and air around the contents of a stage.
#[derive(Clone, Copy)]
pub(in crate::draw) struct Surroundings {
    pub(in crate::draw) environment: Environment,
    pub(in crate::draw) shadows: Option<SunShadows>,
    pub(in crate::draw) air: EyeAir,
    /// True for a view of the frame and for the image of an eye; false for cameras inside a view.
    pub(in crate::draw) is_outermost: bool,
    /// True if the stage has a separate background, sky and water.
    pub(in crate::draw) is_whole: bool,
}

/// A view inside a stage, and its light.
#[derive(Clone, Copy)]
pub(in crate::draw) struct LitView {
    /// The camera with the eye by which the view is lit.
    pub(in crate::draw) camera: CullCamera,
    pub(in crate::draw) around: Surroundings,
    /// The layer of its first shadow map, if it has shadows.
    pub(in crate::draw) first_layer: Option<usize>,
}

/// The uniforms and the air that the leaves of a view are drawn with.
#[derive(Clone, Copy)]
pub(in crate::draw) struct ViewFrame {
    /// Byte offset of the frame uniform.
    pub(in crate::draw) uniform: u32,
    /// Byte offset of the stage uniform: lights and clip planes as the view sees them.
    pub(in crate::draw) positioned: u32,
    /// Index of the set of air tables.
    pub(in crate::draw) air: u8,
    pub(in crate::draw) air_kind: AirKind,
    pub(in crate::draw) has_shadows: bool,
}

/// A stage whose views are prepared: the input of the passes inside its render pass.
#[derive(Clone, Copy)]
pub(in crate::draw) struct LitStage<'a> {
    pub(in crate::draw) input: StageInput<'a>,
    pub(in crate::draw) around: &'a Surroundings,
    /// The stage's own view first, then those inside it.
    pub(in crate::draw) views: &'a [ViewFrame],
    /// By state, the byte offset of the stage uniform with its local lights and its volume; empty without any.
    pub(in crate::draw) positioned_of_state: &'a [u32],
    /// The bound state without any state set, and its index.
    pub(in crate::draw) base: BoundState,
    pub(in crate::draw) base_index: u32,
}

impl LitStage<'_> {
    /// Returns a view by number; the stage's own if there is none.
    pub(in crate::draw) fn view(&self, view: u32) -> &ViewFrame {
        self.views.get(view as usize).unwrap_or(&self.views[0])
    }

    /// Returns the byte offset of the stage uniform for the leaves of a state, which are in a view.
    pub(in crate::draw) fn positioned(&self, state: usize, view: u32) -> u32 {
        self.positioned_of_state.get(state).copied().unwrap_or(self.view(view).positioned)
    }

    /// Returns true if the stage has a sky and water: it is whole, and not only a composition of two eyes.
    pub(in crate::draw) fn has_surroundings(&self) -> bool {
        self.around.is_whole && self.input.stage.stereo.is_none()
    }

    /// Returns the viewport of a view inside the stage in pixels, if that differs from the stage's.
    pub(in crate::draw) fn viewport_px(&self, view: u32) -> Option<[u32; 4]> {
        let inner = (view as usize).checked_sub(1)?;
        self.input.stage.views.get(inner)?.viewport_px
    }
}
