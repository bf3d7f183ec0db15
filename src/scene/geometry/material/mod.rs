//! Materials as plain CPU data: what decoders fill in, and what the device makes pipelines, records and textures of.

mod layers;

use std::sync::Arc;

use glam::Affine2;

pub use self::layers::{Clearcoat, Dielectric, MapParts};
use super::texture::Texture;

/// How alpha is used; glTF's `alphaMode`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// Fragments with alpha below the cutoff are discarded.
    Mask(f32),
    /// The material is blended over what is behind it, in the depth-sorted transparent bin.
    Blend,
}

/// The maps and factors of glTF's metallic-roughness model, beside a material's base colour.
///
/// A factor is multiplied by its map. Maps use the texture coordinates of the vertices, or those of [`SecondUv`].
#[derive(Clone, Debug, PartialEq)]
pub struct MetallicRoughness {
    /// 1 for metals, 0 for other matter.
    pub metallic: f32,
    /// 0 for a mirror, 1 for a rough surface.
    pub roughness: f32,
    /// Occlusion in red unless `occlusion_map` is set, roughness in green, metallic in blue, linear.
    pub occlusion_roughness_metallic: Option<Arc<Texture>>,
    /// Occlusion in red, linear, if its image or its texture coordinates are not those of the map above.
    pub occlusion_map: Option<Arc<Texture>>,
    /// The share of the map's occlusion that is applied, 0 to 1. Occlusion darkens the light of the sky, not that of the sun.
    pub occlusion_strength: f32,
    /// Normals in tangent space, linear: red along u, green against v. The tangent frame follows from positions and texture
    /// coordinates.
    pub normal_map: Option<Arc<Texture>>,
    /// A factor of the red and green of normals.
    pub normal_scale: f32,
    /// Emitted light, linear; 1 is as bright as a white surface in the light of `Environment::sun_color` 1.
    pub emissive: [f32; 3],
    /// A map of the emitted light, sRGB.
    pub emissive_map: Option<Arc<Texture>>,
    /// The texture coordinates of maps that do not use those of the vertices.
    pub second_uv: SecondUv,
    /// An image over the base colour: sRGB. It uses the second texture coordinates as they are. [`Material::unlit`] shows it
    /// too. Raster overlays are such images.
    pub overlay: Option<Arc<Texture>>,
    /// How the overlay changes the base colour.
    pub overlay_mode: OverlayMode,
    /// The reflection where the surface is no metal.
    pub dielectric: Dielectric,
    /// A clear coat over the surface.
    pub clearcoat: Clearcoat,
}

/// How [`MetallicRoughness::overlay`] changes the base colour, whose alpha it keeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OverlayMode {
    /// It lies over it by its own alpha, blended in linear light.
    #[default]
    Over,
    /// It is multiplied with it, such as a light map or a detail map.
    Multiply,
    /// It is added to it. The values are added as they are displayed, and clamped to 1.
    Add,
}

/// The maps of a surface that use the second texture coordinates of its mesh: its attribute [`SecondUv::ATTRIBUTE`] of format
/// `Float32x2`. Each such map has the transform from them to its image, as in KHR_texture_transform. A mesh without the
/// attribute has its first texture coordinates instead.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SecondUv {
    /// The transform of the normal map's coordinates; `None` if the map uses the first ones.
    pub normal: Option<Affine2>,
    /// The same for `occlusion_roughness_metallic`.
    pub occlusion_roughness_metallic: Option<Affine2>,
    /// The same for the emissive map.
    pub emissive: Option<Affine2>,
    /// The same for `occlusion_map`.
    pub occlusion: Option<Affine2>,
    /// The same for the map of [`Dielectric`].
    pub dielectric: Option<Affine2>,
    /// The same for the map of [`Clearcoat`].
    pub clearcoat: Option<Affine2>,
    /// The same for the normal map of [`Clearcoat`].
    pub clearcoat_normal: Option<Affine2>,
}

impl SecondUv {
    /// The name of the attribute with the second texture coordinates.
    pub const ATTRIBUTE: &str = "SECOND_UV";
    /// The name of the attribute with third texture coordinates, which texture units of state sets alone can use:
    /// [`TexGen::ThirdUv`](crate::state::TexGen::ThirdUv).
    pub const THIRD_ATTRIBUTE: &str = "THIRD_UV";

    /// Returns the transforms of the maps that all surfaces may have, in the order of [`MetallicRoughness::maps`], without the
    /// overlay.
    pub(crate) fn of_plain_maps(&self) -> [Option<Affine2>; MetallicRoughness::OVERLAY] {
        [self.normal, self.occlusion_roughness_metallic, self.emissive, self.occlusion]
    }

    /// Returns true if a map uses the second texture coordinates.
    pub(crate) fn is_used(&self) -> bool {
        self.of_plain_maps().iter().chain(&self.of_layer_maps()).any(Option::is_some)
    }

