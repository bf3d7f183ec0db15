//! [`ContentVolume`]: the declared volume of a tile's content, where it is smaller than that of the tile. Plain values; written
//! by decode threads, read by culls.

use glam::{DVec3, Vec4};

use crate::math::BoundingVolume;

/// A volume around a content, as culls test it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ContentVolume {
    /// The centre in the frame of the tile.
    center: DVec3,
    shape: ContentShape,
}

/// The shape of a [`ContentVolume`] around its centre; lengths in metres.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ContentShape {
    Sphere {
        radius_m: f32,
    },
    Box {
        /// Directions of unit length.
        axes: [[f32; 3]; 3],
        half_m: [f32; 3],
    },
}

impl ContentVolume {
    /// Returns the volume in the frame of its tile. The faces of a box stay flat under any affine map, but its axes need not be at
    /// right angles.
    pub fn new(volume: &BoundingVolume) -> Self {
        let Some(b) = volume.oriented_box() else {
            let sphere = volume.bounding_sphere();
            return Self { center: sphere.center, shape: ContentShape::Sphere { radius_m: sphere.radius_m as f32 } };
        };
        let columns = [b.half_axes.x_axis, b.half_axes.y_axis, b.half_axes.z_axis];
        let axes = columns.map(|axis| axis.normalize_or_zero().as_vec3().to_array());
        Self { center: b.center, shape: ContentShape::Box { axes, half_m: columns.map(|axis| axis.length() as f32) } }
    }

    /// Returns the offset from an eye to the centre, both in the frame of the tile, and the shape around it.
    pub fn seen_from(&self, eye: DVec3) -> (Vec4, &ContentShape) {
        ((self.center - eye).as_vec3().extend(0.0), &self.shape)
    }
}
