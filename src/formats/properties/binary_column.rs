//! [`BinaryColumn`]: the values of a property in the binary layout of 3D Tiles Metadata.

use super::component::Component;
use super::property_type::{Element, Length, PropertyType};
use super::shared_bytes::SharedBytes;
use crate::scene::{PropertyColumn, PropertyValue};

/// The maximum number of elements of one value. Rows may overlap, so that a small file could have many long ones.
const MAX_ELEMENTS: usize = 1 << 20;

/// Positions in another list: entry `i` begins at offset `i` and ends at offset `i + 1`.
#[derive(Clone, Debug)]
pub(super) struct Offsets {
    pub component: Component,
    pub bytes: SharedBytes,
}

impl Offsets {
    /// Returns offset `i`; `None` beyond the end.
    fn get(&self, i: usize) -> Option<usize> {
        self.component.read_unsigned(&self.bytes, i)
    }

    fn range(&self, i: usize) -> Option<std::ops::Range<usize>> {
        let [begin, end] = [i, i.checked_add(1)?].map(|at| self.get(at));
        Some(begin?..end?).filter(|range| range.start <= range.end)
    }
}

/// A column as buffer views. Nothing in it is trusted: values beyond the end are absent.
#[derive(Clone, Debug)]
pub(super) struct BinaryColumn {
    pub kind: PropertyType,
    pub values: SharedBytes,
    /// The elements of rows of any length.
    pub array_offsets: Option<Offsets>,
    pub string_offsets: Option<Offsets>,
}

impl PropertyColumn for BinaryColumn {
    fn value(&self, row: usize) -> PropertyValue {
        let stored = match self.kind.length {
            Length::Single => self.element(row),
            Length::Fixed(count) => {
                row.checked_mul(count).and_then(|first| self.list(first..first.checked_add(count)?))
            }
            Length::Variable => {
                self.array_offsets.as_ref().and_then(|offsets| offsets.range(row)).and_then(|range| self.list(range))
            }
        };
        self.kind.value(stored)
    }

    fn size_bytes(&self) -> usize {
        let offsets = [&self.array_offsets, &self.string_offsets].into_iter().flatten();
        self.values.len() + offsets.map(|offsets| offsets.bytes.len()).sum::<usize>()
    }
}

impl BinaryColumn {
    /// Returns true if the buffer views have the values of all rows.
    pub fn has_rows(&self, rows: usize) -> bool {
        let elements = match self.kind.length {
            Length::Single => Some(rows),
            Length::Fixed(count) => rows.checked_mul(count),
            // The last offset is the number of elements. An empty table needs none.
            Length::Variable if rows == 0 => Some(0),
            Length::Variable => self.array_offsets.as_ref().and_then(|offsets| offsets.get(rows)),
        };
        elements.is_some_and(|elements| match &self.kind.element {
            _ if elements == 0 => true,
            Element::Text => {
                let bytes = self.string_offsets.as_ref().and_then(|offsets| offsets.get(elements));
                bytes.is_some_and(|bytes| bytes <= self.values.len())
            }
            element => element.stored_bytes(elements).is_some_and(|bytes| bytes <= self.values.len()),
        })
    }

    /// Returns stored elements; `None` if one of them lies beyond the end, and for more than [`MAX_ELEMENTS`].
    fn list(&self, elements: std::ops::Range<usize>) -> Option<PropertyValue> {
        // The smallest element is a bit; text may be empty, but has an offset of a byte.
        let most = self.values.len().saturating_mul(8) + self.string_offsets.as_ref().map_or(0, |of| of.bytes.len());
        if elements.len() > most.min(MAX_ELEMENTS) {
            return None;
        }
        elements.map(|i| self.element(i)).collect::<Option<_>>().map(PropertyValue::List)
    }

    /// Returns a stored element.
    fn element(&self, i: usize) -> Option<PropertyValue> {
        match &self.kind.element {
            Element::Text => {
                let bytes = self.values.get(self.string_offsets.as_ref()?.range(i)?)?;
                Some(PropertyValue::Text(String::from_utf8_lossy(bytes).into_owned()))
            }
            element => element.read(&self.values, i),
        }
    }
}
