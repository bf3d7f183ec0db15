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

/// A table with a row for each feature and a column for each property.
pub struct PropertyTable {
    /// A name for people; may be empty.
    pub name: String,
    /// The class of its features in the schema; may be empty.
    pub class: String,
    /// The number of rows.
    pub row_count: usize,
    columns: Vec<(String, Box<dyn PropertyColumn>)>,
}

impl PropertyTable {
    /// Creates a table of columns with their names.
    pub fn new(name: String, class: String, row_count: usize, columns: Vec<(String, Box<dyn PropertyColumn>)>) -> Self {
        Self { name, class, row_count, columns }
    }

    /// Returns the names of the properties.
    pub fn property_names(&self) -> impl Iterator<Item = &str> {
        self.columns.iter().map(|(name, _)| name.as_str())
    }

    /// Returns the value of a property in a row; `None` if the table lacks the property or the row.
    pub fn value(&self, property: &str, row: usize) -> Option<PropertyValue> {
        let (_, column) = self.columns.iter().find(|(name, _)| name == property).filter(|_| row < self.row_count)?;
        Some(column.value(row))
    }

    /// Returns all properties in a row; none if the table lacks the row.
    pub fn row(&self, row: usize) -> Vec<(&str, PropertyValue)> {
        let columns = self.columns.iter().filter(|_| row < self.row_count);
        columns.map(|(name, column)| (name.as_str(), column.value(row))).collect()
    }

    /// Returns the bytes of memory that the columns hold.
    pub fn size_bytes(&self) -> usize {
        self.columns.iter().map(|(name, column)| name.len() + column.size_bytes()).sum()
    }
}

impl fmt::Debug for PropertyTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.property_names().collect();
        write!(f, "PropertyTable({:?}, class {:?}, {} rows, {names:?})", self.name, self.class, self.row_count)
    }
}
