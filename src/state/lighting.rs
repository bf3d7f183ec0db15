//! Materials, lights and fog: what the fixed function shades with, in OpenGL's and OSG's terms.

/// Reflection of light in OpenGL's terms, linear colours. With one, vertex colours are factors of `diffuse` and
/// `ambient`; textures of all, or of all but `specular` ([`ColorControl`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceMaterial {
    /// Of ambient light.
    pub ambient: [f32; 3],
    /// Of light from a direction; w is alpha.
    pub diffuse: [f32; 4],
    /// Of mirrored light.
    pub specular: [f32; 3],
    /// Shines by itself.
    pub emission: [f32; 3],
    /// Exponent of the highlight.
    pub shininess: f32,
}

impl Default for SurfaceMaterial {
    /// White and dull.
    fn default() -> Self {
        Self { ambient: [1.0; 3], diffuse: [1.0; 4], specular: [0.0; 3], emission: [0.0; 3], shininess: 0.0 }
    }
}

/// Which part of light textures are factors of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ColorControl {
    /// All of it.
    #[default]
    SingleColor,
    /// All but highlights, which are added to the textured surface.
    SeparateSpecularColor,
}

/// How lights are reckoned with, whichever they are; OSG's `LightModel`.
///
/// The default is what OpenGL begins with, but for light from everywhere, of which there is none. Without any light
/// model it is the same, but that meshes are lit on the side that is seen, as glTF has it of its double-sided materials.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightModel {
    /// Linear colour of light that comes from everywhere.
    pub ambient: [f32; 3],
    /// Highlights are as the eye sees them from its own place; otherwise as from infinitely far along the view axis, so
    /// that a plane under a far light shines alike all over.
    pub local_viewer: bool,
    /// Back faces are lit on their own side, and reflect as the back of [`Attribute::SurfaceMaterials`]; else light falls
    /// on them as on the front faces whose backs they are. Which faces are front faces [`FrontFace`] says.
    ///
    /// [`Attribute::SurfaceMaterials`]: super::Attribute::SurfaceMaterials
    /// [`FrontFace`]: super::FrontFace
    pub two_sided: bool,
    /// Whether textures darken highlights.
    pub color_control: ColorControl,
}

impl Default for LightModel {
    fn default() -> Self {
        Self { ambient: [0.0; 3], local_viewer: false, two_sided: false, color_control: ColorControl::SingleColor }
    }
}

/// A light in OpenGL's terms, linear colours. One that says anything that is not finite does not shine; the renderer says
/// so once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// 0 to 7, see [`Mode::Light`](super::Mode::Light).
    pub number: u8,
    /// x, y, z and 1 for a place, or the direction towards the light and 0.
    pub position: [f64; 4],
    /// Where a spot shines to.
    pub direction: [f64; 3],
    /// Reaches every surface.
    pub ambient: [f32; 3],
    /// Reaches surfaces that face it.
    pub diffuse: [f32; 3],
    /// Mirrored.
    pub specular: [f32; 3],
    /// Divided by `c + l * d + q * d * d` at `d` metres.
    pub attenuation: [f32; 3],
    /// Half angle of a spot's cone in radians; pi shines all around.
    pub spot_cutoff: f32,
    /// How the spot falls off towards its rim.
    pub spot_exponent: f32,
}

impl Default for Light {
    /// A white light from above the eye's back.
    fn default() -> Self {
        Self {
            number: 0,
            position: [0.0, 0.0, 1.0, 0.0],
            direction: [0.0, 0.0, -1.0],
            ambient: [0.0; 3],
            diffuse: [1.0; 3],
            specular: [1.0; 3],
            attenuation: [1.0, 0.0, 0.0],
            spot_cutoff: std::f32::consts::PI,
            spot_exponent: 0.0,
        }
    }
}

/// How fog thickens with the distance `d` in front of the eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FogMode {
    /// From none at `start_m` to all at `end_m`.
    Linear {
        /// Metres.
        start_m: f32,
        /// Metres.
        end_m: f32,
    },
    /// `1 - exp(-density d)`.
    Exp {
        /// Per metre.
        density_per_m: f32,
    },
    /// `1 - exp(-(density d)^2)`.
    Exp2 {
        /// Per metre.
        density_per_m: f32,
    },
}

/// Fog instead of the environment's haze.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fog {
    /// How it thickens.
    pub mode: FogMode,
    /// Linear colour.
    pub color: [f32; 3],
}
