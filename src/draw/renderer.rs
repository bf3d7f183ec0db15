//! The renderer: executes a stage on a context.
//!
//! Draw thread only. Owns the pipelines, the per-frame buffers and the frame timer.

use std::collections::VecDeque;
use std::time::Duration;

use super::batch::{Batch, Run};
use super::environment::{Environment, Sky};
use super::frame::{FrameUniform, LeafUniform, clear_color};
use super::key::Kind;
use super::pipelines::Pipelines;
use crate::cull::RenderStage;
use crate::gpu::{Acquired, FrameTimer, GpuError, GraphicsContext};

/// Frames the processor may be ahead of the adapter.
const FRAMES_IN_FLIGHT: usize = 2;
/// A frame that takes longer than this has hung.
const FRAME_TIMEOUT: Duration = Duration::from_secs(60);

/// What a draw did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DrawStats {
    /// Leaves drawn.
    pub leaves: u32,
    /// Draw calls, the sky's among them.
    pub draw_calls: u32,
    /// Pipelines, bind groups and buffers set.
    pub state_changes: u32,
    /// Those not set because they were set already.
    pub state_changes_skipped: u32,
    /// Triangles submitted.
    pub triangles: u64,
    /// Points submitted.
    pub points: u64,
    /// Pipelines made in this draw; each takes long at its first use.
    pub pipelines_created: u32,
    /// Time of the pass on the adapter, of the latest frame whose timestamps have arrived; `None` without timestamps.
    pub gpu_ms: Option<f64>,
    /// The window showed nothing, so nothing was drawn.
    pub skipped: bool,
}

/// Executes render stages on one [`GraphicsContext`].
pub struct Renderer {
    pipelines: Pipelines,
    frame_buffer: wgpu::Buffer,
    leaf_buffer: wgpu::Buffer,
    frame_bind_group: wgpu::BindGroup,
    most_leaves: usize,
    batch: Batch,
    timer: Option<FrameTimer>,
    in_flight: VecDeque<wgpu::SubmissionIndex>,
}

/// Sets state only where it changes, and counts both.
struct State<'p, 'e> {
    pass: &'p mut wgpu::RenderPass<'e>,
    pipeline: Option<u32>,
    /// Block, and whether it is one of height tiles.
    block: Option<(bool, u32)>,
    vertex_chunk: Option<u32>,
    /// Chunk of meshes, or the grid of a side.
    indices: Option<(bool, u32)>,
    stats: DrawStats,
}

fn leaf_buffer(device: &wgpu::Device, leaves: usize) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("leaves"),
        size: (leaves * size_of::<LeafUniform>()) as u64,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

fn frame_bind_group(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    frame: &wgpu::Buffer,
    leaves: &wgpu::Buffer,
) -> wgpu::BindGroup {
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("frame"),
        layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 1, resource: leaves.as_entire_binding() },
        ],
    })
}

impl Renderer {
    /// A renderer for a context; makes no pipeline yet.
    pub fn new(ctx: &mut GraphicsContext) -> Self {
        let device = ctx.device();
        let pipelines = Pipelines::new(device);
        let frame_buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("frame"),
            size: size_of::<FrameUniform>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let leaf_buffer = leaf_buffer(device, 256);
        let limits = device.limits();
        let most_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        Self {
            frame_bind_group: frame_bind_group(device, &pipelines.frame_layout, &frame_buffer, &leaf_buffer),
            pipelines,
            frame_buffer,
            leaf_buffer,
            most_leaves: usize::try_from(most_bytes / size_of::<LeafUniform>() as u64).unwrap_or(usize::MAX),
            batch: Batch::default(),
            timer: FrameTimer::new(device, ctx.queue()),
            in_flight: VecDeque::with_capacity(FRAMES_IN_FLIGHT + 1),
        }
    }

