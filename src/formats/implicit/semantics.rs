//! Metadata of tiles and contents that replaces what follows from implicit tiling: volumes, heights, errors, refinement and
//! transforms. Decode threads.
//!
//! The 3D Metadata Semantic Reference names the semantics.

use glam::{DAffine3, DMat3, DVec3};

use crate::formats::height::{CornerErrors, are_valid_errors};
use crate::formats::tile::{S2Cell, tile_transform};
use crate::math::{BoundingSphere, OrientedBox, Region, WGS84};
use crate::scene::{PropertyValue, Refine};

/// The semantic of the reference of a content.
pub(super) const CONTENT_URI: &str = "CONTENT_URI";
/// The semantic of the index of a content's group.
pub(super) const CONTENT_GROUP_ID: &str = "CONTENT_GROUP_ID";

/// The semantic of [`CornerErrors`], which height tiles have.
const CORNER_ERRORS: &str = "TERRANE_CORNER_ERRORS";

/// Returns true for a semantic of tiles or contents that is kept as metadata, but has no effect.
pub(super) fn is_without_effect(semantic: &str) -> bool {
    matches!(semantic, "TILE_HORIZON_OCCLUSION_POINT" | "CONTENT_HORIZON_OCCLUSION_POINT")
}

/// The part of a tile or of its content that a metadata property replaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Semantic {
    /// `TILE_BOUNDING_BOX` or `CONTENT_BOUNDING_BOX`: 12 numbers.
    Box,
    /// `TILE_BOUNDING_REGION` or `CONTENT_BOUNDING_REGION`: 6 numbers.
    Region,
    /// `TILE_BOUNDING_SPHERE` or `CONTENT_BOUNDING_SPHERE`: 4 numbers.
    Sphere,
    /// `TILE_BOUNDING_S2_CELL` or `CONTENT_BOUNDING_S2_CELL`: the 64-bit id.
    S2Cell,
    /// `TILE_MINIMUM_HEIGHT` or `CONTENT_MINIMUM_HEIGHT`, metres.
    MinHeight,
    /// `TILE_MAXIMUM_HEIGHT` or `CONTENT_MAXIMUM_HEIGHT`, metres.
    MaxHeight,
    /// `TILE_GEOMETRIC_ERROR`, metres before the scale of the tile.
    GeometricError,
    /// `TILE_REFINE`: 0 or ADD, 1 or REPLACE.
    Refine,
    /// `TILE_TRANSFORM`: 16 numbers, column by column.
    Transform,
    /// [`CORNER_ERRORS`]: 4 numbers, metres.
    CornerErrors,
}

impl Semantic {
    /// Returns the part of a tile that a semantic replaces.
    pub fn of_tile(name: &str) -> Option<Self> {
        match name {
            "TILE_GEOMETRIC_ERROR" => Some(Self::GeometricError),
            "TILE_REFINE" => Some(Self::Refine),
            "TILE_TRANSFORM" => Some(Self::Transform),
            CORNER_ERRORS => Some(Self::CornerErrors),
            _ => Self::of_volume(name.strip_prefix("TILE_")?),
        }
    }

    /// Returns the part of a content that a semantic replaces.
    pub fn of_content(name: &str) -> Option<Self> {
        Self::of_volume(name.strip_prefix("CONTENT_")?)
    }

    fn of_volume(name: &str) -> Option<Self> {
        Some(match name {
            "BOUNDING_BOX" => Self::Box,
            "BOUNDING_REGION" => Self::Region,
            "BOUNDING_SPHERE" => Self::Sphere,
            "BOUNDING_S2_CELL" => Self::S2Cell,
            "MINIMUM_HEIGHT" => Self::MinHeight,
            "MAXIMUM_HEIGHT" => Self::MaxHeight,
            _ => return None,
        })
    }
}

/// The values that a tile has instead of those that follow from its position.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Overrides {
    pub volume: VolumeOverrides,
    pub geometric_error: Option<f64>,
    /// Geometric errors at the corners of a height tile, in metres on the ground. The transform of the tile does not scale them.
    pub corner_errors_m: Option<CornerErrors>,
    pub refine: Option<Refine>,
    /// The transform to the frame of the tile above.
    pub transform: Option<DAffine3>,
    /// True if a value was invalid.
    pub has_invalid: bool,
}

/// The volume that a tile or a content has instead of the one that follows from the position of the tile.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct VolumeOverrides {
    /// The shape in the frame of the tile, or on the globe.
    pub shape: Option<Shape>,
    /// The lowest and the highest height of a shape on the globe, metres.
    pub min_height_m: Option<f64>,
    pub max_height_m: Option<f64>,
}

