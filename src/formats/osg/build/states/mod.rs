//! State sets of the engine of those of a file. Decode threads.

mod lighting;
mod points;

use std::sync::Arc;

use glam::DVec3;

use self::lighting::{blend_equation_of, fog_of, light_model_of, polygon_mode_of};
use super::Builder;
use super::looks::{
    GL_ALPHA_TEST, GL_BLEND, GL_CLIP_PLANE0, GL_CULL_FACE, GL_DEPTH_TEST, GL_FOG, GL_LIGHT0, GL_LIGHTING,
    has_diffuse_vertex_colors, needs_surface_material,
};
use super::textures::FixedUnit;
use super::units::MAX_UNITS;
use crate::formats::osg::objects::{AttributeObject, MaterialObject, ON, StateObject};
use crate::math::color::linear_rgba;
use crate::state::{
    AlphaFunc, Attribute, BlendFactor, BlendFunc, CLIP_PLANES, ColorMask, CompareFunction, CullFace, Depth, FrontFace,
    LIGHTS, Mode, PolygonOffset, StateSet, StateValue, SurfaceMaterial, TexEnv,
};

/// OpenGL's modes that are read here alone.
const GL_POLYGON_OFFSET_FILL: u32 = 0x8037;
/// Modes that change nothing here: the engine's normals have unit length, and vertex colours need no mode.
const WITHOUT_EFFECT: [u32; 3] = [0xba1, 0x803a, 0xb57];

/// The rendering hints of OSG.
const HINT_OPAQUE: i32 = 1;
const HINT_TRANSPARENT: i32 = 2;

