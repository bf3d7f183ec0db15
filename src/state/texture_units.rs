//! Texture units of the fixed function: generated coordinates, and how a texture changes the colour. Plain
//! values.

/// A generator of texture coordinates; OpenGL's `glTexGen`.
///
/// The four planes are for s, t, r and q. 2D and 3D textures are sampled at the coordinates divided by q, so that an
/// image can be projected. Cubes are sampled in the direction of s, t and r, arrays at s and t divided by q in the layer
/// nearest to r.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TexGen {
    /// Distances from planes in the drawable's frame.
    ObjectLinear([[f32; 4]; 4]),
    /// Distances from planes in eye space, or in the frame of a TexGenNode.
    EyeLinear([[f32; 4]; 4]),
    /// The point of a sphere map that has the same reflection.
    SphereMap,
    /// The normal in eye space.
    NormalMap,
    /// The reflected view direction in eye space.
    ReflectionMap,
    /// The coordinates of the mesh's attribute [`SecondUv::ATTRIBUTE`](crate::scene::SecondUv::ATTRIBUTE), which is
    /// `SECOND_UV`; the first ones if it has none. Height tiles have the first ones too.
    SecondUv,
    /// The coordinates of the mesh's attribute `THIRD_UV`, likewise.
    ThirdUv,
}

impl TexGen {
    /// Returns the planes for an image that is not projected: r is 0 and q is 1 everywhere.
    pub const fn planes(s: [f32; 4], t: [f32; 4]) -> [[f32; 4]; 4] {
        [s, t, [0.0; 4], [0.0, 0.0, 0.0, 1.0]]
    }
}

/// How the texture of a unit changes the colour that the units before it left; OSG's `TexEnv` and `TexEnvCombine`.
///
/// The first unit starts with the lit colour times the drawable's own texture. Highlights of
/// [`ColorControl::SeparateSpecularColor`](super::ColorControl::SeparateSpecularColor) are added after the last unit. A lit
/// colour may exceed 1 until it is tone mapped, so that results are clamped to 0 alone; alpha is clamped to 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum TexEnv {
    /// The product of both.
    #[default]
    Modulate,
    /// The texture over the colour, by the texture's alpha; alpha is kept.
    Decal,
    /// From the colour to a constant one, by the texture's colour; alpha is the product.
    Blend([f32; 4]),
    /// The texture.
    Replace,
    /// The sum of the colours; alpha is the product.
    Add,
    /// Any combination of three arguments.
    Combine(TexEnvCombine),
}

impl TexEnv {
    /// Returns the mode as a combination.
    pub(crate) fn as_combination(&self) -> TexEnvCombine {
        use CombineOperand::{Alpha, Color};
        use CombineSource::{Constant, Previous, Texture};
        let product = TexEnvCombine::default();
        match self {
            Self::Modulate => product,
            Self::Decal => TexEnvCombine {
                color: CombineFunction::Interpolate,
                color_arguments: [(Texture, Color), (Previous, Color), (Texture, Alpha)],
                alpha: CombineFunction::Replace,
                ..product
            },
            Self::Blend(constant) => TexEnvCombine {
                color: CombineFunction::Interpolate,
                color_arguments: [(Constant, Color), (Previous, Color), (Texture, Color)],
                constant: *constant,
                ..product
            },
            Self::Replace => TexEnvCombine {
                color: CombineFunction::Replace,
                color_arguments: [(Texture, Color); 3],
                alpha: CombineFunction::Replace,
                alpha_arguments: [(Texture, Alpha); 3],
                ..product
            },
            Self::Add => TexEnvCombine { color: CombineFunction::Add, ..product },
            Self::Combine(combine) => *combine,
        }
    }
}

/// A combination of up to three arguments for colour and for alpha; OpenGL's `GL_COMBINE`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexEnvCombine {
    /// The function of colours.
    pub color: CombineFunction,
    /// The arguments of `color`.
    pub color_arguments: [(CombineSource, CombineOperand); 3],
    /// A factor on the result of `color`.
    pub color_scale: f32,
    /// The function of alphas; the dot products are those of colours and act like `Modulate` here.
    pub alpha: CombineFunction,
    /// The arguments of `alpha`; operands of colours act like those of alphas.
    pub alpha_arguments: [(CombineSource, CombineOperand); 3],
    /// A factor on the result of `alpha`.
    pub alpha_scale: f32,
    /// Linear colour of [`CombineSource::Constant`].
    pub constant: [f32; 4],
    /// Combines values from 0 to 1 as they are displayed (sRGB), as OpenGL does without a conversion of colours, instead of
    /// light. Bump maps and sums of old files look as they were authored.
    pub is_displayed: bool,
}

impl Default for TexEnvCombine {
    /// Returns the product of the colour before and the texture.
    fn default() -> Self {
        use CombineSource::{Constant, Previous, Texture};
        let arguments = |operand| [(Previous, operand), (Texture, operand), (Constant, operand)];
        Self {
            color: CombineFunction::Modulate,
            color_arguments: arguments(CombineOperand::Color),
            color_scale: 1.0,
            alpha: CombineFunction::Modulate,
            alpha_arguments: arguments(CombineOperand::Alpha),
            alpha_scale: 1.0,
            constant: [0.0; 4],
            is_displayed: false,
        }
    }
}

/// A function of the arguments a, b and c.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CombineFunction {
    /// `a b`.
    #[default]
    Modulate,
    /// `a`.
    Replace,
    /// `a + b`.
    Add,
    /// `a + b - 0.5`.
    AddSigned,
    /// `a c + b (1 - c)`.
    Interpolate,
    /// `a - b`.
    Subtract,
    /// `4 (a - 0.5) . (b - 0.5)` in red, green and blue.
    Dot3Rgb,
    /// The same, also in alpha; the function of alphas is ignored.
    Dot3Rgba,
}

/// The source of an argument.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CombineSource {
    /// The texture of the unit.
    #[default]
    Texture,
    /// [`TexEnvCombine::constant`].
    Constant,
    /// The lit colour before all textures.
    PrimaryColor,
    /// The result of the unit before.
    Previous,
    /// The texture of another unit, 0 to 3; white where it has none.
    TextureOf(u8),
}

/// The part of a source that an argument is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CombineOperand {
    /// The colour.
    #[default]
    Color,
    /// 1 minus the colour.
    OneMinusColor,
    /// The alpha in all components.
    Alpha,
    /// 1 minus the alpha in all components.
    OneMinusAlpha,
}
