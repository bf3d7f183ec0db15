//! State sets, and the uniforms and shaders that are read over.

use std::sync::Arc;

use super::{Kind, Reader, ids};
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::objects::{AttributeObject, Object, StateObject};

/// The maximum number of modes or attributes in one list. OpenGL has so few that a longer one is a broken file.
const MAX_LIST: usize = 256;
/// The number of texture units that a state set can have.
const MAX_UNITS: usize = 16;

impl Reader<'_> {
    /// Reads a state set that a boolean marks.
    pub(super) fn optional_state_set(&mut self) -> Result<Option<Arc<StateObject>>> {
        Ok(match self.optional(Self::state_set)? {
            Some(Object::State(state)) => Some(state),
            _ => None,
        })
    }

    /// Reads a state set.
    pub(super) fn state_set(&mut self) -> Result<Object> {
        self.shared(Kind::StateSet, Self::new_state_set)
    }

    fn new_state_set(&mut self) -> Result<Object> {
        self.expect(ids::STATE_SET)?;
        let mut state = StateObject { name: self.object_members()?, nest_bins: true, ..StateObject::default() };
        state.bin_mode = match self.byte()? {
            mode @ 0..=2 => mode.into(),
            // ENCLOSE of the first versions.
            3 => 1,
            mode => return Err(OsgError::invalid(format!(".ive: mode {mode} of a render bin"))),
        };
        state.bin_number = self.integer()?;
        state.bin_name = self.string()?;
        state.modes = self.modes()?;
        state.attributes = self.attributes()?;
        state.texture_modes = self.of_units(Self::modes)?;
        state.texture_attributes = self.of_units(Self::attributes)?;
        if self.version >= 10 {
            for _ in 0..self.count(8)? {
                self.shared(Kind::Uniform, Self::uniform)?;
                self.integer()?;
            }
        }
        Ok(Object::State(Arc::new(state)))
    }

    /// Reads a list of each texture unit.
    fn of_units<T>(&mut self, mut read: impl FnMut(&mut Self) -> Result<Vec<T>>) -> Result<Vec<Vec<T>>> {
        let mut units = Vec::new();
        for unit in 0..self.count(4)? {
            let list = read(self)?;
            if unit < MAX_UNITS {
                units.push(list);
            }
        }
        Ok(units)
    }

    fn short_list<T>(&mut self, read: impl FnMut(&mut Self) -> Result<T>) -> Result<Vec<T>> {
        let list = self.list(8, read)?;
        match list.len() <= MAX_LIST {
            true => Ok(list),
            false => Err(OsgError::invalid(format!("a state set with {} modes or attributes", list.len()))),
        }
    }

    fn modes(&mut self) -> Result<Vec<(u32, u32)>> {
        self.short_list(|reader| Ok((reader.unsigned()?, reader.unsigned()?)))
    }

    fn attributes(&mut self) -> Result<Vec<(Arc<AttributeObject>, u32)>> {
        let all = self.short_list(|reader| Ok((reader.attribute()?, reader.unsigned()?)))?;
        let attribute = |(object, flags)| match object {
            Object::Attribute(attribute) => Some((attribute, flags)),
            _ => None,
        };
        Ok(all.into_iter().filter_map(attribute).collect())
    }

    /// Reads over a uniform.
    fn uniform(&mut self) -> Result<Object> {
        self.expect(ids::UNIFORM)?;
        self.object_members()?;
        let kind = self.unsigned()?;
        if self.version < 12 {
            self.string()?;
        }
        if self.version >= 16 {
            // The number of elements, and their values.
            self.unsigned()?;
            self.array()?;
        } else {
            self.skip(4 * values_of_uniform(kind))?;
        }
        Ok(Object::Nothing)
    }

    /// Reads over a shader.
    pub(super) fn shader(&mut self) -> Result<Object> {
        self.shared(Kind::Shader, |reader| {
            reader.expect(ids::SHADER)?;
            reader.object_members()?;
            if reader.version < 12 {
                reader.string()?;
            }
            // Its type and its source.
            reader.integer()?;
            reader.string()?;
            Ok(Object::Nothing)
        })
    }
}

/// Returns the number of values of a uniform in the first versions, by OpenGL's number of its type. Booleans and samplers
/// are written as integers.
fn values_of_uniform(kind: u32) -> usize {
    match kind {
        // FLOAT, INT, BOOL and the samplers.
        0x1406 | 0x1404 | 0x8b56 | 0x8b5d..=0x8b62 => 1,
        0x8b50 | 0x8b53 | 0x8b57 => 2,
        0x8b51 | 0x8b54 | 0x8b58 => 3,
        0x8b52 | 0x8b55 | 0x8b59 => 4,
        // OSG writes a matrix of 2 x 2 in the room of one of 3 x 3.
        0x8b5a | 0x8b5b => 9,
        0x8b5c => 16,
        _ => 0,
    }
}
