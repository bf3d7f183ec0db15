//! The drawables of a page's nodes: tested one by one, or taken as a range where they are wholly inside the frustum.
//! Culling thread.

use std::ops::Range;

use glam::{DAffine3, Vec4};

use super::page_context::{PageContext, drawable_info};
use super::traversal::Traversal;
use crate::cull::stage::RenderLeaf;
use crate::cull::views::DepthRange;
use crate::cull::views::depth_row;
use crate::scene::{CullAction, CullingMode, DrawSlot, NormalCone, SingleDrawable, UNBOUNDED};

impl Traversal<'_> {
    /// Tests a drawable against the frustum and widens near and far. Returns the depth of its centre and its extent along
    /// the depth axis, or `None` if it is culled.
    #[inline(always)]
    pub(super) fn test_drawable(&mut self, context: &PageContext, drawable: u32, mask: u8) -> Option<(f32, f32)> {
        let row = context.depth;
        self.counters.drawables_tested += 1;
        let (center, half) = box_of(context, drawable);
        if mask != 0 && context.planes.box_is_outside(center, half, mask) {
            return None;
        }
        let depth = row.x * center[0] + row.y * center[1] + row.z * center[2] + row.w;
        match self.widen_depths(row, depth, half) {
            Some(reach) => Some((depth, reach)),
            None if self.camera.culls_contents => None,
            None => Some((depth, 0.0)),
        }
    }

    /// Widens near and far by a box whose centre is at a depth. Returns its extent along the depth axis, or `None` if it
    /// lies wholly behind the eye.
    #[inline(always)]
    fn widen_depths(&mut self, row: Vec4, depth: f32, half: [f32; 3]) -> Option<f32> {
        let reach = row.x.abs() * half[0] + row.y.abs() * half[1] + row.z.abs() * half[2];
        if half[0] < UNBOUNDED {
            if depth + reach < self.views.current().min_depth {
                return None;
            }
            self.views.widen(depth - reach, depth + reach);
        }
        Some(reach)
    }

    /// Returns the depth of a drawable that is never culled, and widens near and far.
    pub(super) fn depth_of_unculled(&mut self, context: &PageContext, drawable: u32) -> f32 {
        let (center, half) = box_of(context, drawable);
        let row = context.depth;
        let depth = row.x * center[0] + row.y * center[1] + row.z * center[2] + row.w;
        // A drawable behind the eye leaves near and far as they are.
        let _ = self.widen_depths(row, depth, half);
        depth
    }

    /// Emits the drawables of a node that is never culled.
    #[cold]
    pub(super) fn take_unculled(&mut self, context: &PageContext, node: u32, matrix: u32) {
        let nodes = &context.page.nodes()[node as usize..];
        for drawable in nodes[0].first_drawable..nodes[1].first_drawable {
            let action = self.ask_drawable(context, drawable);
            if action.visits() {
                let depth = self.depth_of_unculled(context, drawable);
                self.emit_as(&action, context, drawable, depth, matrix);
            }
        }
    }

    /// Tests and emits the only drawable of a page, under a state.
    pub(super) fn take_single_drawable(
        &mut self,
        lone: &SingleDrawable,
        eye_from_page: &DAffine3,
        state: u32,
        mask: u8,
    ) {
        if mask != 0 {
            let planes = self.views.current().planes.in_frame(eye_from_page, lone.center);
            if planes.box_is_outside([0.0; 3], lone.half_m, mask) {
                self.counters.nodes_visited += 1;
                return;
            }
        }
        self.counters.nodes_visited += lone.nodes;
        self.counters.drawables_tested += 1;
        let eye_from_drawable = *eye_from_page * lone.page_from_drawable;
        let state = match &lone.state {
            Some((path, set)) => self.states.below(*path, state, set),
            None => state,
        };
        if let Some(cone) = &lone.cone
            && self.single_looks_away(cone, &eye_from_drawable, state)
        {
            return;
        }
        let row = depth_row(eye_from_page, lone.center, self.views.current().depth_axis);
        if self.widen_depths(row, row.w, lone.half_m).is_none() && self.camera.culls_contents {
            return;
        }
        let state = self.states.meet(state, self.stage);
        let matrix = self.push_matrix(&eye_from_drawable);
        self.leaves.push(RenderLeaf { slot: lone.slot, state, matrix, depth: row.w });
    }

    /// Tests a drawable as [`Self::test_drawable`], and against the occluders.
    pub(super) fn test_behind_occluders(
        &mut self,
        context: &PageContext,
        drawable: u32,
        mask: u8,
    ) -> Option<(f32, f32)> {
        let depths = self.views.depths();
        let seen = self.test_drawable(context, drawable, mask)?;
        let (center, half) = box_of(context, drawable);
        let along = |p: Vec4| p.x.abs() * half[0] + p.y.abs() * half[1] + p.z.abs() * half[2];
        if half[0] < UNBOUNDED && self.occlusion.hides_in_page(center, along) {
            self.counters.occluded += 1;
            self.views.set_depths(depths);
            return None;
        }
        Some(seen)
    }

    /// Returns true if all faces of a drawable look away from the eye, by its normal cone, and its state culls them.
    #[cold]
    fn looks_away(&mut self, context: &PageContext, drawable: u32) -> bool {
        let page = context.page;
        let Some(cone) = page.normal_cones().get(drawable) else { return false };
        let of = page.drawable_refs()[drawable as usize];
        let eye = page.transforms().point_in_node(of.transform, context.eye);
        let is_parallel = self.views.current().ranges.is_parallel();
        // Parallel rays have the same direction everywhere, also behind the eye.
        let toward_eye = is_parallel.then(|| {
            let toward_eye = context.eye - context.depth.truncate().as_dvec3();
            page.transforms().point_in_node(of.transform, toward_eye) - eye
        });
        if !cone.looks_away(eye, toward_eye) {
            return false;
        }
        let state = self.states.path_state(page, of.state_path);
        self.states.culls_backs(state)
    }

    /// Returns true if all faces of the only drawable of a page look away from the eye, and its state culls them.
    #[cold]
    fn single_looks_away(&self, cone: &NormalCone, eye_from_drawable: &DAffine3, state: u32) -> bool {
        let view = self.views.current();
        let drawable_from_eye = eye_from_drawable.inverse();
        let is_parallel = view.ranges.is_parallel();
        let toward_eye = is_parallel.then(|| drawable_from_eye.transform_vector3(-view.depth_axis));
        view.camera.settings.culling.contains(CullingMode::CLUSTER)
            && drawable_from_eye.is_finite()
            && cone.looks_away(drawable_from_eye.translation, toward_eye)
            && self.states.culls_backs(state)
    }

    /// Tests a range of drawables and emits those that are seen.
    #[inline(never)]
    pub(super) fn test_drawables(&mut self, context: &PageContext, first: u32, end: u32, mask: u8, matrix: u32) {
        for drawable in first..end {
            self.test_and_emit(context, drawable, mask, matrix);
        }
    }

    /// Tests a drawable and emits it if it is seen.
    #[inline(always)]
    pub(super) fn test_and_emit(&mut self, context: &PageContext, drawable: u32, mask: u8, matrix: u32) {
        if context.looks_closer {
            return self.test_closely_and_emit(context, drawable, mask, matrix);
        }
        let Some((depth, _)) = self.test_drawable(context, drawable, mask) else { return };
        self.emit(context, drawable, depth, matrix);
    }

    /// Does the same for a drawable that may have a callback or a normal cone, in a view with occluders or primitives.
    #[cold]
    fn test_closely_and_emit(&mut self, context: &PageContext, drawable: u32, mask: u8, matrix: u32) {
        let action = self.ask_drawable(context, drawable);
        if action.visits()
            && let Some((depth, _)) = self.test_closely(context, drawable, mask)
        {
            self.emit_as(&action, context, drawable, depth, matrix);
        }
    }

    /// Asks the cull callback of a drawable; one without a callback is visited.
    pub(super) fn ask_drawable(&self, context: &PageContext, drawable: u32) -> CullAction {
        let Some(callback) = context.page.drawable_callbacks().get(drawable) else { return CullAction::Traverse };
        let (center, half) = box_of(context, drawable);
        (callback.0)(&drawable_info(context, center, half[0] < UNBOUNDED, self.camera.frame))
    }

    /// Adds the leaves of a drawable for an action of its cull callback.
    pub(super) fn emit_as(
        &mut self,
        action: &CullAction,
        context: &PageContext,
        drawable: u32,
        depth: f32,
        matrix: u32,
    ) {
        let CullAction::Passes(passes) = action else { return self.emit(context, drawable, depth, matrix) };
        let path = context.page.drawable_refs()[drawable as usize].state_path;
        let slot = context.slots.get(drawable as usize).copied().unwrap_or(DrawSlot::NONE);
        for sets in passes.iter() {
            let state = self.states.leaf_state_below(context.page, path, sets, self.stage);
            self.leaves.push(RenderLeaf { slot, state, matrix, depth });
        }
    }

    /// Adds the leaf of a drawable.
    #[inline(always)]
    pub(super) fn emit(&mut self, context: &PageContext, drawable: u32, depth: f32, matrix: u32) {
        let path = context.page.drawable_refs()[drawable as usize].state_path;
        let state = self.states.leaf_state(context.page, path, self.stage);
        let slot = context.slots.get(drawable as usize).copied().unwrap_or(DrawSlot::NONE);
        self.leaves.push(RenderLeaf { slot, state, matrix, depth });
    }

    /// Tests a drawable as [`Self::test_drawable`], and by its normal cone, occluders and primitives.
    fn test_closely(&mut self, context: &PageContext, drawable: u32, mask: u8) -> Option<(f32, f32)> {
        if context.has_clusters && self.looks_away(context, drawable) {
            return None;
        }
        let depths = self.views.depths();
        let (depth, reach) = self.test_behind_occluders(context, drawable, mask)?;
        let view = self.views.current().index;
        if context.by_primitives && self.primitives.add(context, drawable, depth, reach, view) {
            self.views.set_depths(depths);
        }
        Some((depth, reach))
    }

    /// Takes a subtree that is wholly inside the frustum: ranges of transforms and of drawables, without reading its nodes.
    pub(super) fn take_inside(&mut self, context: &PageContext, first: u32, end: u32, matrix: u32) {
        let page = context.page;
        let (from, to) = (page.nodes()[first as usize], page.nodes()[end as usize]);
        let first_transform = from.first_transform;
        let transforms = first_transform as usize..to.first_transform as usize;
        let base = self.matrices.push_range(context, transforms, &mut self.stage.eye_from_drawable);
        let matrix_of = |transform: u32| {
            if transform >= first_transform { base + (transform - first_transform) } else { matrix }
        };
        let (first, end) = (from.first_drawable as usize, to.first_drawable as usize);
        self.leaves.reserve(end - first);
        let row = context.depth;
        let abs = row.abs();
        let min_depth = Vec4::splat(self.views.current().min_depth);
        let mut depths = self.views.depths();
        let (mut near, mut far) = (Vec4::splat(depths.near), Vec4::splat(depths.far));
        let blocks = first / 4..end.div_ceil(4);
        let mut start = 4 * blocks.start;
        for four in page.boxes().get(blocks).unwrap_or_default() {
            // The first and the last four may hold drawables of other nodes.
            let own = first.max(start)..end.min(start + 4);
            let [cx, cy, cz] = four.center;
            let [hx, hy, hz] = four.half;
            let depth = cx * row.x + cy * row.y + cz * row.z + Vec4::splat(row.w);
            let reach = hx * abs.x + hy * abs.y + hz * abs.z;
            let (nearest, farthest) = (depth - reach, depth + reach);
            if (farthest.cmplt(min_depth) | hx.cmpge(Vec4::splat(UNBOUNDED))).any() {
                self.views.set_depths(DepthRange { near: near.min_element(), far: far.max_element() });
                self.take_singly(context, own, &matrix_of);
                depths = self.views.depths();
                (near, far) = (Vec4::splat(depths.near), Vec4::splat(depths.far));
            } else if own.len() < 4 {
                let (nearest, farthest) = (nearest.to_array(), farthest.to_array());
                let depth = depth.to_array();
                self.counters.drawables_tested += own.len() as u32;
                for drawable in own {
                    let lane = drawable - start;
                    near = lesser(Vec4::splat(nearest[lane]), near);
                    far = greater(Vec4::splat(farthest[lane]), far);
                    let of = page.drawable_refs()[drawable];
                    let state = self.states.leaf_state(page, of.state_path, self.stage);
                    let slot = context.slots.get(drawable).copied().unwrap_or(DrawSlot::NONE);
                    let matrix = matrix_of(of.transform);
                    self.leaves.push(RenderLeaf { slot, state, matrix, depth: depth[lane] });
                }
            } else {
                near = lesser(nearest, near);
                far = greater(farthest, far);
                self.counters.drawables_tested += 4;
                let Some(of) = page.drawable_refs()[start..].first_chunk::<4>() else { break };
                let slots = context.slots.get(start..).and_then(|s| s.first_chunk::<4>());
                let slots = slots.unwrap_or(&[DrawSlot::NONE; 4]);
                let states = self.states.leaf_states(page, of.map(|r| r.state_path), self.stage);
                let depth = depth.to_array();
                let leaf = |i: usize| RenderLeaf {
                    slot: slots[i],
                    state: states[i],
                    matrix: matrix_of(of[i].transform),
                    depth: depth[i],
                };
                self.leaves.extend_from_slice(&[leaf(0), leaf(1), leaf(2), leaf(3)]);
            }
            start += 4;
        }
        self.views.set_depths(DepthRange { near: near.min_element(), far: far.max_element() });
    }

    /// Tests the drawables of a block of which some are unbounded or behind the eye.
    fn take_singly(&mut self, context: &PageContext, drawables: Range<usize>, matrix_of: &impl Fn(u32) -> u32) {
        for drawable in drawables {
            let matrix = matrix_of(context.page.drawable_refs()[drawable].transform);
            self.test_drawables(context, drawable as u32, drawable as u32 + 1, 0, matrix);
        }
    }
}

