//! Texts as drawables: a rectangle for each letter, with the letter from a texture that all texts share.

#[cfg(feature = "text")]
mod glyphs;
#[cfg(feature = "text")]
mod letters;

use std::sync::Arc;

use glam::DAffine3;

use super::Builder;
use super::facing::{Facing, upright};
use crate::fetch::IoError;
use crate::formats::osg::objects::DrawableObject;
use crate::formats::osg::text::TextObject;
use crate::math::BoundingSphere;
use crate::scene::{AutoScale, BillboardMode, Node};

/// The largest font in pixels.
const MAX_FONT_PX: f64 = 4096.0;

/// Returns a sphere around a text; empty if it is not drawn.
pub(super) fn sphere(text: &TextObject) -> BoundingSphere {
    if !text.position.is_finite() {
        return BoundingSphere::EMPTY;
    }
    // From afar a text whose size is that of the screen is larger than anything.
    let radius = if text.is_sized_by_screen() { 0.0 } else { reach(text) };
    BoundingSphere::new(text.position, radius)
}

#[cfg(feature = "text")]
use self::letters::reach;

#[cfg(not(feature = "text"))]
fn reach(_text: &TextObject) -> f64 {
    0.0
}

impl Builder<'_> {
    /// Makes the node of a text, which may face the screen.
    pub(super) fn text_node(&mut self, object: &Arc<DrawableObject>, text: &TextObject) -> Result<Node, IoError> {
        if !text.faces_screen && !text.is_sized_by_screen() {
            return self.still_geode(object);
        }
        // Units of the drawable by those of the text, and the limit of the scale on the screen.
        let (units, auto_scale) = match text.size_mode {
            1 => (1.0, Some(AutoScale { min: 0.0, max: f64::INFINITY })),
            2 if text.height > 0.0 => {
                // The mesh is as large as its limit, and the screen scales it down to its own size.
                let units = text.font_height_px.clamp(1.0, MAX_FONT_PX) / text.height;
                (units, Some(AutoScale { min: 0.0, max: units.recip() }))
            }
            _ => (1.0, None),
        };
        let (mode, turn) = match text.faces_screen {
            true => (BillboardMode::PointRotEye, DAffine3::from_quat(upright())),
            false => (BillboardMode::NoRotation, DAffine3::IDENTITY),
        };
        let scale = DAffine3::from_scale(glam::DVec3::splat(units));
        let pivot_from_text = turn * scale * DAffine3::from_translation(-text.position);
        self.facing_drawable(object, &pivot_from_text, &Facing { position: text.position, mode, auto_scale })
    }

    /// Notes a text, which needs a typeface to be drawn.
    #[cfg(not(feature = "text"))]
    pub(super) fn text_drawables(&mut self, _text: &TextObject) -> Result<Vec<crate::scene::Drawable>, IoError> {
        self.note("OpenSceneGraph class osgText::Text");
        Ok(Vec::new())
    }
}