impl Builder<'_> {
    /// Returns the state set of an object; `None` if nothing of it is left beside the materials of drawables.
    pub(super) fn state_set(&mut self, object: &Arc<StateObject>) -> Option<Arc<StateSet>> {
        let key = Arc::as_ptr(object).addr();
        if let Some(known) = self.sets.get(&key) {
            return known.clone();
        }
        let made = self.new_state_set(object);
        let set = (made != StateSet::default()).then(|| Arc::new(StateSet { name: object.name.clone(), ..made }));
        self.sets.insert(key, set.clone());
        set
    }

    fn new_state_set(&self, object: &StateObject) -> StateSet {
        let mut set = StateSet::default();
        for (mode, flags) in &object.modes {
            match *mode {
                // It is in the materials of the drawables.
                GL_ALPHA_TEST => {}
                mode if WITHOUT_EFFECT.contains(&mode) => {}
                // Without OpenGL's fog there is the haze of the environment.
                GL_FOG if flags & ON == 0 && !self.is_on_above(GL_FOG) => {}
                mode => match mode_of(mode) {
                    Some(mode) => drop(set.set_mode(mode, value(*flags))),
                    None if *flags & 1 == 0 => {}
                    None => self.note(format!("OpenSceneGraph: mode 0x{mode:x}")),
                },
            }
        }
        let has_fog = object.modes.iter().any(|(mode, flags)| *mode == GL_FOG && flags & ON != 0);
        for (attribute, flags) in &object.attributes {
            // The engine has fog wherever it has the attribute.
            if matches!(**attribute, AttributeObject::Fog(_)) && !has_fog && !self.is_on_above(GL_FOG) {
                continue;
            }
            if let Some(attribute) = self.attribute(attribute) {
                set.set_attribute(attribute, value(*flags | 1));
            }
        }
        self.note_textures(object);
        let (number, name) = match object.hint {
            _ if object.bin_mode != 0 => (object.bin_number, object.bin_name.as_str()),
            HINT_OPAQUE => (0, "RenderBin"),
            HINT_TRANSPARENT => (10, "DepthSortedBin"),
            _ => (0, ""),
        };
        if let Err(error) = set.set_render_bin_details(number, name) {
            self.note(format!("OpenSceneGraph: {error}"));
        }
        if object.bin_mode != 0 {
            (set.bin_value, set.nest_bins) = (value(object.bin_mode | 1), object.nest_bins);
        }
        set
    }

    /// Notes an attribute that could not be made.
    fn valid<T>(&self, made: Option<T>) -> Option<T> {
        if made.is_none() {
            self.note("OpenSceneGraph: an attribute that is out of range");
        }
        made
    }

    /// Returns true if one of the state sets above switches a mode on.
    fn is_on_above(&self, mode: u32) -> bool {
        self.states.iter().flat_map(|state| &state.modes).any(|(known, flags)| *known == mode && flags & ON != 0)
    }

    /// Notes what texture units have beside the textures that are drawn.
    fn note_textures(&self, object: &StateObject) {
        for (unit, attributes) in object.texture_attributes.iter().enumerate() {
            for (attribute, _) in attributes {
                match &**attribute {
                    AttributeObject::Texture(_) if unit >= MAX_UNITS => {
                        self.note("OpenSceneGraph: texture of a unit above 7");
                    }
                    AttributeObject::Other(name) => self.note(format!("OpenSceneGraph: attribute {name}")),
                    _ => {}
                }
            }
        }
    }

    fn attribute(&self, object: &AttributeObject) -> Option<Attribute> {
        Some(match object {
            AttributeObject::Material(material) if needs_surface_material(material) => {
                Attribute::SurfaceMaterial(surface_material(material))
            }
            // They are in the drawables.
            AttributeObject::Material(_) | AttributeObject::AlphaFunc { .. } | AttributeObject::PointSize(_) => {
                return None;
            }
            AttributeObject::BlendFunc(factors) => {
                let [source, destination, source_alpha, destination_alpha] = factors.map(blend_factor);
                Attribute::BlendFunc(BlendFunc {
                    source: source?,
                    destination: destination?,
                    source_alpha: source_alpha?,
                    destination_alpha: destination_alpha?,
                })
            }
            AttributeObject::CullFace(face) => Attribute::CullFace(match face {
                0x404 => CullFace::Front,
                0x408 => CullFace::FrontAndBack,
                _ => CullFace::Back,
            }),
            AttributeObject::FrontFace(winding) => Attribute::FrontFace(match winding {
                0x900 => FrontFace::Clockwise,
                _ => FrontFace::CounterClockwise,
            }),
            AttributeObject::Depth { function, range, write } => {
                let range = range.map(|depth| if depth.is_finite() { depth.clamp(0.0, 1.0) as f32 } else { 0.0 });
                Attribute::Depth(Depth { function: comparison(*function)?, write: *write, range })
            }
            AttributeObject::PolygonOffset { factor, units } => {
                Attribute::PolygonOffset(PolygonOffset { factor: *factor, units: *units })
            }
            AttributeObject::ColorMask(mask) => Attribute::ColorMask(ColorMask(*mask)),
            AttributeObject::LightModel(model) => Attribute::LightModel(light_model_of(model)),
            AttributeObject::Fog(fog) => Attribute::Fog(self.valid(fog_of(fog))?),
            // OSG has them in the frame of each drawable below; those of the engine move with the eye.
            AttributeObject::Light(_) => {
                self.note("OpenSceneGraph: light of a state set (not used)");
                return None;
            }
            AttributeObject::ClipPlane(_) => {
                self.note("OpenSceneGraph: clip plane of a state set (not used)");
                return None;
            }
            AttributeObject::PolygonMode(mode) => Attribute::PolygonMode(polygon_mode_of(*mode)),
            AttributeObject::BlendColor(color) => Attribute::BlendColor(linear_rgba(*color)),
            AttributeObject::BlendEquation([color, alpha]) if color == alpha => {
                Attribute::BlendEquation(self.valid(blend_equation_of(*color))?)
            }
            AttributeObject::BlendEquation(_) => {
                self.note("OpenSceneGraph: BlendEquation that differs for alpha");
                return None;
            }
            AttributeObject::Other(name) => {
                self.note(format!("OpenSceneGraph: attribute {name}"));
                return None;
            }
            // They belong to texture units.
            AttributeObject::Texture(_)
            | AttributeObject::TexEnv { .. }
            | AttributeObject::Combine(_)
            | AttributeObject::TexGen { .. }
            | AttributeObject::TexMat(_) => return None,
        })
    }
}

