//! The flat scan of a page's nodes.

use glam::{DAffine3, DVec3, Vec4};

use super::fade::{Fade, LodShares, WHOLE};
use super::occluders::cull_info;
use super::stage::RenderLeaf;
use super::visitor::{Cull, DepthRange, PageContext, Purpose};
use crate::scene::{CALLBACK, CullAction, DrawSlot, INACTIVE, PLAIN, UNBOUNDED, kind};

/// What holds again behind a subtree.
#[derive(Clone, Copy, Debug)]
pub(super) struct Open {
    /// First node behind the subtree.
    end: u32,
    /// Matrix above the subtree.
    matrix: u32,
    /// Planes above the subtree.
    mask: u8,
}

/// Children of a Lod that can fade; those beyond change at once.
const MOST_FADING: usize = 64;

/// Subtrees of so few nodes are scanned: setting up the ranges would cost more.
const SMALL_SUBTREE: u32 = 4;

impl Cull<'_> {
    /// Visits nodes `first..last`, whole subtrees, under a matrix and the planes they may cross.
    pub(super) fn scan_nodes(&mut self, context: &PageContext, first: u32, last: u32, mask: u8, matrix: u32) {
        let page = context.page;
        let base = self.node_stack.len();
        let mut above = Open { end: last, matrix, mask };
        let mut node = first;
        let small_feature = self.view.small_feature;
        let cull_mask = self.view.settings.cull_mask;
        let takes_ranges = self.takes_ranges && small_feature == 0.0 && !context.by_primitives;
        let has_occluders = !self.occluders.is_empty();
        // A mask of 0 hides nodes of every mask, of those without one too.
        if cull_mask == 0 {
            if context.visit.required {
                self.keep_tiles(context, first, last);
            }
            return;
        }
        let has_masks = !page.masks.is_empty();
        // What few pages and cameras ask for, in one test for each node.
        let looks_closer = small_feature > 0.0 || has_occluders;
        // Counted here: a counter behind `self` is a load and a store for each node.
        let mut visited = 0;
        loop {
            while node >= above.end {
                let ours = self.node_stack.len() > base;
                match self.node_stack.pop_if(|_| ours) {
                    Some(open) => above = open,
                    None => {
                        self.counters.nodes_visited += visited;
                        return;
                    }
                }
            }
            let record = page.nodes[node as usize];
            let skip = record.skip;
            if has_masks && page.masks[node as usize] & cull_mask == 0 {
                if context.visit.required && record.flags & PLAIN == 0 {
                    self.keep_tiles(context, node, node + skip);
                }
                node += skip;
                continue;
            }
            visited += 1;
            let sphere = page.spheres[node as usize];
            let mut mask = above.mask;
            // One test for the many nodes that are nothing special.
            let mut is_active = true;
            if record.flags & (CALLBACK | INACTIVE) != 0 {
                if !self.asks_to_visit(context, node) {
                    node += skip;
                    continue;
                }
                is_active = record.flags & INACTIVE == 0;
            }
            if mask != 0 && is_active {
                match context.planes.test_sphere(sphere, mask) {
                    Some(crossing) => mask = crossing,
                    None => {
                        if context.visit.required && record.flags & PLAIN == 0 {
                            self.keep_tiles(context, node, node + skip);
                        }
                        node += skip;
                        continue;
                    }
                }
            }
            if looks_closer {
                // Not where tiles are below: their errors decide.
                if small_feature > 0.0 && record.flags & PLAIN != 0 && self.is_small(context, sphere) {
                    node += skip;
                    continue;
                }
                if has_occluders && is_active && self.is_occluded(sphere) {
                    if context.visit.required && record.flags & PLAIN == 0 {
                        self.keep_tiles(context, node, node + skip);
                    }
                    node += skip;
                    continue;
                }
            }
            if mask == 0 && skip > SMALL_SUBTREE && record.flags & PLAIN != 0 && takes_ranges {
                self.take_inside(context, node, node + skip, above.matrix);
                node += skip;
                continue;
            }
            match record.kind {
                kind::GEODE | kind::GROUP => {
                    let end = page.nodes[node as usize + 1].first_drawable;
                    let first = record.first_drawable;
                    if end == first + 1 {
                        // Mostly one, without what a loop keeps.
                        self.test_and_emit(context, first, mask, above.matrix);
                    } else if end > first {
                        self.test_drawables(context, first, end, mask, above.matrix);
                    }
                    if mask != above.mask && skip > 1 {
                        self.node_stack.push(above);
                        above = Open { end: node + skip, matrix: above.matrix, mask };
                    }
                    node += 1;
                }
                kind::TRANSFORM => {
                    let own = record.first_transform as usize;
                    let matrix = self.push_transform(context, own);
                    self.node_stack.push(above);
                    above = Open { end: node + skip, matrix, mask };
                    node += 1;
                }
                kind::TILE => {
                    let tile = page.payloads[node as usize];
                    if let Ok(root) = page.tiles.roots.binary_search_by_key(&tile, |r| r.tile) {
                        self.scan_tiles(page, &context.visit, root, mask, context.visit.purpose);
                    }
                    node += skip;
                }
                kind::SWITCH => {
                    let shown = &page.switches[page.payloads[node as usize] as usize];
                    let mut child = node + 1;
                    for index in 0.. {
                        if child >= node + skip {
                            break;
                        }
                        let next = child + page.nodes[child as usize].skip;
                        if shown.get(index).copied().unwrap_or(false) {
                            self.scan_nodes(context, child, next, mask, above.matrix);
                        }
                        child = next;
                    }
                    node += skip;
                }
                kind::SPECIAL => {
                    if self.visit_special(context, node, mask) {
                        node += skip;
                        continue;
                    }
                    if mask != above.mask && skip > 1 {
                        self.node_stack.push(above);
                        above = Open { end: node + skip, matrix: above.matrix, mask };
                    }
                    node += 1;
                }
                _ => {
                    let lod = &page.lods[page.payloads[node as usize] as usize];
                    let enclosing = self.enclosing_transform(context, node);
                    let eye = page.transforms.point_in_node(enclosing, context.eye);
                    let distance_m = eye.distance(lod.center) * self.view.settings.lod_scale;
                    let in_range = |r: &[f64; 2]| r[0] <= distance_m && distance_m < r[1];
                    let shares = self.lod_shares(context, node, lod.ranges_m.iter().map(in_range));
                    let mut child = node + 1;
                    for index in 0.. {
                        if child >= node + skip {
                            break;
                        }
                        let next = child + page.nodes[child as usize].skip;
                        let is_in_range = lod.ranges_m.get(index).is_some_and(in_range);
                        match shares.filter(|_| index < MOST_FADING) {
                            Some(shares) => {
                                self.scan_fading(context, child..next, mask, above.matrix, shares, 1 << index);
                            }
                            None if is_in_range => self.scan_nodes(context, child, next, mask, above.matrix),
                            None => {}
                        }
                        child = next;
                    }
                    node += skip;
                }
            }
        }
    }

    /// What a Lod draws while it changes between its children; `None` while it does not.
    fn lod_shares(
        &mut self,
        context: &PageContext,
        node: u32,
        in_range: impl Iterator<Item = bool>,
    ) -> Option<LodShares> {
        let fade_s = self.view.settings.lod_fade_s;
        if fade_s.is_nan() || fade_s <= 0.0 {
            return None;
        }
        let (page, place) = (context.page, context.visit.place);
        let active = in_range.take(MOST_FADING).enumerate().map(|(i, is)| u64::from(is) << i).sum();
        let lod = (page.payloads[node as usize] as usize, page.lods.len());
        let generation = self.scene.page_id_at(place).generation;
        let shares = self.fades.turn_lod(place, generation, lod, active, self.fades.step(fade_s));
        let is_fading = shares.share < WHOLE;
        self.counters.fading += u32::from(is_fading);
        is_fading.then_some(shares)
    }

    /// Visits a child of a Lod, whose bit is given, in its part of the pixels.
    #[cold]
    fn scan_fading(
        &mut self,
        context: &PageContext,
        nodes: std::ops::Range<u32>,
        mask: u8,
        matrix: u32,
        shares: LodShares,
        bit: u64,
    ) {
        let above = context.visit.fade;
        let (new, old) = above.band().split(shares.share);
        let (band, leaving) = match (shares.old & bit != 0, shares.new & bit != 0) {
            (true, true) => return self.scan_nodes(context, nodes.start, nodes.end, mask, matrix),
            (true, false) => (old, true),
            (false, true) => (new, above.leaving()),
            (false, false) => return,
        };
        if band.is_empty() {
            return;
        }
        // The states of the page's chains under another root, until the end of the child.
        let mut below = *context;
        below.visit.fade = Fade::new(band, above.covered(), leaving);
        below.visit.state = self.faded_state(context.visit.state, band);
        self.open_page(context.page, below.visit.state);
        self.scan_nodes(&below, nodes.start, nodes.end, mask, matrix);
        self.open_page(context.page, context.visit.state);
    }

    /// Keeps the tiles of a culled subtree: the page can only replace what is above it as a whole.
    #[cold]
    fn keep_tiles(&mut self, context: &PageContext, first: u32, end: u32) {
        let tiles = &context.page.tiles;
        let node_of = |root: usize| tiles.nodes[tiles.roots[root].tile as usize];
        let mut root = tiles.roots.partition_point(|r| tiles.nodes[r.tile as usize] < first);
        while root < tiles.roots.len() && node_of(root) < end {
            self.scan_tiles(context.page, &context.visit, root, 0, Purpose::Keep);
            root += 1;
        }
    }

    /// The transform in whose frame a node lies.
    pub(super) fn enclosing_transform(&self, context: &PageContext, node: u32) -> u32 {
        context.page.enclosing_transform(node)
    }

    /// Stores the matrices of a range of transforms one behind the other and returns the first's index.
    #[inline(always)]
    pub(super) fn push_transforms(&mut self, context: &PageContext, transforms: std::ops::Range<usize>) -> u32 {
        let matrices = &mut self.stage.eye_from_drawable;
        let first = matrices.len() as u32;
        let known = &mut self.linear_rows;
        matrices.extend(transforms.map(|transform| transform_rows(context, known, transform)));
        first
    }

    /// Stores the matrix of one transform and returns its index.
    #[inline(always)]
    fn push_transform(&mut self, context: &PageContext, transform: usize) -> u32 {
        let matrix = transform_rows(context, &mut self.linear_rows, transform);
        let matrices = &mut self.stage.eye_from_drawable;
        let index = matrices.len() as u32;
        matrices.push(matrix);
        index
    }

    /// True for a bound that projects to too few pixels.
    fn is_small(&self, context: &PageContext, sphere: Vec4) -> bool {
        let depth = context.depth.dot(sphere.truncate().extend(1.0));
        let scale = context.depth.truncate().length();
        sphere.w * scale < self.view.small_feature * (depth - sphere.w * scale)
    }

    /// What a node's cull callback says; true without one.
    #[cold]
    fn asks_to_visit(&mut self, context: &PageContext, node: u32) -> bool {
        let page = context.page;
        let Ok(place) = page.callbacks.binary_search_by_key(&node, |(n, _)| *n) else { return true };
        let info = cull_info(page, node, context.eye, self.camera.frame);
        matches!((page.callbacks[place].1.0)(&info), CullAction::Traverse)
    }

    /// True for a sphere in the shadow of an occluder.
    #[cold]
    fn is_occluded(&mut self, sphere: Vec4) -> bool {
        let center = sphere.truncate().to_array();
        let hidden =
            (0.0..UNBOUNDED).contains(&sphere.w) && self.occluders.hide(self.page_occluders, center, |_| sphere.w);
        self.counters.occluded += u32::from(hidden);
        hidden
    }

    /// Depth and reach of a drawable that is seen; `None` where it is not. Widens near and far.
    #[inline(always)]
    pub(super) fn test_drawable(&mut self, context: &PageContext, drawable: u32, mask: u8) -> Option<(f32, f32)> {
        let page = context.page;
        let row = context.depth;
        self.counters.drawables_tested += 1;
        let four = &page.boxes[drawable as usize / 4];
        let lane = drawable as usize % 4;
        let center = four.center.map(|c| c[lane]);
        let half = four.half.map(|h| h[lane]);
        if mask != 0 && context.planes.box_is_outside(center, half, mask) {
            return None;
        }
        let depth = row.x * center[0] + row.y * center[1] + row.z * center[2] + row.w;
        let reach = row.x.abs() * half[0] + row.y.abs() * half[1] + row.z.abs() * half[2];
        if half[0] < UNBOUNDED {
            if depth + reach < self.view.least_depth {
                return None; // wholly behind the eye
            }
            if !self.occluders.is_empty() {
                let along = |p: Vec4| p.x.abs() * half[0] + p.y.abs() * half[1] + p.z.abs() * half[2];
                if self.occluders.hide(self.page_occluders, center, along) {
                    self.counters.occluded += 1;
                    return None;
                }
            }
            if depth - reach < self.range.near {
                self.range.near = depth - reach;
            }
            if depth + reach > self.range.far {
                self.range.far = depth + reach;
            }
        }
        Some((depth, reach))
    }

    /// True where a drawable's faces all look away.
    #[cold]
    fn looks_away(&self, context: &PageContext, drawable: u32) -> bool {
        let page = context.page;
        let Ok(place) = page.clusters.binary_search_by_key(&drawable, |(d, _)| *d) else { return false };
        let cone = &page.clusters[place].1;
        let transform = page.drawable_refs[drawable as usize].transform;
        let to_eye = page.transforms.point_in_node(transform, context.eye) - cone.control_point;
        let distance_m = to_eye.length();
        distance_m > cone.radius_m && to_eye.dot(cone.normal) < cone.least_cosine * distance_m
    }

    /// Tests drawables of a node that crosses some plane (or not) and emits those that are seen.
    #[inline(never)]
    fn test_drawables(&mut self, context: &PageContext, first: u32, end: u32, mask: u8, matrix: u32) {
        for drawable in first..end {
            self.test_and_emit(context, drawable, mask, matrix);
        }
    }

    #[inline(always)]
    fn test_and_emit(&mut self, context: &PageContext, drawable: u32, mask: u8, matrix: u32) {
        if context.has_clusters && self.looks_away(context, drawable) {
            return;
        }
        let range = self.range;
        let Some((depth, reach)) = self.test_drawable(context, drawable, mask) else { return };
        if context.by_primitives && self.put_aside(context, drawable, depth, reach) {
            self.range = range;
        }
        let page = context.page;
        let state = self.state_of(page, page.drawable_refs[drawable as usize].state_path);
        let slot = context.slots.get(drawable as usize).copied().unwrap_or(DrawSlot::NONE);
        self.leaves.push(RenderLeaf { slot, state, matrix, depth });
    }

    /// Takes a subtree that is wholly inside: its transforms and its drawables are ranges, its nodes stay unread.
    fn take_inside(&mut self, context: &PageContext, first: u32, end: u32, matrix: u32) {
        let page = context.page;
        let (from, to) = (page.nodes[first as usize], page.nodes[end as usize]);
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
        let last = end.div_ceil(4).min(page.boxes.len());
        for (block, four) in page.boxes.iter().enumerate().take(last).skip(first / 4) {
            // At the ends some of the four are others'.
            let start = 4 * block;
            let (own, own_end) = (first.max(start), end.min(start + 4));
            let [cx, cy, cz] = four.center;
            let [hx, hy, hz] = four.half;
            let depth = cx * row.x + cy * row.y + cz * row.z + Vec4::splat(row.w);
            let reach = hx * abs.x + hy * abs.y + hz * abs.z;
            let behind = (depth + reach).cmplt(least_depth) | hx.cmpge(Vec4::splat(UNBOUNDED));
            if behind.any() {
                self.range = DepthRange { near: near.min_element(), far: far.max_element() };
                self.take_singly(context, own..own_end, &matrix_of);
                (near, far) = (Vec4::splat(self.range.near), Vec4::splat(self.range.far));
                continue;
            }
            let depths = depth.to_array();
            if own_end - own < 4 {
                let (nearest, farthest) = ((depth - reach).to_array(), (depth + reach).to_array());
                self.counters.drawables_tested += (own_end - own) as u32;
                for drawable in own..own_end {
                    let lane = drawable - start;
                    // A NaN in the first operand loses.
                    near = Vec4::splat(nearest[lane]).min(near);
                    far = Vec4::splat(farthest[lane]).max(far);
                    let of = page.drawable_refs[drawable];
                    let state = self.state_of(page, of.state_path);
                    let slot = context.slots.get(drawable).copied().unwrap_or(DrawSlot::NONE);
                    let matrix = matrix_of(of.transform);
                    self.leaves.push(RenderLeaf { slot, state, matrix, depth: depths[lane] });
                }
                continue;
            }
            near = (depth - reach).min(near);
            far = (depth + reach).max(far);
            self.counters.drawables_tested += 4;
            let Some(&[a, b, c, d]) = page.drawable_refs[start..].first_chunk::<4>() else { break };
            let slots = context.slots.get(start..start + 4).and_then(|s| s.first_chunk::<4>());
            let slots = slots.copied().unwrap_or([DrawSlot::NONE; 4]);
            let states = [a, b, c, d].map(|r| self.state_of(page, r.state_path));
            let matrices = [a, b, c, d].map(|r| matrix_of(r.transform));
            let leaf =
                |i: usize| RenderLeaf { slot: slots[i], state: states[i], matrix: matrices[i], depth: depths[i] };
            self.leaves.extend_from_slice(&[leaf(0), leaf(1), leaf(2), leaf(3)]);
        }
        self.range = DepthRange { near: near.min_element(), far: far.max_element() };
    }

    fn take_singly(
        &mut self,
        context: &PageContext,
        drawables: std::ops::Range<usize>,
        matrix_of: &impl Fn(u32) -> u32,
    ) {
        for drawable in drawables {
            let matrix = matrix_of(context.page.drawable_refs[drawable].transform);
            self.test_drawables(context, drawable as u32, drawable as u32 + 1, 0, matrix);
        }
    }
}

