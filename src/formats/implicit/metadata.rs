//! [`MetadataRows`]: the metadata of the tiles of a subtree, or of one content of its tiles. Immutable; decode threads.

use std::sync::Arc;

use super::availability::{Availability, Ranks};
use super::semantics::{Overrides, Semantic};
use crate::scene::{Metadata, MetadataClass, PropertyInfo, PropertyTable, PropertyValue};

/// Returns the part of a tile or of its content that a semantic replaces.
pub(super) type SemanticNamed = fn(&str) -> Option<Semantic>;

/// A property table with a row for each available element.
#[derive(Debug)]
pub(super) struct MetadataRows {
    table: PropertyTable,
    class: Arc<MetadataClass>,
    ranks: Ranks,
    /// The columns that replace what follows from the position of a tile.
    semantics: Vec<(Semantic, usize)>,
}

impl MetadataRows {
    /// Returns the rows of the available elements, whose semantics `named` knows; `None` if the table has no columns.
    pub fn new(table: PropertyTable, of: &Availability, named: SemanticNamed) -> Option<Self> {
        let properties: Vec<_> = table.properties().cloned().collect();
        if properties.is_empty() {
            return None;
        }
        let with_column = |(at, property): (usize, &PropertyInfo)| Some((named(&property.semantic)?, at));
        let semantics = properties.iter().enumerate().filter_map(with_column).collect();
        let class = Arc::new(MetadataClass { name: table.class.clone(), properties });
        Some(Self { table, class, ranks: Ranks::new(of), semantics })
    }

    /// Returns the row of an available element.
    pub fn row(&self, of: &Availability, index: u64) -> usize {
        self.ranks.row(of, index)
    }

    /// Returns the values of a row that replace what follows from the position of a tile.
    pub fn overrides(&self, row: usize) -> Overrides {
        let mut overrides = Overrides::default();
        for (semantic, column) in &self.semantics {
            if let Some(value) = self.table.value_at(*column, row) {
                overrides.set(*semantic, &value);
            }
        }
        overrides
    }

    /// Returns all values of a row; `None` if the table lacks the row.
    pub fn metadata(&self, row: usize) -> Option<Arc<Metadata>> {
        let values = (0..self.class.properties.len()).map(|column| self.table.value_at(column, row));
        Some(Arc::new(Metadata::new(self.class.clone(), values.collect::<Option<_>>()?)))
    }

    /// Returns the value of the property with a meaning.
    pub fn value(&self, semantic: &str, row: usize) -> Option<PropertyValue> {
        self.table.value_by_semantic(semantic, row)
    }

    /// Returns the bytes of CPU memory without the columns, which are parts of the subtree's buffers.
    pub fn size_bytes(&self) -> u64 {
        self.ranks.size_bytes()
    }
}
