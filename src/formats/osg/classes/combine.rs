//! The members of a TexEnvCombine.

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::{AttributeObject, CombineObject};

impl Reader<'_> {
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
