//! [`Units`]: the texture units of a drawable, as a base colour with an image over it, or for the fixed function.
//!
//! OSG combines the units in order by their TexEnv. The quick shaders draw a texture that multiplies or replaces, and one more
//! that is multiplied with it, laid over it or added: light maps, detail maps and decals. A TexEnvCombine counts as the TexEnv
//! that it equals. Everything else takes the units of the fixed function: further textures, coordinates that follow the eye,
//! cubes and other combinations.

use std::sync::Arc;

use super::coordinates::Coordinates;
use super::environments::{Environment, Quick};
use crate::formats::osg::classes::PLANES;
use crate::formats::osg::objects::{AttributeObject, Inherited, ON, StateObject, TextureTarget};
use crate::scene::OverlayMode;
use crate::state::{TEXTURE_UNITS, TexEnv};

/// The number of units that are looked at.
pub(super) const MAX_UNITS: usize = 8;

/// The modes of OpenGL that switch on the kinds of textures and generate coordinates.
const TARGETS: [TextureTarget; 5] =
    [TextureTarget::D1, TextureTarget::D2, TextureTarget::Rectangle, TextureTarget::Cube, TextureTarget::D3];
const GL_TEXTURE_GEN: [u32; 4] = [0xc60, 0xc61, 0xc62, 0xc63];
const GL_EYE_LINEAR: u32 = 0x2400;

/// A texture unit that is on.
#[derive(Clone)]
pub(super) struct Unit {
    pub number: usize,
    pub texture: Arc<AttributeObject>,
    pub target: TextureTarget,
    pub coordinates: Coordinates,
    /// The coordinates are texels of an image instead of shares of its size.
    pub is_in_texels: bool,
}

impl Unit {
    /// Returns true for an image whose coordinates meshes can make.
    fn is_plain(&self) -> bool {
        !matches!(self.target, TextureTarget::Cube | TextureTarget::D3) && self.coordinates.of_meshes().is_some()
    }
}

/// The parts of a material that texture units make.
#[derive(Default)]
pub(super) struct Units {
    /// The texture of the base colour.
    pub base: Option<Unit>,
    /// A texture that changes the base colour in the quick shaders.
    pub overlay: Option<(Unit, OverlayMode)>,
    /// The units of the fixed function by their numbers there; without an overlay.
    pub fixed: Vec<(Unit, TexEnv)>,
    /// True if a texture replaces the lit colour of the surface.
    pub replaces_light: bool,
    /// Names of the features that are not drawn.
    pub left_out: Vec<&'static str>,
}

/// The state of a unit that state sets pass on.
struct Inheriting {
    /// By the indices of [`TARGETS`].
    is_on: [Inherited<bool>; 5],
    /// True for the coordinates s, t, r and q that are generated.
    is_generated: [Inherited<bool>; 4],
    texture: Inherited<Option<Arc<AttributeObject>>>,
    generator: Inherited<(u32, [[f64; 4]; 4])>,
    matrix: Inherited<Option<Arc<AttributeObject>>>,
    environment: Inherited<Option<Environment>>,
}

impl Units {
    /// Resolves a chain of state sets, outermost first. `is_fixed` says that the fixed function draws the surface anyhow.
    pub fn resolve(states: &[Arc<StateObject>], is_fixed: bool) -> Self {
        let count = states.iter().map(|state| state.texture_modes.len()).max().unwrap_or(0);
        let mut left_out = Vec::new();
        let mut found = Vec::new();
        for number in 0..count.min(MAX_UNITS) {
            match Inheriting::resolve(states, number).into_unit(number) {
                Ok(Some((_, Environment { quick: Some(Quick::Hidden), .. }))) | Ok(None) => {}
                Ok(Some(unit)) => found.push(unit),
                Err(what) => left_out.push(what),
            }
        }
        // Units that a later one covers are not drawn, unless a unit behind it reads their textures.
        let covers = |(_, environment): &(Unit, Environment)| {
            matches!(environment.quick, Some(Quick::Replace | Quick::ModulateLight))
        };
        let first = found.iter().rposition(covers).unwrap_or(0);
        let is_read = |number: usize| found[first..].iter().any(|(_, environment)| environment.reads(number));
        if !found[..first].iter().any(|(unit, _)| is_read(unit.number)) {
            found.drain(..first);
        }
        let simple = Self::simple(&found).filter(|units| !is_fixed || units.overlay.is_none());
        let units = simple.unwrap_or_else(|| Self::fixed(found, &mut left_out));
        Self { left_out, ..units }
    }

    /// Returns the units for the quick shaders; `None` if they cannot draw them.
    fn simple(found: &[(Unit, Environment)]) -> Option<Self> {
        let mut units = Self::default();
        for (unit, environment) in found {
            let quick = environment.quick.filter(|_| unit.is_plain())?;
            let is_first = units.base.is_none() && units.overlay.is_none();
            let mode = match quick {
                Quick::Replace | Quick::ModulateLight if is_first => {
                    (units.base, units.replaces_light) = (Some(unit.clone()), quick == Quick::Replace);
                    continue;
                }
                Quick::Modulate if is_first => {
                    units.base = Some(unit.clone());
                    continue;
                }
                Quick::Modulate => OverlayMode::Multiply,
                Quick::Over => OverlayMode::Over,
                Quick::Add => OverlayMode::Add,
                Quick::Replace | Quick::ModulateLight | Quick::Hidden => return None,
            };
            if units.overlay.is_some() {
                return None;
            }
            units.overlay = Some((unit.clone(), mode));
        }
        Some(units)
    }

