//! Drawables that the application draws itself: created by its compile calls, and kept until they are released. Draw
//! thread.

use std::any::Any;
use std::cell::{RefCell, RefMut};

use super::slot_table::SlotTable;
use crate::state::COLOR_LOCATIONS;

/// The maximum number of colour attachments of a target.
pub(crate) const MAX_COLOR_ATTACHMENTS: usize = COLOR_LOCATIONS;

/// The properties of a render target that pipelines depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TargetFormats {
    /// Formats of the colour attachments, by location.
    pub colors: [Option<wgpu::TextureFormat>; MAX_COLOR_ATTACHMENTS],
    /// Format of the depth buffer, which every target has. Depth is reversed: 1 at the near plane and 0 infinitely far.
    pub depth: wgpu::TextureFormat,
    /// Samples per pixel: 1, 2, 4, 8 or 16.
    pub samples: u32,
    /// True for textures, which keep alpha. Windows stay opaque, and alpha must not be written.
    pub keeps_alpha: bool,
}

/// The means to create a custom drawable, once for each context and on the context's thread.
pub struct CompileInfo<'a> {
    /// Creates resources.
    pub device: &'a wgpu::Device,
    /// Writes to resources. Nothing may be submitted to it.
    pub queue: &'a wgpu::Queue,
    /// Layout of bind group 0, which is set when the drawable draws: what `draw::DRAWABLE_PRELUDE` declares.
    pub frame_layout: &'a wgpu::BindGroupLayout,
    /// The cache of compiled pipelines, for the drawable's own pipelines.
    pub pipeline_cache: Option<&'a wgpu::PipelineCache>,
}

/// The reason for which the application's code could not create or draw something.
pub type CustomError = Box<dyn std::error::Error + Send + Sync>;

/// The result of a compile call.
pub(crate) struct CustomShape {
    /// The drawable; `draw` knows its type.
    pub(crate) drawable: Box<dyn Any + Send>,
    /// Its size in GPU memory.
    pub(crate) bytes: u64,
}

type Compile = dyn Fn(&CompileInfo<'_>, &[TargetFormats]) -> Result<CustomShape, String> + Send + Sync;

/// The payload of a custom geometry: creates its drawable, ready to draw into some targets.
pub(crate) struct CustomCompile(pub(crate) Box<Compile>);

struct CustomDrawable {
    /// Drawing changes the drawable through `&self`; nothing else does.
    drawable: RefCell<Box<dyn Any + Send>>,
    bytes: u64,
}

/// Custom drawables by index.
#[derive(Default)]
pub(crate) struct CustomDrawables {
    drawables: SlotTable<CustomDrawable>,
    /// The formats of all targets so far. A drawable is prepared for them when it is compiled.
    target_formats: Vec<TargetFormats>,
    bytes: u64,
}

impl CustomDrawables {
    /// Calls the application's compile function for the targets known so far, and stores its drawable. Returns its index and
    /// its size in bytes.
    pub(in crate::gpu) fn compile(
        &mut self,
        compile: &CustomCompile,
        info: &CompileInfo<'_>,
    ) -> Result<(u32, u64), String> {
        let CustomShape { drawable, bytes } = (compile.0)(info, &self.target_formats)?;
        self.bytes += bytes;
        let index = self.drawables.insert(CustomDrawable { drawable: RefCell::new(drawable), bytes });
        Ok((index, bytes))
    }

    pub(super) fn release(&mut self, index: u32) {
        if let Some(CustomDrawable { bytes, .. }) = self.drawables.remove(index) {
            self.bytes -= bytes;
        }
    }

    /// Makes drawables that are compiled from now on ready for a target.
    pub(in crate::gpu) fn add_target_formats(&mut self, formats: &TargetFormats) {
        if !self.target_formats.contains(formats) {
            self.target_formats.push(*formats);
        }
    }

    /// Borrows a drawable to draw it; `None` if it was released, or is being drawn.
    pub(crate) fn borrow(&self, index: u32) -> Option<RefMut<'_, Box<dyn Any + Send>>> {
        self.drawables.get(index)?.drawable.try_borrow_mut().ok()
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }
}
