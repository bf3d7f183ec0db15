//! [`BinaryInput`]: the binary encoding. Files since OSG 3.1.4 usually have the sizes of their blocks.

use super::names::Names;
use super::values::{Number, Values};
use super::{Input, decoded};
use crate::fetch::about_to_allocate;
use crate::formats::osg::error::{OsgError, Result};

/// The version since which sizes of blocks have 64 bits.
const VERSION_OF_LONG_BLOCKS: u32 = 149;

/// Reads the binary encoding.
pub(in super::super) struct BinaryInput<'a> {
    bytes: std::borrow::Cow<'a, [u8]>,
    at: usize,
    is_big_endian: bool,
    /// The bytes of a block's size; `None` in files without sizes.
    block_size_bytes: Option<usize>,
    /// The ends of the blocks that are open.
    ends: Vec<usize>,
}

impl<'a> BinaryInput<'a> {
    /// Reads bytes from a position behind the magic. Blocks have no sizes yet.
    pub fn new(bytes: &'a [u8], at: usize, is_big_endian: bool) -> Self {
        Self { bytes: bytes.into(), at, is_big_endian, block_size_bytes: None, ends: Vec::new() }
    }

    /// Says that blocks have sizes, whose width depends on the version.
    pub fn set_block_sizes(&mut self, version: u32) {
        self.block_size_bytes = Some(if version >= VERSION_OF_LONG_BLOCKS { 8 } else { 4 });
    }

    /// Returns the bytes that were not read.
    pub fn rest(&self) -> &[u8] {
        &self.bytes[self.at..]
    }

    /// Continues in other bytes: those that were compressed.
    pub fn replace(&mut self, bytes: Vec<u8>) {
        (self.bytes, self.at) = (bytes.into(), 0);
    }

    /// Returns the number that follows without reading it.
    pub fn peek_unsigned(&mut self) -> Result<u32> {
        let at = self.at;
        let value = self.array().map(u32::from_le_bytes);
        self.at = at;
        value
    }

    /// Reads over a number of bytes.
    pub fn skip(&mut self, count: usize) -> Result<()> {
        self.take(count).map(drop)
    }

    fn take(&mut self, count: usize) -> Result<&[u8]> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.bytes.len());
        let Some(end) = end else {
            let reason = format!("it ends where {count} bytes should follow at byte {}", self.at);
            return Err(OsgError::Invalid(reason));
        };
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let is_big_endian = self.is_big_endian;
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        if is_big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }
}

impl Input for BinaryInput<'_> {
    fn is_text(&self) -> bool {
        false
    }

    fn boolean(&mut self) -> Result<bool> {
        Ok(self.take(1)?[0] != 0)
    }

    fn number(&mut self, number: Number) -> Result<f64> {
        Ok(match number {
            Number::I8 => f64::from(i8::from_le_bytes(self.array()?)),
            Number::U8 => f64::from(u8::from_le_bytes(self.array()?)),
            Number::I16 => f64::from(i16::from_le_bytes(self.array()?)),
            Number::U16 => f64::from(u16::from_le_bytes(self.array()?)),
            Number::I32 => f64::from(i32::from_le_bytes(self.array()?)),
            Number::U32 => f64::from(u32::from_le_bytes(self.array()?)),
            Number::F32 => f64::from(f32::from_le_bytes(self.array()?)),
            Number::F64 => f64::from_le_bytes(self.array()?),
        })
    }

    fn numbers(&mut self, number: Number, count: usize) -> Result<Values> {
        fn read<const N: usize, T>(bytes: &[u8], is_big_endian: bool, of: impl Fn([u8; N]) -> T) -> Vec<T> {
            let swapped = |mut bytes: [u8; N]| {
                if is_big_endian {
                    bytes.reverse();
                }
                bytes
            };
            bytes.as_chunks::<N>().0.iter().map(|bytes| of(swapped(*bytes))).collect()
        }
        let swap = self.is_big_endian;
        let too_long = || OsgError::invalid(format!("an array of {count} numbers"));
        let bytes = self.take(count.checked_mul(number.size_bytes()).ok_or_else(too_long)?)?;
        about_to_allocate(number.memory_bytes() * count as u64)?;
        Ok(match number {
            Number::F32 => Values::F32(read(bytes, swap, f32::from_le_bytes)),
            Number::F64 => Values::F64(read(bytes, swap, f64::from_le_bytes)),
            Number::I8 => Values::Whole(number, read(bytes, swap, |b| i32::from(i8::from_le_bytes(b)))),
            Number::U8 => Values::Whole(number, read(bytes, swap, |b| i32::from(u8::from_le_bytes(b)))),
            Number::I16 => Values::Whole(number, read(bytes, swap, |b| i32::from(i16::from_le_bytes(b)))),
            Number::U16 => Values::Whole(number, read(bytes, swap, |b| i32::from(u16::from_le_bytes(b)))),
            Number::I32 | Number::U32 => Values::Whole(number, read(bytes, swap, i32::from_le_bytes)),
        })
    }

    fn word(&mut self) -> Result<String> {
        let length = i32::from_le_bytes(self.array()?);
        let Ok(length) = usize::try_from(length) else {
            return Err(OsgError::invalid(format!("a string of {length} bytes")));
        };
        Ok(decoded(self.take(length)?).into_owned())
    }

    fn quoted(&mut self) -> Result<String> {
        self.word()
    }

    fn bytes(&mut self, count: usize) -> Result<Vec<u8>> {
        self.take(count).map(<[u8]>::to_vec)
    }

    fn keyword(&mut self, _name: &str) -> Result<()> {
        Ok(())
    }

    fn named(&mut self, _names: Names) -> Result<u32> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn matches(&mut self, _name: &str) -> Result<bool> {
        Ok(true)
    }

    fn begin(&mut self) -> Result<()> {
        let start = self.at;
        let size = match self.block_size_bytes {
            None => return Ok(()),
            Some(4) => u64::from(u32::from_le_bytes(self.array()?)),
            Some(_) => u64::from_le_bytes(self.array()?),
        };
        let end = usize::try_from(size).ok().and_then(|size| start.checked_add(size));
        let end = end.filter(|end| (self.at..=self.bytes.len()).contains(end));
        let Some(end) = end else {
            return Err(OsgError::invalid(format!("a block of {size} bytes at byte {start}")));
        };
        self.ends.push(end);
        Ok(())
    }

    fn end(&mut self) -> Result<()> {
        self.ends.pop();
        Ok(())
    }

    fn leave(&mut self) -> Result<()> {
        let Some(end) = self.ends.pop() else { return Ok(()) };
        if end < self.at {
            return Err(OsgError::invalid(format!("a block ends at byte {end}, its contents at byte {}", self.at)));
        }
        self.at = end;
        Ok(())
    }

    fn can_skip(&self) -> bool {
        self.block_size_bytes.is_some()
    }

    fn is_at_end_of_block(&self) -> bool {
        self.ends.last().is_some_and(|end| *end <= self.at)
    }

    fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }
}
