//! [`WarpPass`]: draws the image of a dome or a panorama from six images of the surroundings. An operation of the context that
//! shows it, on the thread that draws.

use std::sync::{Arc, Mutex, PoisonError};

use super::SphericalProjection;
use crate::gpu::{Acquired, GraphicsContext, is_encoded_by_shader};

/// The number of directions in which the surroundings are drawn.
pub(super) const FACES: usize = 6;

/// The images of the surroundings in the present frame. Written by the operations of their contexts, read by the warp after
/// them, all on the thread of their device.
pub(super) type FaceImages = Arc<Mutex<[Option<wgpu::TextureView>; FACES]>>;

/// The objects of a device for targets of one format.
struct Resources {
    device: wgpu::Device,
    format: wgpu::TextureFormat,
    pipeline: wgpu::RenderPipeline,
    display: wgpu::Buffer,
    sampler: wgpu::Sampler,
    /// The size in pixels that the buffer has.
    size_px: [u32; 2],
    /// The images, and the bind group with them.
    bound: Option<([wgpu::TextureView; FACES], wgpu::BindGroup)>,
}

/// Warps the images of a frame into a context's target.
pub(super) struct WarpPass {
    projection: SphericalProjection,
    images: FaceImages,
    /// Created with the first frame, and again for another device.
    resources: Option<Resources>,
}

impl WarpPass {
    pub(super) fn new(projection: SphericalProjection, images: FaceImages) -> Self {
        Self { projection, images, resources: None }
    }

    /// Draws into the selected target. Does nothing while the window has no image.
    pub(super) fn draw(&mut self, context: &mut GraphicsContext) {
        // An error of the window is that of its frame, which acquires it too if it has cameras.
        if !matches!(context.acquire(), Ok(Acquired::Ready)) {
            return;
        }
        let Some(target) = context.color_view().cloned() else { return };
        let images = self.images.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let [Some(front), Some(right), Some(back), Some(left), Some(up), Some(down)] = images else { return };
        let (device, format) = (context.device(), context.color_format());
        let is_current = |of: &Resources| of.device == *device && of.format == format;
        if !self.resources.as_ref().is_some_and(is_current) {
            self.resources = Some(Resources::new(device, format));
        }
        let Some(resources) = &mut self.resources else { return };
        resources.set_display(context.queue(), self.projection, context.size_px());
        resources.draw(context.queue(), &target, [front, right, back, left, up, down]);
    }
}

impl Resources {
    fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Self {
        let shader = device.create_shader_module(wgpu::include_wgsl!("warp.wgsl"));
        let constants = [("ENCODES", f64::from(u8::from(is_encoded_by_shader(format))))];
        let compilation_options =
            wgpu::PipelineCompilationOptions { constants: &constants, ..wgpu::PipelineCompilationOptions::default() };
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("spherical display"),
            layout: None,
            vertex: wgpu::VertexState {
                module: &shader,
                entry_point: Some("vs_main"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &shader,
                entry_point: Some("fs_main"),
                compilation_options,
                targets: &[Some(format.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        let display = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("spherical display"),
            size: 16,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("spherical display"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        });
        Self { device: device.clone(), format, pipeline, display, sampler, size_px: [0, 0], bound: None }
    }

    fn set_display(&mut self, queue: &wgpu::Queue, projection: SphericalProjection, size_px: [u32; 2]) {
        if self.size_px != size_px {
            self.size_px = size_px;
            let (number, distance) = projection.as_shader();
            let [width, height] = size_px.map(|side| side as f32);
            let fields = [number.to_ne_bytes(), distance.to_ne_bytes(), width.to_ne_bytes(), height.to_ne_bytes()];
            queue.write_buffer(&self.display, 0, fields.as_flattened());
        }
    }

    fn draw(&mut self, queue: &wgpu::Queue, target: &wgpu::TextureView, images: [wgpu::TextureView; FACES]) {
        if self.bound.as_ref().is_none_or(|(bound, _)| *bound != images) {
            let mut entries = vec![
                wgpu::BindGroupEntry { binding: 0, resource: self.display.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&self.sampler) },
            ];
            entries.extend((2..).zip(&images).map(|(binding, image)| wgpu::BindGroupEntry {
                binding,
                resource: wgpu::BindingResource::TextureView(image),
            }));
            let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("spherical display"),
                layout: &self.pipeline.get_bind_group_layout(0),
                entries: &entries,
            });
            self.bound = Some((images, group));
        }
        let label = Some("spherical display");
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label,
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            })],
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        if let Some((_, group)) = &self.bound {
            pass.set_bind_group(0, group, &[]);
        }
        pass.draw(0..3, 0..1);
        drop(pass);
        queue.submit([encoder.finish()]);
    }
}
