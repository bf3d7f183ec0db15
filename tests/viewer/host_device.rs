//! Viewers on a device of the application: the frame is a texture that the application draws with.

use kit::shapes::quad;
use kit::skip::skipped_unless_required;
use terrane::gpu::{ContextTraits, GpuError, GraphicsContext, HostDevice};
use terrane::scene::{BlockFormats, Node, Page};
use terrane::viewer::{ThreadingModel, Viewer, ViewerConfig, ViewerError};

const SIZE_PX: [u32; 2] = [64, 48];

/// Returns a device of the software adapter with limits and features as an application may choose them.
fn host_device(limits: wgpu::Limits, features: wgpu::Features) -> Option<HostDevice> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let software = adapters.into_iter().find(|adapter| adapter.get_info().device_type == wgpu::DeviceType::Cpu);
    let Some(adapter) = software else {
        skipped_unless_required("no software adapter");
        return None;
    };
    let wanted = wgpu::DeviceDescriptor { required_limits: limits, required_features: features, ..Default::default() };
    let (device, queue) = pollster::block_on(adapter.request_device(&wanted)).unwrap();
    Some(HostDevice { instance, adapter, device, queue })
}

fn config(threading: ThreadingModel) -> ViewerConfig {
    ViewerConfig { size_px: SIZE_PX, threading, ..ViewerConfig::default() }
}

fn viewer_of_square(host: HostDevice, color: [f32; 4]) -> Viewer {
    let mut viewer = Viewer::new_on_device(host, &config(ThreadingModel::AutomaticSelection)).unwrap();
    viewer.add_root(Page::from_node(Node::geode(vec![quad([0.0; 3], [0.5; 2], color)])).unwrap()).unwrap();
    viewer
}

/// Returns the bytes of the first texels of a texture, copied by the application's queue.
fn first_texels(host: &HostDevice, texture: &wgpu::Texture) -> Vec<u8> {
    let buffer = host.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(SIZE_PX[0] * SIZE_PX[1] * 4),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(SIZE_PX[0] * 4), rows_per_image: None };
    let mut encoder = host.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let to = wgpu::TexelCopyBufferInfo { buffer: &buffer, layout };
    encoder.copy_texture_to_buffer(texture.as_image_copy(), to, texture.size());
    host.queue.submit([encoder.finish()]);
    buffer.slice(..).map_async(wgpu::MapMode::Read, |_| {});
    host.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    buffer.slice(..).get_mapped_range().unwrap().to_vec()
}

#[test]
fn the_application_gets_the_frame_as_a_texture_of_its_device() {
    // Default limits and no features are the least that an application may bring.
    let Some(host) = host_device(wgpu::Limits::default(), wgpu::Features::empty()) else { return };
    let mut red = viewer_of_square(host.clone(), [1.0, 0.0, 0.0, 1.0]);
    let mut green = viewer_of_square(host.clone(), [0.0, 1.0, 0.0, 1.0]);
    for _ in 0..3 {
        red.frame().unwrap();
        green.frame().unwrap();
    }
    for (viewer, channel) in [(&mut red, 0), (&mut green, 1)] {
        assert_eq!(viewer.composite().threading_model(), ThreadingModel::SingleThreaded);
        let view = viewer.color_view().unwrap().unwrap();
        assert!(view.texture().usage().contains(wgpu::TextureUsages::TEXTURE_BINDING));
        let texels = first_texels(&host, view.texture());
        let image = viewer.read_back().unwrap();
        assert_eq!(texels, image.into_raw(), "the view does not show the last frame");
        let center = texels.len() / 2 + SIZE_PX[0] as usize * 2;
        let [dim, bright] = [texels[center + 1 - channel], texels[center + channel]];
        assert!(bright > 100 && dim < 60, "not the square's colour: {:?}", &texels[center..center + 4]);
        assert!(viewer.composite().draw_errors().is_empty(), "{:?}", viewer.composite().draw_errors());
    }
    // A resize makes another texture.
    red.resize([32, 16]).unwrap();
    red.frame().unwrap();
    let view = red.color_view().unwrap().unwrap();
    assert_eq!((view.texture().width(), view.texture().height()), (32, 16));
}

#[test]
fn compressed_formats_are_those_of_the_device() {
    let Some(plain) = host_device(wgpu::Limits::default(), wgpu::Features::empty()) else { return };
    let features = HostDevice::features(&plain.adapter);
    let Some(full) = host_device(wgpu::Limits::default(), features) else { return };
    let formats = |host| GraphicsContext::new_on_device(host, &ContextTraits::default()).unwrap().block_formats();
    assert_eq!(formats(plain), BlockFormats::NONE);
    let expected = BlockFormats {
        bc: features.contains(wgpu::Features::TEXTURE_COMPRESSION_BC),
        etc2: features.contains(wgpu::Features::TEXTURE_COMPRESSION_ETC2),
        astc: features.contains(wgpu::Features::TEXTURE_COMPRESSION_ASTC),
    };
    assert_eq!(formats(full), expected);
}

#[test]
fn models_that_draw_on_other_threads_are_refused() {
    let Some(host) = host_device(wgpu::Limits::default(), wgpu::Features::empty()) else { return };
    let refused = Viewer::new_on_device(host.clone(), &config(ThreadingModel::DrawThreadPerContext)).err().unwrap();
    assert!(matches!(&refused, ViewerError::Setting(text) if text.contains("SingleThreaded")), "{refused}");
    let mut viewer = Viewer::new_on_device(host, &config(ThreadingModel::SingleThreaded)).unwrap();
    let refused = viewer.composite_mut().set_threading_model(ThreadingModel::CullDrawThreadPerContext).unwrap_err();
    assert!(matches!(&refused, ViewerError::Setting(text) if text.contains("SingleThreaded")), "{refused}");
    viewer.frame().unwrap();
}

#[test]
fn a_device_of_too_small_limits_is_refused_by_name() {
    let limits = wgpu::Limits { max_texture_dimension_2d: 1024, ..wgpu::Limits::default() };
    let Some(host) = host_device(limits, wgpu::Features::empty()) else { return };
    let refused = Viewer::new_on_device(host, &config(ThreadingModel::SingleThreaded)).err().unwrap();
    assert!(matches!(refused, ViewerError::Gpu(GpuError::NoDevice { .. })), "{refused}");
    assert!(refused.to_string().contains("max_texture_dimension_2d is 1024 and must be 8192"), "{refused}");
}
