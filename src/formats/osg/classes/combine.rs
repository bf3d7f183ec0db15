//! The members of a TexEnvCombine.

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::{AttributeObject, CombineObject};

/// OpenGL's defaults.
const GL_MODULATE: u32 = 0x2100;
const GL_TEXTURE: u32 = 0x1702;
const GL_CONSTANT: u32 = 0x8576;
const GL_PREVIOUS: u32 = 0x8578;
const GL_SRC_COLOR: u32 = 0x300;
const GL_SRC_ALPHA: u32 = 0x302;

impl Reader<'_> {
    /// Reads the members; those of alpha have no effect, because an overlay keeps the alpha of what is below.
    pub(super) fn tex_env_combine(&mut self) -> Result<AttributeObject> {
        self.attribute_members()?;
        let function = self.gl_member("Combine_RGB", GL_MODULATE)?;
        self.gl_member("Combine_Alpha", GL_MODULATE)?;
        let defaults = [GL_TEXTURE, GL_PREVIOUS, GL_CONSTANT];
        let sources = self.three(["Source0_RGB", "Source1_RGB", "Source2_RGB"], defaults)?;
        self.three(["Source0_Alpha", "Source1_Alpha", "Source2_Alpha"], defaults)?;
        let defaults = [GL_SRC_COLOR, GL_SRC_COLOR, GL_SRC_ALPHA];
        let operands = self.three(["Operand0_RGB", "Operand1_RGB", "Operand2_RGB"], defaults)?;
        self.three(["Operand0_Alpha", "Operand1_Alpha", "Operand2_Alpha"], [GL_SRC_ALPHA; 3])?;
        let scale = self.float_member("Scale_RGB", 1.0)?;
        self.float_member("Scale_Alpha", 1.0)?;
        self.floats_member("ConstantColor", [0.0; 4])?;
        Ok(AttributeObject::Combine(CombineObject { function, sources, operands, scale }))
    }

    fn three(&mut self, names: [&str; 3], defaults: [u32; 3]) -> Result<[u32; 3]> {
        let mut values = defaults;
        for (value, name) in values.iter_mut().zip(names) {
            *value = self.gl_member(name, *value)?;
        }
        Ok(values)
    }
}
