//! [`Block`]: the text of an .osg file as blocks of fields, one field a line.

use std::borrow::Cow;

use glam::DQuat;

use crate::fetch::{Limits, about_to_allocate};
use crate::formats::osg::error::{OsgError, Result};

/// Blocks whose first field may begin with a number: OpenGL's modes.
const BLOCKS_OF_MODES: [&str; 3] = ["StateSet", "GeoState", "textureUnit"];
/// A file may have this many numbers for each of [`Limits::max_elements`].
const NUMBERS_PER_ELEMENT: usize = 8;

/// The fields between two braces.
#[derive(Debug, Default)]
pub(super) struct Block<'a> {
    pub fields: Vec<Field<'a>>,
    /// The numbers that the block begins with: those of arrays, matrices and lists.
    pub numbers: Vec<f64>,
}

/// The words of a line, with the block that follows them.
#[derive(Debug, Default)]
pub(super) struct Field<'a> {
    pub words: Vec<Cow<'a, str>>,
    pub block: Option<Block<'a>>,
}

impl Field<'_> {
    /// Returns a word; empty beyond the last.
    pub fn word(&self, index: usize) -> &str {
        self.words.get(index).map_or("", |word| &**word)
    }

    /// Returns numbers from a word on; `None` if there are fewer.
    pub fn numbers<const N: usize>(&self, from: usize) -> Option<[f64; N]> {
        let mut numbers = [0.0; N];
        for (i, number) in numbers.iter_mut().enumerate() {
            *number = number_of(self.word(from + i))?;
        }
        Some(numbers)
    }
}

impl<'a> Block<'a> {
    /// Returns the field of a name.
    pub fn field(&self, name: &str) -> Option<&Field<'a>> {
        self.fields.iter().find(|field| field.word(0) == name)
    }

    /// Returns the word behind a name; empty without it.
    pub fn word(&self, name: &str) -> &str {
        self.field(name).map_or("", |field| field.word(1))
    }

    /// Returns the numbers behind a name.
    pub fn values<const N: usize>(&self, name: &str) -> Option<[f64; N]> {
        self.field(name)?.numbers(1)
    }

    /// Returns the number behind a name.
    pub fn value(&self, name: &str) -> Option<f64> {
        self.values(name).map(|[value]| value)
    }

    /// Returns false only if the file says so.
    pub fn is_true(&self, name: &str) -> bool {
        !matches!(self.word(name), "FALSE" | "OFF")
    }

    /// Returns the numbers in the block of a field.
    pub fn list(&self, name: &str) -> &[f64] {
        self.field(name).and_then(|field| field.block.as_ref()).map_or(&[], |block| &block.numbers)
    }
}

/// Returns a rotation; the identity for one that is none.
pub(super) fn rotation(block: &Block<'_>, name: &str) -> DQuat {
    block.values(name).map_or(DQuat::IDENTITY, rotation_of)
}

/// Returns the rotation of four numbers; the identity for those that are none.
pub(super) fn rotation_of(numbers: [f64; 4]) -> DQuat {
    let quat = DQuat::from_array(numbers);
    if quat.is_finite() && quat.length_squared() > 0.0 { quat.normalize() } else { DQuat::IDENTITY }
}

/// Parses a number, also a hexadecimal one.
pub(super) fn number_of(word: &str) -> Option<f64> {
    match word.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16).ok().map(f64::from),
        None if word.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first)) => word.parse().ok(),
        None => None,
    }
}

/// Parses a file.
pub(super) fn parse<'a>(text: &'a str, limits: &Limits) -> Result<Block<'a>> {
    let limit = limits.max_elements;
    let mut parser =
        Parser { text, at: 0, line: 1, max_depth: limits.max_depth as usize, limit, fields: 0, numbers: 0, unasked: 0 };
    parser.block(0, false)
}

/// The budget of a content is asked for this many bytes at once.
const ASKED_BYTES: u64 = 64 << 10;

struct Parser<'a> {
    text: &'a str,
    at: usize,
    /// The number of the line.
    line: usize,
    max_depth: usize,
    /// The maximum number of fields.
    limit: usize,
    fields: usize,
    numbers: usize,
    /// Bytes of what was parsed since the content's budget was asked.
    unasked: u64,
}

enum Token<'a> {
    Word(Cow<'a, str>),
    Open,
    Close,
}

