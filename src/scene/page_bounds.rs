//! The bounds of a page's nodes and drawables: fitted when it is made, and again where it changes. What is above a change
//! is fitted once for all changes of a frame, before the frame culls; until then it is stale, which is to say too large.
//!
//! Decode workers (any thread) make pages; update, with `&mut`, changes them.

use glam::{DAffine3, DVec3, DVec4, Vec4};

use super::error::SceneError;
use super::kinds::{CameraNode, ReferenceFrame};
use super::page::{NONE, Page, STALE, Special, UNBOUNDED, kind};
use crate::math::{Aabb, BoundingSphere};

impl Page {
    /// The sphere around everything, in the page's frame.
    pub fn bounding_sphere(&self) -> BoundingSphere {
        self.node_sphere(0).unwrap_or(BoundingSphere::EMPTY)
    }

    /// The sphere around a node, in the page's frame; `None` where it has none.
    pub(crate) fn node_sphere(&self, node: u32) -> Option<BoundingSphere> {
        let stored = *self.spheres.get(node as usize)?;
        let is_stale = self.nodes[node as usize].flags & STALE != 0;
        let sphere = if is_stale { self.fitted_stale_sphere(node) } else { stored };
        let is_bound = sphere.w >= 0.0 && sphere.w < UNBOUNDED;
        is_bound.then(|| BoundingSphere::new(self.origin + sphere.truncate().as_dvec3(), f64::from(sphere.w)))
    }

    /// What the sphere of a stale node will be.
    fn fitted_stale_sphere(&self, node: u32) -> Vec4 {
        let below = node..node + self.nodes[node as usize].skip;
        let mut stale: Vec<u32> = self.stale.iter().copied().filter(|node| below.contains(node)).collect();
        stale.sort_unstable_by(|a, b| b.cmp(a));
        let mut fitted: Vec<(u32, Vec4)> = Vec::with_capacity(stale.len());
        for node in stale {
            let sphere = self.fitted_sphere(node as usize, |below| {
                match fitted.binary_search_by(|(node, _)| (below as u32).cmp(node)) {
                    Ok(place) => fitted[place].1,
                    Err(_) => self.spheres[below],
                }
            });
            fitted.push((node, sphere));
        }
        fitted.last().map_or(self.spheres[node as usize], |(_, sphere)| *sphere)
    }

    /// Spheres of nodes that were fitted so far, those of a page made of nodes once each: the measure that many changes
    /// in a frame cost what they touch.
    pub fn fitted_spheres(&self) -> u64 {
        self.fitted_spheres
    }

    /// Fits what is stale, children before parents.
    pub(crate) fn compute_bounds(&mut self) {
        let mut stale = std::mem::take(&mut self.stale);
        stale.sort_unstable();
        for node in stale.drain(..).rev() {
            self.fit_spheres(node as usize, node as usize + 1);
            self.nodes[node as usize].flags &= !STALE;
        }
        self.stale = stale;
    }

    /// A node's sphere is another: those above are to be fitted. Until then they hold it, so that nothing is culled that
    /// is seen. What is above a stale node is stale.
    pub(crate) fn outdate_above(&mut self, node: u32) {
        let (mut below, mut above) = (node, self.parents[node as usize]);
        while above != NONE {
            let has_grown = self.grow(above as usize, below as usize);
            let record = &mut self.nodes[above as usize];
            let was_stale = record.flags & STALE != 0;
            if was_stale && !has_grown {
                return;
            }
            if !was_stale {
                record.flags |= STALE;
                self.stale.push(above);
            }
            (below, above) = (above, self.parents[above as usize]);
        }
    }

    /// Makes a node's sphere hold that of a child; false where it does.
    fn grow(&mut self, node: usize, child: usize) -> bool {
        let (own, other) = (self.spheres[node].as_dvec4(), self.spheres[child].as_dvec4());
        if self.nodes[node].kind == kind::TILE || other.w < 0.0 || own.w >= f64::from(UNBOUNDED) || self.is_apart(child)
        {
            return false;
        }
        let (center, way) = (own.truncate(), other.truncate() - own.truncate());
        let apart_m = way.length();
        self.spheres[node] = if own.w < 0.0 || other.w >= f64::from(UNBOUNDED) || apart_m + own.w <= other.w {
            self.spheres[child]
        } else if apart_m + other.w <= own.w {
            return false;
        } else {
            let radius_m = 0.5 * (apart_m + own.w + other.w);
            stored_sphere(center + way * ((radius_m - own.w) / apart_m), radius_m)
        };
        true
    }

