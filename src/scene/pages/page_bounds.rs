//! The bounds of a page's nodes and drawables: fitted when the page is built, and again where it changes.
//!
//! A change fits its own subtree at once. Nodes above it become stale: their spheres grow to hold the change, and are
//! fitted once for all changes of a frame before the frame culls. Decode workers (any thread) build pages; update
//! changes them through `&mut`.

use glam::{DAffine3, DVec3, DVec4, Vec4};

use super::node_arrays::kind;
use super::page::Page;
use super::payload_tables::RareNode;
use super::stored_bounds::{EMPTY_SPHERE, UNBOUNDED, UNBOUNDED_SPHERE, stored_sphere};
use crate::math::{Aabb, BoundingSphere};
use crate::scene::error::SceneError;
use crate::scene::geometry::Mesh;
use crate::scene::id::NONE;
use crate::scene::nodes::{CameraNode, ReferenceFrame};

impl Page {
    /// Returns the sphere around everything, in the page's frame. What has no bounds, such as a text of constant size on the
    /// screen, counts with its position.
    pub fn bounding_sphere(&self) -> BoundingSphere {
        self.node_sphere(0).unwrap_or_else(|| self.sphere_of_bounded_parts())
    }

    /// Returns the sphere around the parts with bounds, and the positions of billboards without.
    fn sphere_of_bounded_parts(&self) -> BoundingSphere {
        let mut whole = BoundingSphere::EMPTY;
        let mut unbounded = vec![0];
        while let Some(node) = unbounded.pop() {
            let Some(record) = self.nodes().get(node) else { break };
            if record.kind == kind::TILE {
                continue;
            }
            let special = (record.kind == kind::SPECIAL).then(|| self.payloads()[node] as usize);
            let positions = match special.and_then(|payload| self.rare_nodes().get(payload)) {
                Some(RareNode::Billboard { positions, .. }) => positions.as_slice(),
                _ => &[],
            };
            for (k, drawable) in self.nodes.drawables_of(node).enumerate() {
                let transform = self.drawables.refs()[drawable].transform;
                let part = match (self.drawables.box_in_page(drawable, &self.transforms), positions.get(k)) {
                    (Some(bounds), _) => bounds.bounding_sphere(),
                    (None, Some(position)) => {
                        BoundingSphere::new(self.transforms.page_from_node(transform).transform_point3(*position), 0.0)
                    }
                    (None, None) => continue,
                };
                whole = whole.union(&part);
            }
            for child in self.nodes.children(node).filter(|child| !self.is_in_another_frame(*child)) {
                match self.node_sphere(child as u32) {
                    Some(sphere) => whole = whole.union(&sphere),
                    None => unbounded.push(child),
                }
            }
        }
        whole
    }

    /// Returns the sphere around a node, in the page's frame; `None` if it has none. The sphere of a stale node is
    /// computed as [`Self::compute_bounds`] will fit it.
    pub(crate) fn node_sphere(&self, node: u32) -> Option<BoundingSphere> {
        let stored = *self.spheres().get(node as usize)?;
        let is_stale = self.nodes.is_stale(node as usize);
        self.spheres.in_page(if is_stale { self.fitted_stale_sphere(node) } else { stored })
    }

    /// Returns the sphere that a stale node will have, without changing the page.
    fn fitted_stale_sphere(&self, node: u32) -> Vec4 {
        let spheres = self.spheres();
        let below = node..node + self.nodes()[node as usize].skip;
        let mut stale: Vec<u32> = self.spheres.stale().iter().copied().filter(|node| below.contains(node)).collect();
        stale.sort_unstable_by(|a, b| b.cmp(a));
        let mut fitted: Vec<(u32, Vec4)> = Vec::with_capacity(stale.len());
        for node in stale {
            let sphere = self.fitted_sphere(node as usize, |below| {
                match fitted.binary_search_by(|(node, _)| (below as u32).cmp(node)) {
                    Ok(at) => fitted[at].1,
                    Err(_) => spheres[below],
                }
            });
            fitted.push((node, sphere));
        }
        fitted.last().map_or(spheres[node as usize], |(_, sphere)| *sphere)
    }

    /// Returns the number of node spheres fitted so far, counting each node once when the page is built. Tests use it to
    /// check that many changes in a frame cost only what they touch.
    pub fn fitted_spheres(&self) -> u64 {
        self.spheres.fitted()
    }

    /// Returns true if nodes wait for [`Self::compute_bounds`].
    pub(crate) fn has_stale_bounds(&self) -> bool {
        !self.spheres.stale().is_empty()
    }

