//! [`Units`]: the textures of the first two texture units as a base colour and an image over it.
//!
//! OSG combines the units in order by their TexEnv. Here the first one that multiplies or replaces is the base colour, and
//! one more is multiplied with it, laid over it or added: light maps, detail maps and decals. Each has its own texture coordinates.
//! A TexEnvCombine counts as the TexEnv that it equals.

use std::sync::Arc;

use super::looks::{GL_TEXTURE_2D, Inherited, ON};
use crate::formats::osg::objects::{AttributeObject, CombineObject, StateObject};
use crate::scene::OverlayMode;

/// The number of units that are looked at.
pub(super) const MAX_UNITS: usize = 2;

/// The mode of OpenGL that generates the first texture coordinate.
const GL_TEXTURE_GEN_S: u32 = 0xc60;
/// OpenGL's texture environments, and functions of TexEnvCombine.
const GL_ADD: u32 = 0x104;
const GL_BLEND: u32 = 0xbe2;
const GL_REPLACE: u32 = 0x1e01;
const GL_MODULATE: u32 = 0x2100;
const GL_DECAL: u32 = 0x2101;
const GL_INTERPOLATE: u32 = 0x8575;
const GL_DOT3: [u32; 2] = [0x86ae, 0x86af];
/// Sources and operands of TexEnvCombine.
const GL_TEXTURE: u32 = 0x1702;
const GL_TEXTURE0: u32 = 0x84c0;
const GL_PRIMARY_COLOR: u32 = 0x8577;
const GL_PREVIOUS: u32 = 0x8578;
const GL_SRC_COLOR: u32 = 0x300;
const GL_SRC_ALPHA: u32 = 0x302;
const GL_ONE_MINUS_SRC_ALPHA: u32 = 0x303;

/// The texture attribute of a unit.
#[derive(Clone)]
pub(super) struct Unit {
    pub number: usize,
    pub texture: Arc<AttributeObject>,
}

/// What the units show.
#[derive(Default)]
pub(super) struct Units {
    /// The texture of the base colour.
    pub base: Option<Unit>,
    /// A texture that changes the base colour.
    pub overlay: Option<(Unit, OverlayMode)>,
    /// True if a texture replaces the lit colour of the surface.
    pub replaces_light: bool,
    /// What is not drawn.
    pub left_out: Vec<&'static str>,
}

/// The state of a unit that state sets pass on.
struct Inheriting {
    is_on: Inherited<bool>,
    /// True if the texture coordinates are generated, such as those of reflections.
    is_generated: Inherited<bool>,
    texture: Inherited<Option<Arc<AttributeObject>>>,
    environment: Inherited<Environment>,
}

/// How a unit combines its texture with the colour of the units below it.
#[derive(Clone, Copy)]
enum Environment {
    Replace,
    Modulate,
    /// The texture is multiplied with the lit colour alone, whatever the units below show.
    ModulateLight,
    Over,
    Add,
    /// The texture is not shown.
    Hidden,
    LeftOut(&'static str),
}

impl Units {
    /// Resolves a chain of state sets, outermost first.
    pub fn resolve(states: &[Arc<StateObject>]) -> Self {
        let mut units = Self::default();
        for number in 0..MAX_UNITS {
            let unit = Inheriting::resolve(states, number);
            let Some(texture) = unit.texture.value.filter(|_| unit.is_on.value) else { continue };
            if unit.is_generated.value {
                units.left_out.push("OpenSceneGraph: texture with generated coordinates (TexGen)");
            } else {
                units.add(Unit { number, texture }, unit.environment.value);
            }
        }
        units
    }

