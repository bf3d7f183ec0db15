//! [`PropertyTable`]: the properties of all features of one kind, a row for each feature.

use std::fmt;

use super::property_value::PropertyValue;

/// The values of one property. Implementations of readers decode them on demand.
pub trait PropertyColumn: Send + Sync {
    /// Returns the value in a row; [`PropertyValue::Null`] if there is none.
    fn value(&self, row: usize) -> PropertyValue;
    /// Returns the bytes of memory that the column holds.
    fn size_bytes(&self) -> usize;
}

/// The name of a property, and what its class and its table say about it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PropertyInfo {
    /// The name.
    pub name: String,
    /// The meaning, such as `TILE_GEOMETRIC_ERROR`; empty if none is given.
    pub semantic: String,
    /// The lowest value; [`PropertyValue::Null`] if none is given. That of a table replaces that of the class.
    pub min: PropertyValue,
    /// The highest value; [`PropertyValue::Null`] if none is given.
    pub max: PropertyValue,
}

impl PropertyInfo {
    pub(super) fn size_bytes(&self) -> usize {
        size_of::<Self>() + self.name.len() + self.semantic.len()
    }
}

impl From<String> for PropertyInfo {
    /// Returns a property of which only the name is known.
    fn from(name: String) -> Self {
        Self { name, ..Self::default() }
    }
}

/// A property with its values.
pub(crate) type Column = (PropertyInfo, Box<dyn PropertyColumn>);

/// A table with a row for each feature and a column for each property.
pub struct PropertyTable {
    /// A name for people; may be empty.
    pub name: String,
    /// The class of its features in the schema; may be empty.
    pub class: String,
    /// The number of rows.
    pub row_count: usize,
    columns: Vec<Column>,
}

impl PropertyTable {
    /// Creates a table of columns.
    pub fn new(
        name: String,
        class: String,
        row_count: usize,
        columns: Vec<(PropertyInfo, Box<dyn PropertyColumn>)>,
    ) -> Self {
        Self { name, class, row_count, columns }
    }

    /// Returns the properties in the order of the columns.
    pub fn properties(&self) -> impl Iterator<Item = &PropertyInfo> {
        self.columns.iter().map(|(property, _)| property)
    }

    /// Returns the value of a property in a row; `None` if the table lacks the property or the row.
    pub fn value(&self, property: &str, row: usize) -> Option<PropertyValue> {
        self.value_at(self.properties().position(|known| known.name == property)?, row)
    }

    /// Returns the value of the property with a meaning, such as `NAME`, in a row; `None` if the table lacks the property or
    /// the row.
    pub fn value_by_semantic(&self, semantic: &str, row: usize) -> Option<PropertyValue> {
        self.value_at(self.properties().position(|known| known.semantic == semantic)?, row)
    }

    /// Returns the value in a column and a row; `None` if the table lacks one of them.
    pub(crate) fn value_at(&self, column: usize, row: usize) -> Option<PropertyValue> {
        let (_, column) = self.columns.get(column).filter(|_| row < self.row_count)?;
        Some(column.value(row))
    }

    /// Returns all properties in a row; none if the table lacks the row.
    pub fn row(&self, row: usize) -> Vec<(&str, PropertyValue)> {
        let columns = self.columns.iter().filter(|_| row < self.row_count);
        columns.map(|(property, column)| (property.name.as_str(), column.value(row))).collect()
    }

    /// Returns the bytes of memory that the columns hold.
    pub fn size_bytes(&self) -> usize {
        self.columns.iter().map(|(property, column)| property.size_bytes() + column.size_bytes()).sum()
    }
}

impl fmt::Debug for PropertyTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.properties().map(|property| property.name.as_str()).collect();
        write!(f, "PropertyTable({:?}, class {:?}, {} rows, {names:?})", self.name, self.class, self.row_count)
    }
}
