//! [`Subject`]: what an expression is evaluated for.

use glam::DVec3;

use super::value::{Value, Vector};
use crate::scene::PropertyTable;

/// The values of a point that expressions may use beside its properties.
pub(super) struct Point {
    /// The position before the centre and the transforms of the tile apply.
    pub position: DVec3,
    /// The position in the frame of the whole set.
    pub absolute: DVec3,
    /// sRGB and alpha.
    pub color: [f64; 4],
    /// `None` if the points have no normals.
    pub normal: Option<DVec3>,
}

/// A feature or a point. The default has no properties.
#[derive(Clone, Copy, Default)]
pub(super) struct Subject<'a> {
    /// The table with the properties and the row of the feature.
    pub row: Option<(&'a PropertyTable, usize)>,
    pub point: Option<&'a Point>,
}

impl Subject<'_> {
    /// Returns the value of a variable; undefined if neither the point nor the table has it.
    pub fn variable(&self, name: &str) -> Value {
        if let Some(point) = self.point
            && let Some(value) = point.semantic(name)
        {
            return value;
        }
        let value = self.row.and_then(|(table, row)| table.value(name, row));
        value.map_or(Value::Undefined, Value::from)
    }
}

impl Point {
    /// The names of the semantics.
    pub const POSITION: &'static str = "POSITION";
    pub const ABSOLUTE: &'static str = "POSITION_ABSOLUTE";
    pub const COLOR: &'static str = "COLOR";
    pub const NORMAL: &'static str = "NORMAL";

    /// Returns the value of a semantic; `None` if there is no semantic with this name.
    fn semantic(&self, name: &str) -> Option<Value> {
        let vector = |vector: DVec3| Value::vector(Vector::new(&vector.to_array()));
        Some(match name {
            Self::POSITION => vector(self.position),
            Self::ABSOLUTE => vector(self.absolute),
            Self::COLOR => Value::vector(Vector::new(&self.color)),
            Self::NORMAL => self.normal.map_or(Value::Undefined, vector),
            _ => return None,
        })
    }
}
