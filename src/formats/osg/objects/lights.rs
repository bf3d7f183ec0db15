//! Lights, clip planes and fog of a file, as OSG's classes have them. Decode threads.

/// A Light. Colours are the displayed ones, sRGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::formats::osg) struct LightObject {
    pub number: i32,
    pub ambient: [f32; 4],
    pub diffuse: [f32; 4],
    pub specular: [f32; 4],
    /// Position and 1, or direction towards the light and 0.
    pub position: [f64; 4],
    /// Direction of a spot light.
    pub direction: [f64; 3],
    /// The constant, linear and quadratic coefficients.
    pub attenuation: [f32; 3],
    pub spot_exponent: f32,
    /// Half angle of the cone in degrees; 180 for all directions.
    pub spot_cutoff_deg: f32,
}

impl Default for LightObject {
    /// Returns the values that files leave out.
    fn default() -> Self {
        Self {
            number: 0,
            ambient: [0.0; 4],
            diffuse: [0.0; 4],
            specular: [0.0; 4],
            position: [0.0; 4],
            direction: [0.0; 3],
            attenuation: [1.0, 0.0, 0.0],
            spot_exponent: 0.0,
            spot_cutoff_deg: 180.0,
        }
    }
}

/// A LightModel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::formats::osg) struct LightModelObject {
    /// The displayed colour, sRGB.
    pub ambient: [f32; 4],
    pub has_separate_specular: bool,
    pub local_viewer: bool,
    pub two_sided: bool,
}

impl LightModelObject {
    /// OpenGL's number of a specular colour that textures do not darken.
    pub const SEPARATE_SPECULAR: u32 = 0x81fa;
}

/// A Fog. Lengths in the units of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::formats::osg) struct FogObject {
    /// OpenGL's number: LINEAR, EXP or EXP2.
    pub mode: u32,
    pub start: f32,
    pub end: f32,
    pub density: f32,
    /// The displayed colour, sRGB.
    pub color: [f32; 4],
}

/// A ClipPlane: a point `p` is kept if `normal . p + d >= 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::formats::osg) struct ClipPlaneObject {
    pub number: u32,
    pub plane: [f64; 4],
}