    /// Returns the units for the fixed function. The first one stays the base colour if nothing else needs its texture, since
    /// other formats have base colours too.
    fn fixed(mut found: Vec<(Unit, Environment)>, left_out: &mut Vec<&'static str>) -> Self {
        let mut units = Self::default();
        let uses_light = found.iter().skip(1).any(|(_, environment)| environment.uses_light);
        if let Some((unit, environment)) = found.first() {
            let is_replacing = environment.quick == Some(Quick::Replace);
            units.replaces_light = is_replacing && !uses_light;
            let multiplies = matches!(environment.quick, Some(Quick::Modulate | Quick::ModulateLight));
            let is_read = found.iter().any(|(_, environment)| environment.reads(unit.number));
            if unit.is_plain() && !is_read && (multiplies || units.replaces_light) {
                units.base = Some(found.remove(0).0);
            }
        }
        for (target, what) in [
            (TextureTarget::Cube, "OpenSceneGraph: second cube map of a surface"),
            (TextureTarget::D3, "OpenSceneGraph: second volume of a surface"),
        ] {
            let mut has_one = false;
            found.retain(|(unit, _)| {
                let is_drawn = unit.target != target || !std::mem::replace(&mut has_one, true);
                if !is_drawn {
                    left_out.push(what);
                }
                is_drawn
            });
        }
        if found.len() > TEXTURE_UNITS {
            left_out.push("OpenSceneGraph: texture of a fifth unit");
            found.truncate(TEXTURE_UNITS);
        }
        let numbers: Vec<usize> = found.iter().map(|(unit, _)| unit.number).collect();
        units.fixed = found.into_iter().map(|(unit, environment)| (unit, environment.renumbered(&numbers))).collect();
        units
    }
}

impl Inheriting {
    fn resolve(states: &[Arc<StateObject>], number: usize) -> Self {
        let mut unit = Self {
            is_on: [const { Inherited::new(false) }; 5],
            is_generated: [const { Inherited::new(false) }; 4],
            texture: Inherited::new(None),
            generator: Inherited::new((GL_EYE_LINEAR, PLANES)),
            matrix: Inherited::new(None),
            environment: Inherited::new(Some(Environment::of_mode(Environment::GL_MODULATE, [0.0; 4]))),
        };
        for state in states {
            for (mode, flags) in state.texture_modes.get(number).into_iter().flatten() {
                let is_on = flags & ON != 0;
                if let Some(at) = TARGETS.iter().position(|target| *target as u32 == *mode) {
                    unit.is_on[at].apply(is_on, *flags);
                } else if let Some(at) = GL_TEXTURE_GEN.iter().position(|of| of == mode) {
                    unit.is_generated[at].apply(is_on, *flags);
                }
            }
            for (attribute, flags) in state.texture_attributes.get(number).into_iter().flatten() {
                match &**attribute {
                    AttributeObject::Texture(_) => unit.texture.apply(Some(attribute.clone()), *flags),
                    AttributeObject::TexGen { mode, planes } => unit.generator.apply((*mode, *planes), *flags),
                    AttributeObject::TexMat(_) => unit.matrix.apply(Some(attribute.clone()), *flags),
                    AttributeObject::TexEnv { mode, color } => {
                        unit.environment.apply(Some(Environment::of_mode(*mode, *color)), *flags);
                    }
                    AttributeObject::Combine(combine) => {
                        unit.environment.apply(Environment::of_combine(combine, number), *flags);
                    }
                    _ => {}
                }
            }
        }
        unit
    }

    /// Returns the unit with its environment; `None` if it is off. The error says what is not drawn.
    fn into_unit(self, number: usize) -> Result<Option<(Unit, Environment)>, &'static str> {
        let Some(texture) = self.texture.value else { return Ok(None) };
        let AttributeObject::Texture(object) = &*texture else { return Ok(None) };
        let target = object.target;
        let is_on = TARGETS.iter().zip(&self.is_on).any(|(of, is_on)| *of == target && is_on.value);
        if !is_on {
            return Ok(None);
        }
        let [has_s, _, has_r, has_q] = self.is_generated.map(|mode| mode.value);
        let (mode, planes) = self.generator.value;
        let mut coordinates = match has_s {
            true => Coordinates::generated(mode, planes, [has_r, has_q])
                .ok_or("OpenSceneGraph: texture with generated coordinates (TexGen) of an unknown kind")?,
            false => Coordinates::GEOMETRY,
        };
        let mut is_in_texels = target == TextureTarget::Rectangle;
        if let Some(AttributeObject::TexMat(matrix)) = self.matrix.value.as_deref() {
            coordinates =
                coordinates.moved(matrix).ok_or("OpenSceneGraph: texture with a TexMat that is not finite")?;
            is_in_texels &= !matrix.scales_by_size;
        }
        let environment = self.environment.value.ok_or("OpenSceneGraph: TexEnvCombine of an unknown function")?;
        Ok(Some((Unit { number, texture, target, coordinates, is_in_texels }, environment)))
    }
}
