//! [`Units`]: the textures of the first two texture units as a base colour and an image over it.
//!
//! OSG combines the units in order by their TexEnv. Here the first one that multiplies or replaces is the base colour, and
//! one more is multiplied with it, laid over it or added: light maps, detail maps and decals. Each has its own texture coordinates.

use std::sync::Arc;

use super::looks::{GL_TEXTURE_2D, Inherited, ON};
use crate::formats::osg::objects::{AttributeObject, StateObject};
use crate::scene::OverlayMode;

/// The number of units that are looked at.
pub(super) const MAX_UNITS: usize = 2;

/// OpenGL's texture environments.
const GL_ADD: u32 = 0x104;
const GL_BLEND: u32 = 0xbe2;
const GL_REPLACE: u32 = 0x1e01;
const GL_MODULATE: u32 = 0x2100;
const GL_DECAL: u32 = 0x2101;

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
    texture: Inherited<Option<Arc<AttributeObject>>>,
    environment: Inherited<u32>,
}

impl Units {
    /// Resolves a chain of state sets, outermost first.
    pub fn resolve(states: &[Arc<StateObject>]) -> Self {
        let mut units = Self::default();
        for number in 0..MAX_UNITS {
            let unit = Inheriting::resolve(states, number);
            if let Some(texture) = unit.texture.value.filter(|_| unit.is_on.value) {
                units.add(Unit { number, texture }, unit.environment.value);
            }
        }
        units
    }

    fn add(&mut self, unit: Unit, environment: u32) {
        let mode = match environment {
            GL_REPLACE => {
                (self.base, self.overlay, self.replaces_light) = (Some(unit), None, true);
                return;
            }
            GL_MODULATE if self.base.is_none() && self.overlay.is_none() => {
                self.base = Some(unit);
                return;
            }
            GL_MODULATE => OverlayMode::Multiply,
            GL_DECAL => OverlayMode::Over,
            GL_ADD => OverlayMode::Add,
            GL_BLEND => return self.left_out.push("OpenSceneGraph: TexEnv BLEND"),
            _ => return self.left_out.push("OpenSceneGraph: unknown TexEnv"),
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
            texture: Inherited::new(None),
            environment: Inherited::new(GL_MODULATE),
        };
        for state in states {
            let modes = state.texture_modes.get(number).into_iter().flatten();
            for (_, flags) in modes.filter(|(mode, _)| *mode == GL_TEXTURE_2D) {
                unit.is_on.apply(flags & ON != 0, *flags);
            }
            for (attribute, flags) in state.texture_attributes.get(number).into_iter().flatten() {
                match &**attribute {
                    AttributeObject::Texture(_) => unit.texture.apply(Some(attribute.clone()), *flags),
                    AttributeObject::TexEnv(mode) => unit.environment.apply(*mode, *flags),
                    _ => {}
                }
            }
        }
        unit
    }
}
