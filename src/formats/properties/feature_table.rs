//! Feature tables of 3D Tiles 1.0: padded JSON, and a binary part with some of the values. Decode threads.

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::{DeserializeOwned, Error as _};
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

/// The columns of all feature tables: how many numbers a row has, and how each is stored.
const COLUMNS: [(&str, usize, Store); 14] = [
    ("BATCH_ID", 1, u32_number),
    ("NORMAL", 3, f32_number),
    ("NORMAL_OCT16P", 2, u8_number),
    ("NORMAL_RIGHT", 3, f32_number),
    ("NORMAL_RIGHT_OCT32P", 2, u16_number),
    ("NORMAL_UP", 3, f32_number),
    ("NORMAL_UP_OCT32P", 2, u16_number),
    ("POSITION", 3, f32_number),
    ("POSITION_QUANTIZED", 3, u16_number),
    ("RGB", 3, u8_number),
    ("RGB565", 1, u16_number),
    ("RGBA", 4, u8_number),
    ("SCALE", 1, f32_number),
    ("SCALE_NON_UNIFORM", 3, f32_number),
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
/// part. A column that is shorter than the table is an error, since it would read into the next one. Some writers pad the
/// JSON with zeros instead of spaces.
pub(in crate::formats) fn parse_columns<'a, T: DeserializeOwned>(
    json: &[u8],
    binary: &'a [u8],
) -> Result<(T, Cow<'a, [u8]>), serde_json::Error> {
    parse(json).map(|table| (table, Cow::Borrowed(binary))).or_else(|error| {
        let mut members: Map<String, Value> = parse(json)?;
        if !COLUMNS.iter().any(|(name, ..)| members.get(*name).is_some_and(Value::is_array)) {
            return Err(error);
        }
        let rows = rows_of(&members, binary);
        let mut all = binary.to_vec();
        for (name, components, bytes_of) in COLUMNS {
            let short = |got: usize, unit: &str| {
                serde_json::Error::custom(format_args!("{name} has {got} {unit}, too few for {rows} rows"))
            };
            match members.get(name) {
                Some(Value::Array(numbers)) => {
                    if numbers.len() / components < rows {
                        return Err(short(numbers.len(), "numbers"));
                    }
                    all.resize(all.len().next_multiple_of(4), 0);
                    let offset = all.len();
                    for number in numbers.iter().map(|number| number.as_f64().unwrap_or(f64::NAN)) {
                        let (bytes, size) = bytes_of(number);
                        all.extend_from_slice(&bytes[..size]);
                    }
                    let column = match name {
                        "BATCH_ID" => json!({ "byteOffset": offset, "componentType": "UNSIGNED_INT" }),
                        _ => json!({ "byteOffset": offset }),
                    };
                    members.insert(name.to_owned(), column);
                }
                Some(Value::Object(column)) => {
                    let size = match column.get("componentType").and_then(Value::as_str) {
                        Some("UNSIGNED_BYTE") => 1,
                        None | Some("UNSIGNED_SHORT") if name == "BATCH_ID" => 2,
                        _ => bytes_of(0.0).1,
                    };
                    let offset = column.get("byteOffset").and_then(Value::as_u64).unwrap_or(0);
                    let own = binary.len().saturating_sub(usize::try_from(offset).unwrap_or(usize::MAX));
                    if own / size / components < rows {
                        return Err(short(own, "bytes"));
                    }
                }
                _ => {}
            }
        }
        Ok((T::deserialize(Value::Object(members))?, Cow::Owned(all)))
    })
}

/// Returns the number of rows that a table declares; 0 if it declares none, which its reader refuses.
fn rows_of(members: &Map<String, Value>, binary: &[u8]) -> usize {
    let length = ["POINTS_LENGTH", "INSTANCES_LENGTH"].iter().find_map(|name| members.get(*name));
    length.and_then(|length| Global::<usize>::deserialize(length).ok()?.count(binary)).unwrap_or(0)
}

/// Parses the JSON part. Some writers pad it with zeros instead of spaces.
pub(in crate::formats) fn parse<T: DeserializeOwned>(json: &[u8]) -> Result<T, serde_json::Error> {
    let end = json.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    serde_json::from_slice(&json[..end])
}
