//! [`Component`]: the types of numbers in property tables.

use crate::scene::PropertyValue;

/// A little-endian number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Component {
    /// Returns the type with a name of 3D Tiles Metadata (`UINT8`) or of a batch table (`UNSIGNED_BYTE`).
    pub fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "INT8" | "BYTE" => Self::I8,
            "UINT8" | "UNSIGNED_BYTE" => Self::U8,
            "INT16" | "SHORT" => Self::I16,
            "UINT16" | "UNSIGNED_SHORT" => Self::U16,
            "INT32" | "INT" => Self::I32,
            "UINT32" | "UNSIGNED_INT" => Self::U32,
            "INT64" => Self::I64,
            "UINT64" => Self::U64,
            "FLOAT32" | "FLOAT" => Self::F32,
            "FLOAT64" | "DOUBLE" => Self::F64,
            _ => return None,
        })
    }

    pub fn size_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Returns number `i` of tightly packed numbers; `None` beyond their end.
    pub fn read(self, bytes: &[u8], i: usize) -> Option<PropertyValue> {
        let rest = bytes.get(i.checked_mul(self.size_bytes())?..)?;
        Some(match self {
            Self::I8 => PropertyValue::Int(i8::from_le_bytes(*rest.first_chunk()?).into()),
            Self::U8 => PropertyValue::UInt(u8::from_le_bytes(*rest.first_chunk()?).into()),
            Self::I16 => PropertyValue::Int(i16::from_le_bytes(*rest.first_chunk()?).into()),
            Self::U16 => PropertyValue::UInt(u16::from_le_bytes(*rest.first_chunk()?).into()),
            Self::I32 => PropertyValue::Int(i32::from_le_bytes(*rest.first_chunk()?).into()),
            Self::U32 => PropertyValue::UInt(u32::from_le_bytes(*rest.first_chunk()?).into()),
            Self::I64 => PropertyValue::Int(i64::from_le_bytes(*rest.first_chunk()?)),
            Self::U64 => PropertyValue::UInt(u64::from_le_bytes(*rest.first_chunk()?)),
            Self::F32 => PropertyValue::Float(f32::from_le_bytes(*rest.first_chunk()?).into()),
            Self::F64 => PropertyValue::Float(f64::from_le_bytes(*rest.first_chunk()?)),
        })
    }

    /// Returns unsigned number `i`; `None` beyond the end and for other types.
    pub fn read_unsigned(self, bytes: &[u8], i: usize) -> Option<usize> {
        match self.read(bytes, i)? {
            PropertyValue::UInt(value) => usize::try_from(value).ok(),
            _ => None,
        }
    }

    /// Returns the integer that stands for 1 when integers are normalized; `None` for floating-point numbers.
    pub fn one(self) -> Option<f64> {
        Some(match self {
            Self::I8 => f64::from(i8::MAX),
            Self::U8 => f64::from(u8::MAX),
            Self::I16 => f64::from(i16::MAX),
            Self::U16 => f64::from(u16::MAX),
            Self::I32 => f64::from(i32::MAX),
            Self::U32 => f64::from(u32::MAX),
            Self::I64 => i64::MAX as f64,
            Self::U64 => u64::MAX as f64,
            Self::F32 | Self::F64 => return None,
        })
    }
}
