//! Metadata of tiles that replaces what follows from implicit tiling: volumes, heights and errors. Decode threads.

use crate::formats::properties::{ClassProperty, NumberColumn, Schema, TableJson};

/// The part of a tile that a metadata property replaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Semantic {
    /// `TILE_BOUNDING_BOX`: 12 numbers.
    Box,
    /// `TILE_BOUNDING_REGION`: 6 numbers.
    Region,
    /// `TILE_BOUNDING_SPHERE`: 4 numbers.
    Sphere,
    /// `TILE_MINIMUM_HEIGHT`, metres.
    MinHeight,
    /// `TILE_MAXIMUM_HEIGHT`, metres.
    MaxHeight,
    /// `TILE_GEOMETRIC_ERROR`, metres before the scale of the tile.
    GeometricError,
}

impl Semantic {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "TILE_BOUNDING_BOX" => Self::Box,
            "TILE_BOUNDING_REGION" => Self::Region,
            "TILE_BOUNDING_SPHERE" => Self::Sphere,
            "TILE_MINIMUM_HEIGHT" => Self::MinHeight,
            "TILE_MAXIMUM_HEIGHT" => Self::MaxHeight,
            "TILE_GEOMETRIC_ERROR" => Self::GeometricError,
            _ => return None,
        })
    }

    fn components(self) -> usize {
        match self {
            Self::Box => 12,
            Self::Region => 6,
            Self::Sphere => 4,
            Self::MinHeight | Self::MaxHeight | Self::GeometricError => 1,
        }
    }
}

/// A property of a table that has a meaning for tiles: its meaning, its type, and the buffer view with its values.
pub(super) struct SemanticProperty<'a> {
    pub semantic: Semantic,
    pub view: usize,
    pub property: &'a ClassProperty,
}

/// Returns the properties of a table that have a meaning for tiles.
pub(super) fn properties<'a>(table: &'a TableJson, schema: &'a Schema) -> impl Iterator<Item = SemanticProperty<'a>> {
    let class = table.class.0.as_deref().and_then(|class| schema.classes.get(class));
    class.into_iter().flat_map(|class| &class.properties).filter_map(|(id, property)| {
        let semantic = property.semantic.0.as_deref().and_then(Semantic::named)?;
        let view = table.properties.get(id)?.values?;
        Some(SemanticProperty { semantic, view, property })
    })
}

/// Returns the column of a property whose values begin at a byte of a buffer; `None` if it has the wrong type.
pub(super) fn column(of: &SemanticProperty<'_>, buffer: usize, start: usize) -> Option<NumberColumn> {
    let column = NumberColumn::new(of.property, buffer, start)?;
    (column.components() == of.semantic.components()).then_some(column)
}

/// The values that a tile has instead of those that follow from its position.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Overrides {
    pub oriented_box: Option<[f64; 12]>,
    pub region: Option<[f64; 6]>,
    pub sphere: Option<[f64; 4]>,
    pub min_height_m: Option<f64>,
    pub max_height_m: Option<f64>,
    pub geometric_error: Option<f64>,
}

impl Overrides {
    /// Stores a value. Values that are not finite are left out.
    pub fn set(&mut self, semantic: Semantic, value: &[f64; 16]) {
        if !value[..semantic.components()].iter().all(|number| number.is_finite()) {
            return;
        }
        match semantic {
            Semantic::Box => self.oriented_box = value.first_chunk().copied(),
            Semantic::Region => self.region = value.first_chunk().copied(),
            Semantic::Sphere => self.sphere = value.first_chunk().copied(),
            Semantic::MinHeight => self.min_height_m = Some(value[0]),
            Semantic::MaxHeight => self.max_height_m = Some(value[0]),
            Semantic::GeometricError => self.geometric_error = Some(value[0]),
        }
    }
}
