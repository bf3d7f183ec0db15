//! The flat scan of a page's nodes.

use std::ops::Range;

use glam::Vec4;

use super::fade::{Fade, LodShares, WHOLE};
use super::occluders::cull_info;
use super::visitor::{Cull, PageContext, Purpose};
use crate::scene::{CALLBACK, CullAction, INACTIVE, LARGE, Page, SIMPLE_SUBTREE, UNBOUNDED, UNCULLED, kind};

/// What holds again behind a subtree.
#[derive(Clone, Copy, Debug)]
pub(super) struct Open {
    /// First node behind the subtree.
    end: u32,
    /// Matrix above the subtree.
    matrix: u32,
    /// Planes above the subtree, in the lowest bits.
    mask: u32,
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
        let mut above = Open { end: last, matrix, mask: u32::from(mask) };
        let mut node = first;
        let small_feature = self.view.small_feature;
        let cull_mask = self.view.settings.cull_mask;
        // Flags of subtrees that may be taken as ranges, and of those below which no tile can be missing.
        let takes_ranges = self.takes_ranges && small_feature == 0.0 && !context.by_primitives;
        let range_flags = if takes_ranges { SIMPLE_SUBTREE } else { 0 };
        let keeps = self.keeps(context);
        let free_flags = if keeps { 0 } else { SIMPLE_SUBTREE };
        let has_occluders = !self.occluders.is_empty();
        // A mask of 0 hides nodes of every mask, of those without one too.
        if cull_mask == 0 {
            if keeps {
                self.keep_tiles(context, first, last);
            }
            return;
        }
        let has_masks = !page.masks().is_empty();
        // What few pages and cameras ask for, in one test for each node.
        let looks_closer = small_feature > 0.0 || has_occluders;
        let (nodes, spheres) = (&page.nodes()[..], &page.spheres()[..]);
        loop {
            while node >= above.end {
                let ours = self.node_stack.len() > base;
                match self.node_stack.pop_if(|_| ours) {
                    Some(open) => above = open,
                    None => return,
                }
            }
            let record = &nodes[node as usize];
            let (flags, next) = (record.flags, node + record.skip);
            let may_leave = (flags | free_flags) & SIMPLE_SUBTREE != 0;
            if has_masks && page.masks()[node as usize] & cull_mask == 0 {
                if !may_leave {
                    self.keep_tiles(context, node, next);
                }
                node = next;
                continue;
            }
            self.counters.nodes_visited += 1;
            let sphere = spheres[node as usize];
            let mut mask = above.mask as u8;
            let mut tested = mask;
            // One test for the many nodes that are nothing special.
            if flags & (CALLBACK | INACTIVE) != 0 {
                if !self.asks_to_visit(context, node) {
                    if !may_leave {
                        self.keep_tiles(context, node, next);
                    }
                    node = next;
                    continue;
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
                        if !may_leave {
                            self.keep_tiles(context, node, next);
                        }
                        node = next;
                        continue;
                    }
                }
            }
            if looks_closer {
                // Not where tiles are below: their errors decide.
                if small_feature > 0.0 && flags & LARGE == 0 && self.is_small(context, sphere) {
                    node = next;
                    continue;
                }
                if has_occluders && flags & INACTIVE == 0 && self.is_occluded(sphere) {
                    if !may_leave {
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
                let matrix = self.push_transform(context, record.first_transform as usize);
                self.node_stack.push(above);
                above = Open { end: next, matrix, mask: u32::from(mask) };
                node += 1;
                continue;
            }
            if record.kind == kind::GEODE {
                let (first, end) = (record.first_drawable, nodes[node as usize + 1].first_drawable);
                if end == first + 1 {
                    // Mostly one, without what a loop keeps.
                    self.test_and_emit(context, first, mask, above.matrix);
                } else {
                    self.test_drawables(context, first, end, mask, above.matrix);
                }
            } else if record.kind != kind::GROUP && !self.visit_rare(context, node, record.kind, mask, above.matrix) {
                node = next;
                continue;
            }
            if u32::from(mask) != above.mask && next > node + 1 {
                self.node_stack.push(above);
                above = Open { end: next, matrix: above.matrix, mask: u32::from(mask) };
            }
            node += 1;
        }
    }

