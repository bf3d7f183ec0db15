//! Drawables that the application draws itself: made by their compile calls, kept until they are released. Draw thread.

use std::any::Any;
use std::cell::{RefCell, RefMut};

use super::table::Table;

/// Most colour attachments of a target.
pub(crate) const MOST_COLORS: usize = 4;

/// What pipelines must know of what is drawn into.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TargetFormats {
    /// Of the colour attachments, by location.
    pub colors: [Option<wgpu::TextureFormat>; MOST_COLORS],
    /// Of the depth buffer, which every target has: reversed, 1 at the near plane and 0 infinitely far.
    pub depth: wgpu::TextureFormat,
    /// Samples a pixel, 1 or 4.
    pub samples: u32,
    /// Textures keep alpha; pictures stay opaque, and alpha must not be written.
    pub keeps_alpha: bool,
}

/// What a drawable of the application's own is made with, once for each context and on the context's thread.
pub struct CompileInfo<'a> {
    /// To make resources with.
    pub device: &'a wgpu::Device,
    /// To write to them; submit nothing.
    pub queue: &'a wgpu::Queue,
    /// Layout of bind group 0, which is set when it draws: what `draw::DRAWABLE_PRELUDE` declares.
    pub frame_layout: &'a wgpu::BindGroupLayout,
    /// For the pipelines that it makes: what is kept of earlier starts.
    pub pipeline_cache: Option<&'a wgpu::PipelineCache>,
}

/// Why the application's code could not make or draw something.
pub type CustomError = Box<dyn std::error::Error + Send + Sync>;

/// What a compile call gave.
pub(crate) struct CustomShape {
    /// `draw` knows what it is.
    pub(crate) made: Box<dyn Any + Send>,
    /// Of GPU memory.
    pub(crate) bytes: u64,
}

type Compile = dyn Fn(&CompileInfo<'_>, &[TargetFormats]) -> Result<CustomShape, String> + Send + Sync;

/// What the hook of a custom geometry holds: makes it, ready for some targets.
pub(crate) struct CustomCompile(pub(crate) Box<Compile>);

/// Drawing changes it; nothing else does.
struct Kept {
    made: RefCell<Box<dyn Any + Send>>,
    bytes: u64,
}

/// Custom shapes by place.
#[derive(Default)]
pub(crate) struct CustomShapes {
    shapes: Table<Kept>,
    /// What is drawn into: shapes are made ready for it when they are compiled.
    pub(super) targets: Vec<TargetFormats>,
    bytes: u64,
}

impl CustomShapes {
    pub(super) fn insert(&mut self, shape: CustomShape) -> u32 {
        self.bytes += shape.bytes;
        self.shapes.insert(Kept { made: RefCell::new(shape.made), bytes: shape.bytes })
    }

    pub(super) fn release(&mut self, place: u32) {
        if let Some(Kept { bytes, .. }) = self.shapes.remove(place) {
            self.bytes -= bytes;
        }
    }

    /// What was made, to draw it; `None` where it is gone, or is being drawn.
    pub(crate) fn get(&self, place: u32) -> Option<RefMut<'_, Box<dyn Any + Send>>> {
        self.shapes.get(place)?.made.try_borrow_mut().ok()
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }
}
