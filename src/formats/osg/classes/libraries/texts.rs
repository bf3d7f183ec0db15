//! The members of osgText's classes.

use crate::formats::osg::classes::Reader;
use crate::formats::osg::classes::geometry::VERSION_OF_ARRAY_OBJECTS;
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::{DrawableClass, Object};
use crate::formats::osg::text::{
    ALIGNMENTS, AXES, BACKDROPS, BOX_FILLED, BOX_OUTLINE, CROSS, FADING, GRADIENTS, LAYOUT_NAMES, LAYOUTS,
    LETTERS_ALONE, NO_BACKDROP, SCREEN, SIZE_MODES, SOLIDS, TextObject, rotation_of_axis, text_of_numbers,
};

/// The version since which the mode of drawing is a member like others.
const VERSION_OF_DRAW_MODES: u32 = 117;
/// The version since which a Text3D has a colour.
const VERSION_OF_COLORS: u32 = 68;

impl Reader<'_> {
    /// Reads the members of a Text, FadeText or Text3D.
    pub(super) fn text(&mut self, class: &str) -> Result<Object> {
        // The state set of a text has a program of OSG, which the engine's shader replaces.
        let notes = std::mem::take(&mut self.notes);
        let drawable = self.drawable_members()?;
        self.notes = notes;
        let mut text = TextObject::default();
        self.text_base(&mut text)?;
        if class == "osgText::Text3D" {
            self.float_member("CharacterDepth", 1.0)?;
            self.named_member("RenderMode", &[("PER_FACE", 0), ("PER_GLYPH", 1)], 1)?;
            if self.version >= VERSION_OF_COLORS {
                text.color = self.floats_member("Color", [1.0; 4])?;
            }
            self.notes.add(SOLIDS);
        } else {
            self.flat_text(&mut text)?;
            if class == "osgText::FadeText" {
                self.float_member("FadeSpeed", 0.0)?;
                self.notes.add(FADING);
            }
        }
        Ok(drawable.with(DrawableClass::Text(text)))
    }

    /// Reads the members of the class TextBase.
    fn text_base(&mut self, text: &mut TextObject) -> Result<()> {
        if self.marked_member("Font")? {
            self.input.quoted()?;
        }
        if self.marked_member("FontSize")? {
            self.unsigned()?;
            text.font_height_px = self.unsigned()?.into();
        }
        if self.marked_member("CharacterSize")? {
            [text.height, text.aspect] = self.floats()?.map(f64::from);
        }
        text.size_mode = self.named_member("CharacterSizeMode", SIZE_MODES, 0)?;
        text.max_width = self.float_member("MaximumWidth", 0.0)?.into();
        self.float_member("MaximumHeight", 0.0)?;
        text.line_spacing = self.float_member("LineSpacing", 0.0)?.into();
        if self.marked_member("Text")? {
            text.text = self.characters()?;
        }
        text.position = self.float_point_member("Position")?;
        text.alignment = self.named_member("Alignment", ALIGNMENTS, text.alignment)?;
        let axis = self.named_member("AxisAlignment", AXES, 0)?;
        // The rotation that the axis gave stands if the file has none.
        text.rotation = self.rotation_member_or("Rotation", rotation_of_axis(axis))?;
        text.faces_screen = self.boolean_member("AutoRotateToScreen", axis == SCREEN)?;
        if self.named_member("Layout", LAYOUT_NAMES, 0)? != 0 {
            self.notes.add(LAYOUTS);
        }
        text.draw_mode = self.draw_mode()?;
        text.box_margin = self.float_member("BoundingBoxMargin", 0.0)?.into();
        text.box_color = self.floats_member("BoundingBoxColor", text.box_color)?;
        Ok(())
    }

    /// Reads characters: bytes, or numbers where one is larger.
    fn characters(&mut self) -> Result<String> {
        if self.input.boolean()? {
            return self.input.quoted();
        }
        let array = match self.version >= VERSION_OF_ARRAY_OBJECTS {
            true => match self.object()? {
                Object::Array(array) => array,
                _ => return Ok(String::new()),
            },
            false => self.old_array()?,
        };
        Ok(text_of_numbers((0..array.count()).map(|at| array.get(at, 0))))
    }

    fn draw_mode(&mut self) -> Result<u32> {
        const MODES: [(&str, u32); 4] =
            [("TEXT", LETTERS_ALONE), ("BOUND", BOX_OUTLINE), ("FILLED", BOX_FILLED), ("ALIGNMENT", CROSS)];
        let follows = match self.version >= VERSION_OF_DRAW_MODES {
            true => self.member("DrawMode")?,
            false => self.marked_member("DrawMode")?,
        };
        match follows {
            false => Ok(LETTERS_ALONE),
            true if !self.input.is_text() => self.unsigned(),
            true => {
                let word = self.input.word()?;
                let named = |name: &&str| MODES.iter().find(|(known, _)| known == name).map(|(_, mode)| *mode);
                Ok(word.split('|').filter_map(|name| named(&name)).sum())
            }
        }
    }

    /// Reads the members of the class Text.
    fn flat_text(&mut self, text: &mut TextObject) -> Result<()> {
        text.color = self.floats_member("Color", text.color)?;
        text.backdrop.kind = self.named_member("BackdropType", BACKDROPS, NO_BACKDROP)?;
        // Versions differ in the names of the ways to draw it.
        if self.member("BackdropImplementation")? {
            match self.input.is_text() {
                true => self.input.word().map(drop)?,
                false => self.unsigned().map(drop)?,
            }
        }
        if self.marked_member("BackdropOffset")? {
            text.backdrop.offset = self.floats()?.map(f64::from);
        }
        text.backdrop.color = self.floats_member("BackdropColor", text.backdrop.color)?;
        if self.named_member("ColorGradientMode", &[("SOLID", 0), ("PER_CHARACTER", 1), ("OVERALL", 2)], 0)? != 0 {
            self.notes.add(GRADIENTS);
        }
        if self.marked_member("ColorGradientCorners")? {
            self.block(|reader| {
                for corner in ["TopLeft", "BottomLeft", "BottomRight", "TopRight"] {
                    reader.input.keyword(corner)?;
                    reader.doubles::<4>()?;
                }
                Ok(())
            })?;
        }
        Ok(())
    }
}
