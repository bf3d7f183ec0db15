//! Poses from heading and pitch, and back.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::viewer::view::set_bounds::LocalFrame;

/// Returns the pose of an eye that looks `heading` radians clockwise from north and `pitch` radians above the horizon. Its up
/// direction is defined even when it looks straight down.
pub(super) fn pose_from_angles(frame: &DMat3, eye: DVec3, heading: f64, pitch: f64) -> DAffine3 {
    let (sin_h, cos_h) = heading.sin_cos();
    let (sin_p, cos_p) = pitch.sin_cos();
    let right = DVec3::new(cos_h, -sin_h, 0.0);
    let back = DVec3::new(-sin_h * cos_p, -cos_h * cos_p, -sin_p);
    DAffine3 { matrix3: *frame * DMat3::from_cols(right, back.cross(right), back), translation: eye }
}

/// Returns heading and pitch of a pose in a frame. When it looks straight down or up, the heading is the direction of the
/// image's upper or lower edge.
pub(super) fn heading_and_pitch(frame: &DMat3, pose: &DAffine3) -> (f64, f64) {
    let local = frame.transpose() * pose.matrix3;
    let direction = -local.z_axis;
    let flat = if direction.truncate().length() > 1e-9 {
        direction.truncate()
    } else {
        -local.y_axis.truncate() * direction.z.signum()
    };
    (flat.x.atan2(flat.y), direction.z.clamp(-1.0, 1.0).asin())
}

/// Converts a heading at one point to the heading of the same direction at another, along the shortest way: north differs
/// between the two.
pub(super) fn transport_heading(heading: f64, from: &LocalFrame, to: &LocalFrame) -> f64 {
    let ahead = DQuat::from_rotation_arc(from.up(), to.up()) * from.direction(heading, 0.0);
    let local = to.world_from_local.matrix3.transpose() * ahead;
    if local.is_finite() { local.x.atan2(local.y) } else { heading }
}

/// Returns the change of heading, radians clockwise, that turns the image by `twist` radians counterclockwise. Seen from
/// below the ground (positive pitch) the image turns the other way.
pub(super) fn heading_change(twist: f64, pitch: f64) -> f64 {
    if pitch > 0.0 { -twist } else { twist }
}
