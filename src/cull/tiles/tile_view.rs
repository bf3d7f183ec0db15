//! [`TileView`]: the frame of tile trees as the eye sees it. Culling thread.

use glam::{DAffine3, Vec4};

use super::horizon::Horizon;
use crate::cull::views::{GridPlanes, Planes, View};
use crate::cull::visitor::eye_in;
use crate::scene::{Page, TileBounds, TileEye};

/// Share of the priority that remains for tiles outside of the frustum.
pub(super) const KEPT_SHARE: f32 = 0.25;

/// Upper limit of errors in pixels, chosen so that its square is finite.
pub(in crate::cull) const MAX_ERROR_PX: f32 = 1.8e19;

/// A frame with tile trees, seen from the eye of the current view.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct TileView {
    /// The page's transform whose frame it is.
    pub(super) transform: u32,
    /// Index of the attachment frame for the contents of tiles.
    pub(super) attachment: u32,
    /// Frustum planes, relative to the eye.
    pub(super) planes: Planes,
    /// The same planes for boxes along the axes of the frame.
    pub(super) grid_planes: GridPlanes,
    pub(super) eye: TileEye,
    /// View direction; of unit length where the frame is not scaled.
    forward: Vec4,
    /// Present where the body of the earth hides tiles.
    pub(super) horizon: Option<Horizon>,
}

impl TileView {
    /// Computes the view of a frame from its matrix.
    pub(super) fn new(page: &Page, transform: u32, attachment: u32, eye_from_tiles: &DAffine3, view: &View) -> Self {
        let eye = eye_in(eye_from_tiles);
        let planes = view.planes.in_frame(eye_from_tiles, eye);
        let horizon = view.camera.horizon.as_ref().and_then(|body| {
            let world_from_eye = view.camera.eye_from_world.inverse();
            Horizon::new(body, &(world_from_eye * eye_from_tiles), world_from_eye.translation)
        });
        let m = &eye_from_tiles.matrix3;
        let forward = (m.row(2) / -m.x_axis.length()).as_vec3().extend(0.0);
        let eye = page.tiles().grid().eye(eye);
        let grid_planes = planes.on_grid(eye.step_m(), eye.rest_m());
        Self { transform, attachment, planes, grid_planes, eye, forward, horizon }
    }

    /// Returns the factor of a request's priority for the tile's position in the view, the squared cosine of its angle to the
    /// view direction. It is 1 in the middle and around the eye, a half at 45 degrees, and at least [`KEPT_SHARE`].
    #[inline(always)]
    pub(super) fn priority_share(&self, bounds: &TileBounds) -> f32 {
        let offset = self.eye.offset_to(bounds);
        let (distance2, along, radius2) = (offset.length_squared(), offset.dot(self.forward), bounds.radius2_m2());
        if radius2 >= distance2 {
            return 1.0;
        }
        // All times the distance: the sine of the angle to the centre, and cosine and sine of half the angle that the
        // bounds subtend.
        let [across, half_cos, half_sin] =
            [(distance2 - along * along).max(0.0), distance2 - radius2, radius2].map(f32::sqrt);
        if across * half_cos > along * half_sin {
            let cos = (along * half_cos + across * half_sin).max(0.0) / distance2;
            (cos * cos).max(KEPT_SHARE)
        } else {
            1.0
        }
    }
}
