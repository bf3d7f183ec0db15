//! From window coordinates to intersections, with the camera's lens and levels of detail. Main thread, between frames.

use glam::DVec2;

use super::Viewer;
use super::camera::Camera;
use crate::scene::{
    ComputeNearFar, EyePoint, Intersection, IntersectionLimit, IntersectionVisitor, PolytopeIntersector,
    RayIntersector, WindowView,
};

impl Camera {
    /// The eye for an [`IntersectionVisitor`], in a picture of a size.
    pub fn eye_point(&self, size_px: [u32; 2]) -> EyePoint {
        self.cull_camera(size_px, 0, 0).eye_point()
    }

    /// This camera's picture of a size, for intersectors at places of it: all of its target. Its near plane is at
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

    /// A visitor that meets what this camera draws.
    pub fn intersection_visitor(&self, size_px: [u32; 2]) -> IntersectionVisitor {
        let mut visitor = IntersectionVisitor::as_seen_from(self.eye_point(size_px));
        visitor.traversal_mask = self.settings.cull_mask;
        visitor
    }

    /// The ray of a place in the picture: pixels from its upper left corner, the middle of the first one at 0.5, 0.5.
    pub fn ray_at(&self, size_px: [u32; 2], x_px: f64, y_px: f64) -> RayIntersector {
        RayIntersector::at_window(&self.window_view(size_px), DVec2::new(x_px, y_px))
    }

    /// What is seen in a rectangle of the picture, ordered by the distance in front of the eye; pixels from the upper
    /// left corner, any two corners. A rectangle without area meets nothing.
    pub fn polytope_in(&self, size_px: [u32; 2], from_px: [f64; 2], to_px: [f64; 2]) -> PolytopeIntersector {
        PolytopeIntersector::at_window(&self.window_view(size_px), DVec2::from(from_px), DVec2::from(to_px))
    }
}

impl Viewer {
    /// What is drawn at a place of the window, nearest first; OSG's `View::computeIntersections`. Pixels from the upper
    /// left corner, the middle of the first one at 0.5, 0.5.
    ///
    /// Meets what was loaded with trees ([`PagerConfig::build_kd_trees`](crate::pager::PagerConfig::build_kd_trees)), at
    /// the level that the camera draws. Height tiles are met as their own level is: while the picture morphs between two
    /// levels it lies off by a share of the error that the camera allows.
    ///
    /// What Projection nodes and cameras in the graph draw into the same picture is met where it shows: what is drawn over
    /// others before those, and within one picture by its depth in the last frame.
    pub fn compute_intersections(&self, x_px: f64, y_px: f64, limit: IntersectionLimit) -> Vec<Intersection> {
        let mut ray = RayIntersector::at_window(&self.drawn_view(), DVec2::new(x_px, y_px)).with_limit(limit);
        self.camera.intersection_visitor(self.size_px()).traverse(self.scene(), &mut ray);
        ray.take_intersections()
    }

    /// What is drawn in a rectangle of the window, whether or not something is before it; see
    /// [`Self::compute_intersections`] and [`Camera::polytope_in`].
    pub fn compute_intersections_in(
        &self,
        from_px: [f64; 2],
        to_px: [f64; 2],
        limit: IntersectionLimit,
    ) -> Vec<Intersection> {
        let (from_px, to_px) = (DVec2::from(from_px), DVec2::from(to_px));
        let mut polytope = PolytopeIntersector::at_window(&self.drawn_view(), from_px, to_px).with_limit(limit);
        self.camera.intersection_visitor(self.size_px()).traverse(self.scene(), &mut polytope);
        polytope.take_intersections()
    }

    /// The master camera's picture with the depths of the last frame: its near plane follows what is drawn.
    fn drawn_view(&self) -> WindowView {
        let master = self.view.master.map(|place| place.camera);
        let outcome = self.base.rendering.outcomes().find(|(camera, _)| Some(*camera) == master);
        let near_m = outcome.map_or(self.camera.min_near_m, |(_, outcome)| outcome.near_m);
        let clip_from_eye = self.camera.clip_from_eye(self.size_px(), near_m);
        WindowView { clip_from_eye, ..self.camera.window_view(self.size_px()) }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use crate::scene::{Drawable, Geometry, Material, Mesh, Node, Page, Scene};

    #[test]
    fn rectangles_of_the_picture_hold_what_is_drawn_in_them() {
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
            // Those at the rectangle's edge may be either.
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
