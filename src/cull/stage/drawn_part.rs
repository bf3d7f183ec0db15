//! [`DrawnPart`]: the part of a state's leaves that is drawn. Plain values.

use glam::{DAffine3, DMat3, DVec3};

use crate::cull::FadeBand;

/// The part of a state's leaves that is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DrawnPart {
    /// The pixels of a dither band.
    Band(FadeBand),
    /// The fragments that lie inside a volume.
    Within(CutVolume),
    /// The fragments that lie inside a volume, behind everything else: they are seen only where nothing else is drawn.
    Backdrop(CutVolume),
}

impl DrawnPart {
    /// Returns the volume that the leaves are cut to.
    pub fn volume(&self) -> Option<&CutVolume> {
        match self {
            Self::Band(_) => None,
            Self::Within(volume) | Self::Backdrop(volume) => Some(volume),
        }
    }
}

/// A box or a sphere that leaves are cut to: the map from the eye space of their view to the cube from -1 to 1, or to the
/// unit sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutVolume {
    /// The rows of the affine map.
    pub rows: [[f32; 4]; 3],
    /// True for a sphere.
    pub is_sphere: bool,
}

impl CutVolume {
    /// Creates the volume from its centre, unit axes and half lengths (metres) in a frame. A map without an inverse gives a
    /// volume that cuts nothing away.
    pub(in crate::cull) fn new(
        eye_from_frame: &DAffine3,
        center: DVec3,
        axes: &[[f32; 3]; 3],
        half_m: DVec3,
        is_sphere: bool,
    ) -> Self {
        let axes = DMat3::from_cols_array_2d(&axes.map(|axis| axis.map(f64::from)));
        let eye_from_unit =
            *eye_from_frame * DAffine3 { matrix3: axes * DMat3::from_diagonal(half_m), translation: center };
        let unit_from_eye = eye_from_unit.inverse();
        let unit_from_eye = if unit_from_eye.is_finite() {
            unit_from_eye
        } else {
            DAffine3 { matrix3: DMat3::ZERO, translation: DVec3::ZERO }
        };
        let row = |k: usize| unit_from_eye.matrix3.row(k).extend(unit_from_eye.translation[k]).as_vec4().to_array();
        Self { rows: [row(0), row(1), row(2)], is_sphere }
    }
}
