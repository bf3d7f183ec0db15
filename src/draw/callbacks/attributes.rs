//! State attributes of the application's own; OSG's classes derived from `StateAttribute`. Draw thread.

use std::sync::Arc;

use crate::gpu::{CompileInfo, CustomError, catch_errors};
use crate::state::{Attribute, OpaqueDrawData};

/// A state attribute of the application's own: buffers and textures for the programs below its state set.
///
/// A program declares in bind group 3 what it reads: uniform buffers, read-only storage buffers, textures and samplers.
/// ```text
/// @group(3) @binding(0) var<storage, read> heat: array<f32>;
/// @group(3) @binding(1) var palette: texture_2d<f32>;
/// ```
/// Like a texture, an attribute is found by identity: all state sets that hold the same [`Attribute`] use one bind group for
/// each program and context. It is dropped after the last state set that holds it. A program that declares group 3 below no
/// attribute is drawn in magenta and reported once; programs without group 3 ignore the attribute.
pub trait StateAttribute: Send + Sync + 'static {
    /// Returns the name that error texts use.
    fn name(&self) -> &str;

    /// Creates the bind group for a program, whose `layout` has the bindings that the program declares.
    ///
    /// Called for each program and context before it is first drawn, on the context's draw thread, and again after a device
    /// was lost. Resources may be created before and kept, and their contents may be written at any time by the draw
    /// thread. Errors, also of the device, are reported once, and the leaves are drawn in magenta.
    fn bind(&self, info: &CompileInfo<'_>, layout: &wgpu::BindGroupLayout) -> Result<wgpu::BindGroup, CustomError>;
}

/// Packs a state attribute for a [`StateSet`](crate::state::StateSet).
pub fn state_attribute(attribute: impl StateAttribute) -> Attribute {
    let hook: Box<dyn StateAttribute> = Box::new(attribute);
    Attribute::Custom(OpaqueDrawData(Arc::new(hook)))
}

/// The reason why an attribute cannot be bound.
#[derive(Debug, thiserror::Error)]
enum AttributeError {
    #[error("a custom attribute that `draw::state_attribute` did not create")]
    Unknown,
    #[error("attribute {name:?} cannot be bound: {reason}")]
    Bind { name: String, reason: CustomError },
}

/// Creates the bind group of an attribute for a program's layout.
pub(in crate::draw) fn bind(
    hook: &OpaqueDrawData,
    info: &CompileInfo<'_>,
    layout: &wgpu::BindGroupLayout,
) -> Result<wgpu::BindGroup, String> {
    let Some(attribute) = hook.0.downcast_ref::<Box<dyn StateAttribute>>() else {
        return Err(AttributeError::Unknown.to_string());
    };
    let (bound, error) = catch_errors(info.device, || attribute.bind(info, layout));
    let bound = bound.and_then(|group| error.map_or(Ok(group), |error| Err(error.into())));
    bound.map_err(|reason| AttributeError::Bind { name: attribute.name().to_owned(), reason }.to_string())
}
