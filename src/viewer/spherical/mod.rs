//! Spherical displays: a view drawn in all directions and warped for a dome or a panorama; OSG's set-ups of spherical displays.
//!
//! ```text
//! master camera and five slaves -> six offscreen contexts, 90 degrees each     drawn first
//! an operation of each          -> its image, for the warp
//! an operation of the display's context: images -> dome or panorama            drawn last, in the same frame
//! ```
//! All contexts share a device, whose one thread draws them. Set up on the main thread.

mod warp_pass;

use std::f64::consts::FRAC_PI_2;
use std::sync::{Arc, PoisonError};

use glam::DAffine3;

use self::warp_pass::{FACES, FaceImages, WarpPass};
use super::ViewerError;
use super::camera::FieldOfView;
use super::composite::CompositeViewer;
use super::ids::{ContextId, SlaveId, ViewId};
use super::view::Slave;
use super::view::viewport::ViewArea;
use crate::gpu::ContextTraits;

/// The name of the operations of a display.
const OPERATION: &str = "spherical display";

/// How an image covers the surroundings of the viewer. Its middle is the direction of view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SphericalProjection {
    /// A disc for a fisheye projector, at whose edge rays leave it at a right angle to the direction of view; OSG's 3D
    /// spherical display. The viewer is in the middle of the dome, and the projector behind in the middle of the dome's
    /// opening.
    Dome {
        /// The radius of the dome.
        radius: f64,
        /// The radius of its opening, in the same unit; clamped to 0 and the dome's radius. If both are the same, the dome
        /// is a hemisphere, and the disc an equidistant fisheye image of 180 degrees.
        collar: f64,
    },
    /// All directions in an equirectangular image: longitude along its width, latitude along its height; OSG's panoramic
    /// spherical display.
    Panorama,
}

impl SphericalProjection {
    /// Returns OSG's dome.
    pub const fn dome() -> Self {
        Self::Dome { radius: 1.0, collar: 0.45 }
    }

    /// Returns the number of the projection in the shader, and the distance of the projector in radii of the dome.
    fn as_shader(self) -> (u32, f32) {
        match self {
            Self::Dome { radius, collar } => {
                let share = (collar / radius).clamp(0.0, 1.0);
                let distance = (1.0 - share * share).sqrt();
                (0, if distance.is_finite() { distance as f32 } else { 0.0 })
            }
            Self::Panorama => (1, 0.0),
        }
    }
}

/// A spherical display.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphericalDisplay {
    /// How the image covers the surroundings.
    pub projection: SphericalProjection,
    /// Width and height in pixels of each of the six images that are drawn for it, 1 to 8,192.
    pub face_px: u32,
}

impl Default for SphericalDisplay {
    fn default() -> Self {
        Self { projection: SphericalProjection::dome(), face_px: 1024 }
    }
}

/// Returns the transforms from the master camera's eye space to those of the faces: ahead, right, back, left, up, down.
fn view_offsets() -> [DAffine3; FACES] {
    [
        DAffine3::IDENTITY,
        DAffine3::from_rotation_y(FRAC_PI_2),
        DAffine3::from_rotation_y(2.0 * FRAC_PI_2),
        DAffine3::from_rotation_y(-FRAC_PI_2),
        DAffine3::from_rotation_x(-FRAC_PI_2),
        DAffine3::from_rotation_x(FRAC_PI_2),
    ]
}

impl CompositeViewer {
    /// Shows a view on a spherical display in a context, which keeps its other cameras but shows the display over them. The view
    /// gets an angle of view of 90 degrees, and its cameras are drawn into six new offscreen contexts on the same device;
    /// slaves that it had are removed. Overlays of the view are warped with its image ahead.
    ///
    /// Six images cost six times as much as one. A viewer that draws on demand draws each frame.
    pub fn set_up_spherical_display(
        &mut self,
        view: ViewId,
        context: ContextId,
        display: &SphericalDisplay,
    ) -> Result<(), ViewerError> {
        let mut faces = Vec::with_capacity(FACES);
        let result = self.show_on_faces(view, context, display, &mut faces);
        if result.is_err() {
            for face in faces {
                self.close_context(face)?;
            }
        }
        result
    }

    fn show_on_faces(
        &mut self,
        view: ViewId,
        context: ContextId,
        display: &SphericalDisplay,
        faces: &mut Vec<ContextId>,
    ) -> Result<(), ViewerError> {
        let samples = self.frame.config().samples;
        let slaves: Vec<SlaveId> = self.view(view)?.slaves().map(|(id, _)| id).collect();
        let traits =
            ContextTraits { size_px: [display.face_px.clamp(1, 8192); 2], samples, ..ContextTraits::default() };
        for _ in 0..FACES {
            faces.push(self.open_offscreen_on(context, &traits)?);
        }
        for slave in slaves {
            self.remove_slave(view, slave)?;
        }
        let images = FaceImages::default();
        for (index, (face, view_offset)) in faces.iter().zip(view_offsets()).enumerate() {
            if index == 0 {
                self.move_view(view, *face)?;
            } else {
                self.add_slave(view, Slave { view_offset, ..Slave::new(*face) })?;
            }
            let images = Arc::clone(&images);
            self.context_operations(*face)?.add_fn(OPERATION, true, move |context| {
                images.lock().unwrap_or_else(PoisonError::into_inner)[index] = context.color_view().cloned();
            });
        }
        let of_view = self.view_mut(view)?;
        of_view.set_viewport(ViewArea::Whole);
        of_view.camera.field_of_view = FieldOfView::Fixed { vertical: FRAC_PI_2, aspect: 1.0 };
        let mut warp = WarpPass::new(display.projection, images);
        let operations = self.context_operations(context)?;
        operations.remove(OPERATION);
        operations.add_fn(OPERATION, true, move |context| warp.draw(context));
        self.draw_last(context)
    }
}

#[cfg(test)]
mod tests {
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    use super::*;

    #[test]
    fn shader_is_valid() {
        let module = naga::front::wgsl::parse_str(include_str!("warp.wgsl")).unwrap();
        Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).unwrap();
    }

    #[test]
    fn projector_stands_in_the_middle_of_the_opening() {
        let distance = |radius, collar| SphericalProjection::Dome { radius, collar }.as_shader().1;
        assert_eq!([distance(2.0, 2.0), distance(2.0, 3.0), distance(5.0, 4.0)], [0.0, 0.0, 0.6]);
        assert_eq!([distance(1.0, -1.0), distance(0.0, 0.0), distance(f64::NAN, 1.0)], [1.0, 0.0, 0.0]);
    }
}