/// The matrix of a transform as rows. `known` is the linear part that was multiplied last, and the product.
#[inline(always)]
fn transform_rows(context: &PageContext, known: &mut (u32, [[f32; 4]; 3]), transform: usize) -> [[f32; 4]; 3] {
    let all = &context.page.transforms;
    let of = all.linear_of[transform];
    if of != known.0 {
        multiply_linear(context, known, of);
    }
    let mut matrix = known.1;
    let [px, py, pz] = all.translations[transform];
    let at = &context.visit.eye_from_page.translation;
    let along = |row: &DVec3, at: f64| (row.x * px + row.y * py + row.z * pz + at) as f32;
    let [x, y, z] = &context.eye_rows;
    matrix[0][3] = along(x, at.x);
    matrix[1][3] = along(y, at.y);
    matrix[2][3] = along(z, at.z);
    matrix
}

#[inline(never)]
fn multiply_linear(context: &PageContext, known: &mut (u32, [[f32; 4]; 3]), linear: u32) {
    let page_from_node = context.page.transforms.linears[linear as usize].page_from_node;
    let matrix3 = context.visit.eye_from_page.matrix3 * page_from_node;
    *known = (linear, super::visitor::rows(&DAffine3 { matrix3, translation: DVec3::ZERO }));
}
