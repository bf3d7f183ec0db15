//! [`Look`]: the colour, visibility and size that a style gives a feature. Decode threads.

use crate::math::color::linear_from_srgb;

/// The value of a style for a feature or a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    is_shown: bool,
    /// Linear colour and alpha; `None` if the style leaves the colour as it is.
    pub color: Option<[f32; 4]>,
    /// The side of points in pixels, at most [`MAX_POINT_SIZE_PX`]; `None` if the style has none.
    point_size_px: Option<f32>,
}

/// The maximum size of points.
const MAX_POINT_SIZE_PX: f32 = 64.0;

impl Look {
    /// The look of a feature without a style.
    pub const DEFAULT: Self = Self { is_shown: true, color: None, point_size_px: None };

    /// Returns a look with a colour in sRGB, and with a size of points in pixels.
    pub fn new(is_shown: bool, color: Option<[f64; 4]>, point_size_px: Option<f64>) -> Self {
        let linear = |[r, g, b, a]: [f64; 4]| [linear_from_srgb(r), linear_from_srgb(g), linear_from_srgb(b), a];
        let point_size_px = point_size_px.map(|size| (size as f32).min(MAX_POINT_SIZE_PX));
        Self { is_shown, color: color.map(|color| linear(color).map(|part| part as f32)), point_size_px }
    }

    /// Returns true if the feature is drawn. `pointSize` has no effect on other features than points.
    pub fn is_visible(&self) -> bool {
        self.is_shown && self.alpha() > 0.0
    }

    /// Returns the size of points in pixels, 1 or larger.
    pub fn point_size_px(&self) -> f32 {
        self.point_size_px.unwrap_or(1.0).max(1.0)
    }

    pub fn is_transparent(&self) -> bool {
        self.alpha() < 1.0
    }

    fn alpha(&self) -> f32 {
        self.color.map_or(1.0, |color| color[3])
    }
}