    /// Draws a stage into the context's target: clears it, executes the bins in order, puts the sky behind what
    /// is opaque. The picture can then be drawn over ([`GraphicsContext::color_view`]), read back, or presented.
    /// Waits while the adapter is two frames behind.
    pub fn draw(
        &mut self,
        ctx: &mut GraphicsContext,
        stage: &RenderStage,
        environment: &Environment,
    ) -> Result<DrawStats, GpuError> {
        if ctx.acquire()? == Acquired::Skip {
            return Ok(DrawStats { skipped: true, ..Default::default() });
        }
        ctx.submitted();
        let ctx = &*ctx;
        let dropped = self.batch.build(ctx, &mut self.pipelines, stage, self.most_leaves);
        if dropped > 0 {
            log::warn!("{dropped} leaves are more than the adapter's largest buffer holds, and not drawn");
        }
        let created_before = self.pipelines.created();
        let mut last = None;
        for run in &mut self.batch.runs {
            let index = match last {
                Some((key, index)) if key == run.key.pipeline => index,
                _ => self.pipelines.ensure(ctx, run.key.pipeline),
            };
            run.pipeline = index;
            last = Some((run.key.pipeline, index));
        }
        if environment.sky == Sky::Gradient {
            self.pipelines.ensure_sky(ctx);
        }
        let frame = FrameUniform::new(stage, environment);
        self.upload(ctx, &frame);
        let mut stats = self.record(ctx, environment, &frame)?;
        stats.leaves = self.batch.leaves.len() as u32;
        stats.pipelines_created = self.pipelines.created() - created_before;
        self.throttle(ctx)?;
        stats.gpu_ms = self.timer.as_mut().and_then(FrameTimer::latest_ms);
        Ok(stats)
    }

    fn upload(&mut self, ctx: &GraphicsContext, frame: &FrameUniform) {
        let device = ctx.device();
        let bytes: &[u8] = bytemuck::cast_slice(&self.batch.leaves);
        if bytes.len() as u64 > self.leaf_buffer.size() {
            let leaves = self.batch.leaves.len().next_power_of_two().min(self.most_leaves);
            self.leaf_buffer = leaf_buffer(device, leaves);
            self.frame_bind_group =
                frame_bind_group(device, &self.pipelines.frame_layout, &self.frame_buffer, &self.leaf_buffer);
        }
        ctx.queue().write_buffer(&self.frame_buffer, 0, bytemuck::bytes_of(frame));
        if !bytes.is_empty() {
            ctx.queue().write_buffer(&self.leaf_buffer, 0, bytes);
        }
    }

    fn record(
        &mut self,
        ctx: &GraphicsContext,
        environment: &Environment,
        frame: &FrameUniform,
    ) -> Result<DrawStats, GpuError> {
        let view = ctx.color_view().ok_or_else(|| GpuError::Surface { reason: "no image to draw into".into() })?;
        let mut encoder = ctx.device().create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("scene"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(clear_color(environment, frame)),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: ctx.depth_view(),
                // Reversed-Z: infinitely far is 0.
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Discard }),
                stencil_ops: None,
            }),
            timestamp_writes: self.timer.as_mut().and_then(FrameTimer::begin),
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_bind_group(0, &self.frame_bind_group, &[]);
        let mut state = State {
            pass: &mut pass,
            pipeline: None,
            block: None,
            vertex_chunk: None,
            indices: None,
            stats: DrawStats::default(),
        };
        let (opaque, see_through) = self.batch.runs.split_at(self.batch.sky_before);
        for run in opaque {
            state.draw(ctx, &self.pipelines, run);
        }
        if environment.sky == Sky::Gradient
            && let Some(sky) = self.pipelines.sky()
        {
            state.draw_sky(sky);
        }
        for run in see_through {
            state.draw(ctx, &self.pipelines, run);
        }
        let stats = state.stats;
        drop(pass);
        if let Some(timer) = &self.timer {
            timer.resolve(&mut encoder);
        }
        let submission = ctx.queue().submit([encoder.finish()]);
        if let Some(timer) = &mut self.timer {
            timer.submitted();
        }
        self.in_flight.push_back(submission);
        Ok(stats)
    }

    /// Lets callbacks run, and waits while too many frames are under way.
    fn throttle(&mut self, ctx: &GraphicsContext) -> Result<(), GpuError> {
        let poll = if self.in_flight.len() > FRAMES_IN_FLIGHT {
            wgpu::PollType::Wait { submission_index: self.in_flight.pop_front(), timeout: Some(FRAME_TIMEOUT) }
        } else {
            wgpu::PollType::Poll
        };
        ctx.device().poll(poll).map_err(|e| GpuError::DeviceLost { reason: format!("a frame did not end: {e}") })?;
        ctx.check_lost()
    }

    /// The picture last drawn, top row first. Waits for the adapter. A window's picture can be read between draw
    /// and present, where the platform lets images be copied.
    pub fn read_back(&mut self, ctx: &mut GraphicsContext) -> Result<image::RgbaImage, GpuError> {
        ctx.read_back()
    }
}

