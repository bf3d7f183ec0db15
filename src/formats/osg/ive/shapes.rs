//! Shapes of ShapeDrawables, and height fields.

use std::sync::Arc;

use super::{Kind, Reader, ids};
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{Input as _, Number};
use crate::formats::osg::objects::{ArrayObject, HeightFieldObject, Object, Profile, ShapeObject};

impl Reader<'_> {
    /// Reads a shape.
    pub(super) fn shape(&mut self) -> Result<Object> {
        self.shared(Kind::Shape, Self::new_shape)
    }

    fn new_shape(&mut self) -> Result<Object> {
        let class = self.unsigned()?;
        self.object_members()?;
        let shape = match class {
            ids::SPHERE => ShapeObject::Sphere { center: self.point()?, radius: self.float()?.into() },
            ids::BOX => {
                let (center, half_lengths) = (self.point()?, self.point()?);
                ShapeObject::Box { center, half_lengths, rotation: self.rotation()? }
            }
            ids::CONE => self.round(Profile::Cone)?,
            ids::CYLINDER => self.round(Profile::Cylinder)?,
            ids::CAPSULE => self.round(Profile::Capsule)?,
            ids::HEIGHT_FIELD => {
                let field = self.height_field(|reader| {
                    let count = reader.count(4)?;
                    let values = reader.input.numbers(Number::F32, count)?;
                    Ok(Arc::new(ArrayObject { width: 1, values, binding: None, is_normalized: false }))
                })?;
                ShapeObject::HeightField(field)
            }
            _ => return Err(Self::unknown("a shape", class)),
        };
        Ok(Object::Shape(Arc::new(shape)))
    }

    fn round(&mut self, profile: Profile) -> Result<ShapeObject> {
        let center = self.point()?;
        let [radius, height] = self.floats()?.map(f64::from);
        Ok(ShapeObject::Round { profile, center, radius, height, rotation: self.rotation()? })
    }

    /// Reads the grid of a HeightField, whose heights `read` reads.
    pub(super) fn height_field(
        &mut self,
        read: impl FnOnce(&mut Self) -> Result<Arc<ArrayObject>>,
    ) -> Result<HeightFieldObject> {
        let [columns, rows] = self.integers()?.map(|count| count as usize);
        let origin = self.point()?;
        let interval = self.floats()?.map(f64::from);
        let rotation = self.rotation()?;
        let skirt_height = self.float()?.into();
        // The width of the border.
        self.unsigned()?;
        let heights = read(self)?;
        if columns.checked_mul(rows).is_none_or(|count| count > heights.count()) {
            let reason = format!("a HeightField of {columns} x {rows} with {} heights", heights.count());
            return Err(OsgError::invalid(reason));
        }
        Ok(HeightFieldObject { columns, rows, origin, interval, skirt_height, rotation, heights })
    }
}
