//! The members of a StateSet.

use std::sync::Arc;

use super::Reader;
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{GL_NAMES, Names};
use crate::formats::osg::objects::{AttributeObject, Object, StateObject};

/// The maximum number of modes or attributes in one list.
const MAX_LIST: usize = 256;

/// OSG's flags of modes and attributes.
const FLAGS: Names = &[("ON", 1), ("OVERRIDE", 2), ("PROTECTED", 4), ("INHERIT", 8)];

impl Reader<'_> {
    pub(super) fn state_set(&mut self) -> Result<Object> {
        const BIN_MODES: Names = &[
            ("INHERIT_RENDERBIN_DETAILS", 0),
            ("USE_RENDERBIN_DETAILS", 1),
            ("OVERRIDE_RENDERBIN_DETAILS", 2),
            ("PROTECTED_RENDERBIN_DETAILS", 4),
            ("OVERRIDE_PROTECTED_RENDERBIN_DETAILS", 6),
        ];
        let mut state = StateObject { name: self.object_members()?, ..StateObject::default() };
        if self.marked_member("ModeList")? {
            state.modes = self.modes()?;
        }
        if self.marked_member("AttributeList")? {
            state.attributes = self.attributes()?;
        }
        if self.marked_member("TextureModeList")? {
            state.texture_modes = self.list(|reader| reader.of_unit(Self::modes))?;
        }
        if self.marked_member("TextureAttributeList")? {
            state.texture_attributes = self.list(|reader| reader.of_unit(Self::attributes))?;
        }
        if self.marked_member("UniformList")? {
            self.list(|reader| reader.with_flags(Self::object))?;
        }
        state.hint = self.integer_member("RenderingHint", 0)?;
        state.bin_mode = self.named_member("RenderBinMode", BIN_MODES, 0)?;
        state.bin_number = self.integer_member("BinNumber", 0)?;
        state.bin_name = self.string_member("BinName")?;
        state.nest_bins = self.boolean_member("NestRenderBins", true)?;
        for callback in ["UpdateCallback", "EventCallback"] {
            self.object_member(callback)?;
        }
        if self.version >= 151 && self.marked_member("DefineList")? {
            self.list(|reader| {
                reader.input.quoted()?;
                reader.with_flags(|reader| reader.input.quoted())
            })?;
        }
        Ok(Object::State(Arc::new(state)))
    }

    fn of_unit<T>(&mut self, read: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        self.input.keyword("Data")?;
        read(self)
    }

    /// Reads a list of a state set. OpenGL has so few modes and attributes that a long list is a broken file, and one that
    /// each drawable below would have to resolve.
    fn short_list<T>(&mut self, read: impl FnMut(&mut Self) -> Result<T>) -> Result<Vec<T>> {
        let list = self.list_unless_empty(read)?;
        match list.len() <= MAX_LIST {
            true => Ok(list),
            false => Err(OsgError::invalid(format!("a state set with {} modes or attributes", list.len()))),
        }
    }

    fn modes(&mut self) -> Result<Vec<(u32, u32)>> {
        self.short_list(|reader| Ok((reader.input.named(GL_NAMES)?, reader.flags()?)))
    }

    fn attributes(&mut self) -> Result<Vec<(Arc<AttributeObject>, u32)>> {
        let all = self.short_list(|reader| reader.with_flags(Self::object))?;
        let attribute = |(object, flags)| match object {
            Object::Attribute(attribute) => Some((attribute, flags)),
            _ => None,
        };
        Ok(all.into_iter().filter_map(attribute).collect())
    }

    /// Reads something with its flags.
    fn with_flags<T>(&mut self, read: impl FnOnce(&mut Self) -> Result<T>) -> Result<(T, u32)> {
        let value = read(self)?;
        self.input.keyword("Value")?;
        Ok((value, self.flags()?))
    }

    fn flags(&mut self) -> Result<u32> {
        if !self.input.is_text() {
            return self.unsigned();
        }
        let word = self.input.word()?;
        Ok(word.split('|').filter_map(|flag| FLAGS.iter().find(|(name, _)| *name == flag)).map(|(_, bit)| bit).sum())
    }
}
