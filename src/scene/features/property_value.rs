//! [`PropertyValue`]: the value of one property of a feature.

use std::fmt;

/// A value in a property table.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum PropertyValue {
    /// No value.
    #[default]
    Null,
    /// A truth value.
    Bool(bool),
    /// A signed integer.
    Int(i64),
    /// An unsigned integer.
    UInt(u64),
    /// A floating-point number.
    Float(f64),
    /// Text, or the name of an enumerated value.
    Text(String),
    /// The components of a vector or matrix, or the elements of an array.
    List(Vec<PropertyValue>),
    /// The members of a JSON object with their names.
    Object(Vec<(String, PropertyValue)>),
}

impl PropertyValue {
    /// Returns a number as f64; `None` for other values.
    pub fn as_f64(&self) -> Option<f64> {
        match self {
            Self::Int(value) => Some(*value as f64),
            Self::UInt(value) => Some(*value as f64),
            Self::Float(value) => Some(*value),
            _ => None,
        }
    }

    /// Returns the numbers of a number, vector, matrix or array, those of inner lists in order; `None` if one of them is no
    /// number.
    pub fn as_numbers(&self) -> Option<Vec<f64>> {
        match self {
            Self::List(values) => {
                let parts = values.iter().map(Self::as_numbers).collect::<Option<Vec<_>>>()?;
                Some(parts.concat())
            }
            number => number.as_f64().map(|number| vec![number]),
        }
    }

    /// Returns text; `None` for other values.
    pub fn as_str(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    /// Returns the bytes of memory that the value takes.
    pub(crate) fn size_bytes(&self) -> usize {
        let own = match self {
            Self::Text(text) => text.len(),
            Self::List(values) => values.iter().map(Self::size_bytes).sum(),
            Self::Object(members) => members.iter().map(|(name, value)| name.len() + value.size_bytes()).sum(),
            Self::Null | Self::Bool(_) | Self::Int(_) | Self::UInt(_) | Self::Float(_) => 0,
        };
        size_of::<Self>() + own
    }
}

impl fmt::Display for PropertyValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Null => f.write_str("null"),
            Self::Bool(value) => value.fmt(f),
            Self::Int(value) => value.fmt(f),
            Self::UInt(value) => value.fmt(f),
            Self::Float(value) => value.fmt(f),
            Self::Text(text) => f.write_str(text),
            Self::List(values) => {
                f.write_str("[")?;
                for (i, value) in values.iter().enumerate() {
                    write!(f, "{}{value}", if i > 0 { ", " } else { "" })?;
                }
                f.write_str("]")
            }
            Self::Object(members) => {
                f.write_str("{")?;
                for (i, (name, value)) in members.iter().enumerate() {
                    write!(f, "{}{name}: {value}", if i > 0 { ", " } else { "" })?;
                }
                f.write_str("}")
            }
        }
    }
}