    /// Replaces the map of a transform node and fits the bounds of its subtree; those above it are stale.
    pub(crate) fn set_transform(&mut self, node: u32, parent_from_node: DAffine3) -> Result<bool, SceneError> {
        let index = node as usize;
        if index >= self.node_count() || self.nodes[index].kind != kind::TRANSFORM {
            return Ok(false);
        }
        if !parent_from_node.is_finite() {
            return Err(SceneError::NotFinite);
        }
        let record = self.nodes[index];
        let end = index + record.skip as usize;
        self.transforms.set(record.first_transform, parent_from_node, self.nodes[end].first_transform);
        self.fit_billboards(index, end);
        self.fit_boxes(record.first_drawable as usize, self.nodes[end].first_drawable as usize);
        let before = self.spheres[index];
        self.fit_spheres(index, end);
        if self.spheres[index] != before {
            self.outdate_above(node);
        }
        Ok(true)
    }

    /// Puts other values into a camera node; false where it is none. Bounds above depend on its frame.
    pub(crate) fn set_camera(&mut self, node: u32, camera: CameraNode) -> bool {
        let Some(frame) = self.camera(node).map(|c| c.frame) else { return false };
        let refits = frame != camera.frame;
        if let Some(Special::Camera { camera: old, .. }) = self.specials.get_mut(self.payloads[node as usize] as usize)
        {
            **old = camera;
        }
        if refits {
            self.outdate_above(node);
        }
        true
    }

    /// The box of a drawable in the page's frame; `None` where its bound is not usable.
    pub(crate) fn box_in_page(&self, drawable: usize) -> Option<Aabb> {
        let local = &self.local_boxes[drawable];
        if !usable(local) {
            return None;
        }
        let in_page = local.transformed(&self.transforms.page_from_node(self.drawable_refs[drawable].transform));
        usable(&in_page).then_some(in_page)
    }

    /// Computes the boxes, in the frames of their transforms, of billboards in a range of nodes: how far they reach is a
    /// matter of these transforms.
    pub(crate) fn fit_billboards(&mut self, first: usize, end: usize) {
        if self.specials.is_empty() {
            return;
        }
        for node in (first..end).filter(|node| self.nodes[*node].kind == kind::SPECIAL) {
            let Some(Special::Billboard { mode, positions, bounds }) = self.specials.get(self.payloads[node] as usize)
            else {
                continue;
            };
            let own = self.nodes[node].first_drawable as usize;
            for ((drawable, position), bounds) in (own..).zip(positions).zip(bounds) {
                let page_from_node = self.transforms.page_from_node(self.drawable_refs[drawable].transform);
                // Wherever it turns to.
                let reach = mode.reach(&page_from_node.matrix3, bounds);
                self.local_boxes[drawable] = Aabb { min: *position - reach, max: *position + reach };
            }
        }
    }

    /// Computes the page-frame boxes of a range of drawables.
    pub(crate) fn fit_boxes(&mut self, first: usize, end: usize) {
        for drawable in first..end {
            let (center, half) = match self.box_in_page(drawable) {
                Some(b) => {
                    let center = b.center() - self.origin;
                    let half = b.half_size();
                    let slack = rounding_slack(center.abs().max_element() + half.max_element());
                    ((center).as_vec3(), (half + slack).as_vec3())
                }
                None => (glam::Vec3::ZERO, glam::Vec3::splat(UNBOUNDED)),
            };
            let four = &mut self.boxes[drawable / 4];
            for axis in 0..3 {
                four.center[axis][drawable % 4] = center[axis];
                four.half[axis][drawable % 4] = half[axis];
            }
        }
    }

    /// Computes the spheres of a range of nodes from those below it, deepest first: the middle of the box around
    /// the children's spheres, then the radius that holds them all (as OSG's `Group::computeBound`).
    pub(crate) fn fit_spheres(&mut self, first: usize, end: usize) {
        for node in (first..end).rev() {
            let sphere = self.fitted_sphere(node, |below| self.spheres[below]);
            self.spheres[node] = sphere;
        }
        self.fitted_spheres += (end - first) as u64;
    }

