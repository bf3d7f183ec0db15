//! Picking: intersections at window coordinates, with the camera's lens and levels of detail. Main thread, between frames.

use glam::DVec2;

use super::camera::Camera;
use crate::scene::{
    ComputeNearFar, EyePoint, Intersection, IntersectionLimit, IntersectionVisitor, PolytopeIntersector,
    RayIntersector, WindowView,
};
use crate::viewer::Viewer;

impl Camera {
    /// Returns the eye for an [`IntersectionVisitor`], for an image of a size.
    pub fn eye_point(&self, size_px: [u32; 2]) -> EyePoint {
        self.cull_camera(size_px, 0, 0).eye_point()
    }

    /// Returns the camera's view of a whole target of a size, for intersectors at positions of it. The near plane is at
    /// [`Self::min_near_m`].
    pub fn window_view(&self, size_px: [u32; 2]) -> WindowView {
        let [width, height] = size_px.map(|side| side.max(1));
        WindowView {
            world_from_eye: self.world_from_eye,
            clip_from_eye: self.clip_from_eye(size_px, self.min_near_m),
            viewport_px: [0, 0, width, height],
            fits_depth: self.settings.compute_near_far != ComputeNearFar::Off,
        }
    }

    /// Returns a visitor that intersects what this camera draws.
    pub fn intersection_visitor(&self, size_px: [u32; 2]) -> IntersectionVisitor {
        let mut visitor = IntersectionVisitor::as_seen_from(self.eye_point(size_px));
        visitor.traversal_mask = self.settings.cull_mask;
        visitor
    }

    /// Returns the ray through an image position, in pixels from the upper left corner. The middle of the first pixel is at
    /// 0.5, 0.5.
    pub fn ray_at(&self, size_px: [u32; 2], x_px: f64, y_px: f64) -> RayIntersector {
        RayIntersector::at_window(&self.window_view(size_px), DVec2::new(x_px, y_px))
    }

    /// Returns an intersector for everything in a rectangle of the image, ordered by the distance in front of the eye. The
    /// arguments are any two opposite corners, in pixels from the upper left. A rectangle without area intersects nothing.
    pub fn polytope_in(&self, size_px: [u32; 2], from_px: [f64; 2], to_px: [f64; 2]) -> PolytopeIntersector {
        PolytopeIntersector::at_window(&self.window_view(size_px), DVec2::from(from_px), DVec2::from(to_px))
    }
}

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
    /// [`Camera::polytope_in`].
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

    /// The master camera's view with the near plane of the last frame, which follows what is drawn.
    fn drawn_view(&self) -> WindowView {
        let (frame, view, _) = self.parts();
        let master = view.master.map(|slot| slot.camera);
        let outcome = frame.rendering.outcomes().find(|(camera, _)| Some(*camera) == master);
        let near_m = outcome.map_or(view.camera.min_near_m, |(_, outcome)| outcome.near_m);
        let clip_from_eye = view.camera.clip_from_eye(view.size_px(), near_m);
        WindowView { clip_from_eye, ..view.camera.window_view(view.size_px()) }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use crate::scene::{Drawable, Geometry, Material, Mesh, Node, Page, Scene};

    #[test]
    fn rectangles_find_what_is_drawn_in_them() {
        let size_px = [640, 360];
        let mut camera = Camera::default();
        camera.look_at(DVec3::new(3.0, -50.0, 20.0), DVec3::ZERO, DVec3::Z);
        let mut scene = Scene::new();
        // Dots of 2 cm, a metre apart.
        let dots: Vec<DVec3> =
            (0..400).map(|i| DVec3::new(f64::from(i % 20) - 10.0, f64::from(i / 20) - 10.0, 0.0)).collect();
        for dot in &dots {
            let mesh = Mesh::rectangle(*dot - 0.01, DVec3::X * 0.02, DVec3::Y * 0.02);
            let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default());
            scene.add_root(Page::from_node(Node::geode(vec![drawable])).unwrap());
        }
        let roots = scene.roots().to_vec();
        for (from, to) in
            [([100.0, 50.0], [400.0, 200.0]), ([500.0, 300.0], [320.0, 180.0]), ([0.0; 2], [640.0, 360.0])]
        {
            let mut polytope = camera.polytope_in(size_px, from, to).with_limit(IntersectionLimit::OnePerDrawable);
            camera.intersection_visitor(size_px).traverse(&scene, &mut polytope);
            let mut found: Vec<_> = polytope.intersections().iter().map(|h| h.node_path[0].page).collect();
            found.sort_unstable();
            let clip_from_world =
                camera.clip_from_eye(size_px, 0.1) * glam::DMat4::from(camera.world_from_eye.inverse());
            let expected: Vec<_> = dots
                .iter()
                .zip(&roots)
                .filter(|(dot, _)| {
                    let clip = clip_from_world * dot.extend(1.0);
                    let (x, y) = (320.0 * (1.0 + clip.x / clip.w), 180.0 * (1.0 - clip.y / clip.w));
                    let within = |v: f64, k: usize| from[k].min(to[k]) < v && v < from[k].max(to[k]);
                    clip.w > 0.0 && within(x, 0) && within(y, 1)
                })
                .map(|(_, root)| *root)
                .collect();
            assert!(expected.len() > 20, "{}", expected.len());
            // Dots at the edge of the rectangle may be in or out.
            let differing = found.iter().filter(|f| !expected.contains(f)).count()
                + expected.iter().filter(|e| !found.contains(e)).count();
            assert!(differing <= 2, "{differing}");
            let nearest = polytope.first_intersection().unwrap();
            let distance_m = (nearest.world_point() - camera.eye()).dot(camera.direction());
            assert!((nearest.ratio - distance_m).abs() < 0.03, "ordered by depth");
        }
        let mut none = camera.polytope_in(size_px, [5.0, 5.0], [5.0, 90.0]);
        camera.intersection_visitor(size_px).traverse(&scene, &mut none);
        assert!(none.intersections().is_empty());
    }
}
