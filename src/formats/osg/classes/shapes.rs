//! The members of ShapeDrawable and of its shapes.

use std::sync::Arc;

use super::Reader;
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::{DrawableClass, Object, Profile, ShapeObject};

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
}
