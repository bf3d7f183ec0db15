//! The arguments of indirect draw calls, by which several runs are one call. Draw thread.

use wgpu::util::DrawIndexedIndirectArgs;

use super::run::Run;
use crate::gpu::GraphicsContext;

/// The size of one run's arguments in bytes.
pub(in crate::draw) const INDIRECT_BYTES: u64 = size_of::<DrawIndexedIndirectArgs>() as u64;
/// The least number of runs of a bucket that are drawn by one indirect call; fewer are drawn one by one.
pub(in crate::draw) const MIN_MULTI_DRAW: usize = 4;
/// The number of runs that the first buffer has room for.
const MIN_RUNS: usize = 64;

/// The buffer with the arguments of all runs of a frame, by index of the run.
pub(in crate::draw) struct IndirectBuffer {
    is_supported: bool,
    /// Created when some bucket first has enough runs.
    buffer: Option<wgpu::Buffer>,
    bytes: Vec<u8>,
}

impl IndirectBuffer {
    pub(in crate::draw) fn new(device: &wgpu::Device) -> Self {
        let is_supported = device.features().contains(wgpu::Features::INDIRECT_FIRST_INSTANCE);
        Self { is_supported, buffer: None, bytes: Vec::new() }
    }

    /// Returns the buffer; `None` if runs are drawn one by one.
    pub(in crate::draw) fn buffer(&self) -> Option<&wgpu::Buffer> {
        self.buffer.as_ref()
    }

    /// Uploads the arguments of a frame's runs if some bucket has enough of them. Returns an error if there is no memory
    /// for the buffer; runs are then drawn one by one.
    pub(in crate::draw) fn upload(&mut self, ctx: &GraphicsContext, runs: &[Run]) -> Result<(), String> {
        let has_multi_draw = |same: &[Run]| same.len() >= MIN_MULTI_DRAW;
        if !self.is_supported || !runs.chunk_by(|a, b| a.bucket == b.bucket).any(has_multi_draw) {
            return Ok(());
        }
        self.bytes.clear();
        for run in runs {
            let arguments = DrawIndexedIndirectArgs {
                index_count: run.index_count,
                instance_count: run.leaf_count,
                first_index: run.first_index,
                base_vertex: run.base_vertex,
                first_instance: run.first_leaf,
            };
            self.bytes.extend_from_slice(arguments.as_bytes());
        }
        if self.buffer.as_ref().is_none_or(|buffer| buffer.size() < self.bytes.len() as u64) {
            let size = INDIRECT_BYTES * runs.len().next_power_of_two().max(MIN_RUNS) as u64;
            self.buffer = None;
            self.buffer = Some(ctx.memory().allocate("arguments of draws", size, |device| {
                device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("runs"),
                    size,
                    usage: wgpu::BufferUsages::INDIRECT | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                })
            })?);
        }
        if let Some(buffer) = &self.buffer {
            ctx.queue().write_buffer(buffer, 0, &self.bytes);
        }
        Ok(())
    }
}