    /// Fits the spheres of all stale nodes, children before parents.
    pub(crate) fn compute_bounds(&mut self) {
        let mut stale = self.spheres.take_stale();
        stale.sort_unstable();
        for node in stale.iter().rev() {
            self.fit_spheres(*node as usize, *node as usize + 1);
            self.nodes.set_stale(*node as usize, false);
        }
        self.spheres.reuse_stale(stale);
    }

    /// Marks the nodes above a changed sphere as stale. Until they are fitted, their spheres also hold the changed one, so
    /// that nothing visible is culled. Every node above a stale node is stale.
    fn outdate_above(&mut self, node: u32) {
        let (mut below, mut above) = (node, self.parents()[node as usize]);
        while above != NONE {
            let has_grown = self.grow(above as usize, below as usize);
            let was_stale = self.nodes.is_stale(above as usize);
            if was_stale && !has_grown {
                return;
            }
            if !was_stale {
                self.nodes.set_stale(above as usize, true);
                self.spheres.push_stale(above);
            }
            (below, above) = (above, self.parents()[above as usize]);
        }
    }

    /// Enlarges a node's sphere to hold that of a child. Returns false if it does already.
    fn grow(&mut self, node: usize, child: usize) -> bool {
        let spheres = self.spheres();
        let (own, other) = (spheres[node].as_dvec4(), spheres[child].as_dvec4());
        let is_tile = self.nodes()[node].kind == kind::TILE;
        if is_tile || other.w < 0.0 || own.w >= f64::from(UNBOUNDED) || self.is_in_another_frame(child) {
            return false;
        }
        let (center, way) = (own.truncate(), other.truncate() - own.truncate());
        let apart_m = way.length();
        let grown = if own.w < 0.0 || other.w >= f64::from(UNBOUNDED) || apart_m + own.w <= other.w {
            spheres[child]
        } else if apart_m + other.w <= own.w {
            return false;
        } else {
            let radius_m = 0.5 * (apart_m + own.w + other.w);
            stored_sphere(center + way * ((radius_m - own.w) / apart_m), radius_m)
        };
        self.spheres.set(node, grown);
        true
    }

    /// Replaces the map of a transform node and fits the bounds of its subtree; nodes above it become stale. Returns false
    /// if the node is not a transform.
    pub(crate) fn set_transform(&mut self, node: u32, parent_from_node: DAffine3) -> Result<bool, SceneError> {
        let Some(record) = self.nodes.get(node).copied().filter(|record| record.kind == kind::TRANSFORM) else {
            return Ok(false);
        };
        if !parent_from_node.is_finite() {
            return Err(SceneError::NotFinite);
        }
        let index = node as usize;
        let end = index + record.skip as usize;
        let behind = self.nodes()[end];
        self.transforms.set(record.first_transform, parent_from_node, behind.first_transform);
        self.fit_billboards(index, end);
        self.fit_boxes(record.first_drawable as usize, behind.first_drawable as usize);
        self.fit_changed_spheres(index, end);
        Ok(true)
    }

    /// Replaces the values of a camera node. Nodes above it become stale if its reference frame changes. Returns false if
    /// the node is not a camera.
    pub(crate) fn set_camera(&mut self, node: u32, camera: CameraNode) -> bool {
        let Some(index) = self.nodes.payload_of(node, kind::SPECIAL) else { return false };
        let Some(old) = self.tables.camera_mut(index) else { return false };
        let has_moved = old.frame != camera.frame;
        *old = camera;
        if has_moved {
            self.outdate_above(node);
        }
        true
    }

    /// Fits the bounds to the new mesh of a drawable of a Geode and forgets its normal cone. Returns the drawable's index
    /// in the page; `None` if the node is not a Geode or has no such drawable.
    pub(crate) fn set_mesh_bounds(&mut self, node: u32, drawable: usize, mesh: &Mesh) -> Option<u32> {
        self.nodes.get(node).filter(|record| record.kind == kind::GEODE)?;
        let index = node as usize;
        // The drawables of a node come before those of its children.
        let own = self.nodes.drawables_of(index);
        let number = own.start.checked_add(drawable).filter(|number| own.contains(number))?;
        self.drawables.set_local_box(number, mesh.bounds);
        self.drawables.forget_normal_cone(number as u32);
        self.fit_boxes(number, number + 1);
        self.fit_changed_spheres(index, index + 1);
        Some(number as u32)
    }

    /// Fits the spheres of a subtree; nodes above it become stale if its own sphere changes.
    fn fit_changed_spheres(&mut self, node: usize, end: usize) {
        let before = self.spheres()[node];
        self.fit_spheres(node, end);
        if self.spheres()[node] != before {
            self.outdate_above(node as u32);
        }
    }

