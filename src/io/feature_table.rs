//! Feature tables of 3D Tiles 1.0: JSON with padding behind it, and values that lie in a binary part. Decode workers.

use serde::Deserialize;
use serde::de::DeserializeOwned;

/// Where a column, or the value of all, lies in the binary part.
#[derive(Clone, Copy, Deserialize)]
pub(super) struct Place {
    #[serde(rename = "byteOffset")]
    pub byte_offset: usize,
}

/// A value of the whole table: in the JSON, or in the binary part.
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged)]
pub(super) enum Global<T> {
    Said(T),
    Stored(Place),
}

impl<T> Global<T> {
    fn of<const N: usize>(self, binary: &[u8], read: impl Fn([u8; N]) -> T) -> Option<T> {
        match self {
            Self::Said(value) => Some(value),
            Self::Stored(Place { byte_offset }) => binary.get(byte_offset..)?.first_chunk().copied().map(read),
        }
    }
}

impl Global<[f64; 3]> {
    /// Three f32 where it is stored; `None` where it is cut off or not finite.
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

/// The JSON part. Some writers pad it with zeros instead of spaces.
pub(super) fn parse<T: DeserializeOwned>(json: &[u8]) -> Result<T, serde_json::Error> {
    let end = json.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    serde_json::from_slice(&json[..end])
}
