//! [`TextObject`]: a text of osgText as plain values. Readers of all encodings fill it; [`build`](super::build) makes a mesh of
//! its letters.

#[cfg(feature = "text")]
use glam::DVec2;
use glam::{DQuat, DVec3};

use super::input::Names;

// The notes about texts that are drawn otherwise than by OSG.
pub(super) const LAYOUTS: &str = "OpenSceneGraph: layout of a text (it is drawn from left to right)";
pub(super) const GRADIENTS: &str = "OpenSceneGraph: gradient of a text's colours (it has one colour)";
pub(super) const FADING: &str = "OpenSceneGraph class osgText::FadeText (it does not fade)";
pub(super) const SOLIDS: &str = "OpenSceneGraph class osgText::Text3D (it is flat)";

/// The points of a text's box or base line at which its position can lie, by their names. The numbers are those of binary files.
pub(super) const ALIGNMENTS: Names = &[
    ("LEFT_TOP", 0),
    ("LEFT_CENTER", 1),
    ("LEFT_BOTTOM", 2),
    ("CENTER_TOP", 3),
    ("CENTER_CENTER", 4),
    ("CENTER_BOTTOM", 5),
    ("RIGHT_TOP", 6),
    ("RIGHT_CENTER", 7),
    ("RIGHT_BOTTOM", 8),
    ("LEFT_BASE_LINE", LEFT_BASE_LINE),
    ("CENTER_BASE_LINE", 10),
    ("RIGHT_BASE_LINE", 11),
    ("LEFT_BOTTOM_BASE_LINE", 12),
    ("CENTER_BOTTOM_BASE_LINE", 13),
    ("RIGHT_BOTTOM_BASE_LINE", 14),
    ("BASE_LINE", LEFT_BASE_LINE),
];
const LEFT_BASE_LINE: u32 = 9;
/// The planes that a text can lie in.
pub(super) const AXES: Names = &[
    ("XY_PLANE", 0),
    ("REVERSED_XY_PLANE", 1),
    ("XZ_PLANE", 2),
    ("REVERSED_XZ_PLANE", 3),
    ("YZ_PLANE", 4),
    ("REVERSED_YZ_PLANE", 5),
    ("SCREEN", SCREEN),
    ("USER_DEFINED_ROTATION", 7),
];
/// The number of the plane of the screen.
pub(super) const SCREEN: u32 = 6;
/// The units of a text's size.
pub(super) const SIZE_MODES: Names =
    &[("OBJECT_COORDS", 0), ("SCREEN_COORDS", 1), ("OBJECT_COORDS_WITH_MAXIMUM_SCREEN_SIZE_CAPPED_BY_FONT_HEIGHT", 2)];
pub(super) const LAYOUT_NAMES: Names = &[("LEFT_TO_RIGHT", 0), ("RIGHT_TO_LEFT", 1), ("VERTICAL", 2)];
/// The backdrops that can be drawn behind letters: a shadow in each direction, and an outline.
pub(super) const BACKDROPS: Names = &[
    ("DROP_SHADOW_BOTTOM_RIGHT", 0),
    ("DROP_SHADOW_CENTER_RIGHT", 1),
    ("DROP_SHADOW_TOP_RIGHT", 2),
    ("DROP_SHADOW_BOTTOM_CENTER", 3),
    ("DROP_SHADOW_TOP_CENTER", 4),
    ("DROP_SHADOW_BOTTOM_LEFT", 5),
    ("DROP_SHADOW_CENTER_LEFT", 6),
    ("DROP_SHADOW_TOP_LEFT", 7),
    ("OUTLINE", OUTLINE),
    ("NONE", NO_BACKDROP),
];
const OUTLINE: u32 = 8;
pub(super) const NO_BACKDROP: u32 = 9;
/// The number of the mode of drawing in which there are letters and nothing else.
pub(super) const LETTERS_ALONE: u32 = 1;
/// The bits of what else is drawn: the outline of a box, its inside, and a cross at the position.
pub(super) const BOX_OUTLINE: u32 = 2;
pub(super) const BOX_FILLED: u32 = 4;
pub(super) const CROSS: u32 = 8;

/// The members of a Text, FadeText or Text3D. Lengths in the units of its node, or in pixels.
#[derive(Debug)]
pub(super) struct TextObject {
    pub text: String,
    pub position: DVec3,
    /// Turns the text from the x-y plane, facing +z.
    pub rotation: DQuat,
    pub faces_screen: bool,
    /// The side of the square that a letter is designed in.
    pub height: f64,
    /// Height by width of that square as it is drawn.
    pub aspect: f64,
    /// A number of [`SIZE_MODES`].
    pub size_mode: u32,
    /// The largest height in pixels, for the third of these modes.
    pub font_height_px: f64,
    /// A number of [`ALIGNMENTS`].
    pub alignment: u32,
    /// The gap between lines as a share of the height.
    pub line_spacing: f64,
    /// Lines are broken at this width; 0 or less for none.
    pub max_width: f64,
    /// The displayed colour, sRGB, 0 to 1.
    pub color: [f32; 4],
    pub backdrop: Backdrop,
    /// The bits of what is drawn: the letters ([`LETTERS_ALONE`]), a box and a cross.
    pub draw_mode: u32,
    /// The distance of the box from the letters.
    pub box_margin: f64,
    /// The displayed colour of the inside of the box, sRGB, 0 to 1.
    pub box_color: [f32; 4],
}

