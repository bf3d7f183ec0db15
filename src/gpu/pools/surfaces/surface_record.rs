//! [`SurfaceRecord`]: the factors of a surface and the layers of its maps, as shaders read them. Plain values.

use crate::gpu::pools::textures::TextureLayer;
use crate::scene::{MetallicRoughness, OverlayMode};

/// The layers of a surface's maps, in the order of [`MetallicRoughness::maps`].
pub(in crate::gpu) type MapLayers = [Option<TextureLayer>; MetallicRoughness::MAPS];

/// A surface; mirrors `SurfaceRecord` in surface.wgsl. A test compares them with naga's layout.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct SurfaceRecord {
    /// The layers of base colour, normals, occlusion-roughness-metallic and emission in the textures of the set.
    pub(crate) layers: [u32; 4],
    /// Metallic, roughness, strength of occlusion, scale of normals.
    pub(crate) factors: [f32; 4],
    /// Emitted light, linear; the last element is unused.
    pub(crate) emission: [f32; 4],
    /// The layer of occlusion, a bit for each map that uses the second texture coordinates, the layer of the overlay, and its
    /// mode: 0 over, 1 multiplied, 2 added.
    pub(crate) occlusion_uv_bits_overlay: [u32; 4],
    /// The columns of the matrices from the second texture coordinates to those of each map.
    pub(crate) uv_matrices: [[f32; 4]; MetallicRoughness::TRANSFORMED_MAPS],
    /// The offsets after the matrices; two maps a vector.
    pub(crate) uv_offsets: [[f32; 4]; MetallicRoughness::TRANSFORMED_MAPS / 2],
}

impl SurfaceRecord {
    /// Stands in for the layer of a missing map.
    pub(crate) const NO_LAYER: u32 = u32::MAX;

    pub(super) fn new(surface: &MetallicRoughness, color: TextureLayer, maps: &MapLayers) -> Self {
        let [normal, metallic, emission, occlusion, overlay] =
            maps.map(|map| map.map_or(Self::NO_LAYER, |map| map.layer));
        let [r, g, b] = surface.emissive;
        let transforms = surface.second_uv.of_maps();
        let seconds = (0..).zip(transforms).filter(|(_, transform)| transform.is_some());
        let seconds = seconds.fold(0, |bits, (map, _)| bits | 1 << map);
        let transforms = transforms.map(Option::unwrap_or_default);
        let mode = match surface.overlay_mode {
            OverlayMode::Over => 0,
            OverlayMode::Multiply => 1,
            OverlayMode::Add => 2,
        };
        let offsets = transforms.map(|transform| transform.translation.to_array());
        let pair = |map: usize| [offsets[map][0], offsets[map][1], offsets[map + 1][0], offsets[map + 1][1]];
        Self {
            occlusion_uv_bits_overlay: [occlusion, seconds, overlay, mode],
            uv_matrices: transforms.map(|transform| transform.matrix2.to_cols_array()),
            uv_offsets: [pair(0), pair(2)],
            layers: [color.layer, normal, metallic, emission],
            factors: [surface.metallic, surface.roughness, surface.occlusion_strength, surface.normal_scale],
            emission: [r, g, b, 0.0],
        }
    }
}
