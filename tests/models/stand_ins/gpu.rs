//! A device to which nothing is uploaded.

use std::sync::Arc;
use std::sync::atomic::Ordering;

pub use terrane::gpu::{
    CompileBudget, CompileOperation, CompileStats, Compiled, ContextTraits, GpuError, SurfaceAnswer,
};
use terrane::scene::{BlockFormats, DrawSlot, Mesh};

use super::Seen;
use crate::sync::OperationQueue;

pub struct Device;

/// A handle that is only passed on.
pub struct Handle;

impl Device {
    pub fn poll(&self, _how: wgpu::PollType) -> bool {
        true
    }
}

pub struct GraphicsContext {
    pub seen: Arc<Seen>,
    /// The frame that was drawn last.
    pub frame: u32,
    pub targets: usize,
    compile_operations: Arc<OperationQueue<wgpu::Device>>,
}

impl GraphicsContext {
    pub fn new(seen: &Arc<Seen>) -> Self {
        Self { seen: seen.clone(), frame: 0, targets: 1, compile_operations: Arc::default() }
    }

    /// Contexts show a frame together, after each has drawn it.
    pub fn present(&mut self) {
        let is_torn = self.seen.drawn_in(self.frame) < self.seen.cameras;
        assert!(!is_torn || self.seen.is_ending.load(Ordering::SeqCst), "shown before other contexts have drawn");
    }

    pub fn target_count(&self) -> usize {
        self.targets
    }

    pub fn select_target(&mut self, index: usize) {
        assert!(index < self.targets);
    }

    pub fn remove_target(&mut self, _index: usize) {
        self.targets -= 1;
    }

    pub fn size_px(&self) -> [u32; 2] {
        [1, 1]
    }

    pub fn place(&self) -> (u32, [i32; 2]) {
        (0, [0, 0])
    }

    pub fn block_formats(&self) -> BlockFormats {
        BlockFormats::NONE
    }

    pub fn is_host_device(&self) -> bool {
        false
    }

    pub fn is_software(&self) -> bool {
        true
    }

    pub fn adapter_name(&self) -> String {
        "none".to_owned()
    }

    pub fn compile(&mut self, _operation: CompileOperation) {}

    pub fn compile_operations(&self) -> &Arc<OperationQueue<wgpu::Device>> {
        &self.compile_operations
    }

    pub fn cancel_compiles(&mut self, _tickets: &[u64]) {}

    pub fn run_compiles(&mut self, _budget: &CompileBudget) -> CompileStats {
        CompileStats::default()
    }

    pub fn lacks_memory(&self) -> bool {
        false
    }

    pub fn pending_compiles(&self) -> usize {
        0
    }

    pub fn take_compiled(&mut self) -> Vec<Compiled> {
        Vec::new()
    }

    pub fn rewrite(&mut self, _slot: DrawSlot, _mesh: &Mesh) -> Result<(), GpuError> {
        Ok(())
    }

    pub fn release(&mut self, _slots: &[DrawSlot]) {}

    pub fn flush_released(&mut self) {}

    pub fn resize(&mut self, _size_px: [u32; 2]) -> Result<(), GpuError> {
        Ok(())
    }

    pub fn set_vsync(&mut self, _vsync: bool) {}

    pub fn lose_device(&mut self) {}

    pub fn pretend_surface(&mut self, _answers: &[SurfaceAnswer]) {}

    pub fn is_lost(&self) -> bool {
        false
    }

    pub fn reopen(&mut self) -> Result<(), GpuError> {
        Ok(())
    }

    pub fn bytes_in_use(&self) -> u64 {
        0
    }

    pub fn bytes_allocated(&self) -> u64 {
        0
    }

    pub fn set_max_bytes(&mut self, _owner: u16, _max_bytes: u64) {}

    pub fn bytes_peak(&self) -> u64 {
        0
    }

    pub fn device(&self) -> &Device {
        &Device
    }

    pub fn queue(&self) -> Handle {
        Handle
    }

    pub fn color_view(&self) -> Option<&wgpu::TextureView> {
        None
    }

    pub fn color_format(&self) -> Handle {
        Handle
    }
}
