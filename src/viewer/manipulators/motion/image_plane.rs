//! Positions in the image plane, in image heights from the centre.

use glam::DVec2;

use crate::viewer::events::InputState;

/// Converts a position in the input range, pixels, to image heights from the image's centre, y up.
pub fn image_position(position_px: DVec2, state: &InputState) -> DVec2 {
    let size = state.max - state.min;
    let aspect = if size.y > 0.0 { size.x / size.y } else { 1.0 };
    let state = InputState { position: position_px, ..*state };
    let at = 0.5 * state.normalized() * DVec2::new(aspect, 1.0);
    if at.is_finite() { at.clamp(DVec2::splat(-100.0), DVec2::splat(100.0)) } else { DVec2::ZERO }
}
