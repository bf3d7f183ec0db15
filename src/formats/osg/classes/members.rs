//! The kinds of members that classes have, and the members of the class Object.

use glam::{DQuat, DVec3};

use super::Reader;
use crate::fetch::about_to_allocate;
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{GL_NAMES, Names, Number, doubles, floats, value_of};
use crate::formats::osg::objects::Object;

impl Reader<'_> {
    pub(super) fn unsigned(&mut self) -> Result<u32> {
        Ok(self.input.number(Number::U32)? as i64 as u32)
    }

    pub(super) fn float(&mut self) -> Result<f32> {
        Ok(self.input.number(Number::F32)? as f32)
    }

    pub(super) fn double(&mut self) -> Result<f64> {
        self.input.number(Number::F64)
    }

    pub(super) fn floats<const N: usize>(&mut self) -> Result<[f32; N]> {
        floats(&mut *self.input)
    }

    pub(super) fn doubles<const N: usize>(&mut self) -> Result<[f64; N]> {
        doubles(&mut *self.input)
    }

    /// Reads the number of elements of a list, each of which takes a byte or more.
    pub(super) fn count(&mut self) -> Result<usize> {
        let count = self.unsigned()? as usize;
        match count <= self.input.remaining() {
            true => Ok(count),
            false => Err(OsgError::invalid(format!(
                "a list of {count} elements in the last {} bytes",
                self.input.remaining()
            ))),
        }
    }

    /// Reads as many elements as a list has.
    fn elements<T>(&mut self, count: usize, mut read: impl FnMut(&mut Self) -> Result<T>) -> Result<Vec<T>> {
        about_to_allocate(size_of::<T>() as u64 * count as u64)?;
        (0..count).map(|_| read(self)).collect()
    }

    /// Returns true if a member follows: always in binary.
    pub(super) fn member(&mut self, name: &str) -> Result<bool> {
        self.input.matches(name)
    }

    /// Returns true if a member follows that binary files mark by a boolean.
    pub(super) fn marked_member(&mut self, name: &str) -> Result<bool> {
        if self.input.is_text() { self.input.matches(name) } else { self.input.boolean() }
    }

    pub(super) fn boolean_member(&mut self, name: &str, default: bool) -> Result<bool> {
        if self.member(name)? { self.input.boolean() } else { Ok(default) }
    }

    pub(super) fn integer_member(&mut self, name: &str, default: i32) -> Result<i32> {
        if self.member(name)? { Ok(self.input.number(Number::I32)? as i32) } else { Ok(default) }
    }

    pub(super) fn unsigned_member(&mut self, name: &str, default: u32) -> Result<u32> {
        if self.member(name)? { self.unsigned() } else { Ok(default) }
    }

    pub(super) fn float_member(&mut self, name: &str, default: f32) -> Result<f32> {
        if self.member(name)? { self.float() } else { Ok(default) }
    }

    pub(super) fn double_member(&mut self, name: &str, default: f64) -> Result<f64> {
        if self.member(name)? { self.double() } else { Ok(default) }
    }

    pub(super) fn floats_member<const N: usize>(&mut self, name: &str, default: [f32; N]) -> Result<[f32; N]> {
        if self.member(name)? { self.floats() } else { Ok(default) }
    }

    pub(super) fn point_member(&mut self, name: &str, default: DVec3) -> Result<DVec3> {
        if self.member(name)? { self.doubles().map(DVec3::from_array) } else { Ok(default) }
    }

    /// Reads a point of floats.
    pub(super) fn float_point_member(&mut self, name: &str) -> Result<DVec3> {
        self.floats_member(name, [0.0; 3]).map(|point| DVec3::from_array(point.map(f64::from)))
    }

    /// Reads a rotation; the identity for one of length zero.
    pub(super) fn rotation_member(&mut self, name: &str) -> Result<DQuat> {
        self.rotation_member_or(name, DQuat::IDENTITY)
    }

    /// Reads a rotation, `default` if the file has none; the identity for one of length zero.
    pub(super) fn rotation_member_or(&mut self, name: &str, default: DQuat) -> Result<DQuat> {
        let quat = if self.member(name)? { DQuat::from_array(self.doubles()?) } else { default };
        let is_valid = quat.is_finite() && quat.length_squared() > 0.0;
        Ok(if is_valid { quat.normalize() } else { DQuat::IDENTITY })
    }

    pub(super) fn string_member(&mut self, name: &str) -> Result<String> {
        if self.member(name)? { self.input.quoted() } else { Ok(String::new()) }
    }

    /// Reads a member whose values have names in text; unknown names are noted and have the default.
    pub(super) fn named_member(&mut self, name: &str, names: Names, default: u32) -> Result<u32> {
        if !self.member(name)? {
            return Ok(default);
        }
        if !self.input.is_text() {
            return self.unsigned();
        }
        let word = self.input.word()?;
        Ok(value_of(names, &word).unwrap_or_else(|| {
            self.notes.add(format!("OpenSceneGraph: {name} {}", super::shortened(&word)));
            default
        }))
    }

    /// Reads a member with one of OpenGL's constants.
    pub(super) fn gl_member(&mut self, name: &str, default: u32) -> Result<u32> {
        if self.member(name)? { self.input.named(GL_NAMES) } else { Ok(default) }
    }

    /// Reads over a member with one of OpenGL's constants, whose name in text may be any word.
    pub(super) fn skipped_constant(&mut self, name: &str) -> Result<()> {
        if self.member(name)? {
            match self.input.is_text() {
                true => drop(self.input.word()?),
                false => drop(self.unsigned()?),
            }
        }
        Ok(())
    }

    /// Reads a member with a pointer to an object.
    pub(super) fn object_member(&mut self, name: &str) -> Result<Object> {
        if !self.member(name)? || !self.input.boolean()? {
            return Ok(Object::Nothing);
        }
        self.in_braces(Self::object)
    }

    /// Reads something that is in braces in text and has none in binary.
    pub(super) fn in_braces<T>(&mut self, read: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        let is_text = self.input.is_text();
        if is_text {
            self.input.begin()?;
        }
        let value = read(self)?;
        if is_text {
            self.input.end()?;
        }
        Ok(value)
    }

    /// Reads a block.
    pub(super) fn block<T>(&mut self, read: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        self.input.begin()?;
        let value = read(self)?;
        self.input.end()?;
        Ok(value)
    }

    /// Reads a number and that many elements in a block.
    pub(super) fn list<T>(&mut self, read: impl FnMut(&mut Self) -> Result<T>) -> Result<Vec<T>> {
        let count = self.count()?;
        self.block(|reader| reader.elements(count, read))
    }

    /// Reads a number and, unless it is 0, that many elements in a block.
    pub(super) fn list_unless_empty<T>(&mut self, read: impl FnMut(&mut Self) -> Result<T>) -> Result<Vec<T>> {
        let count = self.count()?;
        if count == 0 {
            return Ok(Vec::new());
        }
        self.block(|reader| reader.elements(count, read))
    }

    /// Reads a member that is a vector: in binary its elements are in no block.
    pub(super) fn vector_member<T>(&mut self, name: &str, read: impl FnMut(&mut Self) -> Result<T>) -> Result<Vec<T>> {
        if !self.member(name)? {
            return Ok(Vec::new());
        }
        let count = self.count()?;
        if count == 0 {
            return Ok(Vec::new());
        }
        self.in_braces(|reader| reader.elements(count, read))
    }

    /// Reads the members of the class Object, and returns its name.
    pub(super) fn object_members(&mut self) -> Result<String> {
        const VARIANCES: Names = &[("STATIC", 0), ("DYNAMIC", 1), ("UNSPECIFIED", 2)];
        let name = self.string_member("Name")?;
        self.named_member("DataVariance", VARIANCES, 2)?;
        if self.version >= 77 {
            self.skipped_member("UserDataContainer")?;
        } else if self.marked_member("UserData")? {
            self.block(Self::object)?;
        }
        Ok(name)
    }

    /// Skips a member with a pointer to user data, whatever its classes.
    fn skipped_member(&mut self, name: &str) -> Result<()> {
        if !self.member(name)? || !self.input.boolean()? {
            return Ok(());
        }
        self.in_braces(|reader| {
            if !reader.input.can_skip() {
                return reader.object().map(drop);
            }
            if reader.input.word()? != "NULL" {
                reader.input.begin()?;
                reader.input.leave()?;
            }
            Ok(())
        })
    }

    /// Reads the members of a DefaultUserDataContainer.
    pub(super) fn user_data(&mut self) -> Result<()> {
        self.object_members()?;
        if self.marked_member("UDC_UserData")? {
            self.block(Self::object)?;
        }
        if self.marked_member("UDC_Descriptions")? {
            self.list(|reader| reader.input.quoted())?;
        }
        if self.marked_member("UDC_UserObjects")? {
            self.list(Self::object)?;
        }
        Ok(())
    }
}
