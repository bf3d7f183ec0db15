//! Drawables.

use std::sync::Arc;

use super::{Kind, Reader, ids};
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::{DrawableClass, DrawableObject, Object, StateObject};

/// The members that all drawables have.
struct DrawableMembers {
    name: String,
    state: Option<Arc<StateObject>>,
}

impl DrawableMembers {
    /// Returns the drawable with the members of its class.
    fn with(self, class: DrawableClass) -> Object {
        let Self { name, state } = self;
        Object::Drawable(Arc::new(DrawableObject { name, mask: u32::MAX, state, class }))
    }
}

impl Reader<'_> {
    /// Reads a drawable.
    pub(super) fn drawable(&mut self) -> Result<Object> {
        self.shared(Kind::Drawable, Self::new_drawable)
    }

    fn new_drawable(&mut self) -> Result<Object> {
        let class = self.unsigned()?;
        match class {
            ids::GEOMETRY => {
                let drawable = self.drawable_members()?;
                Ok(drawable.with(DrawableClass::Geometry(self.geometry()?)))
            }
            ids::SHAPE_DRAWABLE => self.shape_drawable(),
            ids::TEXT => self.text_members(class),
            ids::FADE_TEXT => {
                self.expect(ids::TEXT)?;
                let text = self.text_members(class)?;
                // The speed of fading.
                self.float()?;
                Ok(text)
            }
            ids::TEXT_3D => self.text_members(class),
            _ => Err(Self::unknown("a drawable", class)),
        }
    }

    /// Reads the members of the classes Object and Drawable.
    fn drawable_members(&mut self) -> Result<DrawableMembers> {
        self.expect(ids::DRAWABLE)?;
        let name = self.object_members()?;
        let state = self.optional_state_set()?;
        self.optional(Self::cluster_culling)?;
        if self.version >= 10 {
            // The initial bound.
            self.optional(Self::floats::<6>)?;
        }
        // Display lists and buffers.
        self.skip(3)?;
        Ok(DrawableMembers { name, state })
    }

    fn shape_drawable(&mut self) -> Result<Object> {
        let drawable = match self.version >= 4 {
            true => self.drawable_members()?,
            false => DrawableMembers { name: self.object_members()?, state: None },
        };
        let color = self.floats()?;
        let shape = match self.optional(Self::shape)? {
            Some(Object::Shape(shape)) => Some(shape),
            _ => None,
        };
        Ok(drawable.with(DrawableClass::Shape { shape, color }))
    }

    /// Reads over the members of a Text or Text3D.
    fn text_members(&mut self, class: u32) -> Result<Object> {
        let is_flat = class != ids::TEXT_3D;
        self.drawable_members()?;
        // The font with its resolution; size, aspect, size mode, and the maximum width and height.
        self.string()?;
        self.integers::<7>()?;
        if self.version >= 20 {
            // The spacing of lines.
            self.float()?;
        }
        // Alignment, rotation, whether it turns to the screen, layout and position.
        self.unsigned()?;
        self.floats::<4>()?;
        self.boolean()?;
        self.unsigned()?;
        self.floats::<3>()?;
        if is_flat {
            // The colour.
            self.floats::<4>()?;
        }
        // The mode of drawing.
        self.unsigned()?;
        if is_flat {
            if self.version >= 41 {
                // The box around it.
                self.floats::<5>()?;
            }
            if self.version >= 28 {
                // Backdrop and gradient of colours.
                self.integers::<7>()?;
                self.integers::<18>()?;
            }
        } else {
            // Depth and mode of rendering.
            self.integers::<2>()?;
        }
        if self.boolean()? {
            self.string()?;
        } else {
            // Characters of 32 bits, or bytes before version 18.
            let width = if self.version >= 18 { 4 } else { 1 };
            let count = self.count(width)?;
            self.skip(count * width)?;
        }
        self.note_class(class);
        Ok(Object::Nothing)
    }
}
