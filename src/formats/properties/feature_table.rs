//! Feature tables of 3D Tiles 1.0: padded JSON, and a binary part with some of the values. Decode threads.

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

/// The offset of a column or of a global value in the binary part.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "BTreeMap<String, Value>")]
pub(in crate::formats) struct BinaryOffset {
    pub byte_offset: usize,
}

/// A derived reader would take a list of one number as an offset.
impl TryFrom<BTreeMap<String, Value>> for BinaryOffset {
    type Error = &'static str;

    fn try_from(members: BTreeMap<String, Value>) -> Result<Self, Self::Error> {
        let offset = members.get("byteOffset").and_then(Value::as_u64).and_then(|offset| offset.try_into().ok());
        offset.map(|byte_offset| Self { byte_offset }).ok_or("no valid byteOffset")
    }
}

/// A value of the whole table, in the JSON or in the binary part.
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged, expecting = "a value is neither what its name says nor a byteOffset")]
pub(in crate::formats) enum Global<T> {
    Json(T),
    Binary(BinaryOffset),
}

impl<T> Global<T> {
    fn of<const N: usize>(self, binary: &[u8], read: impl Fn([u8; N]) -> T) -> Option<T> {
        match self {
            Self::Json(value) => Some(value),
            Self::Binary(BinaryOffset { byte_offset }) => binary.get(byte_offset..)?.first_chunk().copied().map(read),
        }
    }
}

impl Global<[f64; 3]> {
    /// Returns the vector, three f32 if it is in the binary part. Returns `None` if it is truncated or not finite.
    pub fn vector(self, binary: &[u8]) -> Option<[f64; 3]> {
        let part = |bytes: &[u8; 12], k: usize| [0, 1, 2, 3].map(|i| bytes[4 * k + i]);
        let numbers =
            self.of(binary, |bytes: [u8; 12]| [0, 1, 2].map(|k| f32::from_le_bytes(part(&bytes, k)).into()))?;
        numbers.iter().all(|x| x.is_finite()).then_some(numbers)
    }
}

impl Global<usize> {
    pub fn count(self, binary: &[u8]) -> Option<usize> {
        self.of(binary, |bytes| u32::from_le_bytes(bytes) as usize)
    }
}

impl Global<[u8; 4]> {
    pub fn bytes(self, binary: &[u8]) -> Option<[u8; 4]> {
        self.of(binary, |bytes| bytes)
    }
}

/// Returns the bytes that store a number in a column.
type Store = fn(f64) -> Number;

/// The columns of all feature tables, and how a number of each is stored.
const COLUMNS: [(&str, Store); 14] = [
    ("BATCH_ID", u32_number),
    ("NORMAL", f32_number),
    ("NORMAL_OCT16P", u8_number),
    ("NORMAL_RIGHT", f32_number),
    ("NORMAL_RIGHT_OCT32P", u16_number),
    ("NORMAL_UP", f32_number),
    ("NORMAL_UP_OCT32P", u16_number),
    ("POSITION", f32_number),
    ("POSITION_QUANTIZED", u16_number),
    ("RGB", u8_number),
    ("RGB565", u16_number),
    ("RGBA", u8_number),
    ("SCALE", f32_number),
    ("SCALE_NON_UNIFORM", f32_number),
];

/// The bytes of a number, and how many of them count.
type Number = ([u8; 4], usize);

fn f32_number(x: f64) -> Number {
    ((x as f32).to_le_bytes(), 4)
}

fn u32_number(x: f64) -> Number {
    ((x as u32).to_le_bytes(), 4)
}

fn u16_number(x: f64) -> Number {
    ((x as u32).to_le_bytes(), 2)
}

fn u8_number(x: f64) -> Number {
    ((x as u32).to_le_bytes(), 1)
}

/// Parses the JSON part of a table with columns. Columns may be lists of numbers in the JSON: they are appended to the binary
/// part. Some writers pad the JSON with zeros instead of spaces.
pub(in crate::formats) fn parse_columns<'a, T: DeserializeOwned>(
    json: &[u8],
    binary: &'a [u8],
) -> Result<(T, Cow<'a, [u8]>), serde_json::Error> {
    parse(json).map(|table| (table, Cow::Borrowed(binary))).or_else(|error| {
        let mut members: Map<String, Value> = parse(json)?;
        let mut binary = binary.to_vec();
        let mut has_lists = false;
        for (name, bytes_of) in COLUMNS {
            let Some(Value::Array(numbers)) = members.get(name) else { continue };
            binary.resize(binary.len().next_multiple_of(4), 0);
            let offset = binary.len();
            for number in numbers.iter().map(|number| number.as_f64().unwrap_or(f64::NAN)) {
                let (bytes, size) = bytes_of(number);
                binary.extend_from_slice(&bytes[..size]);
            }
            let column = match name {
                "BATCH_ID" => json!({ "byteOffset": offset, "componentType": "UNSIGNED_INT" }),
                _ => json!({ "byteOffset": offset }),
            };
            members.insert(name.to_owned(), column);
            has_lists = true;
        }
        if !has_lists {
            return Err(error);
        }
        Ok((T::deserialize(Value::Object(members))?, Cow::Owned(binary)))
    })
}

/// Parses the JSON part. Some writers pad it with zeros instead of spaces.
pub(in crate::formats) fn parse<T: DeserializeOwned>(json: &[u8]) -> Result<T, serde_json::Error> {
    let end = json.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    serde_json::from_slice(&json[..end])
}
