//! [`SurfaceRecord`]: the factors of a surface and the layers of its maps, as shaders read them. Plain values.

use super::surface_pool::MapLayers;
use crate::gpu::pools::textures::TextureLayer;
use crate::scene::MetallicRoughness;

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
}

impl SurfaceRecord {
    /// Stands in for the layer of a missing map.
    pub(crate) const NO_LAYER: u32 = u32::MAX;

    pub(super) fn new(surface: &MetallicRoughness, color: TextureLayer, maps: &MapLayers) -> Self {
        let [normal, occlusion, emission] = maps.map(|map| map.map_or(Self::NO_LAYER, |map| map.layer));
        let [r, g, b] = surface.emissive;
        Self {
            layers: [color.layer, normal, occlusion, emission],
            factors: [surface.metallic, surface.roughness, surface.occlusion_strength, surface.normal_scale],
            emission: [r, g, b, 0.0],
        }
    }
}
