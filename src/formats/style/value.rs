//! [`Value`]: the values of the styling language, with the conversions of JavaScript. Decode threads.

use std::sync::Arc;

use regex::Regex;

use super::text;
use crate::scene::PropertyValue;

/// Two to four components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Vector {
    parts: [f64; 4],
    length: usize,
}

impl Vector {
    /// Returns a vector of the components; `None` unless there are two to four.
    pub fn new(components: &[f64]) -> Option<Self> {
        let mut parts = [0.0; 4];
        let length = components.len();
        parts.get_mut(..length).filter(|_| length >= 2)?.copy_from_slice(components);
        Some(Self { parts, length })
    }

    pub fn components(&self) -> &[f64] {
        &self.parts[..self.length]
    }

    /// Returns the vector with each component replaced.
    pub fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self { parts: self.parts.map(f), ..self }
    }

    /// Combines the components of two vectors; `None` if their lengths differ.
    pub fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Option<Self> {
        let mut parts = [0.0; 4];
        for (part, (a, b)) in parts.iter_mut().zip(self.components().iter().zip(other.components())) {
            *part = f(*a, *b);
        }
        (self.length == other.length).then_some(Self { parts, ..self })
    }

    /// Returns the dot product; `None` if the lengths differ.
    pub fn dot(self, other: Self) -> Option<f64> {
        Some(self.zip(other, |a, b| a * b)?.components().iter().sum())
    }
}

/// A value of an expression. Clones are cheap.
#[derive(Clone, Debug)]
pub(super) enum Value {
    /// No value: a property that is missing, or an operation that is not allowed.
    Undefined,
    Null,
    Bool(bool),
    Number(f64),
    Text(Arc<str>),
    /// A `vec2`, `vec3` or `vec4`. Colours are `vec4`, sRGB from 0 to 1.
    Vector(Vector),
    List(Arc<[Value]>),
    Object(Arc<[(Arc<str>, Value)]>),
    Regex(Arc<Regex>),
}

impl Value {
    pub fn text(text: &str) -> Self {
        Self::Text(text.into())
    }

    /// Returns a vector, or undefined.
    pub fn vector(vector: Option<Vector>) -> Self {
        vector.map_or(Self::Undefined, Self::Vector)
    }

    /// Returns a number, or undefined.
    pub fn number(number: Option<f64>) -> Self {
        number.map_or(Self::Undefined, Self::Number)
    }

    /// Returns the truth value, as JavaScript's `Boolean`.
    pub fn is_true(&self) -> bool {
        match self {
            Self::Undefined | Self::Null => false,
            Self::Bool(value) => *value,
            Self::Number(value) => *value != 0.0 && !value.is_nan(),
            Self::Text(text) => !text.is_empty(),
            Self::Vector(_) | Self::List(_) | Self::Object(_) | Self::Regex(_) => true,
        }
    }

    /// Returns the number, as JavaScript's `Number`; NaN for values without one.
    pub fn to_number(&self) -> f64 {
        match self {
            Self::Null => 0.0,
            Self::Bool(value) => f64::from(u8::from(*value)),
            Self::Number(value) => *value,
            Self::Text(text) => text::number(text),
            Self::Undefined | Self::Vector(_) | Self::List(_) | Self::Object(_) | Self::Regex(_) => f64::NAN,
        }
    }

    /// Returns the text, as the string conversions of the language say.
    pub fn to_text(&self) -> Arc<str> {
        let joined = |parts: &mut dyn Iterator<Item = Arc<str>>| parts.collect::<Vec<_>>().join(", ");
        match self {
            Self::Undefined => "undefined".into(),
            Self::Null => "null".into(),
            Self::Bool(value) => value.to_string().into(),
            Self::Number(value) => text::of_number(*value).into(),
            Self::Text(text) => text.clone(),
            Self::Vector(vector) => {
                let mut parts = vector.components().iter().map(|part| text::of_number(*part).into());
                format!("({})", joined(&mut parts)).into()
            }
            Self::List(parts) => format!("[{}]", joined(&mut parts.iter().map(Self::to_text))).into(),
            Self::Object(_) => "[object Object]".into(),
            Self::Regex(regex) => format!("/{regex}/").into(),
        }
    }