    /// A node's sphere, around those of its children.
    fn fitted_sphere(&self, node: usize, sphere_of: impl Fn(usize) -> Vec4) -> Vec4 {
        let record = &self.nodes[node];
        if record.kind == kind::TILE {
            return self.tile_sphere(node);
        }
        let mut around = Aabb::EMPTY;
        let mut unbounded = false;
        let own = record.first_drawable as usize..self.nodes[node + 1].first_drawable as usize;
        for drawable in own.clone() {
            match self.box_in_page(drawable) {
                Some(b) => around = around.union(&Aabb { min: b.min - self.origin, max: b.max - self.origin }),
                None => unbounded = true,
            }
        }
        let own_box = around;
        let end = node + record.skip as usize;
        let mut child = node + 1;
        while child < end {
            let apart = self.is_apart(child);
            let s = if apart { DVec4::NEG_ONE } else { sphere_of(child).as_dvec4() };
            if s.w >= f64::from(UNBOUNDED) {
                unbounded = true;
            } else if s.w >= 0.0 {
                let (c, r) = (s.truncate(), DVec3::splat(s.w));
                around = around.union(&Aabb { min: c - r, max: c + r });
            }
            child += self.nodes[child].skip as usize;
        }
        if unbounded {
            return Vec4::new(0.0, 0.0, 0.0, UNBOUNDED);
        }
        if around.is_empty() {
            return Vec4::new(0.0, 0.0, 0.0, -UNBOUNDED);
        }
        let center = around.center();
        let mut radius_m = 0.0f64;
        if !own_box.is_empty() {
            radius_m = (own_box.center() - center).length() + own_box.half_size().length();
        }
        let mut child = node + 1;
        while child < end {
            let s = sphere_of(child).as_dvec4();
            if s.w >= 0.0 && !self.is_apart(child) {
                radius_m = radius_m.max(s.truncate().distance(center) + s.w);
            }
            child += self.nodes[child].skip as usize;
        }
        stored_sphere(center, radius_m)
    }

    /// True for nodes whose children are not in the frame of what is above.
    fn is_apart(&self, node: usize) -> bool {
        if self.nodes[node].kind != kind::SPECIAL {
            return false;
        }
        match self.specials.get(self.payloads[node] as usize) {
            Some(Special::Camera { camera, .. }) => camera.frame == ReferenceFrame::Absolute,
            Some(Special::AbsoluteTransform) => true,
            _ => false,
        }
    }

    fn tile_sphere(&self, node: usize) -> Vec4 {
        let tile = self.payloads[node];
        let Ok(root) = self.tiles.roots.binary_search_by_key(&tile, |r| r.tile) else {
            return Vec4::new(0.0, 0.0, 0.0, -UNBOUNDED); // below a top tile: the tile walk has its own bounds
        };
        let page_from_tile = self.transforms.page_from_node(self.tiles.roots[root].transform);
        let sphere = self.tile_root_spheres[root].transformed(&page_from_tile);
        if !sphere.center.is_finite() || !(0.0..f64::from(UNBOUNDED)).contains(&sphere.radius_m) {
            return Vec4::new(0.0, 0.0, 0.0, UNBOUNDED);
        }
        stored_sphere(sphere.center - self.origin, sphere.radius_m)
    }
}

/// A sphere relative to the page's origin as f32, grown by what the rounding may have lost.
fn stored_sphere(center: DVec3, radius_m: f64) -> Vec4 {
    let slack = rounding_slack(center.abs().max_element() + radius_m);
    let radius_m = radius_m + slack;
    if center.is_finite() && radius_m < f64::from(UNBOUNDED) {
        center.as_vec3().extend(radius_m as f32)
    } else {
        Vec4::new(0.0, 0.0, 0.0, UNBOUNDED)
    }
}

/// One f32 step at a coordinate: the spike measured that nothing is lost with it, and 1 leaf of 5 million without.
fn rounding_slack(coordinate_m: f64) -> f64 {
    coordinate_m * f64::from(f32::EPSILON)
}

/// What reaches farther, metres, is no bound: what is beside a vertex gone astray is culled as if that were not there. Ten
/// million kilometres.
const MOST_HALF_M: f64 = 1e10;
/// Nor is what lies farther from its page's frame, where f64 is of a step of a decimetre.
const MOST_CENTER_M: f64 = 1e15;

/// Not empty, and as things are.
fn usable(b: &Aabb) -> bool {
    !b.is_empty()
        && b.half_size().max_element() <= MOST_HALF_M
        && b.center().abs().max_element() <= MOST_CENTER_M
        && b.min.is_finite()
        && b.max.is_finite()
}