impl State<'_, '_> {
    /// True when the value has to be set.
    fn changes<T: PartialEq>(stats: &mut DrawStats, current: &mut Option<T>, wanted: T) -> bool {
        if current.as_ref() == Some(&wanted) {
            stats.state_changes_skipped += 1;
            return false;
        }
        *current = Some(wanted);
        stats.state_changes += 1;
        true
    }

    fn draw(&mut self, ctx: &GraphicsContext, pipelines: &Pipelines, run: &Run) {
        let key = &run.key;
        let is_height = key.pipeline.kind() == Kind::Height;
        let pools = ctx.pools();
        // All looked up first: a run that lacks something changes nothing.
        let (block, vertices, indices, format) = if is_height {
            let grid = pools.heights.grid(key.geometry).map(|g| &g.indices);
            (pools.heights.bind_group(key.block), None, grid, wgpu::IndexFormat::Uint32)
        } else {
            let vertices = pools.meshes.vertex_buffer(key.vertex_chunk);
            let indices = pools.meshes.index_buffer(key.index_chunk);
            (pools.textures.bind_group(key.block), vertices, indices, wgpu::IndexFormat::Uint32)
        };
        let (Some(pipeline), Some(block), Some(indices)) = (pipelines.pipeline(run.pipeline), block, indices) else {
            return;
        };
        if Self::changes(&mut self.stats, &mut self.pipeline, run.pipeline) {
            self.pass.set_pipeline(pipeline);
        }
        if Self::changes(&mut self.stats, &mut self.block, (is_height, key.block)) {
            self.pass.set_bind_group(1, block, &[]);
        }
        if let Some(vertices) = vertices
            && Self::changes(&mut self.stats, &mut self.vertex_chunk, key.vertex_chunk)
        {
            self.pass.set_vertex_buffer(0, vertices.slice(..));
        }
        let index_key = (is_height, if is_height { key.geometry } else { key.index_chunk });
        if Self::changes(&mut self.stats, &mut self.indices, index_key) {
            self.pass.set_index_buffer(indices.slice(..), format);
        }
        let index_range = run.first_index..run.first_index + run.index_count;
        self.pass.draw_indexed(index_range, run.base_vertex, run.first_leaf..run.first_leaf + run.leaf_count);
        self.stats.draw_calls += 1;
        let primitives = u64::from(run.index_count) * u64::from(run.leaf_count);
        if key.pipeline.kind() == Kind::Points {
            self.stats.points += primitives;
        } else if key.pipeline.kind() != Kind::Lines {
            self.stats.triangles += primitives / 3;
        }
    }

    fn draw_sky(&mut self, sky: &wgpu::RenderPipeline) {
        self.pass.set_pipeline(sky);
        self.pipeline = None;
        self.stats.state_changes += 1;
        self.pass.draw(0..3, 0..1);
        self.stats.draw_calls += 1;
    }
}