/// The shape of a volume.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    Box(OrientedBox),
    Region(Region),
    Sphere(BoundingSphere),
    /// Between the heights of the metadata, or those that follow from the position.
    S2(S2Cell),
}

impl Overrides {
    /// Stores a value. Values of the wrong type, and those that are not finite, are invalid and left out; null is as absent.
    pub fn set(&mut self, semantic: Semantic, value: &PropertyValue) {
        let volume = &mut self.volume;
        match semantic {
            // If there are several shapes, the first is taken: the specification leaves the choice.
            Semantic::Box => volume.shape = volume.shape.or(numbers(value).map(oriented_box)),
            Semantic::Region => volume.shape = volume.shape.or(numbers(value).map(region)),
            Semantic::Sphere => volume.shape = volume.shape.or(numbers(value).map(sphere)),
            Semantic::S2Cell => volume.shape = volume.shape.or(s2_cell(value)),
            Semantic::MinHeight => volume.min_height_m = number(value),
            Semantic::MaxHeight => volume.max_height_m = number(value),
            Semantic::GeometricError => self.geometric_error = number(value).filter(|error| *error >= 0.0),
            Semantic::CornerErrors => self.corner_errors_m = numbers(value).filter(are_valid_errors),
            Semantic::Transform => self.transform = numbers(value).as_ref().and_then(tile_transform),
            Semantic::Refine => {
                self.refine = match (value.as_f64(), value.as_str()) {
                    (Some(0.0), _) | (_, Some("ADD")) => Some(Refine::Add),
                    (Some(1.0), _) | (_, Some("REPLACE")) => Some(Refine::Replace),
                    _ => None,
                }
            }
        }
        let is_stored = match semantic {
            Semantic::Box | Semantic::Region | Semantic::Sphere | Semantic::S2Cell => volume.shape.is_some(),
            Semantic::MinHeight => volume.min_height_m.is_some(),
            Semantic::MaxHeight => volume.max_height_m.is_some(),
            Semantic::GeometricError => self.geometric_error.is_some(),
            Semantic::CornerErrors => self.corner_errors_m.is_some(),
            Semantic::Transform => self.transform.is_some(),
            Semantic::Refine => self.refine.is_some(),
        };
        self.has_invalid |= !is_stored && *value != PropertyValue::Null;
    }
}

impl VolumeOverrides {
    /// Returns the volume of a content of a tile that has this volume; `None` if the metadata of the content has none.
    pub fn of_content(&self, content: &Self) -> Option<Self> {
        let heights_m = [content.min_height_m, content.max_height_m];
        match content.shape {
            None if heights_m == [None; 2] => None,
            // The heights of the tile hold for the shape of the tile, and for a cell without heights.
            None | Some(Shape::S2(_)) => Some(Self {
                shape: content.shape.or(self.shape),
                min_height_m: content.min_height_m.or(self.min_height_m),
                max_height_m: content.max_height_m.or(self.max_height_m),
            }),
            Some(_) => Some(*content),
        }
    }
}

fn oriented_box([cx, cy, cz, axes @ ..]: [f64; 12]) -> Shape {
    let [x, y, z] = [0, 3, 6].map(|at| DVec3::from_slice(&axes[at..]));
    Shape::Box(OrientedBox { center: DVec3::new(cx, cy, cz), half_axes: DMat3::from_cols(x, y, z) })
}

/// The tiling replaces the ellipsoid by its own.
fn region([west, south, east, north, min_height_m, max_height_m]: [f64; 6]) -> Shape {
    Shape::Region(Region { west, south, east, north, min_height_m, max_height_m, ellipsoid: WGS84 })
}

fn sphere([x, y, z, radius_m]: [f64; 4]) -> Shape {
    Shape::Sphere(BoundingSphere::new(DVec3::new(x, y, z), radius_m.max(0.0)))
}

fn s2_cell(value: &PropertyValue) -> Option<Shape> {
    match value {
        PropertyValue::UInt(id) => S2Cell::from_id(*id).map(Shape::S2),
        _ => None,
    }
}

fn number(value: &PropertyValue) -> Option<f64> {
    value.as_f64().filter(|number| number.is_finite())
}

fn numbers<const N: usize>(value: &PropertyValue) -> Option<[f64; N]> {
    let numbers: [f64; N] = value.as_numbers()?.try_into().ok()?;
    numbers.iter().all(|number| number.is_finite()).then_some(numbers)
}
