//! Feature tables of 3D Tiles 1.0: padded JSON, and a binary part with some of the values. Decode threads.

use serde::Deserialize;
use serde::de::DeserializeOwned;

/// The offset of a column or of a global value in the binary part.
#[derive(Clone, Copy, Deserialize)]
pub(in crate::formats) struct BinaryOffset {
    #[serde(rename = "byteOffset")]
    pub byte_offset: usize,
}

/// A value of the whole table, in the JSON or in the binary part.
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged)]
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

/// Parses the JSON part. Some writers pad it with zeros instead of spaces.
pub(in crate::formats) fn parse<T: DeserializeOwned>(json: &[u8]) -> Result<T, serde_json::Error> {
    let end = json.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    serde_json::from_slice(&json[..end])
}
