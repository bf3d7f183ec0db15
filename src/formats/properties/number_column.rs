//! [`NumberColumn`]: a column of numbers in a property table. Plain values; decode threads.

use serde_json::Value;

use super::component::Component;
use super::schema::ClassProperty;
use crate::scene::PropertyValue;

/// The maximum number of components of a value.
pub(in crate::formats) const MAX_COMPONENTS: usize = 16;

/// The location of the values of a property with a fixed number of components.
#[derive(Clone, Debug)]
pub(in crate::formats) struct NumberColumn {
    /// The buffer, by the numbering of the caller.
    buffer: usize,
    /// The byte of the first value.
    start: usize,
    component: Component,
    /// The number of components of a value.
    count: usize,
    normalized: bool,
    /// A factor of the values, by component.
    scale: [f64; MAX_COMPONENTS],
    /// A number that is added after the factor, by component.
    offset: [f64; MAX_COMPONENTS],
}

impl NumberColumn {
    /// Returns the column of a property; `None` if its values are no numbers, or not all of the same length.
    pub fn new(property: &ClassProperty, buffer: usize, start: usize) -> Option<Self> {
        let elements = if property.array { property.count? } else { 1 };
        let count = property.components()?.checked_mul(elements)?;
        if count > MAX_COMPONENTS {
            return None;
        }
        let component = Component::from_name(property.component_type.0.as_deref()?)?;
        let (mut scale, mut offset) = ([1.0; MAX_COMPONENTS], [0.0; MAX_COMPONENTS]);
        numbers(property.scale.as_ref(), &mut scale);
        numbers(property.offset.as_ref(), &mut offset);
        Some(Self { buffer, start, component, count, normalized: property.normalized, scale, offset })
    }

    /// Returns the number of components of a value.
    pub fn components(&self) -> usize {
        self.count
    }

    /// Returns the buffer that the values are in.
    pub fn buffer(&self) -> usize {
        self.buffer
    }

    /// Returns the value of a row in the column's buffer; `None` beyond the end. The components after those of the value
    /// are 0.
    pub fn value(&self, buffer: &[u8], row: u64) -> Option<[f64; MAX_COMPONENTS]> {
        let size = self.component.size_bytes();
        let at = usize::try_from(row).ok()?.checked_mul(self.count * size)?.checked_add(self.start)?;
        let bytes = buffer.get(at..at.checked_add(self.count * size)?)?;
        let mut value = [0.0; MAX_COMPONENTS];
        for (i, value) in value.iter_mut().enumerate().take(self.count) {
            *value = self.number(bytes, i)? * self.scale[i] + self.offset[i];
        }
        Some(value)
    }

    /// Returns a component of a value, without scale and offset.
    fn number(&self, bytes: &[u8], i: usize) -> Option<f64> {
        let number = match self.component.read(bytes, i)? {
            PropertyValue::Int(number) => number as f64,
            PropertyValue::UInt(number) => number as f64,
            PropertyValue::Float(number) => number,
            _ => return None,
        };
        let one = self.component.one().filter(|_| self.normalized);
        Some(one.map_or(number, |one| (number / one).max(-1.0)))
    }
}

/// Copies a number or a list of numbers.
fn numbers(json: Option<&Value>, to: &mut [f64; MAX_COMPONENTS]) {
    let mut flat = Vec::new();
    flatten(json.unwrap_or(&Value::Null), &mut flat);
    to.iter_mut().zip(flat).for_each(|(to, number)| *to = number);
}

/// Collects the numbers of nested lists: vectors in arrays are lists of lists.
fn flatten(json: &Value, flat: &mut Vec<f64>) {
    match json {
        Value::Array(list) => list.iter().take(MAX_COMPONENTS).for_each(|element| flatten(element, flat)),
        other => flat.extend(other.as_f64()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(json: &str) -> Option<NumberColumn> {
        NumberColumn::new(&serde_json::from_str(json).unwrap(), 0, 2)
    }

    #[test]
    fn numbers_of_all_shapes_are_read() {
        let bytes: Vec<u8> = (0..200).collect();
        let heights = column(r#"{"type":"SCALAR","componentType":"INT16"}"#).unwrap();
        assert_eq!(heights.value(&bytes, 1).unwrap()[0], f64::from(i16::from_le_bytes([4, 5])));
        let scaled =
            column(r#"{"type":"VEC2","componentType":"UINT8","normalized":true,"scale":[255,510],"offset":[1,2]}"#);
        assert_eq!(scaled.unwrap().value(&bytes, 3).unwrap()[..3], [9.0, 20.0, 0.0]);
        let boxes = column(r#"{"type":"SCALAR","array":true,"count":12,"componentType":"FLOAT64"}"#).unwrap();
        assert_eq!(boxes.components(), 12);
        assert!(boxes.value(&bytes, 0).is_some() && boxes.value(&bytes, 2).is_none());
        assert!(boxes.value(&bytes, u64::MAX).is_none());
        for other in [
            r#"{"type":"STRING"}"#,
            r#"{"type":"SCALAR","componentType":"FLOAT16"}"#,
            r#"{"type":"SCALAR","array":true,"componentType":"UINT8"}"#,
            r#"{"type":"MAT4","array":true,"count":2,"componentType":"UINT8"}"#,
            "{}",
        ] {
            assert!(column(other).is_none(), "{other}");
        }
    }
}
