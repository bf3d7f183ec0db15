//! [`Environment`]: how a texture unit changes the colour of the units below it, as OSG's TexEnv and TexEnvCombine say. Decode
//! threads.

use crate::formats::osg::objects::{CombineObject, CombinePart};
use crate::math::color::linear_rgba;
use crate::state::{CombineFunction, CombineOperand, CombineSource, TexEnv, TexEnvCombine};

/// OpenGL's texture environments, and functions of TexEnvCombine.
const GL_ADD: u32 = 0x104;
const GL_BLEND: u32 = 0xbe2;
const GL_REPLACE: u32 = 0x1e01;
const GL_DECAL: u32 = 0x2101;
const GL_SUBTRACT: u32 = 0x84e7;
const GL_ADD_SIGNED: u32 = 0x8574;
const GL_INTERPOLATE: u32 = 0x8575;
const GL_DOT3_RGB: u32 = 0x86ae;
const GL_DOT3_RGBA: u32 = 0x86af;
/// Sources and operands of TexEnvCombine.
const GL_TEXTURE: u32 = 0x1702;
const GL_TEXTURE0: u32 = 0x84c0;
const GL_CONSTANT: u32 = 0x8576;
const GL_PRIMARY_COLOR: u32 = 0x8577;
const GL_PREVIOUS: u32 = 0x8578;
const GL_SRC_COLOR: u32 = 0x300;
const GL_ONE_MINUS_SRC_COLOR: u32 = 0x301;
const GL_SRC_ALPHA: u32 = 0x302;
const GL_ONE_MINUS_SRC_ALPHA: u32 = 0x303;

/// The environment of a unit.
#[derive(Clone, Copy)]
pub(super) struct Environment {
    /// Its counterpart in the quick shaders; `None` if only the fixed function has it.
    pub quick: Option<Quick>,
    /// True if the lit colour is an argument by itself.
    pub uses_light: bool,
    /// Its form for the fixed function. Textures of other units have OSG's numbers.
    full: TexEnv,
}

/// The environments of the quick shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quick {
    Replace,
    Modulate,
    /// The texture is multiplied with the lit colour alone, whatever the units below show.
    ModulateLight,
    Over,
    Add,
    /// The texture is not shown.
    Hidden,
}

impl Environment {
    pub const GL_MODULATE: u32 = 0x2100;

    /// Returns the environment of a TexEnv. OpenGL takes none but these modes; unknown ones count as its default.
    pub fn of_mode(mode: u32, color: [f32; 4]) -> Self {
        let (quick, full) = match mode {
            GL_REPLACE => (Some(Quick::Replace), TexEnv::Replace),
            GL_DECAL => (Some(Quick::Over), TexEnv::Decal),
            GL_ADD => (Some(Quick::Add), TexEnv::Add),
            GL_BLEND => (None, TexEnv::Blend(linear_rgba(color))),
            _ => (Some(Quick::Modulate), TexEnv::Modulate),
        };
        Self { quick, uses_light: false, full: as_displayed(full) }
    }

    /// Returns the environment of a TexEnvCombine of a unit; `None` for one that is unknown.
    pub fn of_combine(combine: &CombineObject, number: usize) -> Option<Self> {
        let parts = [combine.color, combine.alpha].map(|part| arguments(&part, number));
        let [(color, color_arguments), (alpha, alpha_arguments)] = [parts[0]?, parts[1]?];
        let full = TexEnvCombine {
            color,
            color_arguments,
            color_scale: scale(combine.color.scale),
            alpha,
            alpha_arguments,
            alpha_scale: scale(combine.alpha.scale),
            constant: linear_rgba(combine.constant),
            is_displayed: true,
        };
        let lit = |(source, _): &(CombineSource, CombineOperand)| *source == CombineSource::PrimaryColor;
        let uses_light = full.color_arguments[..arity(color)].iter().any(lit);
        Some(Self { quick: quick_of(&combine.color, number), uses_light, full: TexEnv::Combine(full) })
    }

    /// Returns true if the texture of another unit is an argument.
    pub fn reads(&self, number: usize) -> bool {
        let TexEnv::Combine(combine) = &self.full else { return false };
        let of = CombineSource::TextureOf(number as u8);
        combine.color_arguments[..arity(combine.color)].iter().any(|(source, _)| *source == of)
            || combine.alpha_arguments[..arity(combine.alpha)].iter().any(|(source, _)| *source == of)
    }

    /// Returns the environment with the numbers that units have in the fixed function: their indices in a list.
    pub fn renumbered(self, numbers: &[usize]) -> TexEnv {
        /// The texture of a unit that is off is white.
        const WHITE: CombineSource = CombineSource::TextureOf(u8::MAX);
        let TexEnv::Combine(mut combine) = self.full else { return self.full };
        for (source, _) in combine.color_arguments.iter_mut().chain(&mut combine.alpha_arguments) {
            if let CombineSource::TextureOf(number) = *source {
                let slot = numbers.iter().position(|known| *known == usize::from(number));
                *source = slot.map_or(WHITE, |slot| CombineSource::TextureOf(slot as u8));
            }
        }
        TexEnv::Combine(combine)
    }
}