    /// Returns the transforms of the other maps, in the same order.
    pub(crate) fn of_layer_maps(&self) -> [Option<Affine2>; MetallicRoughness::MAPS - MetallicRoughness::PLAIN_MAPS] {
        [self.dielectric, self.clearcoat, self.clearcoat_normal]
    }
}

impl MetallicRoughness {
    /// The number of maps.
    pub(crate) const MAPS: usize = 8;
    /// The number of maps, the first ones, that surfaces without a [`Dielectric`] or [`Clearcoat`] of their own may have.
    pub(crate) const PLAIN_MAPS: usize = 5;
    /// The number of the overlay among the maps. Those before it may have a transform of texture coordinates.
    pub(crate) const OVERLAY: usize = 4;

    /// Returns the maps: normals, occlusion-roughness-metallic, emission, occlusion, overlay, dielectric, clear coat, normals
    /// of the coat.
    pub(crate) fn maps(&self) -> [Option<&Arc<Texture>>; Self::MAPS] {
        let Self { normal_map, occlusion_roughness_metallic, emissive_map, occlusion_map, overlay, .. } = self;
        let Clearcoat { map: coat, normal_map: coat_normal, .. } = &self.clearcoat;
        let dielectric = &self.dielectric.map;
        [normal_map, occlusion_roughness_metallic, emissive_map, occlusion_map, overlay, dielectric, coat, coat_normal]
            .map(Option::as_ref)
    }

    /// Returns true if the surface has a reflection or a coat beyond the plain model.
    pub(crate) fn is_layered(&self) -> bool {
        self.clearcoat.factors()[0] > 0.0 || self.dielectric != Dielectric::default()
    }

    /// Returns true if there are maps.
    pub(crate) fn has_maps(&self) -> bool {
        self.maps().iter().any(Option::is_some)
    }

    /// Returns the maps in the same order, to be replaced by equal ones.
    pub(crate) fn maps_mut(&mut self) -> [&mut Option<Arc<Texture>>; Self::MAPS] {
        let Self { normal_map, occlusion_roughness_metallic, emissive_map, occlusion_map, overlay, .. } = self;
        let Clearcoat { map: coat, normal_map: coat_normal, .. } = &mut self.clearcoat;
        let dielectric = &mut self.dielectric.map;
        [normal_map, occlusion_roughness_metallic, emissive_map, occlusion_map, overlay, dielectric, coat, coat_normal]
    }
}

impl Default for MetallicRoughness {
    /// Returns a rough surface that is no metal, without maps.
    fn default() -> Self {
        Self {
            metallic: 0.0,
            roughness: 1.0,
            occlusion_roughness_metallic: None,
            occlusion_map: None,
            occlusion_strength: 1.0,
            normal_map: None,
            normal_scale: 1.0,
            emissive: [0.0; 3],
            emissive_map: None,
            second_uv: SecondUv::default(),
            overlay: None,
            overlay_mode: OverlayMode::default(),
            dielectric: Dielectric::default(),
            clearcoat: Clearcoat::default(),
        }
    }
}

/// The surface of a drawable.
///
/// It has one of three models:
/// - **Unlit** if `unlit` is true: the base colour as it is, below an overlay.
/// - **Metallic-roughness** if `metallic_roughness` is set: glTF's model, with reflections of sun and sky.
/// - **Matte** otherwise: light is reflected equally in all directions. It is the quickest lit model.
///
/// Lines and points are never metallic-roughness. States with a program or with OpenGL's fixed function ignore
/// `metallic_roughness`.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// A linear RGBA factor.
    pub base_color: [f32; 4],
    /// A texture that is multiplied by the factor.
    pub texture: Option<Arc<Texture>>,
    /// How alpha is used.
    pub alpha: AlphaMode,
    /// If true, back faces are drawn too. Their normals are turned towards the eye.
    pub double_sided: bool,
    /// If true, the surface is not lit (KHR_materials_unlit).
    pub unlit: bool,
    /// The maps and factors of the metallic-roughness model; `None` for matte materials.
    pub metallic_roughness: Option<MetallicRoughness>,
}

impl Material {
    /// Returns the metallic-roughness model if the material is drawn with it.
    pub(crate) fn surface(&self) -> Option<&MetallicRoughness> {
        self.metallic_roughness.as_ref().filter(|surface| !self.unlit || surface.overlay.is_some())
    }

    /// Returns all textures: the base colour's and the maps.
    pub(super) fn textures(&self) -> impl Iterator<Item = &Arc<Texture>> {
        let maps = self.metallic_roughness.iter().flat_map(|surface| surface.maps().into_iter().flatten());
        self.texture.iter().chain(maps)
    }
}

impl Default for Material {
    fn default() -> Self {
        Self {
            base_color: [1.0; 4],
            texture: None,
            alpha: AlphaMode::Opaque,
            double_sided: false,
            unlit: false,
            metallic_roughness: None,
        }
    }
}
