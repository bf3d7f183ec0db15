//! Billboards: drawables that turn towards the eye. Plain values and the maps that turn them.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::math::Aabb;
use crate::scene::geometry::Drawable;

/// How a [`Billboard`] turns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum BillboardMode {
    /// The drawable is parallel to the screen, its z axis upwards on the screen.
    #[default]
    PointRotEye,
    /// The drawable's normal points at the eye, turned the shortest way.
    PointRotWorld,
    /// The drawable is not turned.
    NoRotation,
    /// The drawable turns only about `axis`, its normal as close to the direction of the eye as possible.
    AxialRot {
        /// The unit axis in the node's frame.
        axis: DVec3,
    },
}

impl BillboardMode {
    /// Returns the map of a drawable at a position of the node's frame; `eye` is a point of the same frame.
    pub(crate) fn eye_from_drawable(self, eye_from_node: &DAffine3, eye: DVec3, position: DVec3) -> DAffine3 {
        let linear = eye_from_node.matrix3;
        let to_eye = (eye - position).normalize_or(DVec3::NEG_Y);
        let matrix3 = match self {
            // The columns are right, away from the eye, and up.
            Self::PointRotEye => {
                let scale = DVec3::new(linear.x_axis.length(), linear.y_axis.length(), linear.z_axis.length());
                DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y) * DMat3::from_diagonal(scale)
            }
            Self::NoRotation => linear,
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

    /// Returns how far a drawable reaches from its position along the node's axes, in any orientation. `linear` is the linear
    /// part of the node's map.
    pub(crate) fn reach(self, linear: &DMat3, bounds: &Aabb) -> DVec3 {
        let farthest = |scale: DVec3| bounds.corners().map(|c| (c * scale).length()).into_iter().fold(0.0, f64::max);
        // A drawable parallel to the screen keeps the node's scales along its own axes, in any direction: the sphere around it
        // is an ellipsoid in the node's frame.
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

/// Scales a drawable so that one unit of it covers one pixel from any distance; `setAutoScaleToScreen` of OSG's
/// `AutoTransform`. The scale stays between two limits, in units of the node per unit of the drawable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AutoScale {
    /// The smallest scale: from nearer the drawable grows on the screen.
    pub min: f64,
    /// The largest scale: from farther away the drawable shrinks on the screen. With [`f64::INFINITY`] the drawables are
    /// never culled, since they are large from far away.
    pub max: f64,
}

impl AutoScale {
    /// Returns the scale of a drawable at a position of the node's frame. `px_per_radian` is the number of pixels that one
    /// metre covers at a depth of one metre, or at any depth if rays are parallel.
    pub(crate) fn scale_at(
        &self,
        eye_from_node: &DAffine3,
        position: DVec3,
        px_per_radian: f64,
        is_parallel: bool,
    ) -> f64 {
        let depth = if is_parallel { 1.0 } else { eye_from_node.transform_point3(position).z.abs() };
        let unit = eye_from_node.matrix3.determinant().abs().cbrt();
        (depth / (px_per_radian * unit)).max(self.min).min(self.max)
    }
}

/// Drawables that turn towards the eye. Each has its pivot at its own origin, looks along -y and has z up.
#[derive(Clone, Debug, Default)]
pub struct Billboard {
    /// How the drawables turn.
    pub mode: BillboardMode,
    /// Keeps the size of the drawables on the screen; `None` leaves it.
    pub auto_scale: Option<AutoScale>,
    /// The position in the node's frame and the shape of each drawable.
    pub drawables: Vec<(DVec3, Drawable)>,
}
