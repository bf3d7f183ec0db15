//! Near and far by primitives, after OSG's `COMPUTE_NEAR_FAR_USING_PRIMITIVES`. Culling thread.
//!
//! Drawables whose bounds may decide near or far are collected while the scene is scanned. Their primitives are examined
//! afterwards, the most promising first, until no other bound lies nearer or farther.
//!
//! Primitives come from the drawables' k-d trees. Height tiles morph into coarser ones: their near end is moved by the
//! largest possible morph, and their far end is that of their bounds with the skirt.

use glam::{DAffine3, DMat4, DVec3, DVec4};

use super::page_context::PageContext;
use crate::cull::views::{DepthRange, View};
use crate::scene::{KdTree, Scene, UNBOUNDED};

/// Maximum number of corners of a triangle that is clipped by five planes.
const MAX_CORNERS: usize = 8;

/// A drawable whose primitives will be examined.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    /// Slot of its page in the scene's page table.
    slot: u32,
    drawable: u32,
    eye_from_page: DAffine3,
    /// Nearest depth of its bound.
    near: f32,
    /// Farthest depth of its bound.
    far: f32,
    /// Index of its view in the view stack.
    view: u32,
}

/// The visible volume of a view.
struct Sight {
    /// Left, right, bottom and top plane, and the plane at the least depth; inside is positive.
    planes: [DVec4; 5],
    /// The row that gives the depth of a point.
    depth: DVec4,
}

impl Sight {
    fn new(view: &View) -> Self {
        let m: &DMat4 = &view.camera.clip_from_eye;
        let [x, y, w] = [m.row(0), m.row(1), m.row(3)];
        let depth = view.depth_axis.extend(0.0);
        let least = depth - DVec4::W * f64::from(view.min_depth);
        Self { planes: [w + x, w - x, w + y, w - y, least], depth }
    }

    /// Returns the volume in the frame of a drawable.
    fn in_frame(&self, eye_from_drawable: &DAffine3) -> Self {
        let map = DMat4::from(*eye_from_drawable).transpose();
        Self { planes: self.planes.map(|plane| map * plane), depth: map * self.depth }
    }
}

/// Returns the signed distance of a point from a plane, in units of the plane's normal.
fn distance(plane: DVec4, point: DVec3) -> f64 {
    plane.truncate().dot(point) + plane.w
}

/// Returns the least and greatest depth of the visible part of a primitive, or `None` if nothing of it is visible.
fn depths(sight: &Sight, corners: &[DVec3]) -> Option<(f64, f64)> {
    let mut polygon = [DVec3::ZERO; MAX_CORNERS];
    let mut count = corners.len().min(3);
    polygon[..count].copy_from_slice(&corners[..count]);
    for plane in sight.planes {
        // Sutherland-Hodgman clipping, one plane at a time.
        let (before, len) = (polygon, count);
        count = 0;
        for i in 0..len {
            let (from, to) = (before[(i + len - 1) % len], before[i]);
            let (a, b) = (distance(plane, from), distance(plane, to));
            if (a >= 0.0) != (b >= 0.0) && count < MAX_CORNERS {
                polygon[count] = from + (to - from) * (a / (a - b));
                count += 1;
            }
            if b >= 0.0 && count < MAX_CORNERS {
                polygon[count] = to;
                count += 1;
            }
        }
    }
    let mut range = None;
    for point in &polygon[..count] {
        let depth = distance(sight.depth, *point);
        let (near, far) = range.unwrap_or((depth, depth));
        range = Some((depth.min(near), depth.max(far)));
    }
    range
}

/// Returns the least value of depth times `sign` over the visible primitives of a tree, or `best` if that is less. Sign 1
/// finds the nearest depth, -1 the farthest.
fn least(tree: &KdTree, sight: &Sight, sign: f64, best: f64) -> f64 {
    let best = std::cell::Cell::new(best);
    tree.visit_in(
        &mut |of| {
            let depth = of.range(sight.depth * sign).0;
            depth < best.get() && sight.planes.iter().all(|plane| of.range(*plane).1 >= 0.0)
        },
        &mut |primitive| {
            if let Some((near, far)) = depths(sight, &primitive.corners[..primitive.count.min(3)]) {
                best.set(best.get().min(if sign > 0.0 { near } else { -far }));
            }
            true
        },
    );
    best.get()
}

/// The drawables whose primitives may decide near and far of their views.
#[derive(Debug, Default)]
pub(in crate::cull) struct PrimitiveCandidates {
    candidates: Vec<Candidate>,
}

impl PrimitiveCandidates {
    /// Drops all candidates and keeps the memory.
    pub fn clear(&mut self) {
        self.candidates.clear();
    }

