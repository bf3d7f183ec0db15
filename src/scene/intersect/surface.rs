//! The primitives of a drawable, from its k-d tree or, while it is in memory, from its payload.

use glam::DVec3;

use super::kd_tree::{BoxInDrawable, KdTree, LineHit, meet};
use super::primitives::{HeightCorners, Primitive, corner_count, mesh_primitives};
use crate::math::Ray;
use crate::scene::geometry::Geometry;
use crate::scene::pages::Page;

/// The source of a drawable's primitives.
#[derive(Clone, Copy, Debug)]
pub enum Surface<'a> {
    Tree(&'a KdTree),
    /// The payload, whose primitives are tested one after the other.
    Payload(&'a Geometry),
}

impl<'a> Surface<'a> {
    /// Returns the surface of a drawable; `None` if the payload was taken and there is no tree, because none was built or the
    /// drawable has no primitives.
    pub fn of(page: &'a Page, drawable: u32) -> Option<Self> {
        if let Some(tree) = page.kd_tree(drawable) {
            return Some(Self::Tree(tree));
        }
        page.drawables().get(drawable as usize).map(|d| Self::Payload(&d.geometry))
    }

    /// Intersects the triangles with a line. `found` returns the ratio up to which the search continues.
    pub(super) fn intersect_line(&self, ray: &Ray, mut found: impl FnMut(&LineHit) -> f64) {
        let geometry = match self {
            Self::Tree(tree) => return tree.intersect_line(ray, found),
            Self::Payload(geometry) => geometry,
        };
        let mut max_ratio = ray.max_ratio;
        each(geometry, &mut |p| {
            if p.count == 3
                && let Some((ratio, weights, _)) = meet(ray, &p.corners)
                && (0.0..=max_ratio).contains(&ratio)
            {
                let hit = LineHit { primitive: p.number, vertices: p.vertices, ratio, weights, normal: p.normal };
                max_ratio = max_ratio.min(found(&hit));
            }
            true
        });
    }

    /// Visits the primitives in boxes for which `boxes` returns true, until `visit` returns false.
    pub(super) fn visit_in(
        &self,
        boxes: &mut dyn FnMut(&BoxInDrawable) -> bool,
        visit: &mut dyn FnMut(&Primitive) -> bool,
    ) {
        match self {
            Self::Tree(tree) => tree.visit_in(boxes, visit),
            Self::Payload(geometry) => each(geometry, visit),
        }
    }
}

fn each(geometry: &Geometry, visit: &mut dyn FnMut(&Primitive) -> bool) {
    match geometry {
        Geometry::Mesh(mesh) => {
            let count = corner_count(mesh.topology);
            for (number, vertices, corners) in mesh_primitives(mesh) {
                let [a, b, c] = corners;
                let normal = if count == 3 { (b - a).cross(c - a) } else { DVec3::ZERO };
                if !visit(&Primitive { number, vertices, corners, count, normal }) {
                    return;
                }
            }
        }
        Geometry::Splats(_) | Geometry::Custom(_) => {}
        Geometry::Height(tile) => {
            let Some(corners) = HeightCorners::new(tile) else { return };
            for place in 0..corners.count() {
                if !visit(&corners.triangle(place)) {
                    return;
                }
            }
        }
    }
}
