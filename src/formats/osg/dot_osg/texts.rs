//! Texts of an .osg file.

use glam::DVec3;

use super::Reader;
use super::fields::{Block, rotation};
use crate::formats::osg::input::value_of;
use crate::formats::osg::text::{
    ALIGNMENTS, AXES, BACKDROPS, FADING, GRADIENTS, LAYOUTS, LETTERS_ALONE, NO_BACKDROP, SCREEN, SIZE_MODES, SOLIDS,
    TextObject, rotation_of_axis, text_of_numbers,
};

impl Reader {
    /// Reads the members of a Text, FadeText or Text3D.
    pub(super) fn text(&mut self, class: &str, block: &Block<'_>) -> TextObject {
        let mut text = TextObject::default();
        let resolution = block.values("fontResolution").or(block.values("fontSize"));
        if let Some([_, height_px]) = resolution.filter(|[_, height_px]: &[f64; 2]| height_px.is_finite()) {
            text.font_height_px = height_px;
        }
        if let Some([height, aspect]) = block.values("characterSize") {
            (text.height, text.aspect) = (height, aspect);
        }
        text.size_mode = value_of(SIZE_MODES, block.word("characterSizeMode")).unwrap_or(0);
        if block.word("autoScaleToLimitScreenSizeToFontResolution") == "TRUE" {
            text.size_mode = 1;
        }
        text.max_width = block.value("maximumWidth").unwrap_or(0.0);
        text.line_spacing = block.value("lineSpacing").unwrap_or(0.0);
        text.alignment = value_of(ALIGNMENTS, block.word("alignment")).unwrap_or(text.alignment);
        let axis = value_of(AXES, block.word("axisAlignment")).unwrap_or(0);
        let has_rotation = block.field("rotation").is_some();
        text.rotation = if has_rotation { rotation(block, "rotation") } else { rotation_of_axis(axis) };
        text.faces_screen = axis == SCREEN || block.word("autoRotateToScreen") == "TRUE";
        text.position = block.values("position").map_or(DVec3::ZERO, DVec3::from_array);
        text.color = block.values("color").map_or(text.color, |color| color.map(|part: f64| part as f32));
        text.draw_mode = block.value("drawMode").map_or(LETTERS_ALONE, |mode| mode as u32);
        text.box_margin = block.value("BoundingBoxMargin").unwrap_or(0.0);
        text.box_color =
            block.values("BoundingBoxColor").map_or(text.box_color, |color| color.map(|part: f64| part as f32));
        let field = block.fields.iter().find(|field| field.word(0) == "text");
        text.text = match field.and_then(|field| field.block.as_ref()) {
            Some(numbers) => text_of_numbers(numbers.numbers.iter().copied()),
            None => block.word("text").to_owned(),
        };
        let backdrop = &mut text.backdrop;
        backdrop.kind = value_of(BACKDROPS, block.word("backdropType")).unwrap_or(NO_BACKDROP);
        for (offset, name) in backdrop.offset.iter_mut().zip(["backdropHorizontalOffset", "backdropVerticalOffset"]) {
            *offset = block.value(name).unwrap_or(*offset);
        }
        backdrop.color =
            block.values("backdropColor").map_or(backdrop.color, |color| color.map(|part: f64| part as f32));
        if !matches!(block.word("colorGradientMode"), "" | "SOLID") {
            self.notes.add(GRADIENTS);
        }
        if !matches!(block.word("layout"), "" | "LEFT_TO_RIGHT") {
            self.notes.add(LAYOUTS);
        }
        match class {
            "osgText::FadeText" => self.notes.add(FADING),
            "osgText::Text3D" => self.notes.add(SOLIDS),
            _ => {}
        }
        text
    }
}
