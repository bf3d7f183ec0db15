//! Shapes of ShapeDrawables, and height fields. Decode threads.

use std::sync::Arc;

use glam::{DQuat, DVec3};

use super::arrays::ArrayObject;

/// A shape of a ShapeDrawable. Lengths in metres.
#[derive(Debug)]
pub(in crate::formats::osg) enum ShapeObject {
    Box {
        center: DVec3,
        half_lengths: DVec3,
        rotation: DQuat,
    },
    Sphere {
        center: DVec3,
        radius: f64,
    },
    /// Around the z axis before it is rotated.
    Round {
        profile: Profile,
        center: DVec3,
        radius: f64,
        height: f64,
        rotation: DQuat,
    },
    Composite(Vec<Arc<ShapeObject>>),
    Triangles {
        positions: Arc<ArrayObject>,
        indices: Arc<ArrayObject>,
    },
    HeightField(HeightFieldObject),
}

/// A grid of heights: `rows` rows from south to north, of `columns` heights from west to east.
#[derive(Debug)]
pub(in crate::formats::osg) struct HeightFieldObject {
    pub columns: usize,
    pub rows: usize,
    pub origin: DVec3,
    /// Metres between columns and between rows.
    pub interval: [f64; 2],
    pub skirt_height: f64,
    pub rotation: DQuat,
    /// A height for each column of each row, or more.
    pub heights: Arc<ArrayObject>,
}

impl HeightFieldObject {
    /// Returns a point of the surface.
    pub fn position(&self, column: usize, row: usize) -> DVec3 {
        let [dx, dy] = self.interval;
        let height = self.heights.get(row * self.columns + column, 0);
        self.origin + self.rotation * DVec3::new(dx * column as f64, dy * row as f64, height)
    }
}

/// The silhouette of a round shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats::osg) enum Profile {
    Cone,
    Cylinder,
    Capsule,
}