/// The shadow or the outline behind the letters of a text.
#[derive(Debug)]
pub(super) struct Backdrop {
    /// A number of [`BACKDROPS`].
    pub kind: u32,
    /// The offset to the right and upwards, as shares of the square that a letter is designed in.
    pub offset: [f64; 2],
    /// The displayed colour, sRGB, 0 to 1.
    pub color: [f32; 4],
}

impl Default for Backdrop {
    /// Returns OSG's defaults.
    fn default() -> Self {
        Self { kind: NO_BACKDROP, offset: [0.07; 2], color: [0.0, 0.0, 0.0, 1.0] }
    }
}

#[cfg(feature = "text")]
impl Backdrop {
    /// Returns the directions in which copies of the letters are drawn: -1, 0 or 1 to the right and upwards.
    fn directions(&self) -> &'static [[i8; 2]] {
        /// By the numbers of shadows.
        const AROUND: [[i8; 2]; 8] = [[1, -1], [1, 0], [1, 1], [0, -1], [0, 1], [-1, -1], [-1, 0], [-1, 1]];
        match self.kind {
            OUTLINE => &AROUND,
            kind => AROUND.get(kind as usize).map_or(&[], std::slice::from_ref),
        }
    }

    /// Returns the offsets of copies of the letters, as shares of the square that a letter is designed in.
    pub fn offsets(&self) -> impl Iterator<Item = DVec2> + Clone {
        /// The largest offset; a letter's rectangle is little larger than its square.
        const MAX_OFFSET: f64 = 1.0;
        /// The width of outlines by their offset, as in OSG's shader for text.
        const OUTLINE_WIDTH: f64 = 0.8;
        let [right, up] = match self.kind {
            // OSG takes the offset to the right for all sides.
            OUTLINE => [OUTLINE_WIDTH * self.offset[0]; 2],
            _ => self.offset,
        };
        let offset = DVec2::new(right, up);
        let is_near = offset.is_finite() && offset.abs().max_element() <= MAX_OFFSET;
        let directions = if is_near { self.directions() } else { &[] };
        directions.iter().map(move |[right, up]| offset * DVec2::new((*right).into(), (*up).into()))
    }
}

impl Default for TextObject {
    /// Returns OSG's defaults.
    fn default() -> Self {
        Self {
            text: String::new(),
            position: DVec3::ZERO,
            rotation: DQuat::IDENTITY,
            faces_screen: false,
            height: 32.0,
            aspect: 1.0,
            size_mode: 0,
            font_height_px: 32.0,
            alignment: LEFT_BASE_LINE,
            line_spacing: 0.0,
            max_width: 0.0,
            color: [1.0; 4],
            backdrop: Backdrop::default(),
            draw_mode: LETTERS_ALONE,
            box_margin: 0.0,
            box_color: [0.0, 0.0, 0.0, 0.5],
        }
    }
}

impl TextObject {
    /// Returns true if a bit of the mode of drawing is set.
    #[cfg(feature = "text")]
    pub fn draws(&self, bit: u32) -> bool {
        self.draw_mode & bit != 0
    }

    /// Returns true if the size is not that of the node alone.
    pub fn is_sized_by_screen(&self) -> bool {
        matches!(self.size_mode, 1 | 2)
    }
}

/// Returns the rotation of one of [`AXES`], as OSG's `setAxisAlignment` sets it.
pub(super) fn rotation_of_axis(axis: u32) -> DQuat {
    use std::f64::consts::{FRAC_PI_2, PI};
    // OSG multiplies the other way round.
    let (about_x, about_y) = (DQuat::from_rotation_x(FRAC_PI_2), DQuat::from_rotation_y(PI));
    match axis {
        1 => about_y,
        2 => about_x,
        3 => about_x * about_y,
        4 => DQuat::from_rotation_z(FRAC_PI_2) * about_x,
        5 => DQuat::from_rotation_z(FRAC_PI_2) * about_x * about_y,
        _ => DQuat::IDENTITY,
    }
}

/// Returns the text of characters as numbers; those that are none are left out.
pub(super) fn text_of_numbers(numbers: impl Iterator<Item = f64>) -> String {
    numbers.filter_map(|number| char::from_u32(number as u32)).collect()
}
