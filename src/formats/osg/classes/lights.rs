//! The members of lights, clip planes and fog, of their nodes, and of further attributes of pixels. Decode threads.

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::input::{GL_NAMES, Names};
use crate::formats::osg::objects::{
    AttributeObject, ClipPlaneObject, FogObject, LightModelObject, LightObject, NodeClass, Object,
};

/// The modes of a Fog.
pub(in crate::formats::osg) const FOG_MODES: Names = &[("LINEAR", 0x2601), ("EXP", 0x800), ("EXP2", 0x801)];
/// The equations of a BlendEquation.
pub(in crate::formats::osg) const EQUATIONS: Names = &[
    ("RGBA_MIN", 0x8007),
    ("RGBA_MAX", 0x8008),
    ("ALPHA_MIN", 0x8320),
    ("ALPHA_MAX", 0x8321),
    ("LOGIC_OP", 0xbf1),
    ("FUNC_ADD", 0x8006),
    ("FUNC_SUBTRACT", 0x800a),
    ("FUNC_REVERSE_SUBTRACT", 0x800b),
];

impl Reader<'_> {
    /// Reads the members of an attribute; `None` if the class is none of these.
    pub(super) fn lighting_of(&mut self, class: &str) -> Result<Option<AttributeObject>> {
        Ok(Some(match class {
            "Light" => self.light()?,
            "LightModel" => {
                const CONTROLS: Names =
                    &[("SEPARATE_SPECULAR_COLOR", LightModelObject::SEPARATE_SPECULAR), ("SINGLE_COLOR", 0x81f9)];
                self.attribute_members()?;
                let ambient = self.floats_member("AmbientIntensity", [0.0; 4])?;
                let control = self.named_member("ColorControl", CONTROLS, 0x81f9)?;
                AttributeObject::LightModel(LightModelObject {
                    ambient,
                    has_separate_specular: control == LightModelObject::SEPARATE_SPECULAR,
                    local_viewer: self.boolean_member("LocalViewer", false)?,
                    two_sided: self.boolean_member("TwoSided", false)?,
                })
            }
            "Fog" => {
                self.attribute_members()?;
                // Text has no LINEAR, which is what OSG's writer takes for the default. Its reader takes EXP then.
                let mode = self.named_member("Mode", FOG_MODES, 0x2601)?;
                let start = self.float_member("Start", 0.0)?;
                let end = self.float_member("End", 1.0)?;
                let density = self.float_member("Density", 1.0)?;
                let color = self.floats_member("Color", [0.0; 4])?;
                self.skipped_constant("FogCoordinateSource")?;
                if !self.input.is_at_end_of_block() {
                    self.boolean_member("UseRadialFog", false)?;
                }
                AttributeObject::Fog(FogObject { mode, start, end, density, color })
            }
            "ClipPlane" => {
                self.attribute_members()?;
                let plane = if self.member("ClipPlane")? { self.doubles()? } else { [0.0; 4] };
                AttributeObject::ClipPlane(ClipPlaneObject { number: self.unsigned_member("ClipPlaneNum", 0)?, plane })
            }
            "PolygonMode" => {
                self.attribute_members()?;
                let mut front = 0x1b02;
                if self.marked_member("Mode")? {
                    self.input.keyword("UseFrontAndBack")?;
                    self.input.boolean()?;
                    self.input.keyword("Front")?;
                    front = self.input.named(GL_NAMES)?;
                    self.input.keyword("Back")?;
                    self.input.named(GL_NAMES)?;
                }
                AttributeObject::PolygonMode(front)
            }
            "BlendColor" => {
                self.attribute_members()?;
                AttributeObject::BlendColor(self.floats_member("ConstantColor", [0.0; 4])?)
            }
            "BlendEquation" => {
                self.attribute_members()?;
                let color = self.named_member("EquationRGB", EQUATIONS, 0x8006)?;
                AttributeObject::BlendEquation([color, self.named_member("EquationAlpha", EQUATIONS, 0x8006)?])
            }
            _ => return Ok(None),
        }))
    }

    fn light(&mut self) -> Result<AttributeObject> {
        self.attribute_members()?;
        let mut light = LightObject { number: self.integer_member("LightNum", 0)?, ..LightObject::default() };
        light.ambient = self.floats_member("Ambient", light.ambient)?;
        light.diffuse = self.floats_member("Diffuse", light.diffuse)?;
        light.specular = self.floats_member("Specular", light.specular)?;
        light.position = self.floats_member("Position", [0.0; 4])?.map(f64::from);
        light.direction = self.floats_member("Direction", [0.0; 3])?.map(f64::from);
        let names = ["ConstantAttenuation", "LinearAttenuation", "QuadraticAttenuation"];
        for (value, name) in light.attenuation.iter_mut().zip(names) {
            *value = self.float_member(name, *value)?;
        }
        light.spot_exponent = self.float_member("SpotExponent", 0.0)?;
        light.spot_cutoff_deg = self.float_member("SpotCutoff", light.spot_cutoff_deg)?;
        Ok(AttributeObject::Light(light))
    }

    pub(super) fn light_source(&mut self) -> Result<Object> {
        let (node, children) = self.group_members()?;
        let light = match self.object_member("Light")? {
            Object::Attribute(attribute) => match &*attribute {
                AttributeObject::Light(light) => Some(*light),
                _ => None,
            },
            _ => None,
        };
        let is_absolute = self.frame_of_state()?;
        Ok(node.with(NodeClass::Light { light, is_absolute }, children))
    }

    pub(super) fn clip_node(&mut self) -> Result<Object> {
        let (node, children) = self.group_members()?;
        let planes = clip_planes(self.vector_member("ClipPlaneList", Self::object)?);
        let is_absolute = self.frame_of_state()?;
        Ok(node.with(NodeClass::Clip { planes, is_absolute }, children))
    }

    /// Returns true if the state of a node moves with the eye.
    fn frame_of_state(&mut self) -> Result<bool> {
        const FRAMES: Names = &[("RELATIVE_RF", 0), ("ABSOLUTE_RF", 1)];
        Ok(self.named_member("ReferenceFrame", FRAMES, 0)? != 0)
    }
}

/// Returns the clip planes among objects.
pub(in crate::formats::osg) fn clip_planes(objects: Vec<Object>) -> Vec<ClipPlaneObject> {
    let plane = |object| match object {
        Object::Attribute(attribute) => match &*attribute {
            AttributeObject::ClipPlane(plane) => Some(*plane),
            _ => None,
        },
        _ => None,
    };
    objects.into_iter().filter_map(plane).collect()
}
