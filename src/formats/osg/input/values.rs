//! [`Number`] and [`Values`]: the types of numbers in a file, and arrays of them.

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    /// Returns the size in a binary file in bytes.
    pub fn size_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Returns the size in [`Values`] in bytes.
    pub fn memory_bytes(self) -> u64 {
        if self == Self::F64 { 8 } else { 4 }
    }

    /// Returns the value that stands for 1 where integers are normalized.
    pub fn one(self) -> f64 {
        match self {
            Self::I8 => f64::from(i8::MAX),
            Self::U8 => f64::from(u8::MAX),
            Self::I16 => f64::from(i16::MAX),
            Self::U16 => f64::from(u16::MAX),
            Self::I32 => f64::from(i32::MAX),
            Self::U32 => f64::from(u32::MAX),
            Self::F32 | Self::F64 => 1.0,
        }
    }
}

/// Numbers of one type, in the memory that they need.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) enum Values {
    F32(Vec<f32>),
    F64(Vec<f64>),
    /// Integers of the type; those of type `U32` as the bits of an `i32`.
    Whole(Number, Vec<i32>),
}

impl Values {
    /// Returns the number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::F64(values) => values.len(),
            Self::Whole(_, values) => values.len(),
        }
    }

    /// Returns a value; 0 beyond the end.
    pub fn get(&self, index: usize) -> f64 {
        match self {
            Self::F32(values) => values.get(index).map_or(0.0, |value| f64::from(*value)),
            Self::F64(values) => values.get(index).copied().unwrap_or(0.0),
            Self::Whole(Number::U32, values) => values.get(index).map_or(0.0, |value| f64::from(*value as u32)),
            Self::Whole(_, values) => values.get(index).map_or(0.0, |value| f64::from(*value)),
        }
    }

    /// Returns the type of the values.
    pub fn number(&self) -> Number {
        match self {
            Self::F32(_) => Number::F32,
            Self::F64(_) => Number::F64,
            Self::Whole(number, _) => *number,
        }
    }

    /// Returns the bytes of memory that the values take.
    pub fn size_bytes(&self) -> u64 {
        self.number().memory_bytes() * self.len() as u64
    }
}
