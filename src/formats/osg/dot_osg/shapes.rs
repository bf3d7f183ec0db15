//! Shapes of an .osg file.

use std::sync::Arc;

use glam::DVec3;

use super::fields::{Block, rotation};
use super::terrain::height_field;
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::{Profile, ShapeObject};

/// Reads a shape; `None` if the class is none that is read.
pub(super) fn shape(class: &str, block: &Block<'_>) -> Result<Option<ShapeObject>> {
    let center = block.values("Center").map_or(DVec3::ZERO, DVec3::from_array);
    let size = |name| block.value(name).unwrap_or(1.0);
    let round = |profile| {
        let rotation = rotation(block, "Rotation");
        ShapeObject::Round { profile, center, radius: size("Radius"), height: size("Height"), rotation }
    };
    Ok(Some(match class {
        "Box" => {
            let half_lengths = block.values("HalfLengths").map_or(DVec3::ONE, DVec3::from_array);
            ShapeObject::Box { center, half_lengths, rotation: rotation(block, "Rotation") }
        }
        "Sphere" => ShapeObject::Sphere { center, radius: size("Radius") },
        "Cone" => round(Profile::Cone),
        "Cylinder" => round(Profile::Cylinder),
        "Capsule" => round(Profile::Capsule),
        "CompositeShape" => {
            let parts = block.fields.iter().filter_map(|field| Some((field.word(0), field.block.as_ref()?)));
            // Parts of parts would have to be bounded.
            let parts = parts.filter(|(class, _)| *class != "CompositeShape");
            let parts = parts.filter_map(|(class, block)| shape(class, block).transpose());
            ShapeObject::Composite(parts.map(|part| part.map(Arc::new)).collect::<Result<_>>()?)
        }
        "HeightField" | "Grid" => height_field(block)?,
        _ => return Ok(None),
    }))
}