    /// Computes the local boxes of the billboards in a range of nodes. They depend on the transforms above, since a
    /// billboard turns.
    pub(super) fn fit_billboards(&mut self, first: usize, end: usize) {
        if self.tables.rare_nodes().is_empty() {
            return;
        }
        for node in (first..end).filter(|node| self.nodes.records()[*node].kind == kind::SPECIAL) {
            let payload = self.nodes.payloads()[node] as usize;
            let Some(RareNode::Billboard { mode, auto_scale, positions, bounds }) =
                self.tables.rare_nodes().get(payload)
            else {
                continue;
            };
            let max_scale = auto_scale.map_or(1.0, |scale| scale.max);
            for ((drawable, position), bounds) in self.nodes.drawables_of(node).zip(positions).zip(bounds) {
                let transform = self.drawables.refs()[drawable].transform;
                let reach = max_scale * mode.reach(&self.transforms.page_from_node(transform).matrix3, bounds);
                self.drawables.set_local_box(drawable, Aabb { min: *position - reach, max: *position + reach });
            }
        }
    }

    /// Computes the boxes in the page's frame of a range of drawables.
    pub(super) fn fit_boxes(&mut self, first: usize, end: usize) {
        self.drawables.fit(first..end, &self.transforms, self.spheres.origin());
    }

    /// Computes the spheres of a range of nodes from those of their children, deepest first.
    pub(super) fn fit_spheres(&mut self, first: usize, end: usize) {
        for node in (first..end).rev() {
            let sphere = self.fitted_sphere(node, |below| self.spheres()[below]);
            self.spheres.set(node, sphere);
        }
        self.spheres.count_fitted((end - first) as u64);
    }

    /// Returns the sphere of a node from those of its children: its centre is the middle of the box around them, its radius
    /// holds them all (as OSG's `Group::computeBound`).
    fn fitted_sphere(&self, node: usize, sphere_of: impl Fn(usize) -> Vec4) -> Vec4 {
        if self.nodes()[node].kind == kind::TILE {
            return self.tile_sphere(node);
        }
        let origin = self.origin();
        let mut around = Aabb::EMPTY;
        let mut is_unbounded = false;
        for drawable in self.nodes.drawables_of(node) {
            match self.drawables.box_in_page(drawable, &self.transforms) {
                Some(b) => around = around.union(&Aabb { min: b.min - origin, max: b.max - origin }),
                None => is_unbounded = true,
            }
        }
        let own_box = around;
        for child in self.nodes.children(node) {
            let is_apart = self.is_in_another_frame(child);
            let s = if is_apart { DVec4::NEG_ONE } else { sphere_of(child).as_dvec4() };
            if s.w >= f64::from(UNBOUNDED) {
                is_unbounded = true;
            } else if s.w >= 0.0 {
                let (c, r) = (s.truncate(), DVec3::splat(s.w));
                around = around.union(&Aabb { min: c - r, max: c + r });
            }
        }
        if is_unbounded {
            return UNBOUNDED_SPHERE;
        }
        if around.is_empty() {
            return EMPTY_SPHERE;
        }
        let center = around.center();
        let mut radius_m = 0.0f64;
        if !own_box.is_empty() {
            radius_m = (own_box.center() - center).length() + own_box.half_size().length();
        }
        for child in self.nodes.children(node) {
            let s = sphere_of(child).as_dvec4();
            if s.w >= 0.0 && !self.is_in_another_frame(child) {
                radius_m = radius_m.max(s.truncate().distance(center) + s.w);
            }
        }
        stored_sphere(center, radius_m)
    }

    /// Returns true for nodes whose children are not in the frame of the nodes above: their spheres do not count there.
    fn is_in_another_frame(&self, node: usize) -> bool {
        if self.nodes()[node].kind != kind::SPECIAL {
            return false;
        }
        match self.rare_nodes().get(self.payloads()[node] as usize) {
            Some(RareNode::Camera { camera, .. }) => camera.frame == ReferenceFrame::Absolute,
            Some(RareNode::AbsoluteTransform) => true,
            _ => false,
        }
    }

    /// Returns the sphere of a tile node: the declared one for a top tile, an empty one below it, where the tile walk has
    /// its own bounds.
    fn tile_sphere(&self, node: usize) -> Vec4 {
        let Some((root, sphere)) = self.tiles.root_with_sphere(self.payloads()[node]) else { return EMPTY_SPHERE };
        let sphere = sphere.transformed(&self.transforms.page_from_node(root.transform));
        if !sphere.center.is_finite() || !(0.0..f64::from(UNBOUNDED)).contains(&sphere.radius_m) {
            return UNBOUNDED_SPHERE;
        }
        stored_sphere(sphere.center - self.origin(), sphere.radius_m)
    }
}