/// Returns the lesser of each component; a NaN in `new` loses.
#[inline(always)]
fn lesser(new: Vec4, known: Vec4) -> Vec4 {
    // The x86 instruction returns its second operand for a NaN in the first.
    if cfg!(target_arch = "x86_64") { new.min(known) } else { Vec4::select(new.cmplt(known), new, known) }
}

/// Returns the greater of each component; a NaN in `new` loses.
#[inline(always)]
fn greater(new: Vec4, known: Vec4) -> Vec4 {
    if cfg!(target_arch = "x86_64") { new.max(known) } else { Vec4::select(new.cmpgt(known), new, known) }
}

/// Returns centre and half size of a drawable's box.
#[inline(always)]
fn box_of(context: &PageContext, drawable: u32) -> ([f32; 3], [f32; 3]) {
    let four = &context.page.boxes()[drawable as usize / 4];
    let lane = drawable as usize % 4;
    let of = |v: &Vec4| AsRef::<[f32; 4]>::as_ref(v)[lane];
    (four.center.each_ref().map(of), four.half.each_ref().map(of))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_is_neither_least_nor_greatest() {
        let (new, known) = (Vec4::new(f32::NAN, 1.0, 5.0, f32::NEG_INFINITY), Vec4::new(3.0, 3.0, 3.0, 3.0));
        assert_eq!(lesser(new, known).to_array(), [3.0, 1.0, 3.0, f32::NEG_INFINITY]);
        assert_eq!(greater(new, known).to_array(), [3.0, 3.0, 5.0, 3.0]);
    }
}
