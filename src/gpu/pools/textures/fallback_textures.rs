//! [`FallbackTextures`]: the textures that texture units without a texture bind. Created with the renderer; draw thread.

/// Textures of one texel: white colour, and the far depth in depth textures.
pub(crate) struct FallbackTextures {
    pub(crate) plane: wgpu::TextureView,
    pub(crate) cube: wgpu::TextureView,
    pub(crate) volume: wgpu::TextureView,
    pub(crate) layers: wgpu::TextureView,
    depth_plane: wgpu::TextureView,
    depth_cube: wgpu::TextureView,
    depth_layers: wgpu::TextureView,
}

impl FallbackTextures {
    pub(crate) fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Self {
        let view = |layers: u32, dimension: wgpu::TextureDimension, view: wgpu::TextureViewDimension| {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some("white"),
                size: wgpu::Extent3d { width: 1, height: 1, depth_or_array_layers: layers },
                mip_level_count: 1,
                sample_count: 1,
                dimension,
                format: wgpu::TextureFormat::Rgba8Unorm,
                usage: wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            });
            let texels = vec![255u8; 4 * layers as usize];
            queue.write_texture(
                texture.as_image_copy(),
                &texels,
                wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4), rows_per_image: Some(1) },
                texture.size(),
            );
            texture.create_view(&wgpu::TextureViewDescriptor { dimension: Some(view), ..Default::default() })
        };
        // wgpu clears unwritten textures to 0, which is infinitely far.
        let depth = |layers: u32, view: wgpu::TextureViewDimension| {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some("no depth"),
                size: wgpu::Extent3d { width: 1, height: 1, depth_or_array_layers: layers },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::Depth32Float,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            });
            texture.create_view(&wgpu::TextureViewDescriptor { dimension: Some(view), ..Default::default() })
        };
        let plane = wgpu::TextureDimension::D2;
        Self {
            plane: view(1, plane, wgpu::TextureViewDimension::D2),
            cube: view(6, plane, wgpu::TextureViewDimension::Cube),
            volume: view(1, wgpu::TextureDimension::D3, wgpu::TextureViewDimension::D3),
            layers: view(1, plane, wgpu::TextureViewDimension::D2Array),
            depth_plane: depth(1, wgpu::TextureViewDimension::D2),
            depth_cube: depth(6, wgpu::TextureViewDimension::Cube),
            depth_layers: depth(1, wgpu::TextureViewDimension::D2Array),
        }
    }

    /// Returns the texture for a program that declares one of this dimension.
    pub(crate) fn of(&self, dimension: wgpu::TextureViewDimension, is_depth: bool) -> &wgpu::TextureView {
        match (dimension, is_depth) {
            (wgpu::TextureViewDimension::Cube, false) => &self.cube,
            (wgpu::TextureViewDimension::Cube, true) => &self.depth_cube,
            (wgpu::TextureViewDimension::D3, _) => &self.volume,
            (wgpu::TextureViewDimension::D2Array, false) => &self.layers,
            (wgpu::TextureViewDimension::D2Array, true) => &self.depth_layers,
            (_, false) => &self.plane,
            (_, true) => &self.depth_plane,
        }
    }
}
