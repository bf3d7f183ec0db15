//! [`read_back`]: reads a target's image back. Draw thread; waits for the adapter.

use std::time::Duration;

use crate::gpu::GpuError;

/// The time limit for the adapter to finish the frame.
const TIMEOUT: Duration = Duration::from_secs(60);

fn failed(reason: impl std::fmt::Display) -> GpuError {
    GpuError::ReadBack { reason: reason.to_string() }
}

/// Returns the image in a texture, top row first. `texture` is `None` after a window's image was presented.
pub(super) fn read_back(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    texture: Option<&wgpu::Texture>,
) -> Result<image::RgbaImage, GpuError> {
    let texture = texture.ok_or_else(|| failed("the window's image was already presented"))?;
    if !texture.usage().contains(wgpu::TextureUsages::COPY_SRC) {
        return Err(failed("this window's images cannot be copied"));
    }
    let swap_red_and_blue = match texture.format() {
        wgpu::TextureFormat::Rgba8UnormSrgb | wgpu::TextureFormat::Rgba8Unorm => false,
        wgpu::TextureFormat::Bgra8UnormSrgb | wgpu::TextureFormat::Bgra8Unorm => true,
        other => return Err(failed(format!("images of format {other:?} are not converted"))),
    };
    let [width, height] = [texture.width(), texture.height()];
    let row_bytes = width * 4;
    let padded_bytes = row_bytes.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("read-back"),
        size: u64::from(padded_bytes) * u64::from(height),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("read-back") });
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(padded_bytes), rows_per_image: None },
        },
        texture.size(),
    );
    let submission = queue.submit([encoder.finish()]);
    let (sender, receiver) = std::sync::mpsc::sync_channel(1);
    buffer.map_async(wgpu::MapMode::Read, .., move |result| {
        // The receiver is gone only after a timeout below.
        let _ = sender.send(result);
    });
    device.poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: Some(TIMEOUT) }).map_err(failed)?;
    receiver.recv_timeout(TIMEOUT).map_err(failed)?.map_err(failed)?;
    let mut pixels = Vec::with_capacity((row_bytes * height) as usize);
    {
        let view = buffer.get_mapped_range(..).map_err(failed)?;
        for row in view.chunks_exact(padded_bytes as usize) {
            pixels.extend_from_slice(&row[..row_bytes as usize]);
        }
    }
    if swap_red_and_blue {
        for pixel in pixels.chunks_exact_mut(4) {
            pixel.swap(0, 2);
        }
    }
    image::RgbaImage::from_raw(width, height, pixels).ok_or_else(|| failed("the size of the image is wrong"))
}
