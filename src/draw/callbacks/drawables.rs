//! Drawables that the application draws itself; OSG's `Drawable::drawImplementation`.
//!
//! ```text
//! CustomDrawable     in the scene, any thread      bounds, name; compile -> CompiledDrawable
//! CompiledDrawable   one a context, draw thread    prepare: pipelines for a kind of target; draw: into the pass
//! ```

use std::ops::Range;
use std::sync::Arc;

use glam::{DMat4, Mat4, Vec4};

use super::RenderInfo;
use crate::cull::CullCamera;
use crate::draw::batch::{Bucket, Run};
use crate::draw::state::{Sources, State};
use crate::draw::uniforms::frame::LeafUniform;
use crate::gpu::{CompileInfo, CustomCompile, CustomError, CustomShape, TargetFormats, watched};
use crate::math::Aabb;
use crate::scene::{CustomGeometry, Geometry};
use crate::state::{OpaqueDrawData, ResolvedState};

pub use crate::draw::pipelines::DRAWABLE_PRELUDE;

/// What the application draws itself: in a Geode like any other drawable, as the geometry that [`custom_geometry`]
/// makes of it. It is culled by its bounds, goes to the bin of its state set (that of transparent things where its
/// material blends), and is drawn at its place there. Its material's texture is not uploaded, and a program of its
/// state set does not shade it. Where levels of detail fade it changes in the middle. It casts no shadow, and no
/// intersection meets it.
pub trait CustomDrawable: Send + Sync + 'static {
    /// For people, and for errors.
    fn name(&self) -> &str;

    /// Box around what it draws, in its own frame, metres. Asked once, by [`custom_geometry`].
    fn bounds(&self) -> Aabb;

    /// CPU memory that it holds.
    fn size_bytes(&self) -> u64 {
        0
    }

    /// Makes what one context needs to draw it. Called once for each context on its thread, between frames, in the time
    /// that uploads may take; once more after a device was lost. What the device complains about meanwhile is an error
    /// like one returned: it is said once, and the drawable not drawn.
    fn compile(&self, info: &CompileInfo<'_>) -> Result<Box<dyn CompiledDrawable>, CustomError>;
}

/// What a [`CustomDrawable`] is in one context. Used and dropped on the context's thread.
pub trait CompiledDrawable: Send + 'static {
    /// GPU memory that it holds, for the pager's budgets. Asked once, after it was compiled.
    fn size_bytes(&self) -> u64 {
        0
    }

    /// Makes the pipelines for a kind of target. Called once for each before it is first drawn there: as part of its
    /// compilation for what is drawn into already, else in the frame that needs it. Where it fails, or the device
    /// complains, the drawable is not drawn there.
    fn prepare(&mut self, info: &CompileInfo<'_>, target: &TargetFormats) -> Result<(), CustomError>;

    /// Draws its leaves into the pass. Viewport, scissor, stencil reference and blend constant are those of its state,
    /// bind group 0 is that of [`DRAWABLE_PRELUDE`]; whatever it changes is set again for the next leaf. An error is
    /// said once; the next frame asks again. What breaks wgpu's rules for passes costs the whole frame.
    fn draw(&mut self, info: &DrawableInfo<'_>, pass: &mut wgpu::RenderPass<'_>) -> Result<(), CustomError>;
}

/// What a drawable is given to draw with, and may not keep.
pub struct DrawableInfo<'a> {
    /// Device, queue, the stage with its camera, the frame's times.
    pub render: &'a RenderInfo<'a>,
    /// What is drawn into.
    pub target: TargetFormats,
    /// x, y, width and height of the viewport in pixels.
    pub viewport_px: [f32; 4],
    /// The camera that its leaves were culled for: the stage's, or the nested one above them.
    pub camera: &'a CullCamera,
    /// Projection of its leaves: the camera's, or that of a Projection node above. Reversed depth.
    pub clip_from_eye: DMat4,
    /// What the state sets above it come to. Pipelines that are to heed it (faces, depth, blending) are made by it.
    pub state: &'a ResolvedState,
    /// Its leaves in the prelude's `leaves`: to be the instances of its draw calls. More than one where it hangs in
    /// several places.
    pub instances: Range<u32>,
    leaves: &'a [LeafUniform],
}

impl DrawableInfo<'_> {
    /// From its frame to the eye's, for each of its leaves; relative to the eye, so that `f32` is enough.
    pub fn eye_from_drawable(&self) -> impl ExactSizeIterator<Item = Mat4> + '_ {
        self.leaves.iter().map(|leaf| {
            let [x, y, z] = leaf.eye_from_drawable.map(Vec4::from_array);
            Mat4::from_cols(x, y, z, Vec4::W).transpose()
        })
    }

    /// Linear colour factor of material and state set, for each of its leaves.
    pub fn colors(&self) -> impl ExactSizeIterator<Item = [f32; 4]> + '_ {
        self.leaves.iter().map(|leaf| leaf.color)
    }
}

