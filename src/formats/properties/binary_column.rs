//! [`BinaryColumn`]: the values of a property in the binary layout of 3D Tiles Metadata.

use std::collections::BTreeMap;

use serde_json::Value;

use super::component::Component;
use crate::scene::{PropertyColumn, PropertyValue};

/// The type of one element.
#[derive(Clone, Debug)]
pub(super) enum Element {
    /// The components of a number, vector or matrix.
    Numbers { component: Component, components: usize },
    /// One bit each, lowest first.
    Bool,
    /// UTF-8, delimited by offsets.
    Text,
    /// Numbers with names.
    Enum { component: Component, names: BTreeMap<i64, String> },
}

/// Positions in another list: entry `i` begins at offset `i` and ends at offset `i + 1`.
#[derive(Clone, Debug)]
pub(super) struct Offsets {
    pub component: Component,
    pub bytes: Vec<u8>,
}

impl Offsets {
    fn range(&self, i: usize) -> Option<std::ops::Range<usize>> {
        let [begin, end] = [i, i.checked_add(1)?].map(|at| self.component.read_unsigned(&self.bytes, at));
        Some(begin?..end?).filter(|range| range.start <= range.end)
    }
}

/// How many elements a row has.
#[derive(Clone, Debug)]
pub(super) enum Rows {
    Single,
    Fixed(usize),
    Variable(Offsets),
}

/// A column as buffer views. Nothing in it is trusted: values beyond the end are [`PropertyValue::Null`].
#[derive(Clone, Debug)]
pub(super) struct BinaryColumn {
    pub element: Element,
    pub rows: Rows,
    pub values: Vec<u8>,
    pub string_offsets: Option<Offsets>,
    pub normalized: bool,
    /// Applied to floating-point and normalized numbers, by component; empty for none.
    pub scale: Vec<f64>,
    pub offset: Vec<f64>,
    /// The stored value that stands for none.
    pub no_data: Option<PropertyValue>,
    /// The value of rows without one.
    pub default: PropertyValue,
}

impl PropertyColumn for BinaryColumn {
    fn value(&self, row: usize) -> PropertyValue {
        let value = match &self.rows {
            Rows::Single => self.element(row),
            Rows::Fixed(count) => {
                row.checked_mul(*count).and_then(|first| self.list(first..first.checked_add(*count)?))
            }
            Rows::Variable(offsets) => offsets.range(row).and_then(|range| self.list(range)),
        };
        let value = value.filter(|value| Some(value) != self.no_data.as_ref());
        value.map_or_else(|| self.default.clone(), |value| self.transformed(value))
    }

    fn size_bytes(&self) -> usize {
        let offsets = |offsets: &Offsets| offsets.bytes.len();
        let rows = match &self.rows {
            Rows::Variable(of) => offsets(of),
            Rows::Single | Rows::Fixed(_) => 0,
        };
        self.values.len() + rows + self.string_offsets.as_ref().map_or(0, offsets)
    }
}

impl BinaryColumn {
    /// Returns stored elements; `None` if one of them lies beyond the end.
    fn list(&self, elements: std::ops::Range<usize>) -> Option<PropertyValue> {
        // The smallest element is a bit; text may be empty, but has an offset of a byte.
        let most = self.values.len().saturating_mul(8) + self.string_offsets.as_ref().map_or(0, |of| of.bytes.len());
        if elements.len() > most {
            return None;
        }
        elements.map(|i| self.element(i)).collect::<Option<_>>().map(PropertyValue::List)
    }

    /// Returns a stored element.
    fn element(&self, i: usize) -> Option<PropertyValue> {
        match &self.element {
            Element::Numbers { component, components: 1 } => component.read(&self.values, i),
            Element::Numbers { component, components } => {
                let first = i.checked_mul(*components)?;
                (0..*components)
                    .map(|c| component.read(&self.values, first.checked_add(c)?))
                    .collect::<Option<_>>()
                    .map(PropertyValue::List)
            }
            Element::Bool => {
                let byte = self.values.get(i / 8)?;
                Some(PropertyValue::Bool(byte >> (i % 8) & 1 == 1))
            }
            Element::Text => {
                let bytes = self.values.get(self.string_offsets.as_ref()?.range(i)?)?;
                Some(PropertyValue::Text(String::from_utf8_lossy(bytes).into_owned()))
            }
            Element::Enum { component, names } => {
                let value = component.read(&self.values, i)?;
                let number = match value {
                    PropertyValue::Int(number) => number,
                    PropertyValue::UInt(number) => i64::try_from(number).ok()?,
                    _ => return None,
                };
                Some(names.get(&number).map_or(value, |name| PropertyValue::Text(name.clone())))
            }
        }
    }

    /// Normalizes, scales and offsets the numbers of a value.
    fn transformed(&self, value: PropertyValue) -> PropertyValue {
        let Element::Numbers { component, .. } = &self.element else { return value };
        let one = component.one().filter(|_| self.normalized);
        let is_float = component.one().is_none();
        if !is_float && one.is_none() || is_float && self.scale.is_empty() && self.offset.is_empty() {
            return value;
        }
        self.transformed_part(value, one, 0)
    }

    fn transformed_part(&self, value: PropertyValue, one: Option<f64>, component: usize) -> PropertyValue {
        if let PropertyValue::List(parts) = value {
            let part = |(i, part)| self.transformed_part(part, one, i);
            return PropertyValue::List(parts.into_iter().enumerate().map(part).collect());
        }
        let Some(number) = value.as_f64() else { return value };
        let number = one.map_or(number, |one| (number / one).max(-1.0));
        // One number applies to all components.
        let of = |list: &[f64], none: f64| list.get(component).or(list.first()).copied().unwrap_or(none);
        PropertyValue::Float(number * of(&self.scale, 1.0) + of(&self.offset, 0.0))
    }
}

/// Returns the numbers of a JSON value: of a number, or of an array of any depth.
pub(super) fn numbers(value: Option<&Value>) -> Vec<f64> {
    match value {
        Some(Value::Array(parts)) => parts.iter().flat_map(|part| numbers(Some(part))).collect(),
        Some(number) => number.as_f64().into_iter().collect(),
        None => Vec::new(),
    }
}

/// Converts a JSON value. `element` decides between signed and unsigned numbers.
pub(super) fn from_json(value: &Value, element: &Element) -> PropertyValue {
    match value {
        Value::Null => PropertyValue::Null,
        Value::Bool(value) => PropertyValue::Bool(*value),
        Value::String(text) => PropertyValue::Text(text.clone()),
        Value::Array(parts) => PropertyValue::List(parts.iter().map(|part| from_json(part, element)).collect()),
        Value::Object(members) => {
            let member = |(name, value): (&String, &Value)| (name.clone(), from_json(value, element));
            PropertyValue::Object(members.iter().map(member).collect())
        }
        Value::Number(number) => {
            use Component::{F32, F64, I8, I16, I32, I64};
            let float = number.as_f64().map_or(PropertyValue::Null, PropertyValue::Float);
            match element {
                Element::Numbers { component: F32, .. } => {
                    number.as_f64().map_or(PropertyValue::Null, |x| PropertyValue::Float(f64::from(x as f32)))
                }
                Element::Numbers { component: F64, .. } => float,
                Element::Numbers { component: I8 | I16 | I32 | I64, .. } => {
                    number.as_i64().map_or(float, PropertyValue::Int)
                }
                _ => match (number.as_u64(), number.as_i64()) {
                    (Some(number), _) => PropertyValue::UInt(number),
                    (None, Some(number)) => PropertyValue::Int(number),
                    (None, None) => float,
                },
            }
        }
    }
}
