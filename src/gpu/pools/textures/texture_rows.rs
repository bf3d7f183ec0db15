//! [`TextureRows`]: the part of a texture that one step of an upload writes. Draw thread, or the compile thread.

/// Whole rows of one level of one layer, in a texture of 4 bytes per texel.
pub(in crate::gpu) struct TextureRows {
    pub(in crate::gpu) layer: u32,
    pub(in crate::gpu) level: u32,
    /// The first row.
    pub(in crate::gpu) first: u32,
    /// The number of rows.
    pub(in crate::gpu) count: u32,
    /// The width of a row in texels.
    pub(in crate::gpu) width: u32,
}

/// Writes rows by the queue; `data` holds exactly these rows. Only the thread that submits may call it.
pub(in crate::gpu) fn write_rows(queue: &wgpu::Queue, texture: &wgpu::Texture, rows: &TextureRows, data: &[u8]) {
    queue.write_texture(
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: rows.level,
            origin: wgpu::Origin3d { x: 0, y: rows.first, z: rows.layer },
            aspect: wgpu::TextureAspect::All,
        },
        data,
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(rows.width * 4), rows_per_image: None },
        wgpu::Extent3d { width: rows.width, height: rows.count, depth_or_array_layers: 1 },
    );
}
