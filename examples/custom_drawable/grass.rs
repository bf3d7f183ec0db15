//! The drawable: its bounds, shader module and buffers.

use glam::DVec3;
use terrane::draw::{CompiledDrawable, CustomDrawable, DRAWABLE_PRELUDE};
use terrane::gpu::{CompileInfo, CustomError};
use terrane::math::Aabb;

use super::compiled_grass::CompiledGrass;

/// The radius of the meadow, metres.
const RADIUS_M: f64 = 12.0;
/// The height of the longest blades, metres.
const HEIGHT_M: f64 = 0.9;

/// A meadow whose blades are made in the vertex shader.
pub struct Grass;

impl CustomDrawable for Grass {
    fn name(&self) -> &str {
        "grass"
    }

    fn bounds(&self) -> Aabb {
        Aabb { min: DVec3::new(-RADIUS_M, -RADIUS_M, 0.0), max: DVec3::new(RADIUS_M, RADIUS_M, HEIGHT_M) }
    }

    fn compile(&self, info: &CompileInfo<'_>) -> Result<Box<dyn CompiledDrawable>, CustomError> {
        let module = info.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("grass"),
            source: wgpu::ShaderSource::Wgsl(format!("{DRAWABLE_PRELUDE}{}", include_str!("grass.wgsl")).into()),
        });
        let time = info.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("time"),
            size: 16,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let layout = info.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("grass"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::VERTEX,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            }],
        });
        let group = info.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("grass"),
            layout: &layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: time.as_entire_binding() }],
        });
        let layout = info.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("grass"),
            bind_group_layouts: &[Some(info.frame_layout), Some(&layout)],
            immediate_size: 0,
        });
        Ok(Box::new(CompiledGrass { module, layout, group, time, pipelines: Vec::new() }))
    }
}
