//! The passes of a frame. Each is a type that owns its pipelines and buffers, prepares its part of a stage, and records
//! it. All run on the draw thread.
//!
//! | pass | records | when |
//! |---|---|---|
//! | [`air`] | compute pass: tables of scattered light for each eye | once, before all stages |
//! | [`shadows`] | one render pass for each cascade, into the shadow maps | before the stage |
//! | [`texture_draws`] | one render pass for each multisampled colour that the stage does not clear | before the stage |
//! | [`background`] | fills a part of a target instead of clearing all of it | in the stage's render pass, in this order |
//! | [`leaves`] | the opaque runs | same |
//! | [`queries`] | boxes of occlusion queries, against the depth of opaque runs | same |
//! | [`sky`] | the sky behind the opaque runs | same |
//! | [`water`] | the sea | same |
//! | [`leaves`] | the runs that the background shines through | same |
//! | [`composition`] | the images of two eyes as one | same |
//! | [`depth_resolve`] | multisampled depth into the camera's texture | after the stage |
//! | [`display`] | one render pass from an image of light, or for a window without sRGB, to the context's image | same |
//! | [`texture_draws`] | one render pass for each level of textures that have them computed | after the stages around it |
//! | [`frame_copy`] | a copy of what the camera shows into a texture | same |
//! | [`texture_readback`] | copies of camera textures to buffers that the processor reads | same |
//!
//! There is no trait for passes: their prepared parts have different types, and the renderer calls each of them once for
//! a stage, in the order above.

pub(in crate::draw) mod air;
pub(in crate::draw) mod background;
pub(in crate::draw) mod composition;
pub(in crate::draw) mod depth_resolve;
pub(in crate::draw) mod display;
pub(in crate::draw) mod frame_copy;
mod fullscreen;
pub(in crate::draw) mod leaves;
pub(in crate::draw) mod queries;
pub(in crate::draw) mod shading;
pub(in crate::draw) mod shadows;
pub(in crate::draw) mod sky;
pub(in crate::draw) mod stage_input;
pub(in crate::draw) mod texture_draws;
pub(in crate::draw) mod texture_readback;
pub(in crate::draw) mod water;

use air::AirPass;
use background::BackgroundPass;
use composition::StereoComposition;
use depth_resolve::DepthResolve;
use display::DisplayPass;
use queries::QueryPass;
use shadows::casters::ShadowPass;
use sky::SkyPass;
use texture_draws::{Mipmaps, MsaaRestore};
use texture_readback::TextureReadback;
use water::WaterPass;

/// The passes of a renderer. The leaves themselves need no type: their runs are in the
/// [`Batch`](crate::draw::batch::Batch).
pub(in crate::draw) struct Passes {
    pub(in crate::draw) air: AirPass,
    pub(in crate::draw) shadows: ShadowPass,
    pub(in crate::draw) msaa_restore: MsaaRestore,
    pub(in crate::draw) background: BackgroundPass,
    pub(in crate::draw) queries: QueryPass,
    pub(in crate::draw) sky: SkyPass,
    pub(in crate::draw) water: WaterPass,
    pub(in crate::draw) composition: StereoComposition,
    pub(in crate::draw) depth_resolve: DepthResolve,
    pub(in crate::draw) display: DisplayPass,
    pub(in crate::draw) mipmaps: Mipmaps,
    pub(in crate::draw) readback: TextureReadback,
}

impl Passes {
    /// Creates the passes of a renderer. Pipelines and buffers are created when they are first needed.
    pub(in crate::draw) fn new(device: &wgpu::Device) -> Self {
        Self {
            air: AirPass::new(device),
            shadows: ShadowPass::new(device),
            msaa_restore: MsaaRestore::default(),
            background: BackgroundPass::default(),
            queries: QueryPass::default(),
            sky: SkyPass::default(),
            water: WaterPass::default(),
            composition: StereoComposition::default(),
            depth_resolve: DepthResolve::default(),
            display: DisplayPass::default(),
            mipmaps: Mipmaps::default(),
            readback: TextureReadback::default(),
        }
    }

    /// Returns the number of pipelines created so far by passes that do so themselves.
    pub(in crate::draw) fn created_pipelines(&self) -> u32 {
        let textures = self.msaa_restore.created() + self.depth_resolve.created() + self.mipmaps.created();
        textures + self.display.created() + self.air.created()
    }
}
