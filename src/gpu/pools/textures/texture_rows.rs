//! [`TextureRows`]: the part of a texture that one step of an upload writes. Draw thread, or the compile thread.

/// Whole rows of one level of one layer. A row of a compressed format is a row of blocks.
pub(in crate::gpu) struct TextureRows {
    pub(in crate::gpu) layer: u32,
    pub(in crate::gpu) level: u32,
    /// The first row.
    pub(in crate::gpu) first: u32,
    /// The number of rows.
    pub(in crate::gpu) count: u32,
    /// The width of the level in texels.
    pub(in crate::gpu) width: u32,
    /// The size of a row in bytes.
    pub(in crate::gpu) row_bytes: u32,
    /// The side of a block of texels: 1 for formats without compression.
    pub(in crate::gpu) block_side: u32,
}

impl TextureRows {
    /// Returns the position of the first row in a texture.
    pub(in crate::gpu) fn destination<'a>(&self, texture: &'a wgpu::Texture) -> wgpu::TexelCopyTextureInfo<'a> {
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: self.level,
            origin: wgpu::Origin3d { x: 0, y: self.first * self.block_side, z: self.layer },
            aspect: wgpu::TextureAspect::All,
        }
    }

    /// Returns the size of the rows in texels. Blocks reach beyond the edges of small levels.
    pub(in crate::gpu) fn extent(&self) -> wgpu::Extent3d {
        let side = self.block_side;
        let (width, height) = (self.width.next_multiple_of(side), self.count * side);
        wgpu::Extent3d { width, height, depth_or_array_layers: 1 }
    }
}

/// Writes rows by the queue; `data` holds exactly these rows. Only the thread that submits may call it.
pub(in crate::gpu) fn write_rows(queue: &wgpu::Queue, texture: &wgpu::Texture, rows: &TextureRows, data: &[u8]) {
    let bytes_per_row = Some(rows.row_bytes);
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row, rows_per_image: None };
    queue.write_texture(rows.destination(texture), data, layout, rows.extent());
}