/// Why a custom drawable is not seen.
#[derive(Debug, thiserror::Error)]
enum Error {
    #[error("drawable {name:?} cannot be compiled: {reason}")]
    Compile { name: Arc<str>, reason: CustomError },
    #[error("drawable {name:?} cannot be drawn into {target:?}: {reason}")]
    Target { name: Arc<str>, target: TargetFormats, reason: CustomError },
    #[error("drawable {name:?} was not drawn: {reason}")]
    Draw { name: Arc<str>, reason: CustomError },
}

/// A compiled drawable and what it is ready for.
struct Made {
    name: Arc<str>,
    drawable: Box<dyn CompiledDrawable>,
    /// Targets met, and whether it can be drawn there.
    targets: Vec<(TargetFormats, bool)>,
}

/// A geometry that the application draws itself; to be given to
/// [`scene::Drawable::new`](crate::scene::Drawable::new).
pub fn custom_geometry(drawable: impl CustomDrawable) -> Geometry {
    let (bounds, size_bytes) = (drawable.bounds(), drawable.size_bytes());
    let name: Arc<str> = drawable.name().into();
    let compile = CustomCompile(Box::new(move |info, targets| {
        let made = guarded(info.device, || drawable.compile(info));
        let drawable = made.map_err(|reason| Error::Compile { name: name.clone(), reason }.to_string())?;
        let mut made = Made { name: name.clone(), drawable, targets: Vec::new() };
        for target in targets {
            // What is wrong is said when it is to be drawn there.
            if guarded(info.device, || made.drawable.prepare(info, target)).is_ok() {
                made.targets.push((*target, true));
            }
        }
        let bytes = made.drawable.size_bytes();
        Ok(CustomShape { made: Box::new(made), bytes })
    }));
    Geometry::Custom(CustomGeometry { bounds, size_bytes, hook: OpaqueDrawData(Arc::new(compile)) })
}

/// What the device complains about becomes an error.
fn guarded<T>(device: &wgpu::Device, make: impl FnOnce() -> Result<T, CustomError>) -> Result<T, CustomError> {
    let (made, error) = watched(device, make);
    let made = made?;
    error.map_or(Ok(made), |error| Err(error.into()))
}

impl Made {
    /// True when it can be drawn into a target; makes it ready when first asked, and says then why it cannot.
    fn is_ready(&mut self, info: &CompileInfo<'_>, target: &TargetFormats, stats: &mut u32) -> Result<bool, Error> {
        if let Some((_, is_ready)) = self.targets.iter().find(|(known, _)| known == target) {
            return Ok(*is_ready);
        }
        let prepared = guarded(info.device, || self.drawable.prepare(info, target));
        *stats += 1;
        self.targets.push((*target, prepared.is_ok()));
        match prepared {
            Ok(()) => Ok(true),
            Err(reason) => Err(Error::Target { name: self.name.clone(), target: *target, reason }),
        }
    }
}

impl State<'_, '_> {
    /// Has a run drawn by the application.
    pub(in crate::draw) fn draw_custom(&mut self, from: &Sources<'_>, bucket: &Bucket, run: &Run) {
        let Some((info, target)) = from.pass else { return };
        // The place of the shape.
        let Some(mut made) = from.ctx.pools().customs.get(run.first_index) else { return };
        let Some(made) = made.downcast_mut::<Made>() else { return };
        let compile = CompileInfo {
            device: info.device,
            queue: info.queue,
            frame_layout: &from.pipelines.frame_layout,
            pipeline_cache: from.ctx.pipeline_cache(),
        };
        match made.is_ready(&compile, &target, &mut self.stats.pipelines_created) {
            Ok(true) => {}
            Ok(false) => return,
            Err(error) => return self.errors.push(error.to_string()),
        }
        let stage = info.stage;
        let instances = run.first_leaf..run.first_leaf + run.leaf_count;
        let range = instances.start as usize..instances.end as usize;
        let (Some(state), Some(leaves)) =
            (stage.state_sets.get(bucket.custom as usize), from.batch.leaves().get(range))
        else {
            return;
        };
        self.apply(from, bucket.statics);
        let index = stage.view_of_state.get(bucket.custom as usize).copied().unwrap_or(0);
        let view = stage.views.get((index as usize).wrapping_sub(1));
        let viewport = from.statics.get(bucket.statics as usize).map_or([0.0; 6], |s| s.dynamics.viewport);
        let drawing = DrawableInfo {
            render: info,
            target,
            viewport_px: [0, 1, 2, 3].map(|i| viewport[i]),
            camera: stage.camera_of(index),
            clip_from_eye: view.map_or(stage.camera.clip_from_eye, |view| view.clip_from_eye),
            state,
            instances,
            leaves,
        };
        if let Err(reason) = made.drawable.draw(&drawing, self.pass) {
            self.errors.push(Error::Draw { name: made.name.clone(), reason }.to_string());
        }
        self.stats.draw_calls += 1;
        self.forget();
    }
}
