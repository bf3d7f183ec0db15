//! The drawables of a page's nodes: tested one by one, or taken as a range where they are wholly inside, with the
//! matrices above them.

use std::ops::Range;

use glam::{DAffine3, DVec3, Vec4};

use super::planes::depth_row;
use super::stage::RenderLeaf;
use super::visitor::{Cull, DepthRange, PageContext};
use crate::scene::{DrawSlot, SingleDrawable, UNBOUNDED};

impl Cull<'_> {
    /// Stores the matrices of a range of transforms one behind the other and returns the first's index.
    #[inline(always)]
    pub(super) fn push_transforms(&mut self, context: &PageContext, transforms: Range<usize>) -> u32 {
        let matrices = &mut self.stage.eye_from_drawable;
        let first = matrices.len() as u32;
        let known = &mut self.linear_rows;
        matrices.extend(transforms.map(|transform| transform_rows(context, known, transform)));
        first
    }

    /// Stores the matrix of one transform and returns its index.
    #[inline(always)]
    pub(super) fn push_transform(&mut self, context: &PageContext, transform: usize) -> u32 {
        let matrix = transform_rows(context, &mut self.linear_rows, transform);
        let matrices = &mut self.stage.eye_from_drawable;
        let index = matrices.len() as u32;
        matrices.push(matrix);
        index
    }

    /// Depth and reach of a drawable that is seen; `None` where it is not. Widens near and far.
    #[inline(always)]
    pub(super) fn test_drawable(&mut self, context: &PageContext, drawable: u32, mask: u8) -> Option<(f32, f32)> {
        let row = context.depth;
        self.counters.drawables_tested += 1;
        let (center, half) = box_of(context, drawable);
        if mask != 0 && context.planes.box_is_outside(center, half, mask) {
            return None;
        }
        let depth = row.x * center[0] + row.y * center[1] + row.z * center[2] + row.w;
        self.widen_range(row, depth, half).map(|reach| (depth, reach))
    }

    /// The reach of a box whose middle is in a depth; `None` where it is wholly behind the eye. Widens near and far.
    #[inline(always)]
    fn widen_range(&mut self, row: Vec4, depth: f32, half: [f32; 3]) -> Option<f32> {
        let reach = row.x.abs() * half[0] + row.y.abs() * half[1] + row.z.abs() * half[2];
        if half[0] < UNBOUNDED {
            if depth + reach < self.view.least_depth {
                return None;
            }
            if depth - reach < self.range.near {
                self.range.near = depth - reach;
            }
            if depth + reach > self.range.far {
                self.range.far = depth + reach;
            }
        }
        Some(reach)
    }

    /// The depth of a drawable that no test may cull. Widens near and far.
    pub(super) fn depth_of_unculled(&mut self, context: &PageContext, drawable: u32) -> f32 {
        let (center, half) = box_of(context, drawable);
        let row = context.depth;
        let depth = row.x * center[0] + row.y * center[1] + row.z * center[2] + row.w;
        // What is behind the eye says nothing of near and far.
        let _ = self.widen_range(row, depth, half);
        depth
    }

    /// Emits the drawables of a node that is not to be culled, nor what it draws.
    #[cold]
    pub(super) fn take_unculled(&mut self, context: &PageContext, node: u32, matrix: u32) {
        let nodes = &context.page.nodes()[node as usize..];
        for drawable in nodes[0].first_drawable..nodes[1].first_drawable {
            let depth = self.depth_of_unculled(context, drawable);
            self.emit(context, drawable, depth, matrix);
        }
    }

    /// Tests and emits the drawable of a page that is one drawable, under a state.
    pub(super) fn take_lone(&mut self, lone: &SingleDrawable, eye_from_page: &DAffine3, state: u32, mask: u8) {
        if mask != 0 {
            let planes = self.view.planes.in_frame(eye_from_page, lone.center);
            if planes.box_is_outside([0.0; 3], lone.half_m, mask) {
                self.counters.nodes_visited += 1;
                return;
            }
        }
        self.counters.nodes_visited += lone.nodes;
        self.counters.drawables_tested += 1;
        let row = depth_row(eye_from_page, lone.center, self.view.depth_axis);
        if self.widen_range(row, row.w, lone.half_m).is_none() {
            return;
        }
        let state = match &lone.state {
            Some((path, set)) => self.graph.find_or_insert_path(*path, state, set),
            None => state,
        };
        let state = self.graph.meet(state, self.stage);
        let matrix = self.push_matrix(&(*eye_from_page * lone.page_from_drawable));
        self.leaves.push(RenderLeaf { slot: lone.slot, state, matrix, depth: row.w });
    }

    /// [`Self::test_drawable`] where there may be occluders.
    pub(super) fn test_behind_occluders(
        &mut self,
        context: &PageContext,
        drawable: u32,
        mask: u8,
    ) -> Option<(f32, f32)> {
        let range = self.range;
        let seen = self.test_drawable(context, drawable, mask)?;
        let (center, half) = box_of(context, drawable);
        let along = |p: Vec4| p.x.abs() * half[0] + p.y.abs() * half[1] + p.z.abs() * half[2];
        if half[0] < UNBOUNDED && self.occluders.hide(self.page_occluders, center, along) {
            self.counters.occluded += 1;
            self.range = range;
            return None;
        }
        Some(seen)
    }

    /// True where a drawable's faces all look away.
    #[cold]
    fn looks_away(&self, context: &PageContext, drawable: u32) -> bool {
        let page = context.page;
        let Some(cone) = page.normal_cones().get(drawable) else { return false };
        let transform = page.drawable_refs()[drawable as usize].transform;
        let eye = page.transforms().point_in_node(transform, context.eye);
        if self.view.ranges.is_parallel() {
            // Seen from everywhere along the same way, also what is behind the eye.
            let toward_eye = context.eye - context.depth.truncate().as_dvec3();
            let toward_eye = page.transforms().point_in_node(transform, toward_eye) - eye;
            return toward_eye.dot(cone.normal) < cone.least_cosine * toward_eye.length();
        }
        let to_eye = eye - cone.control_point;
        let distance_m = to_eye.length();
        distance_m > cone.radius_m && to_eye.dot(cone.normal) < cone.least_cosine * distance_m
    }

    /// Tests drawables of a node that crosses some plane (or not) and emits those that are seen.
    #[inline(never)]
    pub(super) fn test_drawables(&mut self, context: &PageContext, first: u32, end: u32, mask: u8, matrix: u32) {
        for drawable in first..end {
            self.test_and_emit(context, drawable, mask, matrix);
        }
    }

    #[inline(always)]
    pub(super) fn test_and_emit(&mut self, context: &PageContext, drawable: u32, mask: u8, matrix: u32) {
        let seen = if context.looks_closer {
            self.test_closely(context, drawable, mask)
        } else {
            self.test_drawable(context, drawable, mask)
        };
        let Some((depth, _)) = seen else { return };
        self.emit(context, drawable, depth, matrix);
    }

    #[inline(always)]
    pub(super) fn emit(&mut self, context: &PageContext, drawable: u32, depth: f32, matrix: u32) {
        let state = self.state_of(context.page, context.page.drawable_refs()[drawable as usize].state_path);
        let slot = context.slots.get(drawable as usize).copied().unwrap_or(DrawSlot::NONE);
        self.leaves.push(RenderLeaf { slot, state, matrix, depth });
    }

    /// [`Self::test_drawable`] where normal cones, occluders or primitives count.
    #[cold]
    fn test_closely(&mut self, context: &PageContext, drawable: u32, mask: u8) -> Option<(f32, f32)> {
        if context.has_clusters && self.looks_away(context, drawable) {
            return None;
        }
        let range = self.range;
        let (depth, reach) = self.test_behind_occluders(context, drawable, mask)?;
        if context.by_primitives && self.put_aside(context, drawable, depth, reach) {
            self.range = range;
        }
        Some((depth, reach))
    }

    /// Takes a subtree that is wholly inside: its transforms and its drawables are ranges, its nodes stay unread.
    pub(super) fn take_inside(&mut self, context: &PageContext, first: u32, end: u32, matrix: u32) {
        let page = context.page;
        let (from, to) = (page.nodes()[first as usize], page.nodes()[end as usize]);
        let first_transform = from.first_transform;
        let base = self.push_transforms(context, first_transform as usize..to.first_transform as usize);
        let matrix_of = |transform: u32| {
            if transform >= first_transform { base + (transform - first_transform) } else { matrix }
        };
        let (first, end) = (from.first_drawable as usize, to.first_drawable as usize);
        self.leaves.reserve(end - first);
        let row = context.depth;
        let abs = row.abs();
        let least_depth = Vec4::splat(self.view.least_depth);
        let (mut near, mut far) = (Vec4::splat(self.range.near), Vec4::splat(self.range.far));
        let blocks = first / 4..end.div_ceil(4);
        let mut start = 4 * blocks.start;
        for four in page.boxes().get(blocks).unwrap_or_default() {
            // At the ends some of the four are others'.
            let own = first.max(start)..end.min(start + 4);
            let [cx, cy, cz] = four.center;
            let [hx, hy, hz] = four.half;
            let depth = cx * row.x + cy * row.y + cz * row.z + Vec4::splat(row.w);
            let reach = hx * abs.x + hy * abs.y + hz * abs.z;
            let (nearest, farthest) = (depth - reach, depth + reach);
            if (farthest.cmplt(least_depth) | hx.cmpge(Vec4::splat(UNBOUNDED))).any() {
                self.range = DepthRange { near: near.min_element(), far: far.max_element() };
                self.take_singly(context, own, &matrix_of);
                (near, far) = (Vec4::splat(self.range.near), Vec4::splat(self.range.far));
            } else if own.len() < 4 {
                let (nearest, farthest) = (nearest.to_array(), farthest.to_array());
                let depths = depth.to_array();
                self.counters.drawables_tested += own.len() as u32;
                for drawable in own {
                    let lane = drawable - start;
                    near = lesser(Vec4::splat(nearest[lane]), near);
                    far = greater(Vec4::splat(farthest[lane]), far);
                    let of = page.drawable_refs()[drawable];
                    let state = self.state_of(page, of.state_path);
                    let slot = context.slots.get(drawable).copied().unwrap_or(DrawSlot::NONE);
                    let matrix = matrix_of(of.transform);
                    self.leaves.push(RenderLeaf { slot, state, matrix, depth: depths[lane] });
                }
            } else {
                near = lesser(nearest, near);
                far = greater(farthest, far);
                self.counters.drawables_tested += 4;
                let Some(of) = page.drawable_refs()[start..].first_chunk::<4>() else { break };
                let slots = context.slots.get(start..).and_then(|s| s.first_chunk::<4>());
                let slots = slots.unwrap_or(&[DrawSlot::NONE; 4]);
                let states = self.states_of(page, of.map(|r| r.state_path));
                let depths = depth.to_array();
                let leaf = |i: usize| RenderLeaf {
                    slot: slots[i],
                    state: states[i],
                    matrix: matrix_of(of[i].transform),
                    depth: depths[i],
                };
                self.leaves.extend_from_slice(&[leaf(0), leaf(1), leaf(2), leaf(3)]);
            }
            start += 4;
        }
        self.range = DepthRange { near: near.min_element(), far: far.max_element() };
    }

    fn take_singly(&mut self, context: &PageContext, drawables: Range<usize>, matrix_of: &impl Fn(u32) -> u32) {
        for drawable in drawables {
            let matrix = matrix_of(context.page.drawable_refs()[drawable].transform);
            self.test_drawables(context, drawable as u32, drawable as u32 + 1, 0, matrix);
        }
    }
}

