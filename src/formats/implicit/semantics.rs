//! Metadata of tiles that replaces what follows from implicit tiling: volumes, heights, errors and refinement. Decode threads.
//!
//! The 3D Metadata Semantic Reference names the semantics.

use crate::scene::{PropertyValue, Refine};

/// The semantic of the reference of a content.
pub(super) const CONTENT_URI: &str = "CONTENT_URI";
/// The semantic of the index of a content's group.
pub(super) const CONTENT_GROUP_ID: &str = "CONTENT_GROUP_ID";

/// Semantics of tiles and contents that are kept as metadata, but have no effect.
const WITHOUT_EFFECT: [&str; 10] = [
    "TILE_BOUNDING_S2_CELL",
    "TILE_HORIZON_OCCLUSION_POINT",
    "TILE_TRANSFORM",
    "CONTENT_BOUNDING_BOX",
    "CONTENT_BOUNDING_REGION",
    "CONTENT_BOUNDING_S2_CELL",
    "CONTENT_BOUNDING_SPHERE",
    "CONTENT_HORIZON_OCCLUSION_POINT",
    "CONTENT_MAXIMUM_HEIGHT",
    "CONTENT_MINIMUM_HEIGHT",
];

/// Returns true for a semantic of tiles or contents that has no effect.
pub(super) fn is_without_effect(semantic: &str) -> bool {
    WITHOUT_EFFECT.contains(&semantic)
}

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
    /// `TILE_REFINE`: 0 or ADD, 1 or REPLACE.
    Refine,
}

impl Semantic {
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "TILE_BOUNDING_BOX" => Self::Box,
            "TILE_BOUNDING_REGION" => Self::Region,
            "TILE_BOUNDING_SPHERE" => Self::Sphere,
            "TILE_MINIMUM_HEIGHT" => Self::MinHeight,
            "TILE_MAXIMUM_HEIGHT" => Self::MaxHeight,
            "TILE_GEOMETRIC_ERROR" => Self::GeometricError,
            "TILE_REFINE" => Self::Refine,
            _ => return None,
        })
    }
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
    pub refine: Option<Refine>,
}

impl Overrides {
    /// Stores a value. Values of the wrong type, and those that are not finite, are left out.
    pub fn set(&mut self, semantic: Semantic, value: &PropertyValue) {
        match semantic {
            Semantic::Box => self.oriented_box = numbers(value),
            Semantic::Region => self.region = numbers(value),
            Semantic::Sphere => self.sphere = numbers(value),
            Semantic::MinHeight => self.min_height_m = number(value),
            Semantic::MaxHeight => self.max_height_m = number(value),
            Semantic::GeometricError => self.geometric_error = number(value),
            Semantic::Refine => {
                self.refine = match (value.as_f64(), value.as_str()) {
                    (Some(0.0), _) | (_, Some("ADD")) => Some(Refine::Add),
                    (Some(1.0), _) | (_, Some("REPLACE")) => Some(Refine::Replace),
                    _ => None,
                }
            }
        }
    }
}

fn number(value: &PropertyValue) -> Option<f64> {
    value.as_f64().filter(|number| number.is_finite())
}

fn numbers<const N: usize>(value: &PropertyValue) -> Option<[f64; N]> {
    let numbers: [f64; N] = value.as_numbers()?.try_into().ok()?;
    numbers.iter().all(|number| number.is_finite()).then_some(numbers)
}
