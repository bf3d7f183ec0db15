//! [`TextInput`]: the text encoding. Words are separated by white space; blocks are in braces.

use super::names::{Names, value_of};
use super::values::{Number, Values};
use super::{Input, decoded};
use crate::fetch::about_to_allocate;
use crate::formats::osg::error::{OsgError, Result};

/// Reads the text encoding.
pub(super) struct TextInput<'a> {
    text: &'a [u8],
    at: usize,
}

impl<'a> TextInput<'a> {
    pub fn new(text: &'a [u8]) -> Self {
        Self { text, at: 0 }
    }

    /// Returns the next word and the position behind it; `None` at the end.
    fn peek(&self) -> Option<(&'a str, usize)> {
        let is_space = |at: &usize| self.text[*at].is_ascii_whitespace();
        let start = (self.at..self.text.len()).find(|at| !is_space(at))?;
        let end = (start..self.text.len()).find(is_space).unwrap_or(self.text.len());
        // A word that is not UTF-8 is part of a string that is skipped, or matches nothing.
        Some((std::str::from_utf8(&self.text[start..end]).unwrap_or("?"), end))
    }

    fn next(&mut self) -> Result<&'a str> {
        let (word, end) = self.peek().ok_or_else(|| OsgError::invalid("the text ends early"))?;
        self.at = end;
        Ok(word)
    }

    fn line(&self) -> usize {
        1 + self.text[..self.at.min(self.text.len())].iter().filter(|byte| **byte == b'\n').count()
    }

    fn expect(&mut self, word: &str) -> Result<()> {
        match self.next()? {
            found if found == word => Ok(()),
            found => {
                let found: String = found.chars().take(40).collect();
                Err(OsgError::invalid(format!("line {}: {found} instead of {word}", self.line())))
            }
        }
    }

    /// Returns the error for a word that is no number.
    fn no_number(&self, word: &str) -> OsgError {
        let word: String = word.chars().take(40).collect();
        OsgError::invalid(format!("line {}: {word} is not a number", self.line()))
    }
}

/// Parses a number of a type.
fn parse(word: &str, number: Number) -> Option<f64> {
    Some(match number {
        Number::F32 => f64::from(word.parse::<f32>().ok()?),
        Number::F64 => word.parse::<f64>().ok()?,
        // Hexadecimal numbers are masks.
        _ => match word.strip_prefix("0x").or(word.strip_prefix("0X")) {
            Some(digits) => f64::from(u32::from_str_radix(digits, 16).ok()?),
            None => word.parse::<i64>().ok()? as f64,
        },
    })
}

impl Input for TextInput<'_> {
    fn is_text(&self) -> bool {
        true
    }

    fn boolean(&mut self) -> Result<bool> {
        Ok(self.next()? == "TRUE")
    }

    fn number(&mut self, number: Number) -> Result<f64> {
        let word = self.next()?;
        parse(word, number).ok_or_else(|| self.no_number(word))
    }

    fn numbers(&mut self, number: Number, count: usize) -> Result<Values> {
        // Each takes a digit and a space.
        if count > self.remaining() / 2 + 1 {
            return Err(OsgError::invalid(format!("line {}: an array of {count} numbers", self.line())));
        }
        about_to_allocate(number.memory_bytes() * count as u64)?;
        Ok(match number {
            Number::F32 => {
                let values = (0..count).map(|_| self.number(number).map(|value| value as f32));
                Values::F32(values.collect::<Result<_>>()?)
            }
            Number::F64 => Values::F64((0..count).map(|_| self.number(number)).collect::<Result<_>>()?),
            Number::U32 => {
                let values = (0..count).map(|_| self.number(number).map(|value| value as u32 as i32));
                Values::Whole(number, values.collect::<Result<_>>()?)
            }
            _ => {
                let values = (0..count).map(|_| self.number(number).map(|value| value as i32));
                Values::Whole(number, values.collect::<Result<_>>()?)
            }
        })
    }

    fn word(&mut self) -> Result<String> {
        self.next().map(str::to_owned)
    }

    fn quoted(&mut self) -> Result<String> {
        let start = (self.at..self.text.len()).find(|at| !self.text[*at].is_ascii_whitespace());
        let Some(start) = start.filter(|start| self.text[*start] == b'"') else { return self.word() };
        let mut bytes = Vec::new();
        let mut at = start + 1;
        loop {
            match self.text.get(at) {
                None => return Err(OsgError::invalid(format!("line {}: a string does not end", self.line()))),
                Some(b'"') => break,
                Some(b'\\') => {
                    bytes.extend(self.text.get(at + 1));
                    at += 2;
                }
                Some(byte) => {
                    bytes.push(*byte);
                    at += 1;
                }
            }
        }
        self.at = at + 1;
        Ok(decoded(&bytes).into_owned())
    }

    fn bytes(&mut self, _count: usize) -> Result<Vec<u8>> {
        Err(OsgError::invalid("bytes in a text file"))
    }

    fn keyword(&mut self, name: &str) -> Result<()> {
        self.expect(name)
    }

    fn named(&mut self, names: Names) -> Result<u32> {
        let word = self.next()?;
        // Values without a name are written as numbers. Unknown names select nothing.
        Ok(value_of(names, word).or_else(|| Some(parse(word, Number::I32)? as i64 as u32)).unwrap_or(0))
    }

    fn matches(&mut self, name: &str) -> Result<bool> {
        match self.peek() {
            Some((word, end)) if word == name => {
                self.at = end;
                Ok(true)
            }
            _ => Ok(false),
        }
    }

    fn begin(&mut self) -> Result<()> {
        self.expect("{")
    }

    fn end(&mut self) -> Result<()> {
        self.expect("}")
    }

    fn leave(&mut self) -> Result<()> {
        let mut depth = 0usize;
        loop {
            let (word, end) = self.peek().ok_or_else(|| OsgError::invalid("the text ends inside of a block"))?;
            if word.starts_with('"') {
                // Braces in a string are no blocks.
                self.quoted()?;
                continue;
            }
            self.at = end;
            match word {
                "{" => depth += 1,
                "}" if depth == 0 => return Ok(()),
                "}" => depth -= 1,
                _ => {}
            }
        }
    }

    fn can_skip(&self) -> bool {
        true
    }

    fn is_at_end_of_block(&self) -> bool {
        // An object whose members all have their defaults looks the same as a reference to one.
        false
    }

    fn remaining(&self) -> usize {
        self.text.len() - self.at
    }
}