    fn add(&mut self, unit: Unit, environment: Environment) {
        let mode = match environment {
            Environment::Hidden => return,
            Environment::Replace => {
                (self.base, self.overlay, self.replaces_light) = (Some(unit), None, true);
                return;
            }
            Environment::ModulateLight => {
                (self.base, self.overlay, self.replaces_light) = (Some(unit), None, false);
                return;
            }
            Environment::Modulate if self.base.is_none() && self.overlay.is_none() => {
                self.base = Some(unit);
                return;
            }
            Environment::Modulate => OverlayMode::Multiply,
            Environment::Over => OverlayMode::Over,
            Environment::Add => OverlayMode::Add,
            Environment::LeftOut(what) => return self.left_out.push(what),
        };
        if self.overlay.is_some() {
            return self.left_out.push("OpenSceneGraph: texture of unit 1 over one that is no base colour");
        }
        self.overlay = Some((unit, mode));
    }
}

impl Inheriting {
    fn resolve(states: &[Arc<StateObject>], number: usize) -> Self {
        let mut unit = Self {
            is_on: Inherited::new(false),
            is_generated: Inherited::new(false),
            texture: Inherited::new(None),
            environment: Inherited::new(Environment::Modulate),
        };
        for state in states {
            for (mode, flags) in state.texture_modes.get(number).into_iter().flatten() {
                match *mode {
                    GL_TEXTURE_2D => unit.is_on.apply(flags & ON != 0, *flags),
                    GL_TEXTURE_GEN_S => unit.is_generated.apply(flags & ON != 0, *flags),
                    _ => {}
                }
            }
            for (attribute, flags) in state.texture_attributes.get(number).into_iter().flatten() {
                match &**attribute {
                    AttributeObject::Texture(_) => unit.texture.apply(Some(attribute.clone()), *flags),
                    AttributeObject::TexEnv(mode) => unit.environment.apply(Environment::of_mode(*mode), *flags),
                    AttributeObject::Combine(combine) => {
                        unit.environment.apply(Environment::of_combine(combine, number), *flags);
                    }
                    _ => {}
                }
            }
        }
        unit
    }
}

impl Environment {
    fn of_mode(mode: u32) -> Self {
        match mode {
            GL_REPLACE => Self::Replace,
            GL_MODULATE => Self::Modulate,
            GL_DECAL => Self::Over,
            GL_ADD => Self::Add,
            GL_BLEND => Self::LeftOut("OpenSceneGraph: TexEnv BLEND"),
            _ => Self::LeftOut("OpenSceneGraph: unknown TexEnv"),
        }
    }

    /// Returns the environment that a TexEnvCombine of a unit equals.
    fn of_combine(combine: &CombineObject, number: usize) -> Self {
        let CombineObject { function, sources, operands, scale } = *combine;
        let of = |i: usize| match sources[i] {
            // A unit can name its own texture by its number.
            source if source.checked_sub(GL_TEXTURE0) == Some(number as u32) => (GL_TEXTURE, operands[i]),
            // The first unit has the lit colour below it.
            GL_PRIMARY_COLOR if number == 0 => (GL_PREVIOUS, operands[i]),
            source => (source, operands[i]),
        };
        const TEXTURE: (u32, u32) = (GL_TEXTURE, GL_SRC_COLOR);
        const PREVIOUS: (u32, u32) = (GL_PREVIOUS, GL_SRC_COLOR);
        const LIGHT: (u32, u32) = (GL_PRIMARY_COLOR, GL_SRC_COLOR);
        let is_pair = |other| [of(0), of(1)] == [TEXTURE, other] || [of(0), of(1)] == [other, TEXTURE];
        let is_over = |other: (u32, u32)| match [of(0), of(1), of(2)] {
            [TEXTURE, below, (GL_TEXTURE, GL_SRC_ALPHA)] => below == other,
            [below, TEXTURE, (GL_TEXTURE, GL_ONE_MINUS_SRC_ALPHA)] => below == other,
            _ => false,
        };
        match function {
            _ if scale != 1.0 => Self::LeftOut("OpenSceneGraph: scale of a TexEnvCombine"),
            GL_REPLACE if of(0) == TEXTURE => Self::Replace,
            GL_REPLACE if of(0) == PREVIOUS => Self::Hidden,
            GL_MODULATE if is_pair(PREVIOUS) => Self::Modulate,
            GL_MODULATE if is_pair(LIGHT) => Self::ModulateLight,
            GL_ADD if is_pair(PREVIOUS) => Self::Add,
            GL_INTERPOLATE if is_over(PREVIOUS) => Self::Over,
            function if GL_DOT3.contains(&function) => {
                Self::LeftOut("OpenSceneGraph: TexEnvCombine with a dot product (bump map)")
            }
            _ => Self::LeftOut("OpenSceneGraph: TexEnvCombine of another function or other sources"),
        }
    }
}