    /// Visits a node of the kinds that few pages have many of. True: its children are scanned like those of a group.
    #[inline(never)]
    fn visit_rare(&mut self, context: &PageContext, node: u32, kind: u8, mask: u8, matrix: u32) -> bool {
        match kind {
            kind::TILE => {
                let (page, tile) = (context.page, context.page.payloads()[node as usize]);
                if let Ok(root) = page.tiles().roots().binary_search_by_key(&tile, |r| r.tile) {
                    self.scan_tiles(page, &context.visit, root, mask, context.visit.purpose);
                }
            }
            kind::SPECIAL => return !self.visit_special(context, node, mask),
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
        let measure = lod.measure(eye.distance(lod.center), self.view.settings.lod_scale, &self.view.ranges);
        let is_shown = |child: usize| lod.shows(child, measure);
        let shares = self.lod_shares(context, node, (0..lod.ranges.len()).map(is_shown));
        for (index, child) in children(page, node).enumerate() {
            match shares.filter(|_| index < MOST_FADING) {
                Some(shares) => self.scan_fading(context, child, mask, matrix, shares, 1 << index),
                None if is_shown(index) => {
                    self.scan_nodes(context, child.start, child.end, mask, matrix);
                }
                None => self.keep_required(context, child),
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
        let lod = (page.payloads()[node as usize] as usize, page.lods().len());
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
        nodes: Range<u32>,
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
            (false, false) => return self.keep_required(context, nodes),
        };
        if band.is_empty() {
            return self.keep_required(context, nodes);
        }
        let mut below = *context;
        below.visit.fade = Fade::new(band, above.covered(), leaving);
        let outer = self.enter_band(band);
        self.scan_nodes(&below, nodes.start, nodes.end, mask, matrix);
        self.enter_band(outer);
    }

    /// Keeps the tiles of a subtree that is not shown, where what replaces the page's parent waits for them.
    pub(super) fn keep_required(&mut self, context: &PageContext, nodes: Range<u32>) {
        if self.keeps(context) {
            self.keep_tiles(context, nodes.start, nodes.end);
        }
    }

    /// What replaces the page's parent waits for all tiles of the page: culled ones are asked for too. Shadows take what
    /// is there.
    fn keeps(&self, context: &PageContext) -> bool {
        context.visit.required && !self.view.casts
    }

    /// Keeps the tiles of a culled subtree: the page can only replace what is above it as a whole.
    #[cold]
    fn keep_tiles(&mut self, context: &PageContext, first: u32, end: u32) {
        let tiles = &context.page.tiles();
        let node_of = |root: usize| tiles.nodes()[tiles.roots()[root].tile as usize];
        let mut root = tiles.roots().partition_point(|r| tiles.nodes()[r.tile as usize] < first);
        while root < tiles.roots().len() && node_of(root) < end {
            self.scan_tiles(context.page, &context.visit, root, 0, Purpose::Keep);
            root += 1;
        }
    }

    /// The transform in whose frame a node lies.
    pub(super) fn enclosing_transform(&self, context: &PageContext, node: u32) -> u32 {
        context.page.enclosing_transform(node)
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
        let Some(callback) = page.cull_callback(node) else { return true };
        let info = cull_info(page, node, context.eye, self.camera.frame);
        matches!((callback.0)(&info), CullAction::Traverse)
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
}

/// The children of a node, each with its subtree.
fn children(page: &Page, node: u32) -> impl Iterator<Item = Range<u32>> {
    let (mut next, end) = (node + 1, node + page.nodes()[node as usize].skip);
    std::iter::from_fn(move || {
        let child = next;
        next += page.nodes()[child as usize].skip;
        (child < end).then_some(child..next)
    })
}
