//! Drawables that the application draws itself; OSG's `Drawable::drawImplementation`.
//!
//! ```text
//! CustomDrawable     in the scene, any thread      bounds, name; compile -> CompiledDrawable
//! CompiledDrawable   one a context, draw thread    prepare: pipelines for a kind of target; draw: into the pass
//! ```

use std::any::Any;
use std::ops::Range;
use std::sync::Arc;

use glam::{DMat4, Mat4, Vec4};

use super::info::RenderInfo;
use crate::cull::CullCamera;
use crate::draw::uniforms::frame::LeafUniform;
use crate::gpu::{CompileInfo, CustomCompile, CustomError, CustomShape, TargetFormats, catch_errors};
use crate::math::Aabb;
use crate::scene::{CustomGeometry, Geometry};
use crate::state::{OpaqueDrawData, ResolvedState};

/// A drawable that the application draws itself. [`custom_geometry`] makes it a geometry, which hangs in a Geode like any
/// other.
///
/// It is culled by its bounds and drawn at its position in the bin of its state set, or in the bin of transparent things
/// if its material blends. Its material's texture is not uploaded, and a program of its state set does not shade it.
/// Where levels of detail fade it switches in the middle of the fade. It casts no shadow, and intersections ignore it.
pub trait CustomDrawable: Send + Sync + 'static {
    /// Returns the name that error texts use.
    fn name(&self) -> &str;

    /// Returns the box around everything it draws, in its own frame and in metres. [`custom_geometry`] calls this once.
    fn bounds(&self) -> Aabb;

    /// Returns the bytes of CPU memory that it uses.
    fn size_bytes(&self) -> u64 {
        0
    }

    /// Creates the resources that one context needs to draw it.
    ///
    /// Called once for each context on its draw thread, between frames and within the time budget of uploads; called
    /// again after a device was lost. Errors of the device in the meantime count as errors of the call: they are reported
    /// once, and the drawable is not drawn.
    fn compile(&self, info: &CompileInfo<'_>) -> Result<Box<dyn CompiledDrawable>, CustomError>;
}

/// The resources of a [`CustomDrawable`] in one context. They are used and dropped on the context's draw thread.
pub trait CompiledDrawable: Send + 'static {
    /// Returns the bytes of GPU memory that it uses, for the pager's budgets. Called once after it was compiled.
    fn size_bytes(&self) -> u64 {
        0
    }

    /// Creates the pipelines for a kind of target.
    ///
    /// Called once for each kind before it is first drawn there: while it is compiled for the targets in use, and otherwise
    /// in the frame that needs it. If it fails, or the device reports an error, the drawable is not drawn there.
    fn prepare(&mut self, info: &CompileInfo<'_>, target: &TargetFormats) -> Result<(), CustomError>;

    /// Draws its leaves into the pass.
    ///
    /// Viewport, scissor, stencil reference and blend constant are those of its state, and bind group 0 is that of
    /// [`DRAWABLE_PRELUDE`](crate::draw::DRAWABLE_PRELUDE). The renderer sets all state again for the next leaf. An error
    /// is reported once, and the next frame calls it again. Breaking wgpu's rules for passes makes the whole frame
    /// invalid.
    fn draw(&mut self, info: &DrawableInfo<'_>, pass: &mut wgpu::RenderPass<'_>) -> Result<(), CustomError>;
}

/// The data that a drawable draws with; it may not keep them.
pub struct DrawableInfo<'a> {
    /// The device, queue, stage and times of the frame.
    pub render: &'a RenderInfo<'a>,
    /// The formats of the target.
    pub target: TargetFormats,
    /// The viewport: x, y, width and height in pixels.
    pub viewport_px: [f32; 4],
    /// The camera that its leaves were culled for: the stage's, or a nested one above them.
    pub camera: &'a CullCamera,
    /// The projection of its leaves: the camera's, or that of a Projection node above. Depths are reversed.
    pub clip_from_eye: DMat4,
    /// The resolved state of the state sets above it. Pipelines that respect it (faces, depth, blending) are created by
    /// the drawable.
    pub state: &'a ResolvedState,
    /// The range of its leaves in the prelude's `leaves`, to be used as the instances of its draw calls. It has several
    /// leaves if it hangs under several parents.
    pub instances: Range<u32>,
    pub(in crate::draw) leaves: &'a [LeafUniform],
}