impl<'a> Parser<'a> {
    /// Returns the next token and true if it is the first of its line; `None` at the end.
    fn token(&mut self) -> Result<Option<(Token<'a>, bool)>> {
        let before = self.line;
        let bytes = self.text.as_bytes();
        loop {
            match bytes.get(self.at) {
                None => return Ok(None),
                Some(b'\n') => self.line += 1,
                Some(b'#') if bytes[..self.at].last().is_none_or(|last| *last == b'\n') => {
                    let rest = &bytes[self.at..];
                    self.at += rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len());
                    continue;
                }
                Some(byte) if byte.is_ascii_whitespace() => {}
                Some(_) => break,
            }
            self.at += 1;
        }
        let is_first = self.line > before || self.at == 0;
        let start = self.at;
        let token = match bytes[start] {
            b'{' => Token::Open,
            b'}' => Token::Close,
            b'"' => return self.quoted().map(|word| Some((Token::Word(word), is_first))),
            _ => {
                let rest = &bytes[start..];
                let is_end = |byte: &u8| byte.is_ascii_whitespace() || matches!(byte, b'{' | b'}');
                self.at += rest.iter().position(is_end).unwrap_or(rest.len());
                return Ok(Some((Token::Word(Cow::Borrowed(&self.text[start..self.at])), is_first)));
            }
        };
        self.at += 1;
        Ok(Some((token, is_first)))
    }

    /// Reads a string in quotes.
    fn quoted(&mut self) -> Result<Cow<'a, str>> {
        let start = self.at + 1;
        let mut plain: Option<String> = None;
        let mut is_escaped = false;
        for (offset, letter) in self.text[start..].char_indices() {
            self.line += usize::from(letter == '\n');
            match letter {
                '"' if !is_escaped => {
                    self.at = start + offset + 1;
                    return Ok(plain.map_or(Cow::Borrowed(&self.text[start..start + offset]), Cow::Owned));
                }
                '\\' if !is_escaped => {
                    plain.get_or_insert_with(|| self.text[start..start + offset].to_owned());
                    is_escaped = true;
                    continue;
                }
                _ => {}
            }
            is_escaped = false;
            if let Some(plain) = &mut plain {
                plain.push(letter);
            }
        }
        Err(OsgError::invalid(format!("line {}: a string does not end", self.line)))
    }

    /// Adds bytes that a list takes for one more element, with room to grow. Asks the content's budget now and then.
    fn add_bytes(&mut self, element_bytes: usize) -> Result<()> {
        self.unasked += 2 * element_bytes as u64;
        if self.unasked >= ASKED_BYTES {
            about_to_allocate(std::mem::take(&mut self.unasked))?;
        }
        Ok(())
    }

    fn count(&self, what: &'static str, got: usize, limit: usize) -> Result<()> {
        let (got, limit) = (got as u64, limit as u64);
        if got > limit { Err(OsgError::TooLarge { what, got, limit }) } else { Ok(()) }
    }

    /// Reads a block up to its end; the file itself at depth 0. `has_modes` says that numbers begin fields.
    fn block(&mut self, depth: usize, has_modes: bool) -> Result<Block<'a>> {
        self.count("depth of blocks", depth, self.max_depth)?;
        let mut block = Block::default();
        let mut is_list = !has_modes && depth > 0;
        loop {
            let Some((token, is_first)) = self.token()? else {
                return match depth {
                    0 => Ok(block),
                    _ => Err(OsgError::invalid(format!("line {}: the text ends inside of a block", self.line))),
                };
            };
            match token {
                Token::Word(word) => {
                    if is_list && let Some(number) = number_of(&word) {
                        self.numbers += 1;
                        self.count(
                            "numbers of an .osg file",
                            self.numbers,
                            self.limit.saturating_mul(NUMBERS_PER_ELEMENT),
                        )?;
                        self.add_bytes(size_of::<f64>())?;
                        block.numbers.push(number);
                        continue;
                    }
                    is_list = false;
                    // Behind a block begins another field.
                    match block.fields.last_mut().filter(|last| !is_first && last.block.is_none()) {
                        Some(field) => {
                            self.add_bytes(size_of::<Cow<'_, str>>())?;
                            field.words.push(word);
                        }
                        None => {
                            self.add_bytes(size_of::<Field<'_>>() + size_of::<Cow<'_, str>>())?;
                            self.fields += 1;
                            self.count("fields of an .osg file", self.fields, self.limit)?;
                            block.fields.push(Field { words: vec![word], block: None });
                        }
                    }
                }
                Token::Open => {
                    if block.fields.last().is_none_or(|last| last.block.is_some()) {
                        block.fields.push(Field::default());
                    }
                    let has_modes = block.fields.last().is_some_and(|field| BLOCKS_OF_MODES.contains(&field.word(0)));
                    self.add_bytes(size_of::<Field<'_>>())?;
                    let inner = self.block(depth + 1, has_modes)?;
                    if let Some(field) = block.fields.last_mut() {
                        field.block = Some(inner);
                    }
                    is_list = false;
                }
                Token::Close if depth > 0 => return Ok(block),
                Token::Close => return Err(OsgError::invalid(format!("line {}: }} without {{", self.line))),
            }
        }
    }
}
