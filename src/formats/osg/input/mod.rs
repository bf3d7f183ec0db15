//! The two encodings of OpenSceneGraph's own files behind one trait: binary (.osgb) and text (.osgt).
//!
//! OSG writes the same members of a class in the same order in both. In text a member has its name and is left out if it has
//! its default; in binary it is its value alone. CPU only; one thread reads one file.

mod binary;
mod header;
mod names;
mod text;
mod values;

pub(super) use binary::BinaryInput;
pub(super) use header::{Opened, inflate, is_native, open};
pub(super) use names::{ARRAY_TYPES, GL_NAMES, Names, PRIMITIVE_TYPES, value_of};
pub(super) use values::{Number, Values};

use std::borrow::Cow;

use super::error::Result;

/// Reads the values of a file in their order. Every method fails at the end of the file.
pub(super) trait Input {
    /// Returns true for text, where members have names.
    fn is_text(&self) -> bool;
    /// Reads a boolean.
    fn boolean(&mut self) -> Result<bool>;
    /// Reads a number of a type. All of them are exact as f64.
    fn number(&mut self, number: Number) -> Result<f64>;
    /// Reads a number of values of a type. Fails before it allocates if the rest of the file is too short for them.
    fn numbers(&mut self, number: Number, count: usize) -> Result<Values>;
    /// Reads a string without white space, such as the name of a class.
    fn word(&mut self) -> Result<String>;
    /// Reads a string that is quoted in text.
    fn quoted(&mut self) -> Result<String>;
    /// Reads a number of bytes. Only in binary; text has none.
    fn bytes(&mut self, count: usize) -> Result<Vec<u8>>;
    /// Reads the name of a value; nothing in binary.
    fn keyword(&mut self, name: &str) -> Result<()>;
    /// Reads a value that has a name in text.
    fn named(&mut self, names: Names) -> Result<u32>;
    /// Returns true and consumes the name if a member of this name follows. Only in text.
    fn matches(&mut self, name: &str) -> Result<bool>;
    /// Begins a block.
    fn begin(&mut self) -> Result<()>;
    /// Ends a block that was read completely.
    fn end(&mut self) -> Result<()>;
    /// Skips the rest of a block and ends it. Does nothing in files without block sizes.
    fn leave(&mut self) -> Result<()>;
    /// Returns true if blocks can be skipped unread.
    fn can_skip(&self) -> bool;
    /// Returns true if nothing is left in the current block, as far as the file says how long it is.
    fn is_at_end_of_block(&self) -> bool;
    /// Returns the maximum number of elements, each of which takes a byte or more, that can follow.
    fn remaining(&self) -> usize;
}

/// Returns the text of bytes: UTF-8, or else a character for each byte, as OSG writes them.
pub(super) fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    std::str::from_utf8(bytes).map_or_else(|_| bytes.iter().map(|byte| char::from(*byte)).collect(), Cow::Borrowed)
}

/// Reads several floats.
pub(super) fn floats<const N: usize>(input: &mut (impl Input + ?Sized)) -> Result<[f32; N]> {
    doubles_of(input, Number::F32).map(|values| values.map(|value| value as f32))
}

/// Reads several doubles.
pub(super) fn doubles<const N: usize>(input: &mut (impl Input + ?Sized)) -> Result<[f64; N]> {
    doubles_of(input, Number::F64)
}

fn doubles_of<const N: usize>(input: &mut (impl Input + ?Sized), number: Number) -> Result<[f64; N]> {
    let mut values = [0.0; N];
    for value in &mut values {
        *value = input.number(number)?;
    }
    Ok(values)
}
