//! Billboards: drawables that turn towards the eye. Plain values and the maps that turn them.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::math::Aabb;
use crate::scene::geometry::Drawable;

/// How a [`Billboard`] turns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum BillboardMode {
    /// Parallel to the screen, its z axis up in the picture.
    #[default]
    PointRotEye,
    /// Its normal towards the eye, turned the shortest way.
    PointRotWorld,
    /// Turned about `axis` (unit, in the node's frame) only, its normal as near to the eye as that allows.
    AxialRot {
        /// Axis in the node's frame.
        axis: DVec3,
    },
}

impl BillboardMode {
    /// The map of a drawable at a position of the node's frame, seen from `eye` there.
    pub(crate) fn eye_from_drawable(self, eye_from_node: &DAffine3, eye: DVec3, position: DVec3) -> DAffine3 {
        let linear = eye_from_node.matrix3;
        let to_eye = (eye - position).normalize_or(DVec3::NEG_Y);
        let matrix3 = match self {
            // Right, away from the eye, up.
            Self::PointRotEye => {
                let scale = DVec3::new(linear.x_axis.length(), linear.y_axis.length(), linear.z_axis.length());
                DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y) * DMat3::from_diagonal(scale)
            }
            Self::PointRotWorld => linear * DMat3::from_quat(DQuat::from_rotation_arc(DVec3::NEG_Y, to_eye)),
            Self::AxialRot { axis } => {
                let axis = axis.normalize_or(DVec3::Z);
                let across = to_eye - axis * axis.dot(to_eye);
                let front = across.try_normalize().unwrap_or_else(|| axis.any_orthonormal_vector());
                linear * DMat3::from_cols((-front).cross(axis), -front, axis)
            }
        };
        DAffine3 { matrix3, translation: eye_from_node.transform_point3(position) }
    }

    /// How far a drawable reaches from its position along the node's axes, wherever it turns to; `linear` is the map of
    /// the node.
    pub(crate) fn reach(self, linear: &DMat3, bounds: &Aabb) -> DVec3 {
        let farthest = |scale: DVec3| bounds.corners().map(|c| (c * scale).length()).into_iter().fold(0.0, f64::max);
        // Parallel to the screen its own axes keep the node's scales, in whatever direction these are there: a ball about
        // it is an ellipsoid of the node.
        if self == Self::PointRotEye {
            let scale = DVec3::new(linear.x_axis.length(), linear.y_axis.length(), linear.z_axis.length());
            let inverse = linear.inverse();
            let rows = DVec3::new(inverse.row(0).length(), inverse.row(1).length(), inverse.row(2).length());
            let reach = farthest(scale) * rows;
            if reach.is_finite() {
                return reach;
            }
        }
        DVec3::splat(farthest(DVec3::ONE))
    }
}

/// Drawables that turn towards the eye. Each has its pivot at its own origin, looks along -y and has z up.
#[derive(Clone, Debug)]
pub struct Billboard {
    /// How they turn.
    pub mode: BillboardMode,
    /// Position in the node's frame and shape of each.
    pub drawables: Vec<(DVec3, Drawable)>,
}
