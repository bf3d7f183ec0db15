//! Materials, lights and fog of the fixed function, in the terms of OpenGL and OSG.

/// A surface material in OpenGL's terms, with linear colours.
///
/// Vertex colours multiply `diffuse` and `ambient`. Textures multiply everything, or everything but `specular`
/// ([`ColorControl`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceMaterial {
    /// Reflection of ambient light.
    pub ambient: [f32; 3],
    /// Diffuse reflection; w is alpha.
    pub diffuse: [f32; 4],
    /// Specular reflection, of lights and of the environment's sun.
    pub specular: [f32; 3],
    /// Emitted light.
    pub emission: [f32; 3],
    /// Exponent of the highlight.
    pub shininess: f32,
}

impl Default for SurfaceMaterial {
    /// Returns a white material without highlights.
    fn default() -> Self {
        Self { ambient: [1.0; 3], diffuse: [1.0; 4], specular: [0.0; 3], emission: [0.0; 3], shininess: 0.0 }
    }
}

/// The part of the reflected light that textures multiply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ColorControl {
    /// All light.
    #[default]
    SingleColor,
    /// All light but highlights, which are added to the textured surface.
    SeparateSpecularColor,
}

/// Parameters of lighting that hold for all lights; OSG's `LightModel`.
///
/// The default is OpenGL's initial state, except that global ambient light is black. Without a light model the same
/// holds, but meshes are lit on the visible side, as glTF requires for double-sided materials.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightModel {
    /// Linear colour of global ambient light.
    pub ambient: [f32; 3],
    /// Highlights are computed for the position of the eye. Otherwise they are computed for an eye infinitely far along the
    /// view axis, so that a plane under a far light is equally bright everywhere.
    pub local_viewer: bool,
    /// Back faces are lit on their own side, with the back material of [`Attribute::SurfaceMaterials`]. Otherwise they are
    /// lit like the front faces that they belong to. [`FrontFace`] defines the front.
    ///
    /// [`Attribute::SurfaceMaterials`]: super::Attribute::SurfaceMaterials
    /// [`FrontFace`]: super::FrontFace
    pub two_sided: bool,
    /// Selects whether textures darken highlights.
    pub color_control: ColorControl,
}

impl Default for LightModel {
    fn default() -> Self {
        Self { ambient: [0.0; 3], local_viewer: false, two_sided: false, color_control: ColorControl::SingleColor }
    }
}

/// A light in OpenGL's terms, with linear colours. A light with a value that is not finite is off, which the renderer
/// reports once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// The number of the light, 0 to 7, see [`Mode::Light`](super::Mode::Light). Local lights need none.
    pub number: u8,
    /// Position and 1, or direction towards the light and 0.
    pub position: [f64; 4],
    /// Direction of a spot light.
    pub direction: [f64; 3],
    /// Colour that reaches every surface.
    pub ambient: [f32; 3],
    /// Colour that reaches surfaces facing the light.
    pub diffuse: [f32; 3],
    /// Colour of highlights.
    pub specular: [f32; 3],
    /// Coefficients c, l and q: at `d` metres the light is divided by `c + l * d + q * d * d`.
    pub attenuation: [f32; 3],
    /// The distance in metres at which a light with a position ends. It falls by `1 - (d / range)^4` more than by its
    /// attenuation, as in glTF's KHR_lights_punctual. Infinite by default.
    pub range_m: f32,
    /// Half angle of a spot's cone in radians, at most pi / 2; pi lights all directions.
    pub spot_cutoff: f32,
    /// Half angle in radians of the cone inside of which a spot has its full strength. It falls smoothly from there to
    /// `spot_cutoff`. From `spot_cutoff` on, as by default, the rim is sharp.
    pub spot_inner_cutoff: f32,
    /// Exponent of a spot's falloff towards its rim.
    pub spot_exponent: f32,
}

impl Default for Light {
    /// Returns a white light from behind the eye.
    fn default() -> Self {
        Self {
            number: 0,
            position: [0.0, 0.0, 1.0, 0.0],
            direction: [0.0, 0.0, -1.0],
            ambient: [0.0; 3],
            diffuse: [1.0; 3],
            specular: [1.0; 3],
            attenuation: [1.0, 0.0, 0.0],
            range_m: f32::INFINITY,
            spot_inner_cutoff: std::f32::consts::PI,
            spot_cutoff: std::f32::consts::PI,
            spot_exponent: 0.0,
        }
    }
}

/// The density of fog by the depth `d` in front of the eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FogMode {
    /// Grows linearly from none at `start_m` to full at `end_m`.
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

/// Fog that replaces the environment's haze.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fog {
    /// The growth with depth.
    pub mode: FogMode,
    /// Linear colour.
    pub color: [f32; 3],
    /// True to mix colours as they are displayed (sRGB), as OpenGL does; false to mix light.
    pub is_displayed: bool,
}
