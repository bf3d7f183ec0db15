//! The kinds of values that classes have.

use glam::{DMat4, DQuat, DVec3};

use super::{Reader, ids};
use crate::fetch::about_to_allocate;
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{Input as _, Number, doubles, floats};

impl Reader<'_> {
    pub(super) fn boolean(&mut self) -> Result<bool> {
        self.input.boolean()
    }

    /// Reads one byte with a small number.
    pub(super) fn byte(&mut self) -> Result<u8> {
        Ok(self.input.number(Number::U8)? as u8)
    }

    pub(super) fn integer(&mut self) -> Result<i32> {
        Ok(self.input.number(Number::I32)? as i32)
    }

    pub(super) fn unsigned(&mut self) -> Result<u32> {
        Ok(self.input.number(Number::U32)? as u32)
    }

    pub(super) fn float(&mut self) -> Result<f32> {
        Ok(self.input.number(Number::F32)? as f32)
    }

    pub(super) fn double(&mut self) -> Result<f64> {
        self.input.number(Number::F64)
    }

    pub(super) fn string(&mut self) -> Result<String> {
        self.input.word()
    }

    pub(super) fn integers<const N: usize>(&mut self) -> Result<[u32; N]> {
        let mut values = [0; N];
        for value in &mut values {
            *value = self.unsigned()?;
        }
        Ok(values)
    }

    pub(super) fn floats<const N: usize>(&mut self) -> Result<[f32; N]> {
        floats(&mut self.input)
    }

    pub(super) fn doubles<const N: usize>(&mut self) -> Result<[f64; N]> {
        doubles(&mut self.input)
    }

    /// Reads a point of floats.
    pub(super) fn point(&mut self) -> Result<DVec3> {
        self.floats().map(|point: [f32; 3]| DVec3::from_array(point.map(f64::from)))
    }

    /// Reads a rotation; the identity for one of length zero.
    pub(super) fn rotation(&mut self) -> Result<DQuat> {
        let quat = DQuat::from_array(self.floats::<4>()?.map(f64::from));
        let is_valid = quat.is_finite() && quat.length_squared() > 0.0;
        Ok(if is_valid { quat.normalize() } else { DQuat::IDENTITY })
    }

    /// Reads a matrix of doubles. OSG multiplies rows, so that its rows are the columns of ours.
    pub(super) fn matrix(&mut self) -> Result<DMat4> {
        self.doubles().map(|rows| DMat4::from_cols_array(&rows))
    }

    /// Reads the number of elements of a list, each of which takes a number of bytes or more. Negative numbers are zero, as
    /// in OSG's loops.
    pub(super) fn count(&mut self, element_bytes: usize) -> Result<usize> {
        let count = self.integer()?.max(0) as usize;
        let left = self.input.remaining();
        match count <= left / element_bytes {
            true => Ok(count),
            false => Err(OsgError::invalid(format!("a list of {count} elements in the last {left} bytes"))),
        }
    }

    /// Reads a number and that many elements.
    pub(super) fn list<T>(
        &mut self,
        element_bytes: usize,
        mut read: impl FnMut(&mut Self) -> Result<T>,
    ) -> Result<Vec<T>> {
        let count = self.count(element_bytes)?;
        about_to_allocate(size_of::<T>() as u64 * count as u64)?;
        (0..count).map(|_| read(self)).collect()
    }

    /// Reads something that a boolean marks.
    pub(super) fn optional<T>(&mut self, read: impl FnOnce(&mut Self) -> Result<T>) -> Result<Option<T>> {
        if self.boolean()? { read(self).map(Some) } else { Ok(None) }
    }

    /// Reads over a number of bytes.
    pub(super) fn skip(&mut self, count: usize) -> Result<()> {
        self.input.skip(count)
    }

    /// Returns the number of the class that follows, which is not consumed.
    pub(super) fn class(&mut self) -> Result<u32> {
        self.input.peek_unsigned()
    }

    /// Reads the number of a class that must follow.
    pub(super) fn expect(&mut self, class: u32) -> Result<()> {
        let found = self.unsigned()?;
        if found == class {
            return Ok(());
        }
        let (expected, found) = (ids::name(class), ids::name(found));
        let left = self.input.remaining();
        Err(OsgError::invalid(format!(".ive: {expected} should follow {left} bytes before the end, not class {found}")))
    }
}