impl DrawableInfo<'_> {
    /// Returns the transform from its frame to the eye for each of its leaves. It is relative to the eye, so that `f32` is
    /// precise enough.
    pub fn eye_from_drawable(&self) -> impl ExactSizeIterator<Item = Mat4> + '_ {
        self.leaves.iter().map(|leaf| {
            let [x, y, z] = leaf.eye_from_drawable.map(Vec4::from_array);
            Mat4::from_cols(x, y, z, Vec4::W).transpose()
        })
    }

    /// Returns the linear colour factor of material and state set for each of its leaves.
    pub fn colors(&self) -> impl ExactSizeIterator<Item = [f32; 4]> + '_ {
        self.leaves.iter().map(|leaf| leaf.color)
    }
}

/// The reason why a custom drawable is not drawn.
#[derive(Debug, thiserror::Error)]
enum DrawableError {
    #[error("drawable {name:?} cannot be compiled: {reason}")]
    Compile { name: Arc<str>, reason: CustomError },
    #[error("drawable {name:?} cannot be drawn into {target:?}: {reason}")]
    Target { name: Arc<str>, target: TargetFormats, reason: CustomError },
    #[error("drawable {name:?} was not drawn: {reason}")]
    Draw { name: Arc<str>, reason: CustomError },
}

/// A compiled drawable and the kinds of targets that it was prepared for.
struct Prepared {
    name: Arc<str>,
    drawable: Box<dyn CompiledDrawable>,
    /// Each kind of target met, and whether it can be drawn there.
    targets: Vec<(TargetFormats, bool)>,
}

/// Creates a geometry that the application draws itself, for
/// [`scene::Drawable::new`](crate::scene::Drawable::new).
pub fn custom_geometry(drawable: impl CustomDrawable) -> Geometry {
    let (bounds, size_bytes) = (drawable.bounds(), drawable.size_bytes());
    let name: Arc<str> = drawable.name().into();
    let compile = CustomCompile(Box::new(move |info, targets| {
        let compiled = guarded(info.device, || drawable.compile(info));
        let drawable = compiled.map_err(|reason| DrawableError::Compile { name: name.clone(), reason }.to_string())?;
        let mut prepared = Prepared { name: name.clone(), drawable, targets: Vec::new() };
        for target in targets {
            // An error is reported when the drawable is drawn there.
            if guarded(info.device, || prepared.drawable.prepare(info, target)).is_ok() {
                prepared.targets.push((*target, true));
            }
        }
        let bytes = prepared.drawable.size_bytes();
        Ok(CustomShape { drawable: Box::new(prepared), bytes })
    }));
    Geometry::Custom(CustomGeometry { bounds, size_bytes, hook: OpaqueDrawData(Arc::new(compile)) })
}

/// Calls a function and returns an error of the device in the meantime as its error.
fn guarded<T>(device: &wgpu::Device, create: impl FnOnce() -> Result<T, CustomError>) -> Result<T, CustomError> {
    let (created, error) = catch_errors(device, create);
    let created = created?;
    error.map_or(Ok(created), |error| Err(error.into()))
}

/// Returns true if a compiled shape can be drawn into a target. Prepares it at the first call for the target, which also
/// returns the error and counts a created pipeline.
pub(in crate::draw) fn ensure_ready(
    shape: &mut (dyn Any + Send),
    info: &CompileInfo<'_>,
    target: &TargetFormats,
    created: &mut u32,
) -> Result<bool, String> {
    let Some(prepared) = shape.downcast_mut::<Prepared>() else { return Ok(false) };
    if let Some((_, is_ready)) = prepared.targets.iter().find(|(known, _)| known == target) {
        return Ok(*is_ready);
    }
    let result = guarded(info.device, || prepared.drawable.prepare(info, target));
    *created += 1;
    prepared.targets.push((*target, result.is_ok()));
    match result {
        Ok(()) => Ok(true),
        Err(reason) => Err(DrawableError::Target { name: prepared.name.clone(), target: *target, reason }.to_string()),
    }
}

/// Draws a compiled shape into a pass.
pub(in crate::draw) fn draw(
    shape: &mut (dyn Any + Send),
    info: &DrawableInfo<'_>,
    pass: &mut wgpu::RenderPass<'_>,
) -> Result<(), String> {
    let Some(prepared) = shape.downcast_mut::<Prepared>() else { return Ok(()) };
    let drawn = prepared.drawable.draw(info, pass);
    drawn.map_err(|reason| DrawableError::Draw { name: prepared.name.clone(), reason }.to_string())
}
