//! [`PropertyType`]: how stored values of a property become values. Plain values; any thread.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde_json::Value;

use super::component::Component;
use super::schema::{ClassProperty, Schema, ValueChanges};
use crate::scene::{PropertyInfo, PropertyValue, ValueDecoder};

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
    Enum { component: Component, names: Arc<BTreeMap<i64, String>> },
}

/// The number of elements of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Length {
    /// The value is no array.
    Single,
    /// An array of this many elements.
    Fixed(usize),
    /// An array of any length.
    Variable,
}

/// The type of a property, and the conversion from stored values.
#[derive(Clone, Debug)]
pub(in crate::formats) struct PropertyType {
    pub(super) element: Element,
    pub(super) length: Length,
    normalized: bool,
    /// Applied to floating-point and normalized numbers, by component; empty for none.
    scale: Vec<f64>,
    offset: Vec<f64>,
    /// The stored value that stands for none.
    no_data: Option<PropertyValue>,
    /// The value where there is none.
    default: PropertyValue,
}

impl PropertyType {
    /// Returns the type of values that are used as they are stored.
    pub(super) fn plain(element: Element) -> Self {
        Self {
            element,
            length: Length::Single,
            normalized: false,
            scale: Vec::new(),
            offset: Vec::new(),
            no_data: None,
            default: PropertyValue::Null,
        }
    }

    /// Returns the type of a property of a class, as `changes` of a table modify it. Returns `None` if it is invalid.
    pub fn new(of: &ClassProperty, schema: &Schema, changes: &ValueChanges) -> Option<Self> {
        let element = element(of, schema)?;
        let length = match (of.array, of.count) {
            (false, _) => Length::Single,
            (true, Some(count)) => Length::Fixed(count),
            (true, None) => Length::Variable,
        };
        let own = &of.values;
        Some(Self {
            length,
            normalized: of.normalized,
            scale: numbers(changes.scale.as_ref().or(own.scale.as_ref())),
            offset: numbers(changes.offset.as_ref().or(own.offset.as_ref())),
            no_data: of.no_data.as_ref().map(|value| from_json(value, &element)),
            default: of.default.as_ref().map_or(PropertyValue::Null, |value| from_json(value, &element)),
            element,
        })
    }

    /// Returns name, semantic and range of a property with this type.
    pub fn info(&self, name: &str, of: &ClassProperty, changes: &ValueChanges) -> PropertyInfo {
        // The range is of values after scale and offset.
        let bound = |own: &Option<Value>, changed: &Option<Value>| {
            let bound = changed.as_ref().or(own.as_ref());
            bound.map_or(PropertyValue::Null, |bound| from_json(bound, &self.element))
        };
        PropertyInfo {
            name: name.to_owned(),
            semantic: of.semantic.0.clone().unwrap_or_default(),
            min: bound(&of.values.min, &changes.min),
            max: bound(&of.values.max, &changes.max),
        }
    }

    /// Returns the size of a value in bytes; `None` for bits, text, and arrays of any length.
    pub fn size_bytes(&self) -> Option<usize> {
        let element = self.element.size_bytes()?;
        match self.length {
            Length::Single => Some(element),
            Length::Fixed(count) => element.checked_mul(count),
            Length::Variable => None,
        }
    }

    /// Returns true if values are numbers of the type with a name, such as `UINT8`.
    pub fn has_component(&self, name: &str) -> bool {
        let (Element::Numbers { component, .. } | Element::Enum { component, .. }) = &self.element else {
            return false;
        };
        Component::from_name(name) == Some(*component)
    }

    /// Converts a stored value, or its absence.
    pub(super) fn value(&self, stored: Option<PropertyValue>) -> PropertyValue {
        let stored = stored.filter(|stored| *stored != PropertyValue::Null && Some(stored) != self.no_data.as_ref());
        stored.map_or_else(|| self.default.clone(), |stored| self.transformed(stored))
    }

    /// Converts a value in JSON, or its absence.
    pub(super) fn value_of_json(&self, json: Option<&Value>) -> PropertyValue {
        self.value(json.map(|json| from_json(json, &self.element)))
    }

    /// Normalizes, scales and offsets the numbers of a value.
    fn transformed(&self, value: PropertyValue) -> PropertyValue {
        let Element::Numbers { component, components } = self.element else { return value };
        let one = component.one().filter(|_| self.normalized);
        let is_float = component.one().is_none();
        if !is_float && one.is_none() || is_float && self.scale.is_empty() && self.offset.is_empty() {
            return value;
        }
        let mut at = 0;
        self.transformed_part(value, one, components, &mut at)
    }