/// The lesser of each; of what is no number what is known.
#[inline(always)]
fn lesser(new: Vec4, known: Vec4) -> Vec4 {
    // There a NaN in the first operand loses.
    if cfg!(target_arch = "x86_64") { new.min(known) } else { Vec4::select(new.cmplt(known), new, known) }
}

/// The greater of each; of what is no number what is known.
#[inline(always)]
fn greater(new: Vec4, known: Vec4) -> Vec4 {
    if cfg!(target_arch = "x86_64") { new.max(known) } else { Vec4::select(new.cmpgt(known), new, known) }
}

/// Centre and half size of a drawable's box.
#[inline(always)]
fn box_of(context: &PageContext, drawable: u32) -> ([f32; 3], [f32; 3]) {
    let four = &context.page.boxes()[drawable as usize / 4];
    let lane = drawable as usize % 4;
    let of = |v: &Vec4| AsRef::<[f32; 4]>::as_ref(v)[lane];
    (four.center.each_ref().map(of), four.half.each_ref().map(of))
}

/// The matrix of a transform as rows. `known` is the linear part that was multiplied last, and the product.
#[inline(always)]
fn transform_rows(context: &PageContext, known: &mut (u32, [Vec4; 3]), transform: usize) -> [[f32; 4]; 3] {
    let all = context.page.transforms();
    let of = all.linear_of()[transform];
    if of != known.0 {
        multiply_linear(context, known, of);
    }
    let [px, py, pz] = all.translations()[transform];
    let at = &context.visit.eye_from_page.translation;
    let along = |row: &DVec3, at: f64| Vec4::W * (row.x * px + row.y * py + row.z * pz + at) as f32;
    let ([x, y, z], linear) = (&context.eye_rows, &known.1);
    [linear[0] + along(x, at.x), linear[1] + along(y, at.y), linear[2] + along(z, at.z)].map(|row| row.to_array())
}

#[inline(never)]
fn multiply_linear(context: &PageContext, known: &mut (u32, [Vec4; 3]), linear: u32) {
    let page_from_node = context.page.transforms().linears()[linear as usize].page_from_node;
    let matrix3 = context.visit.eye_from_page.matrix3 * page_from_node;
    let rows = super::visitor::rows(&DAffine3 { matrix3, translation: DVec3::ZERO });
    *known = (linear, rows.map(Vec4::from_array));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_is_neither_least_nor_greatest() {
        let (new, known) = (Vec4::new(f32::NAN, 1.0, 5.0, f32::NEG_INFINITY), Vec4::new(3.0, 3.0, 3.0, 3.0));
        assert_eq!(lesser(new, known).to_array(), [3.0, 1.0, 3.0, f32::NEG_INFINITY]);
        assert_eq!(greater(new, known).to_array(), [3.0, 3.0, 5.0, 3.0]);
    }
}