/// Returns an environment that combines values as they are displayed, as OpenGL does. A product is the same in light.
fn as_displayed(environment: TexEnv) -> TexEnv {
    match environment {
        TexEnv::Modulate => environment,
        _ => TexEnv::Combine(TexEnvCombine { is_displayed: true, ..environment.as_combination() }),
    }
}

/// Returns a factor, which OpenGL allows to be 1, 2 or 4.
fn scale(scale: f32) -> f32 {
    if scale.is_finite() { scale.clamp(0.0, 4.0) } else { 1.0 }
}

/// Returns the number of arguments of a function.
fn arity(function: CombineFunction) -> usize {
    match function {
        CombineFunction::Replace => 1,
        CombineFunction::Interpolate => 3,
        _ => 2,
    }
}

type Arguments = [(CombineSource, CombineOperand); 3];

/// Returns function and arguments of a part; `None` if something that the function takes is unknown.
fn arguments(part: &CombinePart, number: usize) -> Option<(CombineFunction, Arguments)> {
    let function = match part.function {
        GL_REPLACE => CombineFunction::Replace,
        Environment::GL_MODULATE => CombineFunction::Modulate,
        GL_ADD => CombineFunction::Add,
        GL_ADD_SIGNED => CombineFunction::AddSigned,
        GL_INTERPOLATE => CombineFunction::Interpolate,
        GL_SUBTRACT => CombineFunction::Subtract,
        GL_DOT3_RGB => CombineFunction::Dot3Rgb,
        GL_DOT3_RGBA => CombineFunction::Dot3Rgba,
        _ => return None,
    };
    let mut arguments = [(CombineSource::Texture, CombineOperand::Color); 3];
    for (i, argument) in arguments.iter_mut().enumerate().take(arity(function)) {
        let source = match part.sources[i] {
            GL_TEXTURE => CombineSource::Texture,
            GL_CONSTANT => CombineSource::Constant,
            GL_PRIMARY_COLOR => CombineSource::PrimaryColor,
            GL_PREVIOUS => CombineSource::Previous,
            source => match u8::try_from(source.checked_sub(GL_TEXTURE0)?).ok()? {
                // A unit can name its own texture by its number.
                unit if usize::from(unit) == number => CombineSource::Texture,
                unit => CombineSource::TextureOf(unit),
            },
        };
        let operand = match part.operands[i] {
            GL_SRC_COLOR => CombineOperand::Color,
            GL_ONE_MINUS_SRC_COLOR => CombineOperand::OneMinusColor,
            GL_SRC_ALPHA => CombineOperand::Alpha,
            GL_ONE_MINUS_SRC_ALPHA => CombineOperand::OneMinusAlpha,
            _ => return None,
        };
        *argument = (source, operand);
    }
    Some((function, arguments))
}

/// Returns the environment of the quick shaders that the colours of a TexEnvCombine equal.
fn quick_of(part: &CombinePart, number: usize) -> Option<Quick> {
    const TEXTURE: (u32, u32) = (GL_TEXTURE, GL_SRC_COLOR);
    const PREVIOUS: (u32, u32) = (GL_PREVIOUS, GL_SRC_COLOR);
    const LIGHT: (u32, u32) = (GL_PRIMARY_COLOR, GL_SRC_COLOR);
    let of = |i: usize| match part.sources[i] {
        source if source.checked_sub(GL_TEXTURE0) == Some(number as u32) => (GL_TEXTURE, part.operands[i]),
        // The first unit has the lit colour below it.
        GL_PRIMARY_COLOR if number == 0 => (GL_PREVIOUS, part.operands[i]),
        source => (source, part.operands[i]),
    };
    let is_pair = |other| [of(0), of(1)] == [TEXTURE, other] || [of(0), of(1)] == [other, TEXTURE];
    let is_over = matches!(
        [of(0), of(1), of(2)],
        [TEXTURE, PREVIOUS, (GL_TEXTURE, GL_SRC_ALPHA)] | [PREVIOUS, TEXTURE, (GL_TEXTURE, GL_ONE_MINUS_SRC_ALPHA)]
    );
    match part.function {
        _ if part.scale != 1.0 => None,
        GL_REPLACE if of(0) == TEXTURE => Some(Quick::Replace),
        GL_REPLACE if of(0) == PREVIOUS => Some(Quick::Hidden),
        Environment::GL_MODULATE if is_pair(PREVIOUS) => Some(Quick::Modulate),
        Environment::GL_MODULATE if is_pair(LIGHT) => Some(Quick::ModulateLight),
        GL_ADD if is_pair(PREVIOUS) => Some(Quick::Add),
        GL_INTERPOLATE if is_over => Some(Quick::Over),
        _ => None,
    }
}