    /// Converts a number, or the numbers of lists. `at` counts the numbers so far.
    fn transformed_part(
        &self,
        value: PropertyValue,
        one: Option<f64>,
        components: usize,
        at: &mut usize,
    ) -> PropertyValue {
        if let PropertyValue::List(parts) = value {
            let parts = parts.into_iter().map(|part| self.transformed_part(part, one, components, at));
            return PropertyValue::List(parts.collect());
        }
        let Some(number) = value.as_f64() else { return value };
        let number = one.map_or(number, |one| (number / one).max(-1.0));
        let factor = |list: &[f64], none: f64| {
            // One number applies to all, one element to all elements of an array.
            let known = list.get(*at).or_else(|| list.get(*at % components)).or(list.first());
            known.copied().unwrap_or(none)
        };
        let number = number * factor(&self.scale, 1.0) + factor(&self.offset, 0.0);
        *at += 1;
        PropertyValue::Float(number)
    }
}

impl ValueDecoder for PropertyType {
    fn value(&self, bytes: &[u8]) -> PropertyValue {
        let stored = match self.length {
            Length::Single => self.element.read(bytes, 0),
            // Every element has a byte.
            Length::Fixed(count) if count <= bytes.len() => {
                (0..count).map(|i| self.element.read(bytes, i)).collect::<Option<_>>().map(PropertyValue::List)
            }
            Length::Fixed(_) | Length::Variable => None,
        };
        Self::value(self, stored)
    }
}

impl Element {
    /// Returns the size of an element in bytes; `None` for bits and text.
    fn size_bytes(&self) -> Option<usize> {
        match self {
            Self::Numbers { component, components } => Some(component.size_bytes() * components),
            Self::Enum { component, .. } => Some(component.size_bytes()),
            Self::Bool | Self::Text => None,
        }
    }

    /// Returns the bytes of `count` elements without gaps; `None` for text, and if they are too many.
    pub fn stored_bytes(&self, count: usize) -> Option<usize> {
        match self {
            Self::Bool => Some(count.div_ceil(8)),
            element => element.size_bytes()?.checked_mul(count),
        }
    }

    /// Returns element `i` of elements without gaps; `None` beyond the end, and for text.
    pub fn read(&self, bytes: &[u8], i: usize) -> Option<PropertyValue> {
        match self {
            Self::Numbers { component, components: 1 } => component.read(bytes, i),
            Self::Numbers { component, components } => {
                let first = i.checked_mul(*components)?;
                (0..*components)
                    .map(|c| component.read(bytes, first.checked_add(c)?))
                    .collect::<Option<_>>()
                    .map(PropertyValue::List)
            }
            Self::Bool => {
                let byte = bytes.get(i / 8)?;
                Some(PropertyValue::Bool(byte >> (i % 8) & 1 == 1))
            }
            Self::Text => None,
            Self::Enum { component, names } => {
                let value = component.read(bytes, i)?;
                let number = match value {
                    PropertyValue::Int(number) => number,
                    PropertyValue::UInt(number) => i64::try_from(number).ok()?,
                    _ => return None,
                };
                Some(names.get(&number).map_or(value, |name| PropertyValue::Text(name.clone())))
            }
        }
    }
}

fn element(of: &ClassProperty, schema: &Schema) -> Option<Element> {
    match of.kind.0.as_deref()? {
        "BOOLEAN" => Some(Element::Bool),
        "STRING" => Some(Element::Text),
        "ENUM" => {
            let values = schema.enums.get(of.enum_type.0.as_deref()?)?;
            let component = Component::from_name(values.value_type.0.as_deref().unwrap_or("UINT16"))?;
            Some(Element::Enum { component, names: values.values.clone() })
        }
        _ => {
            let component = Component::from_name(of.component_type.0.as_deref()?)?;
            Some(Element::Numbers { component, components: of.components()? })
        }
    }
}

/// Returns the numbers of a JSON value: of a number, or of an array of any depth.
fn numbers(value: Option<&Value>) -> Vec<f64> {
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
            // Some writers add a fraction to integers, as in 255.0.
            let whole = || number.as_f64().filter(|x| x.fract() == 0.0 && x.abs() < 2f64.powi(53)).map(|x| x as i64);
            match element {
                Element::Numbers { component: F32, .. } => {
                    number.as_f64().map_or(PropertyValue::Null, |x| PropertyValue::Float(f64::from(x as f32)))
                }
                Element::Numbers { component: F64, .. } => float,
                Element::Numbers { component: I8 | I16 | I32 | I64, .. } => {
                    number.as_i64().or_else(whole).map_or(float, PropertyValue::Int)
                }
                Element::Numbers { .. } | Element::Enum { .. } => {
                    let whole = || u64::try_from(whole()?).ok();
                    number.as_u64().or_else(whole).map_or(float, PropertyValue::UInt)
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
