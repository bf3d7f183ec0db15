//! Picking: intersectors at window coordinates, with the camera's lens and levels of detail.

use glam::DVec2;

use crate::scene::{ComputeNearFar, EyePoint, IntersectionVisitor, PolytopeIntersector, RayIntersector, WindowView};
use crate::viewer::camera::Camera;

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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use crate::scene::{Drawable, Geometry, IntersectionLimit, Material, Mesh, Node, Page, Scene};

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
