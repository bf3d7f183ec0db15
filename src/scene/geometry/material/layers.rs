//! [`Dielectric`] and [`Clearcoat`]: reflections beyond the metallic-roughness model, as plain CPU data.

use std::sync::Arc;

use crate::scene::geometry::texture::Texture;

/// The reflection of a surface where it is no metal: glTF's KHR_materials_ior and KHR_materials_specular.
#[derive(Clone, Debug, PartialEq)]
pub struct Dielectric {
    /// The index of refraction: 1 for air, 1.5 for glass and plastic, 2.4 for diamond. 0 reflects all light.
    pub ior: f32,
    /// The strength of the reflection, 0 to 1.
    pub specular: f32,
    /// A factor of the light that is reflected towards where it came from, linear. At grazing angles the reflection is white.
    pub specular_color: [f32; 3],
    /// A map of factors: the colour in red, green and blue, sRGB, and the strength in alpha.
    pub map: Option<Arc<Texture>>,
    /// The parts of the map that count: its colour first, then its strength.
    pub map_parts: MapParts,
}

/// A clear coat over a surface, such as varnish: glTF's KHR_materials_clearcoat. Its index of refraction is 1.5.
#[derive(Clone, Debug, PartialEq)]
pub struct Clearcoat {
    /// The share of the surface that is coated, 0 to 1. Without it there is no coat.
    pub strength: f32,
    /// 0 for a mirror, 1 for a rough coat.
    pub roughness: f32,
    /// A map of factors, linear: the strength in red, the roughness in green.
    pub map: Option<Arc<Texture>>,
    /// The parts of the map that count: its strength first, then its roughness.
    pub map_parts: MapParts,
    /// Normals in tangent space, as in [`MetallicRoughness::normal_map`](super::MetallicRoughness::normal_map). Without it the
    /// coat fills the bumps of the surface.
    pub normal_map: Option<Arc<Texture>>,
    /// A factor of the red and green of normals.
    pub normal_scale: f32,
}

/// The parts of a map that count. The other one has factors of 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MapParts {
    /// Both parts.
    #[default]
    Both,
    /// The first part alone.
    First,
    /// The second part alone.
    Second,
}

impl MapParts {
    /// Returns true if the first part counts.
    pub(crate) fn has_first(self) -> bool {
        self != Self::Second
    }

    /// Returns true if the second part counts.
    pub(crate) fn has_second(self) -> bool {
        self != Self::First
    }
}

impl Default for Dielectric {
    /// Returns the reflection of the plain metallic-roughness model.
    fn default() -> Self {
        Self { ior: 1.5, specular: 1.0, specular_color: [1.0; 3], map: None, map_parts: MapParts::Both }
    }
}

impl Default for Clearcoat {
    /// Returns no coat.
    fn default() -> Self {
        let (map, normal_map, map_parts) = (None, None, MapParts::Both);
        Self { strength: 0.0, roughness: 0.0, map, map_parts, normal_map, normal_scale: 1.0 }
    }
}

impl Dielectric {
    /// The largest finite index; it reflects nearly all light.
    const MAX_IOR: f32 = 1e4;

    /// Returns the light that is reflected at normal incidence before the strength, linear, which may be more than 1, and the
    /// strength. Values out of range are clamped; those that are no numbers are the default's.
    pub(crate) fn reflectance(&self) -> ([f32; 3], f32) {
        let or = |value: f32, default: f32| if value.is_nan() { default } else { value };
        let ior = self.valid_ior();
        let root = (ior - 1.0) / (ior + 1.0);
        let color = self.specular_color.map(|part| (root * root * or(part, 1.0)).clamp(0.0, f32::MAX));
        (color, or(self.specular, 1.0).clamp(0.0, 1.0))
    }

    /// Returns the index of refraction: 0, or from 1 on.
    pub(crate) fn valid_ior(&self) -> f32 {
        match self.ior {
            ior if ior.is_nan() => 1.5,
            ior if ior <= 0.0 => 0.0,
            ior => ior.clamp(1.0, Self::MAX_IOR),
        }
    }
}

impl Clearcoat {
    /// Returns strength and roughness. Values out of range are clamped; those that are no numbers are 0.
    pub(crate) fn factors(&self) -> [f32; 2] {
        [self.strength, self.roughness].map(|factor| if factor.is_nan() { 0.0 } else { factor.clamp(0.0, 1.0) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflectance_is_finite_whatever_the_factors_are() {
        let of = |ior: f32, specular: f32, part: f32| {
            Dielectric { ior, specular, specular_color: [part; 3], ..Dielectric::default() }.reflectance()
        };
        let close = |(color, strength): ([f32; 3], f32), expected: (f32, f32)| {
            assert!((color[0] - expected.0).abs() < 1e-3 && strength == expected.1, "{color:?} {strength}");
        };
        close(of(1.5, 1.0, 1.0), (0.04, 1.0));
        close(of(1.0, 1.0, 1.0), (0.0, 1.0));
        close(of(2.4, 0.5, 0.5), (0.0848, 0.5));
        close(of(0.0, 1.0, 1.0), (1.0, 1.0));
        close(of(-3.0, 2.0, 1.0), (1.0, 1.0));
        close(of(0.5, -1.0, 1.0), (0.0, 0.0));
        close(of(f32::INFINITY, 1.0, 1.0), (1.0, 1.0));
        close(of(f32::NAN, f32::NAN, f32::NAN), (0.04, 1.0));
        assert!(of(2.0, 1.0, f32::INFINITY).0.iter().all(|part| part.is_finite()));
        let coat = Clearcoat { strength: f32::NAN, roughness: 7.0, ..Clearcoat::default() };
        assert_eq!(coat.factors(), [0.0, 1.0]);
    }
}
