//! Schemas of the 3D Metadata specification as tilesets have them. Immutable; decode threads.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use crate::formats::lenient::{Text, or_default};

/// A schema: the classes that property tables and metadata entities have.
#[derive(Clone, Debug, Default, Deserialize)]
pub(in crate::formats) struct Schema {
    #[serde(default, deserialize_with = "or_default")]
    pub classes: BTreeMap<String, Class>,
}

#[derive(Clone, Debug, Default, Deserialize)]
pub(in crate::formats) struct Class {
    #[serde(default, deserialize_with = "or_default")]
    pub properties: BTreeMap<String, Property>,
}

/// A property of a class.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(in crate::formats) struct Property {
    #[serde(rename = "type", default)]
    pub kind: Text,
    #[serde(default)]
    pub component_type: Text,
    #[serde(default, deserialize_with = "or_default")]
    pub array: bool,
    /// The number of elements of an array; `None` for arrays of any length.
    pub count: Option<usize>,
    #[serde(default, deserialize_with = "or_default")]
    pub normalized: bool,
    pub offset: Option<Value>,
    pub scale: Option<Value>,
    #[serde(default)]
    pub semantic: Text,
}

/// The type of the components of a number, vector or matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    Int8,
    Uint8,
    Int16,
    Uint16,
    Int32,
    Uint32,
    Int64,
    Uint64,
    Float32,
    Float64,
}

impl Component {
    /// Returns the type that a schema names.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "INT8" => Self::Int8,
            "UINT8" => Self::Uint8,
            "INT16" => Self::Int16,
            "UINT16" => Self::Uint16,
            "INT32" => Self::Int32,
            "UINT32" => Self::Uint32,
            "INT64" => Self::Int64,
            "UINT64" => Self::Uint64,
            "FLOAT32" => Self::Float32,
            "FLOAT64" => Self::Float64,
            _ => return None,
        })
    }

    pub const fn size_bytes(self) -> usize {
        match self {
            Self::Int8 | Self::Uint8 => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 => 4,
            Self::Int64 | Self::Uint64 | Self::Float64 => 8,
        }
    }

    /// Returns the value that stands for 1 in a normalized property.
    const fn one(self) -> f64 {
        match self {
            Self::Int8 => i8::MAX as f64,
            Self::Uint8 => u8::MAX as f64,
            Self::Int16 => i16::MAX as f64,
            Self::Uint16 => u16::MAX as f64,
            Self::Int32 => i32::MAX as f64,
            Self::Uint32 => u32::MAX as f64,
            Self::Int64 => i64::MAX as f64,
            Self::Uint64 => u64::MAX as f64,
            Self::Float32 | Self::Float64 => 1.0,
        }
    }

    /// Reads a component from the beginning of `bytes`; `None` if there are too few.
    pub fn read(self, bytes: &[u8], normalized: bool) -> Option<f64> {
        let value = match self {
            Self::Int8 => f64::from(*bytes.first()? as i8),
            Self::Uint8 => f64::from(*bytes.first()?),
            Self::Int16 => f64::from(i16::from_le_bytes(*bytes.first_chunk()?)),
            Self::Uint16 => f64::from(u16::from_le_bytes(*bytes.first_chunk()?)),
            Self::Int32 => f64::from(i32::from_le_bytes(*bytes.first_chunk()?)),
            Self::Uint32 => f64::from(u32::from_le_bytes(*bytes.first_chunk()?)),
            Self::Int64 => i64::from_le_bytes(*bytes.first_chunk()?) as f64,
            Self::Uint64 => u64::from_le_bytes(*bytes.first_chunk()?) as f64,
            Self::Float32 => f64::from(f32::from_le_bytes(*bytes.first_chunk()?)),
            Self::Float64 => f64::from_le_bytes(*bytes.first_chunk()?),
        };
        Some(if normalized { (value / self.one()).max(-1.0) } else { value })
    }
}

impl Property {
    /// Returns the number of components of an element; `None` if the elements are no numbers.
    pub(super) fn components(&self) -> Option<usize> {
        Some(match self.kind.0.as_deref()? {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" | "MAT2" => 4,
            "MAT3" => 9,
            "MAT4" => 16,
            _ => return None,
        })
    }
}
