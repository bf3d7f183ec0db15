//! Drawables.

use std::sync::Arc;

use super::{Kind, Reader, ids};
use crate::formats::osg::error::Result;
use crate::formats::osg::input::{Input as _, Number};
use crate::formats::osg::objects::{DrawableClass, DrawableObject, Object, StateObject};
use crate::formats::osg::text::{FADING, GRADIENTS, LAYOUTS, SOLIDS, TextObject, text_of_numbers};

/// The classes that OSG writes. Of others its writer reports an error and writes the number of the drawable alone.
const DRAWABLES: [u32; 5] = [ids::GEOMETRY, ids::SHAPE_DRAWABLE, ids::TEXT, ids::FADE_TEXT, ids::TEXT_3D];

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
        let class = self.class()?;
        if !DRAWABLES.contains(&class) {
            self.notes.add("OpenSceneGraph: a drawable that OSG's writer of .ive leaves out, such as particles");
            return Ok(Object::Nothing);
        }
        self.unsigned()?;
        match class {
            ids::GEOMETRY => {
                let drawable = self.drawable_members()?;
                Ok(drawable.with(DrawableClass::Geometry(self.geometry()?)))
            }
            ids::SHAPE_DRAWABLE => self.shape_drawable(),
            ids::FADE_TEXT => {
                self.expect(ids::TEXT)?;
                let text = self.text_members(class)?;
                // The speed of fading.
                self.float()?;
                Ok(text)
            }
            _ => self.text_members(class),
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

    /// Reads the members of a Text or Text3D.
    fn text_members(&mut self, class: u32) -> Result<Object> {
        let is_flat = class != ids::TEXT_3D;
        // The state set of a text has a program of OSG, which the engine's shader replaces.
        let notes = std::mem::take(&mut self.notes);
        let drawable = self.drawable_members()?;
        self.notes = notes;
        let mut text = TextObject::default();
        // The font and its resolution.
        self.string()?;
        self.unsigned()?;
        text.font_height_px = self.unsigned()?.into();
        [text.height, text.aspect] = self.floats()?.map(f64::from);
        text.size_mode = self.unsigned()?;
        // The maximum height follows.
        let [max_width, _] = self.floats::<2>()?;
        text.max_width = max_width.into();
        if self.version >= 20 {
            text.line_spacing = self.float()?.into();
        }
        text.alignment = self.unsigned()?;
        text.rotation = self.rotation()?;
        text.faces_screen = self.boolean()?;
        if self.unsigned()? != 0 {
            self.notes.add(LAYOUTS);
        }
        text.position = self.point()?;
        if is_flat {
            text.color = self.floats()?;
        }
        text.draw_mode = self.unsigned()?;
        if is_flat {
            if self.version >= 41 {
                text.box_margin = self.float()?.into();
                text.box_color = self.floats()?;
            }
            if self.version >= 28 {
                text.backdrop.kind = self.unsigned()?;
                text.backdrop.offset = self.floats()?.map(f64::from);
                text.backdrop.color = self.floats()?;
                // How OSG draws it.
                self.unsigned()?;
                if self.unsigned()? != 0 {
                    self.notes.add(GRADIENTS);
                }
                self.floats::<16>()?;
            }
        } else {
            // Depth and mode of rendering.
            self.integers::<2>()?;
            self.notes.add(SOLIDS);
        }
        if class == ids::FADE_TEXT {
            self.notes.add(FADING);
        }
        text.text = self.characters()?;
        Ok(drawable.with(DrawableClass::Text(text)))
    }

    /// Reads characters: bytes, or numbers where one is larger.
    fn characters(&mut self) -> Result<String> {
        if self.boolean()? {
            return self.string();
        }
        // Numbers of 32 bits, or bytes before version 18.
        let (number, width) = if self.version >= 18 { (Number::U32, 4) } else { (Number::U8, 1) };
        let count = self.count(width)?;
        let numbers = self.input.numbers(number, count)?;
        Ok(text_of_numbers((0..count).map(|at| numbers.get(at))))
    }
}
