//! Makes the engine's lights, clip planes, fog and light models of those of a file. Decode threads.

use std::sync::Arc;

use glam::DVec4;

use crate::fetch::IoError;
use crate::formats::osg::build::Builder;
use crate::formats::osg::objects::{ClipPlaneObject, FogObject, LightModelObject, LightObject, NodeObject};
use crate::math::color::linear_rgba;
use crate::scene::{ClipNode, LightSource, Node, NodeKind, ReferenceFrame};
use crate::state::{BlendEquation, CLIP_PLANES, ColorControl, Fog, FogMode, LIGHTS, Light, LightModel, PolygonMode};

impl Builder<'_> {
    /// Makes the node of a LightSource; a group if its light is not drawn.
    pub(in super::super) fn light_source(
        &mut self,
        object: &Arc<NodeObject>,
        light: Option<&LightObject>,
        is_absolute: bool,
    ) -> Result<Node, IoError> {
        let kind = match light.and_then(|light| self.light(light)) {
            Some(light) => NodeKind::LightSource(Box::new(LightSource { light, frame: frame(is_absolute) })),
            None => NodeKind::Group,
        };
        Ok(Node { children: self.children(&object.children)?, ..Node::new(kind) })
    }

    /// Returns a light; `None`, noted, if it is not drawn. Light 0 is that of OSG's viewer unless a file replaces it. Here sun
    /// and sky are light 0, so that one file does not change the light of a whole scene.
    fn light(&self, light: &LightObject) -> Option<Light> {
        let made = light_of(light);
        match made {
            Some(Light { number: 0, .. }) => {
                self.note("OpenSceneGraph: light 0 of a file (the environment's light takes its place)");
                None
            }
            None => {
                self.note("OpenSceneGraph: a light whose number is not 0 to 7");
                None
            }
            light => light,
        }
    }

    /// Makes the node of a ClipNode.
    pub(in super::super) fn clip_node(
        &mut self,
        object: &Arc<NodeObject>,
        planes: &[ClipPlaneObject],
        is_absolute: bool,
    ) -> Result<Node, IoError> {
        let valid: Vec<(u8, DVec4)> = planes.iter().filter_map(plane_of).collect();
        if valid.len() < planes.len() {
            self.note("OpenSceneGraph: a clip plane whose number is not 0 to 5 or that is not finite");
        }
        let kind = match valid.is_empty() {
            true => NodeKind::Group,
            false => NodeKind::ClipNode(Box::new(ClipNode { planes: valid, frame: frame(is_absolute) })),
        };
        Ok(Node { children: self.children(&object.children)?, ..Node::new(kind) })
    }
}

fn frame(is_absolute: bool) -> ReferenceFrame {
    if is_absolute { ReferenceFrame::Absolute } else { ReferenceFrame::Relative }
}

/// Returns a linear colour without its alpha.
fn rgb(color: [f32; 4]) -> [f32; 3] {
    let [red, green, blue, _] = linear_rgba(color);
    [red, green, blue]
}

/// Returns a light; `None` if OpenGL's fixed function has none of its number.
fn light_of(light: &LightObject) -> Option<Light> {
    /// The largest half angle of a spot light, degrees.
    const MAX_SPOT_DEG: f32 = 90.0;
    let number = u8::try_from(light.number).ok().filter(|number| usize::from(*number) < LIGHTS)?;
    let spot_cutoff = match light.spot_cutoff_deg {
        degrees if degrees <= MAX_SPOT_DEG => degrees.max(0.0).to_radians(),
        _ => std::f32::consts::PI,
    };
    Some(Light {
        number,
        position: light.position,
        direction: light.direction,
        ambient: rgb(light.ambient),
        diffuse: rgb(light.diffuse),
        specular: rgb(light.specular),
        attenuation: light.attenuation,
        spot_cutoff,
        spot_exponent: light.spot_exponent,
        ..Light::default()
    })
}

/// Returns a clip plane with its number; `None` if it cannot be one.
fn plane_of(plane: &ClipPlaneObject) -> Option<(u8, DVec4)> {
    let number = u8::try_from(plane.number).ok().filter(|number| usize::from(*number) < CLIP_PLANES)?;
    let equation = DVec4::from_array(plane.plane);
    equation.is_finite().then_some((number, equation))
}

pub(super) fn light_model_of(model: &LightModelObject) -> LightModel {
    LightModel {
        ambient: rgb(model.ambient),
        local_viewer: model.local_viewer,
        two_sided: model.two_sided,
        color_control: match model.has_separate_specular {
            true => ColorControl::SeparateSpecularColor,
            false => ColorControl::SingleColor,
        },
    }
}

/// Returns fog; `None` if it is not finite.
pub(super) fn fog_of(fog: &FogObject) -> Option<Fog> {
    let FogObject { mode, start: start_m, end: end_m, density: density_per_m, color } = *fog;
    let mode = match mode {
        0x800 => FogMode::Exp { density_per_m },
        0x801 => FogMode::Exp2 { density_per_m },
        _ => FogMode::Linear { start_m, end_m },
    };
    let is_finite = [start_m, end_m, density_per_m].iter().chain(&color).all(|value| value.is_finite());
    is_finite.then(|| Fog { mode, color: rgb(color), is_displayed: true })
}

pub(super) fn polygon_mode_of(mode: u32) -> PolygonMode {
    match mode {
        0x1b00 => PolygonMode::Point,
        0x1b01 => PolygonMode::Line,
        _ => PolygonMode::Fill,
    }
}

/// Returns the equation of an OpenGL number; `None` for those of extensions.
pub(super) fn blend_equation_of(equation: u32) -> Option<BlendEquation> {
    Some(match equation {
        0x8006 => BlendEquation::Add,
        0x8007 => BlendEquation::Min,
        0x8008 => BlendEquation::Max,
        0x800a => BlendEquation::Subtract,
        0x800b => BlendEquation::ReverseSubtract,
        _ => return None,
    })
}
