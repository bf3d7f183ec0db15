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
    pub(crate) uv_matrices: [[f32; 4]; MetallicRoughness::OVERLAY],
    /// The offsets after the matrices; two maps a vector.
    pub(crate) uv_offsets: [[f32; 4]; MetallicRoughness::OVERLAY / 2],
}

impl SurfaceRecord {
    /// Stands in for the layer of a missing map.
    pub(crate) const NO_LAYER: u32 = u32::MAX;

    fn layer(map: Option<TextureLayer>) -> u32 {
        map.map_or(Self::NO_LAYER, |map| map.layer)
    }

    pub(super) fn new(surface: &MetallicRoughness, color: TextureLayer, maps: &MapLayers) -> Self {
        let [normal, metallic, emission, occlusion, overlay, ..] = maps.map(Self::layer);
        let [r, g, b] = surface.emissive;
        let transforms = surface.second_uv.of_plain_maps();
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

/// A surface with a reflection or a coat beyond the plain model; mirrors `SurfaceRecord` of the layered surfaces, see
/// layered_record.wgsl. A test compares them with naga's layout.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct LayeredRecord {
    pub(crate) plain: SurfaceRecord,
    /// The linear reflection of parts that are no metal, at normal incidence; its strength.
    pub(crate) dielectric: [f32; 4],
    /// Strength and roughness of the coat, scale of its normals; the last element is unused.
    pub(crate) coat: [f32; 4],
    /// The layers of the maps of dielectric and coat, [bits](Self::bits), the layer of the normal map of the coat.
    pub(crate) layer_maps: [u32; 4],
    /// The columns of the matrices from the second texture coordinates to those of the maps.
    pub(crate) layer_matrices: [[f32; 4]; 3],
    /// The offsets after the matrices; two maps a vector.
    pub(crate) layer_offsets: [[f32; 4]; 2],
}

impl LayeredRecord {
    pub(super) fn new(surface: &MetallicRoughness, color: TextureLayer, maps: &MapLayers) -> Self {
        let [_, _, _, _, _, dielectric_map, coat_map, normal_map] = maps.map(SurfaceRecord::layer);
        let ([r, g, b], strength) = surface.dielectric.reflectance();
        let [coat, roughness] = surface.clearcoat.factors();
        let transforms = surface.second_uv.of_layer_maps().map(Option::unwrap_or_default);
        let [dielectric, clearcoat, normal] = transforms.map(|transform| transform.translation.to_array());
        Self {
            plain: SurfaceRecord::new(surface, color, maps),
            dielectric: [r, g, b, strength],
            coat: [coat, roughness, surface.clearcoat.normal_scale, 0.0],
            layer_maps: [dielectric_map, coat_map, Self::bits(surface), normal_map],
            layer_matrices: transforms.map(|transform| transform.matrix2.to_cols_array()),
            layer_offsets: [
                [dielectric[0], dielectric[1], clearcoat[0], clearcoat[1]],
                [normal[0], normal[1], 0.0, 0.0],
            ],
        }
    }

    /// Returns a bit for each map that uses the second texture coordinates, and for each part of the maps that counts.
    fn bits(surface: &MetallicRoughness) -> u32 {
        let MetallicRoughness { dielectric, clearcoat, second_uv, .. } = surface;
        let parts = [dielectric.map_parts, clearcoat.map_parts];
        let parts = parts.into_iter().flat_map(|parts| [parts.has_first(), parts.has_second()]);
        let seconds = second_uv.of_layer_maps().map(|transform| transform.is_some());
        seconds.into_iter().chain(parts).zip(0..).fold(0, |bits, (is_set, bit)| bits | u32::from(is_set) << bit)
    }
}
