//! A drawable of the application's own: grass that waves, each blade made in the vertex shader, under the engine's sun
//! and shadows.
//!
//! ```text
//! cargo run --release --example custom_drawable -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a round meadow of grass in waves of the wind on brown ground, with the shadow of a white ball across it, and
//! the ball standing in the grass.

use anyhow::Result;
use glam::DVec3;
use terrane::cull::SunShadows;
use terrane::draw::{CompiledDrawable, CustomDrawable, DRAWABLE_PRELUDE, DrawableInfo, Environment, custom_geometry};
use terrane::gpu::{CompileInfo, CustomError, TargetFormats};
use terrane::math::Aabb;
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::viewer::{Viewer, ViewerConfig, WindowOptions, has_display, run_window};

/// Of the meadow.
const RADIUS_M: f64 = 12.0;
/// Of the longest blades.
const HEIGHT_M: f64 = 0.9;
const BLADES: u32 = 90_000;

/// Behind the engine's own declarations: `leaves`, `point_in_eye`, `frame`, `light_of_sun`, `sun_shadow`, ...
const WGSL: &str = "
@group(1) @binding(0) var<uniform> time_s: vec4<f32>;

struct Varying {
    @builtin(position) clip: vec4<f32>,
    @location(0) in_eye: vec3<f32>,
    @location(1) color: vec3<f32>,
}

fn random(seed: u32) -> f32 {
    let a = (seed ^ 61u ^ (seed >> 16u)) * 9u;
    let b = (a ^ (a >> 4u)) * 0x27d4eb2du;
    return f32((b ^ (b >> 15u)) & 0xffffffu) / 16777216.0;
}

@vertex
fn vs_grass(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> Varying {
    let blade = vertex / 3u;
    let radius = 12.0 * sqrt(random(3u * blade));
    let place = radius * vec2<f32>(cos(6.2832 * random(3u * blade + 1u)), sin(6.2832 * random(3u * blade + 1u)));
    let turn = 6.2832 * random(3u * blade + 2u);
    var point = vec3<f32>(place + 0.03 * (f32(vertex % 3u) - 1.0) * vec2<f32>(cos(turn), sin(turn)), 0.0);
    let tip = vertex % 3u == 1u;
    if tip {
        let wind = sin(0.7 * place.x + 0.4 * place.y - 2.0 * time_s.x) + 0.3 * sin(3.1 * place.x - 5.0 * time_s.x);
        point += vec3<f32>(0.25 * wind, 0.1 * wind, 0.35 + 0.5 * random(blade) - 0.06 * wind * wind);
    }
    let in_eye = point_in_eye(leaves[instance], point);
    let color = mix(vec3<f32>(0.05, 0.12, 0.02), vec3<f32>(0.35, 0.55, 0.12), select(0.0, 1.0, tip));
    return Varying(frame.clip_from_eye * vec4<f32>(in_eye, 1.0), in_eye, color * leaves[instance].color.rgb);
}

@fragment
fn fs_grass(in: Varying) -> @location(0) vec4<f32> {
    let ground = above_ground(in.in_eye);
    let sun = light_of_sun(ground.xyz, ground.xyz, ground.w) * sun_shadow(in.in_eye, ground.xyz);
    let lit = in.color * (sun + light_of_sky(ground.xyz, ground.xyz));
    return vec4<f32>(through_air(lit, aerial(in.in_eye)), 1.0);
}
";

struct Grass;

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
            source: wgpu::ShaderSource::Wgsl(format!("{DRAWABLE_PRELUDE}{WGSL}").into()),
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

/// The grass on one context.
struct CompiledGrass {
    module: wgpu::ShaderModule,
    layout: wgpu::PipelineLayout,
    group: wgpu::BindGroup,
    time: wgpu::Buffer,
    pipelines: Vec<(TargetFormats, wgpu::RenderPipeline)>,
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
                // Depth is reversed.
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

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(30), |n| n.parse())?;
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let options = WindowOptions { on_open: Box::new(build), ..WindowOptions::default() };
        return Ok(run_window(ViewerConfig::default(), options).map(drop)?);
    }
    let mut viewer = Viewer::new_offscreen(&ViewerConfig { samples: 4, ..ViewerConfig::default() })?;
    build(&mut viewer)?;
    for _ in 0..frames {
        viewer.frame()?;
    }
    value("--screenshot").map_or(Ok(()), |file| Ok(viewer.read_back()?.save(file)?))
}

fn build(viewer: &mut Viewer) -> Result<(), terrane::viewer::ViewerError> {
    let brown = Material { base_color: [0.10, 0.07, 0.04, 1.0], double_sided: true, ..Material::default() };
    let ground = Mesh::rectangle(DVec3::new(-40.0, -40.0, 0.0), DVec3::X * 80.0, DVec3::Y * 80.0);
    let ball = Mesh::sphere(DVec3::new(0.0, 2.0, 1.6), 1.6, 64);
    let drawables = vec![
        Drawable::new(ground.into(), brown),
        Drawable::new(ball.into(), Material::default()),
        Drawable::new(custom_geometry(Grass), Material::default()),
    ];
    viewer.add_root(Page::from_node(Node::group(vec![Node::geode(drawables)])).expect("a shallow graph"))?;
    viewer.view_mut().environment = Environment {
        sun_direction: DVec3::new(-0.8, 0.3, 0.5).normalize(),
        shadows: Some(SunShadows::default()),
        ..viewer.view().environment
    };
    viewer.view_mut().camera.look_at(DVec3::new(2.0, -15.0, 5.0), DVec3::new(0.0, 0.0, 0.5), DVec3::Z);
    Ok(())
}
