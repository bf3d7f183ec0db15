//! The header of a file: its encoding, version and compressor.

use std::io::Read;

use super::Input;
use super::binary::BinaryInput;
use super::text::TextInput;
use super::values::Number;
use crate::fetch::gated;
use crate::formats::osg::error::{OsgError, Result};

/// The first bytes of a binary file: two numbers in the byte order of the writer.
const MAGIC: [u8; 8] = [0xa1, 0x0e, 0x91, 0x6c, 0x45, 0x45, 0xfb, 0x1a];
const MAGIC_BIG_ENDIAN: [u8; 8] = [0x6c, 0x91, 0x0e, 0xa1, 0x1a, 0xfb, 0x45, 0x45];
const MAGIC_TEXT: &[u8] = b"#Ascii";

/// The type of a file that holds an image.
const TYPE_IMAGE: u32 = 2;
/// Bits of the attributes in a binary header.
const HAS_DOMAINS: u32 = 1;
const HAS_SCHEMA: u32 = 2;
const HAS_BLOCK_SIZES: u32 = 4;
/// The version since which the first two of these bits have their meaning.
const VERSION_OF_DOMAINS: u32 = 98;

/// A file behind its header.
pub(in super::super) struct Opened<'a> {
    pub input: Box<dyn Input + 'a>,
    /// The version of OSG (SOVERSION): 161 for 3.6.5.
    pub version: u32,
}

/// Returns true for the first bytes of an .osgb or .osgt file.
pub(in super::super) fn is_native(bytes: &[u8]) -> bool {
    [&MAGIC[..], &MAGIC_BIG_ENDIAN, MAGIC_TEXT].iter().any(|magic| bytes.starts_with(magic))
}

/// Reads the header of a file, and decompresses what follows. `max_bytes` limits the result.
pub(in super::super) fn open(bytes: &[u8], max_bytes: u64) -> Result<Opened<'_>> {
    if let Some(text) = bytes.strip_prefix(MAGIC_TEXT) {
        return open_text(text);
    }
    let is_big_endian = bytes.starts_with(&MAGIC_BIG_ENDIAN);
    if !is_big_endian && !bytes.starts_with(&MAGIC) {
        return Err(OsgError::invalid("unknown magic"));
    }
    let mut input = BinaryInput::new(bytes, MAGIC.len(), is_big_endian);
    let kind = input.number(Number::U32)? as u32;
    let version = input.number(Number::U32)? as u32;
    let attributes = input.number(Number::U32)? as u32;
    check_kind(kind == TYPE_IMAGE)?;
    if attributes & HAS_BLOCK_SIZES != 0 {
        input.set_block_sizes(version);
    }
    if attributes & HAS_DOMAINS != 0 && version >= VERSION_OF_DOMAINS {
        let count = input.number(Number::U32)? as u32;
        for _ in 0..count {
            input.word()?;
            input.number(Number::I32)?;
        }
    }
    let compressor = input.word()?;
    match compressor.as_str() {
        "0" => {}
        "zlib" => {
            let plain = inflate(input.rest(), max_bytes)?;
            input.replace(plain);
        }
        _ => {
            let name: String = compressor.chars().take(40).collect();
            return Err(OsgError::Unsupported(format!("compressor {name:?}")));
        }
    }
    if attributes & HAS_SCHEMA != 0 {
        // The names of all members, in the order that the version says anyway.
        input.word()?;
    }
    Ok(Opened { input: Box::new(input), version })
}

fn open_text(text: &[u8]) -> Result<Opened<'_>> {
    let mut input = TextInput::new(text);
    check_kind(input.word()? == "Image")?;
    input.keyword("#Version")?;
    let version = input.number(Number::U32)? as u32;
    input.keyword("#Generator")?;
    input.word()?;
    input.word()?;
    while input.matches("#CustomDomain")? {
        input.word()?;
        input.number(Number::I32)?;
    }
    Ok(Opened { input: Box::new(input), version })
}

fn check_kind(is_image: bool) -> Result<()> {
    match is_image {
        true => Err(OsgError::Unsupported("an image without a scene".to_owned())),
        false => Ok(()),
    }
}

/// Decompresses zlib or gzip.
pub(in super::super) fn inflate(bytes: &[u8], max_bytes: u64) -> Result<Vec<u8>> {
    let mut plain = Vec::new();
    let limit = max_bytes.saturating_add(1);
    let read = match bytes.starts_with(&[0x1f, 0x8b]) {
        true => gated(flate2::read::GzDecoder::new(bytes)).take(limit).read_to_end(&mut plain),
        false => gated(flate2::read::ZlibDecoder::new(bytes)).take(limit).read_to_end(&mut plain),
    };
    read.map_err(|e| OsgError::invalid(format!("zlib: {e}")))?;
    if plain.len() as u64 > max_bytes {
        let (got, limit) = (plain.len() as u64, max_bytes);
        return Err(OsgError::TooLarge { what: "decompressed OpenSceneGraph file", got, limit });
    }
    Ok(plain)
}
