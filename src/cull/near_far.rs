//! Near and far by primitives, after OSG's `COMPUTE_NEAR_FAR_USING_PRIMITIVES`: what may decide them is put aside while
//! the scene is walked, and looked at afterwards, the likeliest first, until no other can lie nearer or farther.
//!
//! Primitives are those of the drawables' k-d trees, in the frame of the drawable. Height tiles morph into coarser ones:
//! their near end is moved by what that may be, their far end is that of their bounds, with the skirt.

use glam::{DAffine3, DMat4, DVec3, DVec4};

use super::view::View;
use super::visitor::{Cull, DepthRange, PageContext};
use crate::scene::{KdTree, Scene, UNBOUNDED};

/// Most corners of a triangle cut by five planes.
const MOST_CORNERS: usize = 8;

/// A drawable whose primitives have not been looked at.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    /// Place in the scene's page table.
    place: u32,
    drawable: u32,
    eye_from_page: DAffine3,
    /// Of its bound.
    near: f32,
    far: f32,
    /// Its view in the stage.
    view: u32,
}

/// Where primitives are looked for: inside all planes.
struct Sight {
    /// Left, right, bottom and top side of what is seen, and where depths begin.
    planes: [DVec4; 5],
    /// Depth of a point.
    depth: DVec4,
}

impl Sight {
    fn new(view: &View) -> Self {
        let m: &DMat4 = &view.clip_from_eye;
        let [x, y, w] = [m.row(0), m.row(1), m.row(3)];
        let depth = view.depth_axis.extend(0.0);
        let least = depth - DVec4::W * f64::from(view.least_depth);
        Self { planes: [w + x, w - x, w + y, w - y, least], depth }
    }

    /// The same in the frame of a drawable.
    fn in_frame(&self, eye_from_drawable: &DAffine3) -> Self {
        let map = DMat4::from(*eye_from_drawable).transpose();
        Self { planes: self.planes.map(|plane| map * plane), depth: map * self.depth }
    }
}

fn above(plane: DVec4, point: DVec3) -> f64 {
    plane.truncate().dot(point) + plane.w
}

/// Least and greatest depth of what is seen of a primitive; `None` where nothing is.
fn depths(sight: &Sight, corners: &[DVec3]) -> Option<(f64, f64)> {
    let mut polygon = [DVec3::ZERO; MOST_CORNERS];
    let mut count = corners.len().min(3);
    polygon[..count].copy_from_slice(&corners[..count]);
    for plane in sight.planes {
        // Sutherland and Hodgman: what is kept of the edge that ends at each corner.
        let (before, len) = (polygon, count);
        count = 0;
        for i in 0..len {
            let (from, to) = (before[(i + len - 1) % len], before[i]);
            let (a, b) = (above(plane, from), above(plane, to));
            if (a >= 0.0) != (b >= 0.0) && count < MOST_CORNERS {
                polygon[count] = from + (to - from) * (a / (a - b));
                count += 1;
            }
            if b >= 0.0 && count < MOST_CORNERS {
                polygon[count] = to;
                count += 1;
            }
        }
    }
    let mut range = None;
    for point in &polygon[..count] {
        let depth = above(sight.depth, *point);
        let (near, far) = range.unwrap_or((depth, depth));
        range = Some((depth.min(near), depth.max(far)));
    }
    range
}

/// The nearest (`sign` 1) or farthest (-1) seen depth of a tree's primitives times the sign, if less than `best`.
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

impl Cull<'_> {
    /// Puts a drawable aside to look at its primitives; false where there are none at hand and its bound decides.
    #[cold]
    pub(super) fn put_aside(&mut self, context: &PageContext, drawable: u32, depth: f32, reach: f32) -> bool {
        let has_tree = context.page.kd_tree(drawable).is_some();
        // Primitives of what is left out of account are where they are all the same.
        if !has_tree || !(depth - reach).is_finite() || reach >= UNBOUNDED {
            return false;
        }
        self.candidates.push(Candidate {
            place: context.visit.place,
            drawable,
            eye_from_page: context.visit.eye_from_page,
            near: depth - reach,
            far: depth + reach,
            view: self.view.index,
        });
        true
    }

    /// Widens near and far of the views by what was put aside.
    pub(super) fn look_at_primitives(&mut self) {
        let mut met = std::mem::take(self.candidates);
        met.sort_unstable_by_key(|candidate| candidate.view);
        for of_view in met.chunk_by_mut(|a, b| a.view == b.view) {
            if let Some(view) = self.views.get_mut(of_view[0].view as usize) {
                view.range = widened(self.scene, view, of_view);
            }
        }
        met.clear();
        *self.candidates = met;
    }
}

/// Near and far of a view, and of what of it was put aside.
fn widened(scene: &Scene, view: &View, met: &mut [Candidate]) -> DepthRange {
    let sight = Sight::new(view);
    let DepthRange { mut near, mut far } = view.range;
    let of = |candidate: &Candidate| {
        let page = scene.page_at(candidate.place)?;
        let tree = page.kd_tree(candidate.drawable)?;
        let transform = page.drawable_refs().get(candidate.drawable as usize)?.transform;
        let eye_from_drawable = candidate.eye_from_page * page.transforms().page_from_node(transform);
        Some((tree, sight.in_frame(&eye_from_drawable)))
    };
    met.sort_unstable_by(|a, b| a.near.total_cmp(&b.near));
    for candidate in &*met {
        if candidate.near >= near {
            break;
        }
        let nearest = match of(candidate) {
            Some((tree, sight)) if tree.is_of_heights() => {
                let surface = least(tree, &sight, 1.0, f64::INFINITY);
                (view.ranges.before_morph(surface) as f32).max(candidate.near)
            }
            Some((tree, sight)) => least(tree, &sight, 1.0, f64::from(near)) as f32,
            None => candidate.near,
        };
        near = near.min(nearest);
    }
    met.sort_unstable_by(|a, b| b.far.total_cmp(&a.far));
    for candidate in &*met {
        if candidate.far <= far {
            break;
        }
        let farthest = match of(candidate) {
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
    fn what_is_seen_of_a_triangle_is_cut_at_the_sides() {
        // A field of view of 90 degrees.
        let clip_from_eye =
            glam::dcamera::rh::proj::directx::perspective_infinite_reverse(std::f64::consts::FRAC_PI_2, 1.0, 0.1);
        let sight = Sight::new(&View::new(&CullCamera { clip_from_eye, ..CullCamera::default() }));
        let at = |x: f64, z: f64| DVec3::new(x, 0.0, -z);
        let seen = |corners: &[DVec3]| depths(&sight, corners).map(|(a, b)| [a, b].map(|d| (d * 1e9).round() / 1e9));
        assert_eq!(seen(&[at(0.0, 2.0), at(1.0, 5.0), at(0.0, 3.0)]), Some([2.0, 5.0]));
        // From far on the left to far on the right, slanting: seen where |x| <= depth.
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
