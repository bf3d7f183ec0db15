//! The members of state attributes.

use std::sync::Arc;

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::input::Names;
use crate::formats::osg::objects::{AttributeObject, CombineObject, MaterialObject, Object, TextureTarget};

pub(super) const COMPARISONS: Names = &[
    ("NEVER", 0x200),
    ("LESS", 0x201),
    ("EQUAL", 0x202),
    ("LEQUAL", 0x203),
    ("GREATER", 0x204),
    ("NOTEQUAL", 0x205),
    ("GEQUAL", 0x206),
    ("ALWAYS", 0x207),
];

impl Reader<'_> {
    /// Reads the members of an attribute; `None` if the class is none.
    pub(super) fn attribute_of(&mut self, class: &str) -> Result<Option<Object>> {
        let attribute = match class {
            "Material" => self.material()?,
            "Texture1D" => self.texture(TextureTarget::D1)?,
            "Texture2D" => self.texture(TextureTarget::D2)?,
            "TextureRectangle" => self.texture(TextureTarget::Rectangle)?,
            "Texture3D" => self.texture(TextureTarget::D3)?,
            "TextureCubeMap" => self.texture(TextureTarget::Cube)?,
            "BlendFunc" => {
                self.attribute_members()?;
                let source = self.gl_member("SourceRGB", 0)?;
                let source_alpha = self.gl_member("SourceAlpha", 0)?;
                let destination = self.gl_member("DestinationRGB", 0)?;
                let destination_alpha = self.gl_member("DestinationAlpha", 0)?;
                AttributeObject::BlendFunc([source, destination, source_alpha, destination_alpha])
            }
            "AlphaFunc" => {
                self.attribute_members()?;
                let function = self.named_member("Function", COMPARISONS, 0x207)?;
                AttributeObject::AlphaFunc { function, reference: self.float_member("ReferenceValue", 1.0)? }
            }
            "CullFace" => {
                const FACES: Names = &[("FRONT", 0x404), ("BACK", 0x405), ("FRONT_AND_BACK", 0x408)];
                self.attribute_members()?;
                AttributeObject::CullFace(self.named_member("Mode", FACES, 0x405)?)
            }
            "FrontFace" => {
                const WINDINGS: Names = &[("CLOCKWISE", 0x900), ("COUNTER_CLOCKWISE", 0x901)];
                self.attribute_members()?;
                AttributeObject::FrontFace(self.named_member("Mode", WINDINGS, 0x901)?)
            }
            "Depth" => {
                self.attribute_members()?;
                let function = self.named_member("Function", COMPARISONS, 0x201)?;
                let range = [self.double_member("ZNear", 0.0)?, self.double_member("ZFar", 1.0)?];
                AttributeObject::Depth { function, range, write: self.boolean_member("WriteMask", true)? }
            }
            "PolygonOffset" => {
                self.attribute_members()?;
                let factor = self.float_member("Factor", 0.0)?;
                AttributeObject::PolygonOffset { factor, units: self.float_member("Units", 0.0)? }
            }
            "ColorMask" => {
                self.attribute_members()?;
                let mut mask = [true; 4];
                for (is_written, name) in mask.iter_mut().zip(["RedMask", "GreenMask", "BlueMask", "AlphaMask"]) {
                    *is_written = self.boolean_member(name, true)?;
                }
                AttributeObject::ColorMask(mask)
            }
            "TexEnv" => {
                const MODES: Names =
                    &[("DECAL", 0x2101), ("MODULATE", 0x2100), ("BLEND", 0xbe2), ("REPLACE", 0x1e01), ("ADD", 0x104)];
                self.attribute_members()?;
                let mode = self.named_member("Mode", MODES, 0x2100)?;
                AttributeObject::TexEnv { mode, color: self.floats_member("Color", [0.0; 4])? }
            }
            "TexEnvCombine" => self.tex_env_combine()?,
            "TexGen" => self.tex_gen()?,
            "TexMat" => self.tex_mat()?,
            "ShadeModel" => {
                const MODES: Names = &[("FLAT", 0x1d00), ("SMOOTH", 0x1d01)];
                self.attribute_members()?;
                self.named_member("Mode", MODES, 0x1d01)?;
                AttributeObject::Other("ShadeModel")
            }
            "LineWidth" => {
                self.attribute_members()?;
                self.float_member("Width", 1.0)?;
                AttributeObject::Other("LineWidth")
            }
            "Point" => {
                self.attribute_members()?;
                let size_px = self.float_member("Size", 0.0)?;
                self.float_member("FadeThresholdSize", 0.0)?;
                let attenuation = self.floats_member("DistanceAttenuation", [0.0; 3])?;
                self.float_member("MinSize", 0.0)?;
                self.float_member("MaxSize", 0.0)?;
                AttributeObject::of_point(size_px, attenuation)
            }
            _ => match self.lighting_of(class)? {
                Some(attribute) => attribute,
                None => return Ok(None),
            },
        };
        Ok(Some(Object::Attribute(Arc::new(attribute))))
    }

    /// Reads the members of the classes Object and StateAttribute.
    pub(super) fn attribute_members(&mut self) -> Result<()> {
        self.object_members()?;
        for callback in ["UpdateCallback", "EventCallback"] {
            self.object_member(callback)?;
        }
        Ok(())
    }

    fn material(&mut self) -> Result<AttributeObject> {
        /// The value of OFF is OSG's own.
        const COLOR_MODES: Names = &[
            ("AMBIENT", 0x1200),
            ("DIFFUSE", 0x1201),
            ("SPECULAR", 0x1202),
            ("EMISSION", 0x1600),
            ("AMBIENT_AND_DIFFUSE", 0x1602),
            ("OFF", 0x1603),
        ];
        self.attribute_members()?;
        let color_mode = self.named_member("ColorMode", COLOR_MODES, 0x1603)?;
        let ambient = self.sides("Ambient", [0.2, 0.2, 0.2, 1.0])?;
        let diffuse = self.sides("Diffuse", [0.8, 0.8, 0.8, 1.0])?;
        let specular = self.sides("Specular", [0.0, 0.0, 0.0, 1.0])?;
        let emission = self.sides("Emission", [0.0, 0.0, 0.0, 1.0])?;
        let shininess = self.sides("Shininess", [0.0])?.map(|[value]| value);
        Ok(AttributeObject::Material(MaterialObject { color_mode, ambient, diffuse, specular, emission, shininess }))
    }

    /// Reads a value of front and back.
    fn sides<const N: usize>(&mut self, name: &str, default: [f32; N]) -> Result<[[f32; N]; 2]> {
        if !self.marked_member(name)? {
            return Ok([default; 2]);
        }
        let is_same = self.input.boolean()?;
        self.input.keyword("Front")?;
        let front = self.floats()?;
        self.input.keyword("Back")?;
        let back = self.floats()?;
        Ok(if is_same { [front; 2] } else { [front, back] })
    }

    pub(super) fn tex_env_combine(&mut self) -> Result<AttributeObject> {
        self.attribute_members()?;
        let CombineObject { mut color, mut alpha, .. } = CombineObject::default();
        color.function = self.gl_member("Combine_RGB", color.function)?;
        alpha.function = self.gl_member("Combine_Alpha", alpha.function)?;
        color.sources = self.three(["Source0_RGB", "Source1_RGB", "Source2_RGB"], color.sources)?;
        alpha.sources = self.three(["Source0_Alpha", "Source1_Alpha", "Source2_Alpha"], alpha.sources)?;
        color.operands = self.three(["Operand0_RGB", "Operand1_RGB", "Operand2_RGB"], color.operands)?;
        alpha.operands = self.three(["Operand0_Alpha", "Operand1_Alpha", "Operand2_Alpha"], alpha.operands)?;
        color.scale = self.float_member("Scale_RGB", color.scale)?;
        alpha.scale = self.float_member("Scale_Alpha", alpha.scale)?;
        let constant = self.floats_member("ConstantColor", [0.0; 4])?;
        Ok(AttributeObject::Combine(CombineObject { color, alpha, constant }))
    }

    fn three(&mut self, names: [&str; 3], defaults: [u32; 3]) -> Result<[u32; 3]> {
        let mut values = defaults;
        for (value, name) in values.iter_mut().zip(names) {
            *value = self.gl_member(name, *value)?;
        }
        Ok(values)
    }
}