    /// Adds a drawable by the depth of its centre and its extent along the depth axis. Returns false if it has no k-d tree
    /// of primitives, so that its bound decides.
    #[cold]
    pub fn add(&mut self, context: &PageContext, drawable: u32, depth: f32, reach: f32, view: u32) -> bool {
        let has_tree = context.page.kd_tree(drawable).is_some();
        // Unbounded drawables do not count for near and far, neither do their primitives.
        if !has_tree || !(depth - reach).is_finite() || reach >= UNBOUNDED {
            return false;
        }
        self.candidates.push(Candidate {
            slot: context.visit.slot,
            drawable,
            eye_from_page: context.visit.eye_from_page,
            near: depth - reach,
            far: depth + reach,
            view,
        });
        true
    }

    /// Widens near and far of each view by the primitives of its candidates, and drops the candidates.
    pub fn widen_views(&mut self, scene: &Scene, views: &mut [View]) {
        self.candidates.sort_unstable_by_key(|candidate| candidate.view);
        for of_view in self.candidates.chunk_by_mut(|a, b| a.view == b.view) {
            if let Some(view) = views.get_mut(of_view[0].view as usize) {
                view.depths = widened(scene, view, of_view);
            }
        }
        self.candidates.clear();
    }
}

/// Returns near and far of a view, widened by the primitives of its candidates.
fn widened(scene: &Scene, view: &View, candidates: &mut [Candidate]) -> DepthRange {
    let sight = Sight::new(view);
    let DepthRange { mut near, mut far } = view.depths;
    let tree_of = |candidate: &Candidate| {
        let page = scene.page_at(candidate.slot)?;
        let tree = page.kd_tree(candidate.drawable)?;
        let transform = page.drawable_refs().get(candidate.drawable as usize)?.transform;
        let eye_from_drawable = candidate.eye_from_page * page.transforms().page_from_node(transform);
        Some((tree, sight.in_frame(&eye_from_drawable)))
    };
    candidates.sort_unstable_by(|a, b| a.near.total_cmp(&b.near));
    for candidate in &*candidates {
        if candidate.near >= near {
            break;
        }
        let nearest = match tree_of(candidate) {
            Some((tree, sight)) if tree.is_of_heights() => {
                let surface = least(tree, &sight, 1.0, f64::INFINITY);
                (view.ranges.before_morph(surface) as f32).max(candidate.near)
            }
            Some((tree, sight)) => least(tree, &sight, 1.0, f64::from(near)) as f32,
            None => candidate.near,
        };
        near = near.min(nearest);
    }
    candidates.sort_unstable_by(|a, b| b.far.total_cmp(&a.far));
    for candidate in &*candidates {
        if candidate.far <= far {
            break;
        }
        let farthest = match tree_of(candidate) {
            Some((tree, _)) if tree.is_of_heights() => candidate.far,
            Some((tree, sight)) => -least(tree, &sight, -1.0, -f64::from(far)) as f32,
            None => candidate.far,
        };
        far = far.max(farthest);
    }
    DepthRange { near, far }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cull::CullCamera;

    #[test]
    fn depths_are_those_of_the_visible_part_of_a_triangle() {
        // A field of view of 90 degrees.
        let clip_from_eye =
            glam::dcamera::rh::proj::directx::perspective_infinite_reverse(std::f64::consts::FRAC_PI_2, 1.0, 0.1);
        let sight = Sight::new(&View::new(&CullCamera { clip_from_eye, ..CullCamera::default() }));
        let at = |x: f64, z: f64| DVec3::new(x, 0.0, -z);
        let seen = |corners: &[DVec3]| depths(&sight, corners).map(|(a, b)| [a, b].map(|d| (d * 1e9).round() / 1e9));
        assert_eq!(seen(&[at(0.0, 2.0), at(1.0, 5.0), at(0.0, 3.0)]), Some([2.0, 5.0]));
        // A slanting segment from far left to far right is visible where |x| <= depth.
        assert_eq!(
            seen(&[at(-10.0, 1.0), at(10.0, 3.0)]),
            Some([(20.0f64 / 11.0 * 1e9).round() / 1e9, (20.0f64 / 9.0 * 1e9).round() / 1e9])
        );
        assert_eq!(seen(&[at(3.0, 1.0), at(9.0, 2.0), at(4.0, 2.0)]), None);
        assert_eq!(seen(&[at(0.0, -2.0), at(0.5, -2.0), at(0.0, 4.0)]), Some([0.0, 4.0]));
        assert_eq!(seen(&[at(1.0, 7.0)]), Some([7.0, 7.0]));
        assert_eq!(seen(&[DVec3::NAN, at(1.0, 7.0), at(0.0, 7.0)]).map(|r| r[1]), Some(7.0));
    }
}
