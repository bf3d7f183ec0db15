//! The drawable on one graphics context: its pipelines, one per kind of render target, and its draw call.

use terrane::draw::{CompiledDrawable, DrawableInfo};
use terrane::gpu::{CompileInfo, CustomError, TargetFormats};

/// The number of blades.
const BLADES: u32 = 90_000;

/// The grass on one graphics context.
pub struct CompiledGrass {
    pub module: wgpu::ShaderModule,
    pub layout: wgpu::PipelineLayout,
    pub group: wgpu::BindGroup,
    pub time: wgpu::Buffer,
    pub pipelines: Vec<(TargetFormats, wgpu::RenderPipeline)>,
}

impl CompiledDrawable for CompiledGrass {
    fn prepare(&mut self, info: &CompileInfo<'_>, target: &TargetFormats) -> Result<(), CustomError> {
        let format = target.colors[0].ok_or("grass needs a colour to draw into")?;
        let pipeline = info.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("grass"),
            layout: Some(&self.layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: Some("vs_grass"),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: target.depth,
                depth_write_enabled: Some(true),
                // Depth is reversed: 1 is near, 0 is far.
                depth_compare: Some(wgpu::CompareFunction::GreaterEqual),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: wgpu::MultisampleState { count: target.samples, ..Default::default() },
            fragment: Some(wgpu::FragmentState {
                module: &self.module,
                entry_point: Some("fs_grass"),
                compilation_options: Default::default(),
                targets: &[Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::COLOR })],
            }),
            multiview_mask: None,
            cache: info.pipeline_cache,
        });
        self.pipelines.push((*target, pipeline));
        Ok(())
    }

    fn draw(&mut self, info: &DrawableInfo<'_>, pass: &mut wgpu::RenderPass<'_>) -> Result<(), CustomError> {
        let time_s = info.render.clock.simulation_time_s as f32;
        info.render.queue.write_buffer(&self.time, 0, bytemuck::bytes_of(&[time_s; 4]));
        let pipeline = self.pipelines.iter().find(|(target, _)| *target == info.target);
        pass.set_pipeline(&pipeline.ok_or("no pipeline for this target")?.1);
        pass.set_bind_group(1, &self.group, &[]);
        pass.draw(0..3 * BLADES, info.instances.clone());
        Ok(())
    }
}
