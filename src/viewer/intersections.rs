//! Intersections with what a [`Viewer`] draws at positions of its window. Main thread, between frames.

use glam::DVec2;

use super::viewer::Viewer;
use crate::scene::{Intersection, IntersectionLimit, PolytopeIntersector, RayIntersector, WindowView};

impl Viewer {
    /// Returns what is drawn at a position of the window, nearest first; OSG's `View::computeIntersections`. The position is
    /// in pixels from the upper left corner; the middle of the first pixel is at 0.5, 0.5.
    ///
    /// Only contents with k-d trees are found ([`PagerConfig::build_kd_trees`](crate::pager::PagerConfig::build_kd_trees)),
    /// at the level that the camera draws. Height tiles are intersected at their own level: while the image morphs between
    /// two levels, the result is off by a fraction of the error that the camera allows.
    ///
    /// Objects below Projection nodes and cameras in the graph are found where they are visible. Overlays are first, and
    /// within one image the order is that of the depths in the last frame.
    pub fn compute_intersections(&self, x_px: f64, y_px: f64, limit: IntersectionLimit) -> Vec<Intersection> {
        let mut ray = RayIntersector::at_window(&self.drawn_view(), DVec2::new(x_px, y_px)).with_limit(limit);
        self.view().camera.intersection_visitor(self.view().size_px()).traverse(self.scene(), &mut ray);
        ray.take_intersections()
    }

    /// Returns everything that is drawn in a rectangle of the window, hidden or not; see [`Self::compute_intersections`] and
    /// [`Camera::polytope_in`](super::Camera::polytope_in).
    pub fn compute_intersections_in(
        &self,
        from_px: [f64; 2],
        to_px: [f64; 2],
        limit: IntersectionLimit,
    ) -> Vec<Intersection> {
        let (from_px, to_px) = (DVec2::from(from_px), DVec2::from(to_px));
        let mut polytope = PolytopeIntersector::at_window(&self.drawn_view(), from_px, to_px).with_limit(limit);
        self.view().camera.intersection_visitor(self.view().size_px()).traverse(self.scene(), &mut polytope);
        polytope.take_intersections()
    }

    /// Returns the master camera's view with the near plane of the last frame, which follows what is drawn.
    fn drawn_view(&self) -> WindowView {
        let (frame, view, _) = self.parts();
        let master = view.master.map(|slot| slot.camera);
        let outcome = frame.rendering.outcomes().find(|(camera, _)| Some(*camera) == master);
        let near_m = outcome.map_or(view.camera.min_near_m, |(_, outcome)| outcome.near_m);
        let clip_from_eye = view.camera.clip_from_eye(view.size_px(), near_m);
        WindowView { clip_from_eye, ..view.camera.window_view(view.size_px()) }
    }
}
