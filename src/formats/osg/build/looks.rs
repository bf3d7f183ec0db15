//! [`Look`]: what the state sets above a drawable say about its material.

use std::sync::Arc;

use super::units::Units;
use crate::formats::osg::objects::{AttributeObject, Inherited, MaterialObject, ON, StateObject};
use crate::math::color::linear_rgba;
use crate::scene::AlphaMode;

/// OpenGL's modes.
pub(super) const GL_CULL_FACE: u32 = 0xb44;
pub(super) const GL_LIGHTING: u32 = 0xb50;
pub(super) const GL_DEPTH_TEST: u32 = 0xb71;
pub(super) const GL_ALPHA_TEST: u32 = 0xbc0;
pub(super) const GL_BLEND: u32 = 0xbe2;
pub(super) const GL_FOG: u32 = 0xb60;
pub(super) const GL_LIGHT0: u32 = 0x4000;
pub(super) const GL_CLIP_PLANE0: u32 = 0x3000;
/// OpenGL's comparisons.
const GL_GREATER: u32 = 0x204;
const GL_GEQUAL: u32 = 0x206;
const GL_ALWAYS: u32 = 0x207;
/// Modes of a material in which vertex colours are the diffuse colour.
const DIFFUSE_COLOR_MODES: [u32; 2] = [0x1201, 0x1602];

/// The state that a drawable's material takes from the state sets above it.
pub(super) struct Look {
    pub units: Units,
    pub is_lit: bool,
    pub culls_faces: bool,
    /// The side of points in pixels.
    pub point_size_px: f32,
    is_blended: bool,
    /// Comparison and reference.
    alpha_test: Option<(u32, f32)>,
    material: Option<MaterialObject>,
    /// Lights, clip planes or fog of the file, which the fixed function alone draws.
    has_fixed_state: bool,
}

impl Look {
    /// Resolves a chain of state sets, outermost first. A viewer of OSG lights by default and culls no faces.
    pub fn resolve(states: &[Arc<StateObject>]) -> Self {
        let mut modes = [
            (GL_LIGHTING, Inherited::new(true)),
            (GL_CULL_FACE, Inherited::new(false)),
            (GL_BLEND, Inherited::new(false)),
            (GL_ALPHA_TEST, Inherited::new(false)),
        ];
        let mut material = Inherited::new(None);
        let mut alpha_func = Inherited::new((GL_ALWAYS, 1.0));
        let mut point_size = Inherited::new(1.0);
        let mut has_fixed_state = false;
        for state in states {
            has_fixed_state |= has_fixed_function_state(state);
            for (mode, flags) in &state.modes {
                if let Some((_, value)) = modes.iter_mut().find(|(known, _)| known == mode) {
                    value.apply(flags & ON != 0, *flags);
                }
            }
            for (attribute, flags) in &state.attributes {
                match &**attribute {
                    AttributeObject::PointSize(size_px) => point_size.apply(*size_px, *flags),
                    AttributeObject::Material(value) => material.apply(Some(*value), *flags),
                    AttributeObject::AlphaFunc { function, reference } => {
                        alpha_func.apply((*function, *reference), *flags);
                    }
                    _ => {}
                }
            }
        }
        let [is_lit, culls_faces, is_blended, tests_alpha] = modes.map(|(_, mode)| mode.value);
        let test = Some(alpha_func.value).filter(|(function, _)| tests_alpha && *function != GL_ALWAYS);
        let (units, alpha_test, material) = (Units::default(), test, material.value);
        let point_size_px = point_size.value;
        let mut look =
            Self { units, is_lit, culls_faces, point_size_px, is_blended, alpha_test, material, has_fixed_state };
        look.units = Units::resolve(states, look.is_fixed());
        look.is_lit &= !look.units.replaces_light;
        look
    }

    /// Returns true if only the fixed function draws the highlights or glows of the material, the alpha test, or the file's
    /// lights, clip planes and fog.
    fn is_fixed(&self) -> bool {
        let has_surface_material = self.material.as_ref().is_some_and(needs_surface_material);
        self.has_fixed_state || has_surface_material || self.alpha_test_beside_material().is_some()
    }

    /// Returns true if vertex colours are shown: without lighting, without a material, or if the material says so.
    pub fn has_vertex_colors(&self) -> bool {
        let shows = |material: &MaterialObject| DIFFUSE_COLOR_MODES.contains(&material.color_mode);
        !self.units.replaces_light && (!self.is_lit || self.material.as_ref().is_none_or(shows))
    }

    /// Returns the linear colour factor of the material.
    pub fn base_color(&self) -> [f32; 4] {
        match &self.material {
            // A material in the state set has the colour already.
            Some(material) if self.is_lit && !self.has_vertex_colors() && !needs_surface_material(material) => {
                linear_rgba(material.diffuse[0])
            }
            _ => [1.0; 4],
        }
    }

    /// Returns the alpha mode of the material.
    pub fn alpha_mode(&self) -> AlphaMode {
        match self.alpha_test {
            _ if self.is_blended => AlphaMode::Blend,
            Some((GL_GREATER, reference)) => AlphaMode::Mask(reference.max(1.0 / 512.0)),
            Some((GL_GEQUAL, reference)) => AlphaMode::Mask(reference),
            _ => AlphaMode::Opaque,
        }
    }

    /// Returns comparison and reference of an alpha test that the material cannot express.
    pub fn alpha_test_beside_material(&self) -> Option<(u32, f32)> {
        let is_mask = |function| matches!(function, GL_GREATER | GL_GEQUAL);
        self.alpha_test.filter(|(function, _)| self.is_blended || !is_mask(*function))
    }
}

/// Returns true if a state set switches lights, clip planes or fog on, or has a light model.
fn has_fixed_function_state(state: &StateObject) -> bool {
    let is_fixed = |mode: u32| {
        mode == GL_FOG || (GL_LIGHT0 + 1..GL_LIGHT0 + 8).contains(&mode) || mode >> 3 == GL_CLIP_PLANE0 >> 3
    };
    state.modes.iter().any(|(mode, flags)| flags & ON != 0 && is_fixed(*mode))
        || state.attributes.iter().any(|(attribute, _)| matches!(**attribute, AttributeObject::LightModel(_)))
}

/// Returns true if a material has highlights or glows, which only OpenGL's fixed function draws.
pub(super) fn needs_surface_material(material: &MaterialObject) -> bool {
    let is_black = |color: &[f32; 4]| color[..3].iter().all(|part| *part <= 0.0);
    let shines = !is_black(&material.specular[0]) && material.shininess[0] > 0.0;
    shines || !is_black(&material.emission[0])
}

/// Returns true if vertex colours replace the diffuse colour of a material.
pub(super) fn has_diffuse_vertex_colors(material: &MaterialObject) -> bool {
    DIFFUSE_COLOR_MODES.contains(&material.color_mode)
}
