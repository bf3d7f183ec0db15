//! Positioned state: lights, clip planes and texture planes in the eye space of the view that they were met in.

use glam::{DAffine3, DVec3, DVec4};

use crate::state::{Light, TexGen};

/// A light in eye space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionedLight {
    /// The light, with position and direction in the eye space of the view.
    pub light: Light,
    /// The view that it was met in: 0 is the stage's own, others are one more than their index in
    /// [`RenderStage::views`](super::RenderStage::views).
    pub view: u32,
}

/// Returns a light in another frame. Positions are scaled to w = 1.
pub(crate) fn move_light(to_from: &DAffine3, light: &Light) -> Light {
    let [x, y, z, w] = light.position;
    let (position, w) = if w == 0.0 {
        (to_from.transform_vector3(DVec3::new(x, y, z)), 0.0)
    } else {
        (to_from.transform_point3(DVec3::new(x, y, z) / w), 1.0)
    };
    Light {
        position: position.extend(w).to_array(),
        direction: to_from.transform_vector3(DVec3::from_array(light.direction)).to_array(),
        ..*light
    }
}

/// Returns a plane `normal . p + d` in another frame; a plane that clips nothing if the map has no inverse.
pub(crate) fn move_plane(to_from: &DAffine3, plane: DVec4) -> DVec4 {
    let from_to = to_from.inverse();
    let normal = from_to.matrix3.transpose() * plane.truncate();
    let moved = normal.extend(plane.truncate().dot(from_to.translation) + plane.w);
    if moved.is_finite() { moved } else { DVec4::new(0.0, 0.0, 0.0, 1.0) }
}

/// A clip plane, which clips the leaves whose state enables it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipPlane {
    /// The number of the plane, 0 to 5.
    pub number: u8,
    /// The plane in the eye space of the view; points with `normal . p + d >= 0` are kept.
    pub plane: DVec4,
    /// The view that it was met in, as [`PositionedLight::view`].
    pub view: u32,
}

/// Texture coordinates that a TexGenNode generates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionedTexGen {
    /// The texture unit.
    pub unit: u8,
    /// The generator; eye-linear planes are in the eye space of the view.
    pub texgen: TexGen,
    /// The view that it was met in, as [`PositionedLight::view`].
    pub view: u32,
}

impl PositionedTexGen {
    /// Returns the generator in another eye space.
    pub(crate) fn moved(&self, to_from: &DAffine3) -> TexGen {
        move_texgen(to_from, self.texgen)
    }
}

/// Returns a generator with its eye-linear planes in another eye space.
pub(in crate::cull) fn move_texgen(to_from: &DAffine3, texgen: TexGen) -> TexGen {
    match texgen {
        TexGen::EyeLinear(planes) => TexGen::EyeLinear(planes.map(|plane| {
            let plane = DVec4::from_array(plane.map(f64::from));
            move_plane(to_from, plane).as_vec4().to_array()
        })),
        other => other,
    }
}