    /// Returns true if type and value are equal, as `===`. Lists are compared by their elements.
    pub fn equals(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Undefined, Self::Undefined) | (Self::Null, Self::Null) => true,
            (Self::Bool(a), Self::Bool(b)) => a == b,
            (Self::Number(a), Self::Number(b)) => a == b,
            (Self::Text(a), Self::Text(b)) => a == b,
            (Self::Vector(a), Self::Vector(b)) => a == b,
            (Self::List(a), Self::List(b)) => a.len() == b.len() && a.iter().zip(b.iter()).all(|(a, b)| a.equals(b)),
            (Self::Regex(a), Self::Regex(b)) => a.as_str() == b.as_str(),
            (Self::Object(a), Self::Object(b)) => Arc::ptr_eq(a, b),
            _ => false,
        }
    }

    /// Returns the member of an object, the component of a vector or the element of a list; undefined if it is missing.
    pub fn member(&self, key: &Self) -> Self {
        let name = match key {
            Self::Text(name) => Some(&**name),
            _ => None,
        };
        let index = match (key, name) {
            (Self::Number(index), _) if *index >= 0.0 && index.fract() == 0.0 => Some(*index as usize),
            (_, Some(name)) => name.parse().ok(),
            _ => None,
        };
        let found = match self {
            Self::Vector(vector) => {
                let named = || ["x", "y", "z", "w"].iter().position(|part| Some(*part) == name);
                let colored = || ["r", "g", "b", "a"].iter().position(|part| Some(*part) == name);
                let at = index.or_else(named).or_else(colored);
                at.and_then(|at| vector.components().get(at).copied().map(Self::Number))
            }
            Self::List(parts) if name == Some("length") => Some(Self::Number(parts.len() as f64)),
            Self::Text(text) if name == Some("length") => Some(Self::Number(text.encode_utf16().count() as f64)),
            Self::List(parts) => index.and_then(|at| parts.get(at).cloned()),
            Self::Object(members) => {
                members.iter().find(|(member, _)| Some(&**member) == name).map(|(_, value)| value.clone())
            }
            _ => None,
        };
        found.unwrap_or(Self::Undefined)
    }
}

/// Combines two numbers, or the components of two vectors of one type.
pub(super) fn componentwise(left: &Value, right: &Value, f: impl Fn(f64, f64) -> f64) -> Value {
    match (left, right) {
        (Value::Number(a), Value::Number(b)) => Value::Number(f(*a, *b)),
        (Value::Vector(a), Value::Vector(b)) => Value::vector(Vector::zip(*a, *b, f)),
        _ => Value::Undefined,
    }
}

impl From<PropertyValue> for Value {
    /// Converts the value of a property. Two to four numbers become a vector.
    fn from(value: PropertyValue) -> Self {
        match value {
            PropertyValue::Null => Self::Null,
            PropertyValue::Bool(value) => Self::Bool(value),
            PropertyValue::Int(value) => Self::Number(value as f64),
            PropertyValue::UInt(value) => Self::Number(value as f64),
            PropertyValue::Float(value) => Self::Number(value),
            PropertyValue::Text(text) => Self::Text(text.into()),
            PropertyValue::List(parts) => {
                let numbers: Option<Vec<f64>> = match parts.len() {
                    2..=4 => parts.iter().map(PropertyValue::as_f64).collect(),
                    _ => None,
                };
                match numbers.and_then(|numbers| Vector::new(&numbers)) {
                    Some(vector) => Self::Vector(vector),
                    None => Self::List(parts.into_iter().map(Self::from).collect()),
                }
            }
            PropertyValue::Object(members) => {
                Self::Object(members.into_iter().map(|(name, value)| (name.into(), value.into())).collect())
            }
        }
    }
}

impl From<Value> for PropertyValue {
    fn from(value: Value) -> Self {
        match value {
            Value::Undefined | Value::Null => Self::Null,
            Value::Bool(value) => Self::Bool(value),
            Value::Number(value) => Self::Float(value),
            Value::Text(text) => Self::Text(text.as_ref().to_owned()),
            Value::Vector(vector) => Self::List(vector.components().iter().map(|part| Self::Float(*part)).collect()),
            Value::List(parts) => Self::List(parts.iter().cloned().map(Self::from).collect()),
            Value::Object(members) => Self::Object(
                members.iter().cloned().map(|(name, value)| (name.as_ref().to_owned(), value.into())).collect(),
            ),
            Value::Regex(_) => Self::Text(value.to_text().as_ref().to_owned()),
        }
    }
}