impl Builder<'_> {
    /// Returns the state set of drawables with texture units of the fixed function, or with an alpha test that their material
    /// cannot express; `None` without either. `origin` is what the positions of the mesh are relative to.
    pub(super) fn state_of_drawable(
        &mut self,
        units: &[FixedUnit],
        origin: DVec3,
        alpha_test: Option<(u32, f32)>,
    ) -> Option<Arc<StateSet>> {
        /// The number of sets that are compared with a new one.
        const MAX_COMPARED: usize = 16;
        if units.is_empty() && alpha_test.is_none() {
            return None;
        }
        let mut set = StateSet::default();
        for (slot, unit) in (0..).zip(units) {
            set = set.with(Attribute::Texture(slot, unit.binding.clone()));
            if unit.environment != TexEnv::Modulate {
                set = set.with(Attribute::TexEnv(slot, unit.environment));
            }
            if let Some(generator) = unit.coordinates.generator(unit.own_coordinates, origin) {
                set = set.with(Attribute::TexGen(slot, generator));
            }
            let matrix = unit.coordinates.fixed_matrix(unit.are_turned_over, unit.is_turned_over);
            if let Some(matrix) = matrix {
                set = set.with(Attribute::TexMat(slot, matrix));
            }
        }
        if let Some((function, reference)) = alpha_test {
            let function = comparison(function).unwrap_or(CompareFunction::Always);
            set = set.with(Attribute::AlphaFunc(AlphaFunc { function, reference }));
        }
        // Drawables with equal state are drawn together.
        let recent = self.drawable_sets.iter().rev().take(MAX_COMPARED);
        if let Some(known) = recent.into_iter().find(|known| known.attributes == set.attributes) {
            return Some(known.clone());
        }
        let set = Arc::new(set);
        self.drawable_sets.push(set.clone());
        Some(set)
    }
}

fn mode_of(mode: u32) -> Option<Mode> {
    Some(match mode {
        GL_BLEND => Mode::Blend,
        GL_CULL_FACE => Mode::CullFace,
        GL_DEPTH_TEST => Mode::DepthTest,
        GL_LIGHTING => Mode::Lighting,
        GL_POLYGON_OFFSET_FILL => Mode::PolygonOffset,
        GL_FOG => Mode::Fog,
        _ => {
            let number = |first: u32, count: usize| {
                let number = mode.checked_sub(first).and_then(|number| u8::try_from(number).ok());
                number.filter(|number| usize::from(*number) < count)
            };
            let light = number(GL_LIGHT0, LIGHTS).map(Mode::Light);
            light.or(number(GL_CLIP_PLANE0, CLIP_PLANES).map(Mode::ClipPlane))?
        }
    })
}

/// Converts OSG's flags.
fn value(flags: u32) -> StateValue {
    let all = [StateValue::ON, StateValue::OVERRIDE, StateValue::PROTECTED, StateValue::INHERIT];
    let set = all.iter().enumerate().filter(|(bit, _)| flags & 1 << bit != 0);
    set.fold(StateValue::OFF, |value, (_, flag)| value | *flag)
}

fn comparison(function: u32) -> Option<CompareFunction> {
    use CompareFunction::{Always, Equal, Greater, GreaterOrEqual, Less, LessOrEqual, Never, NotEqual};
    let all = [Never, Less, Equal, LessOrEqual, Greater, NotEqual, GreaterOrEqual, Always];
    all.get(function.checked_sub(0x200)? as usize).copied()
}

fn blend_factor(factor: u32) -> Option<BlendFactor> {
    Some(match factor {
        0 => BlendFactor::Zero,
        1 => BlendFactor::One,
        0x300 => BlendFactor::SrcColor,
        0x301 => BlendFactor::OneMinusSrcColor,
        0x302 => BlendFactor::SrcAlpha,
        0x303 => BlendFactor::OneMinusSrcAlpha,
        0x304 => BlendFactor::DstAlpha,
        0x305 => BlendFactor::OneMinusDstAlpha,
        0x306 => BlendFactor::DstColor,
        0x307 => BlendFactor::OneMinusDstColor,
        0x308 => BlendFactor::SrcAlphaSaturate,
        0x8001 => BlendFactor::ConstantColor,
        0x8002 => BlendFactor::OneMinusConstantColor,
        0x8003 => BlendFactor::ConstantAlpha,
        0x8004 => BlendFactor::OneMinusConstantAlpha,
        _ => return None,
    })
}

fn surface_material(material: &MaterialObject) -> SurfaceMaterial {
    let color = |sides: &[[f32; 4]; 2]| linear_rgba(sides[0]);
    let rgb = |sides: &[[f32; 4]; 2]| {
        let [red, green, blue, _] = color(sides);
        [red, green, blue]
    };
    // Vertex colours multiply what they replace in OpenGL.
    let has_colors = has_diffuse_vertex_colors(material);
    SurfaceMaterial {
        ambient: rgb(&material.ambient),
        diffuse: if has_colors { [1.0; 4] } else { color(&material.diffuse) },
        specular: rgb(&material.specular),
        emission: rgb(&material.emission),
        shininess: material.shininess[0].clamp(0.0, 128.0),
    }
}
