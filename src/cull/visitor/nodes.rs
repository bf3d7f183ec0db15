//! The flat scan of a page's nodes in depth-first order. Culling thread.
//!
//! Each node is skipped with its subtree, taken with it as a range, or entered. This is the hot loop of cull:
//! the rare cases are in functions that are not inlined.

use std::ops::Range;

use glam::Vec4;

use super::page_context::{OpenNode, PageContext, cull_info};
use super::page_queue::Purpose;
use super::traversal::Traversal;
use crate::cull::fading::{Fade, LodIndex, LodShares, WHOLE};
use crate::scene::{CALLBACK, CullAction, CullPass, INACTIVE, LARGE, Page, SIMPLE_SUBTREE, UNBOUNDED, UNCULLED, kind};

/// Number of children of a Lod that can fade; further ones are switched at once.
const MAX_FADING_CHILDREN: usize = 64;

/// Subtrees of at most this many nodes are scanned: setting up the ranges would cost more.
const SMALL_SUBTREE: u32 = 4;

impl Traversal<'_> {
    /// Scans the nodes `first..last`, which are whole subtrees, under a matrix and the planes that they may cross.
    pub(super) fn scan_nodes(&mut self, context: &PageContext, first: u32, last: u32, mask: u8, matrix: u32) {
        let page = context.page;
        let base = self.stacks.nodes.len();
        let mut above = OpenNode { end: last, matrix, mask: u32::from(mask) };
        let mut node = first;
        let small_feature = self.views.current().small_feature;
        let cull_mask = self.views.current().camera.settings.cull_mask;
        // Flags of subtrees that may be taken as ranges.
        let takes_ranges = self.takes_ranges() && small_feature == 0.0 && !context.by_primitives;
        let range_flags = if takes_ranges { SIMPLE_SUBTREE } else { 0 };
        // Flags of subtrees that may be skipped: they hold no tile that must be kept.
        let keeps = self.keeps(context);
        let free_flags = if keeps { 0 } else { SIMPLE_SUBTREE };
        let has_occluders = self.occlusion.is_active();
        // A cull mask of 0 hides all nodes, also those of pages without masks.
        if cull_mask == 0 {
            if keeps {
                self.keep_tiles(context, first, last);
            }
            return;
        }
        let has_masks = !page.masks().is_empty();
        // One test per node for what few pages and cameras need.
        let looks_closer = small_feature > 0.0 || has_occluders;
        let (nodes, spheres) = (page.nodes(), page.spheres());
        loop {
            while node >= above.end {
                let ours = self.stacks.nodes.len() > base;
                match self.stacks.nodes.pop_if(|_| ours) {
                    Some(open) => above = open,
                    None => return,
                }
            }
            let record = &nodes[node as usize];
            let (flags, next) = (record.flags, node + record.skip);
            let may_skip = (flags | free_flags) & SIMPLE_SUBTREE != 0;
            if has_masks && page.masks()[node as usize] & cull_mask == 0 {
                if !may_skip {
                    self.keep_tiles(context, node, next);
                }
                node = next;
                continue;
            }
            self.counters.nodes_visited += 1;
            let sphere = spheres[node as usize];
            let mut mask = above.mask as u8;
            let mut tested = mask;
            // One test rules this out for most nodes.
            if flags & (CALLBACK | INACTIVE) != 0 {
                match self.ask_node(context, node) {
                    CullAction::Traverse => {}
                    CullAction::Skip => {
                        if !may_skip {
                            self.keep_tiles(context, node, next);
                        }
                        node = next;
                        continue;
                    }
                    CullAction::Passes(passes) => {
                        self.scan_passes(context, node, &passes, mask, above.matrix);
                        node = next;
                        continue;
                    }
                }
                if flags & UNCULLED != 0 && record.kind == kind::GEODE {
                    self.take_unculled(context, node, above.matrix);
                    node += 1;
                    continue;
                }
                tested = if flags & INACTIVE != 0 { 0 } else { mask };
            }
            if tested != 0 {
                match context.planes.test_sphere(sphere, tested) {
                    Some(crossing) => mask = crossing,
                    None => {
                        if !may_skip {
                            self.keep_tiles(context, node, next);
                        }
                        node = next;
                        continue;
                    }
                }
            }
            if looks_closer {
                // LARGE marks subtrees with tiles, whose errors decide instead.
                if small_feature > 0.0 && flags & LARGE == 0 && self.is_small(context, sphere) {
                    node = next;
                    continue;
                }
                if has_occluders && flags & INACTIVE == 0 && self.is_occluded(sphere) {
                    if !may_skip {
                        self.keep_tiles(context, node, next);
                    }
                    node = next;
                    continue;
                }
            }
            if mask == 0 && record.skip > SMALL_SUBTREE && flags & range_flags != 0 {
                self.take_inside(context, node, next, above.matrix);
                node = next;
                continue;
            }
            if record.kind == kind::TRANSFORM {
                let transform = record.first_transform as usize;
                let matrix = self.matrices.push(context, transform, &mut self.stage.eye_from_drawable);
                self.stacks.nodes.push(above);
                above = OpenNode { end: next, matrix, mask: u32::from(mask) };
                node += 1;
                continue;
            }
            if record.kind == kind::GEODE {
                let (first, end) = (record.first_drawable, nodes[node as usize + 1].first_drawable);
                if end == first + 1 {
                    // The usual case, without the setup of a loop.
                    self.test_and_emit(context, first, mask, above.matrix);
                } else {
                    self.test_drawables(context, first, end, mask, above.matrix);
                }
            } else if record.kind != kind::GROUP && !self.visit_rare(context, node, record.kind, mask, above.matrix) {
                node = next;
                continue;
            }
            if u32::from(mask) != above.mask && next > node + 1 {
                self.stacks.nodes.push(above);
                above = OpenNode { end: next, matrix: above.matrix, mask: u32::from(mask) };
            }
            node += 1;
        }
    }

    /// Visits a node of a kind that is rare in most pages. Returns true if its children must be scanned like a group's.
    #[inline(never)]
    fn visit_rare(&mut self, context: &PageContext, node: u32, kind: u8, mask: u8, matrix: u32) -> bool {
        match kind {
            kind::TILE => {
                let (page, tile) = (context.page, context.page.payloads()[node as usize]);
                if let Ok(root) = page.tiles().roots().binary_search_by_key(&tile, |r| r.tile) {
                    self.scan_tiles(page, &context.visit, root, mask, context.visit.purpose);
                }
            }
            kind::SPECIAL => return self.visit_rare_node(context, node, mask),
            kind::SWITCH => self.visit_switch(context, node, mask, matrix),
            _ => self.visit_lod(context, node, mask, matrix),
        }
        false
    }

    fn visit_switch(&mut self, context: &PageContext, node: u32, mask: u8, matrix: u32) {
        let page = context.page;
        let shown = &page.switches()[page.payloads()[node as usize] as usize];
        for (index, child) in children(page, node).enumerate() {
            if shown.get(index).copied().unwrap_or(false) {
                self.scan_nodes(context, child.start, child.end, mask, matrix);
            } else {
                self.keep_required(context, child);
            }
        }
    }

    fn visit_lod(&mut self, context: &PageContext, node: u32, mask: u8, matrix: u32) {
        let page = context.page;
        let lod = &page.lods()[page.payloads()[node as usize] as usize];
        let enclosing = self.enclosing_transform(context, node);
        let eye = page.transforms().point_in_node(enclosing, context.eye);
        let measure = lod.measure(
            eye.distance(lod.center),
            self.views.current().camera.settings.lod_scale,
            &self.views.current().ranges,
        );
        let is_shown = |child: usize| lod.shows(child, measure);
        let shares = self.lod_shares(context, node, (0..lod.ranges.len()).map(is_shown));
        for (index, child) in children(page, node).enumerate() {
            match shares.filter(|_| index < MAX_FADING_CHILDREN) {
                Some(shares) => self.scan_fading(context, child, mask, matrix, shares, 1 << index),
                None if is_shown(index) => {
                    self.scan_nodes(context, child.start, child.end, mask, matrix);
                }
                None => self.keep_required(context, child),
            }
        }
    }

    /// Returns the shares of a Lod's children while it fades between them, and otherwise `None`.
    fn lod_shares(
        &mut self,
        context: &PageContext,
        node: u32,
        in_range: impl Iterator<Item = bool>,
    ) -> Option<LodShares> {
        let fade_s = self.views.current().camera.settings.lod_fade_s;
        if fade_s.is_nan() || fade_s <= 0.0 {
            return None;
        }
        let page = context.page;
        let active = in_range.take(MAX_FADING_CHILDREN).enumerate().map(|(i, is)| u64::from(is) << i).sum();
        let lod = LodIndex {
            page: self.scene.page_id_at(context.visit.slot),
            index: page.payloads()[node as usize] as usize,
            count: page.lods().len(),
        };
        let shares = self.fades.advance_lod(lod, active, self.fades.step(fade_s));
        let is_fading = shares.share < WHOLE;
        self.counters.fading += u32::from(is_fading);
        is_fading.then_some(shares)
    }

    /// Visits a child of a Lod that fades, in the band of the child. `bit` selects the child in the sets of the shares.
    #[cold]
    fn scan_fading(
        &mut self,
        context: &PageContext,
        nodes: Range<u32>,
        mask: u8,
        matrix: u32,
        shares: LodShares,
        bit: u64,
    ) {
        let above = context.visit.fade;
        let (new, old) = above.band().split(shares.share);
        let (band, is_leaving) = match (shares.old & bit != 0, shares.new & bit != 0) {
            (true, true) => return self.scan_nodes(context, nodes.start, nodes.end, mask, matrix),
            (true, false) => (old, true),
            (false, true) => (new, above.is_leaving()),
            (false, false) => return self.keep_required(context, nodes),
        };
        if band.is_empty() {
            return self.keep_required(context, nodes);
        }
        let mut below = *context;
        below.visit.fade = Fade::new(band, above.is_covered(), is_leaving);
        let outer = self.states.enter_band(band);
        self.scan_nodes(&below, nodes.start, nodes.end, mask, matrix);
        self.states.enter_band(outer);
    }

    /// Keeps the tiles of a subtree that is not shown, if the page can only replace its parent as a whole.
    pub(super) fn keep_required(&mut self, context: &PageContext, nodes: Range<u32>) {
        if self.keeps(context) {
            self.keep_tiles(context, nodes.start, nodes.end);
        }
    }

    /// Returns true if culled tiles of the page are requested too, because the page can only replace its parent as a whole.
    /// Shadows use what is resident.
    fn keeps(&self, context: &PageContext) -> bool {
        context.visit.required && !self.views.current().casts
    }

    /// Keeps and requests the tiles of a culled subtree.
    #[cold]
    fn keep_tiles(&mut self, context: &PageContext, first: u32, end: u32) {
        let tiles = context.page.tiles();
        let node_of = |root: usize| tiles.nodes()[tiles.roots()[root].tile as usize];
        let mut root = tiles.roots().partition_point(|r| tiles.nodes()[r.tile as usize] < first);
        while root < tiles.roots().len() && node_of(root) < end {
            self.scan_tiles(context.page, &context.visit, root, 0, Purpose::Keep);
            root += 1;
        }
    }

    /// Returns the transform in whose frame a node lies.
    pub(super) fn enclosing_transform(&self, context: &PageContext, node: u32) -> u32 {
        context.page.enclosing_transform(node)
    }

    /// Returns true if a bound projects to too few pixels.
    fn is_small(&self, context: &PageContext, sphere: Vec4) -> bool {
        let depth = context.depth.dot(sphere.truncate().extend(1.0));
        let scale = context.depth.truncate().length();
        sphere.w * scale < self.views.current().small_feature * (depth - sphere.w * scale)
    }

    /// Asks a node's cull callback. A node without one is visited, and so is a node in a pass of its callback.
    #[cold]
    fn ask_node(&mut self, context: &PageContext, node: u32) -> CullAction {
        let page = context.page;
        let Some((callback, _)) = page.cull_callback(node) else { return CullAction::Traverse };
        if self.in_pass.take_if(|visited| *visited == node).is_some() {
            return CullAction::Traverse;
        }
        (callback.0)(&cull_info(page, node, context.eye, self.camera.frame))
    }

    /// Visits a node once for each pass of its cull callback.
    #[cold]
    fn scan_passes(&mut self, context: &PageContext, node: u32, passes: &[CullPass], mask: u8, matrix: u32) {
        let page = context.page;
        let end = node + page.nodes()[node as usize].skip;
        if passes.is_empty() {
            self.keep_required(context, node..end);
        }
        let path = page.cull_callback(node).map_or(0, |(_, path)| *path);
        for sets in passes {
            self.states.push(page, path, sets);
            self.in_pass = Some(node);
            self.scan_nodes(context, node, end, mask, matrix);
            self.states.pop();
        }
    }

    /// Returns true if a sphere is hidden by an occluder.
    #[cold]
    fn is_occluded(&mut self, sphere: Vec4) -> bool {
        let center = sphere.truncate().to_array();
        let hidden = (0.0..UNBOUNDED).contains(&sphere.w) && self.occlusion.hides_in_page(center, |_| sphere.w);
        self.counters.occluded += u32::from(hidden);
        hidden
    }
}

/// Returns the subtree of each child of a node.
fn children(page: &Page, node: u32) -> impl Iterator<Item = Range<u32>> {
    let (mut next, end) = (node + 1, node + page.nodes()[node as usize].skip);
    std::iter::from_fn(move || {
        let child = next;
        next += page.nodes()[child as usize].skip;
        (child < end).then_some(child..next)
    })
}
