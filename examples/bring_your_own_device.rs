//! Terrane on the application's own wgpu device: the host makes instance, adapter, device and queue, takes the last frame
//! as a texture view, and draws with it. A host with a loop calls `color_view` after each `frame`.
//!
//! ```text
//! cargo run --release --example bring_your_own_device -- [SOURCE] [--frames N] [--screenshot FILE]
//! ```
//! Expected: the terrain in colour on the left, and the same frame in grey on the right of a white line.

mod shared;

use anyhow::{Context as _, Result};
use terrane::gpu::HostDevice;
use terrane::viewer::{Viewer, ViewerConfig};
use terrane::wgpu;

const SHADER: &str = "
@group(0) @binding(0) var terrain: texture_2d<f32>;
@vertex fn corner(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    return vec4f(f32(i & 1u) * 4.0 - 1.0, f32(i >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}
@fragment fn shade(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let color = textureLoad(terrain, vec2u(at.xy), 0).rgb;
    let x = at.x - f32(textureDimensions(terrain).x) / 2.0;
    let grey = vec3f(dot(color, vec3f(0.21, 0.72, 0.07)));
    return vec4f(select(select(grey, color, x < 0.0), vec3f(1.0), abs(x) < 2.0), 1.0);
}";

fn main() -> Result<()> {
    let args = shared::Args::parse()?;
    // The application creates its device as usual. Terrane's features are optional; without them some functions are
    // missing.
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))?;
    let wanted = wgpu::DeviceDescriptor { required_features: HostDevice::features(&adapter), ..Default::default() };
    let (device, queue) = pollster::block_on(adapter.request_device(&wanted))?;

    let config = ViewerConfig { max_sse_px: 3.0, ..ViewerConfig::default() };
    let host = HostDevice { instance, adapter, device: device.clone(), queue: queue.clone() };
    let mut viewer = Viewer::new_on_device(host, &config)?;
    viewer.load(&args.source()?)?;
    shared::draw(&args, &mut viewer)?;
    let terrain = viewer.color_view()?.context("offscreen contexts have a view")?;

    // The host's own pass, into its own texture.
    let format = wgpu::TextureFormat::Rgba8UnormSrgb;
    let pipeline = shared::host::fullscreen_pipeline(&device, SHADER, format);
    let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("host"),
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&terrain) }],
    });
    let target = shared::host::target(&device, config.size_px, format);
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let view = target.create_view(&wgpu::TextureViewDescriptor::default());
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: &view,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations::default(),
        })],
        ..Default::default()
    });
    pass.set_pipeline(&pipeline);
    pass.set_bind_group(0, &bindings, &[]);
    pass.draw(0..3, 0..1);
    drop(pass);
    queue.submit([encoder.finish()]);
    args.save_image(|| shared::host::read_back(&device, &queue, &target))
}
