//! The members of ShapeDrawable and of its shapes.

use std::sync::Arc;

use super::Reader;
use super::geometry::VERSION_OF_ARRAY_OBJECTS;
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::objects::{ArrayObject, DrawableClass, HeightFieldObject, Object, Profile, ShapeObject};

impl Reader<'_> {
    pub(super) fn shape_drawable(&mut self) -> Result<Object> {
        let drawable = self.drawable_members()?;
        let color = self.floats_member("Color", [1.0; 4])?;
        self.object_member("TessellationHints")?;
        let shape = match &drawable.shape {
            Object::Shape(shape) => Some(shape.clone()),
            _ => None,
        };
        Ok(drawable.with(DrawableClass::Shape { shape, color }))
    }

    /// Reads the members of a shape.
    pub(super) fn shape(&mut self, class: &str) -> Result<Object> {
        self.object_members()?;
        let shape = match class {
            "Box" => {
                let center = self.float_point_member("Center")?;
                let half_lengths = self.float_point_member("HalfLengths")?;
                ShapeObject::Box { center, half_lengths, rotation: self.rotation_member("Rotation")? }
            }
            "Sphere" => {
                let center = self.float_point_member("Center")?;
                ShapeObject::Sphere { center, radius: self.float_member("Radius", 0.0)?.into() }
            }
            "CompositeShape" => {
                self.object_member("Shape")?;
                let parts = if self.marked_member("Children")? { self.list(Self::object)? } else { Vec::new() };
                // Parts of parts would have to be bounded.
                let shape = |object| match object {
                    Object::Shape(shape) if !matches!(*shape, ShapeObject::Composite(_)) => Some(shape),
                    _ => None,
                };
                ShapeObject::Composite(parts.into_iter().filter_map(shape).collect())
            }
            "TriangleMesh" => {
                let [positions, indices] = [self.shape_array("Vertices")?, self.shape_array("Indices")?];
                match (positions, indices) {
                    (Some(positions), Some(indices)) => ShapeObject::Triangles { positions, indices },
                    _ => return Ok(Object::Nothing),
                }
            }
            "HeightField" => return self.height_field(),
            _ => {
                let profile = match class {
                    "Cone" => Profile::Cone,
                    "Cylinder" => Profile::Cylinder,
                    _ => Profile::Capsule,
                };
                let center = self.float_point_member("Center")?;
                let radius = self.float_member("Radius", 0.0)?.into();
                let height = self.float_member("Height", 0.0)?.into();
                ShapeObject::Round { profile, center, radius, height, rotation: self.rotation_member("Rotation")? }
            }
        };
        Ok(Object::Shape(Arc::new(shape)))
    }

    /// Reads an array of a TriangleMesh.
    fn shape_array(&mut self, name: &str) -> Result<Option<Arc<ArrayObject>>> {
        if !self.marked_member(name)? {
            return Ok(None);
        }
        if self.version < VERSION_OF_ARRAY_OBJECTS {
            return self.old_array().map(Some);
        }
        Ok(match self.object()? {
            Object::Array(array) => Some(array),
            _ => None,
        })
    }

    fn height_field(&mut self) -> Result<Object> {
        let [columns, rows] = match self.marked_member("Area")? {
            true => [self.unsigned()? as usize, self.unsigned()? as usize],
            false => [0; 2],
        };
        let origin = self.float_point_member("Origin")?;
        let interval = [self.float_member("XInterval", 0.0)?.into(), self.float_member("YInterval", 0.0)?.into()];
        let skirt_height = self.float_member("SkirtHeight", 0.0)?.into();
        self.unsigned_member("BorderWidth", 0)?;
        let rotation = self.rotation_member("Rotation")?;
        if !self.marked_member("Heights")? {
            return Ok(Object::Nothing);
        }
        let heights = self.old_array()?;
        if columns.checked_mul(rows).is_none_or(|count| count > heights.count()) {
            let reason = format!("a HeightField of {columns} x {rows} with {} heights", heights.count());
            return Err(OsgError::invalid(reason));
        }
        let field = HeightFieldObject { columns, rows, origin, interval, skirt_height, rotation, heights };
        Ok(Object::Shape(Arc::new(ShapeObject::HeightField(field))))
    }
}
