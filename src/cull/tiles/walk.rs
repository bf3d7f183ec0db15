//! The walk of a tile tree: which tiles are drawn, and which are requested. Culling thread.
//!
//! Each tile that is met is stamped as wanted, and wants its children where its error is too large. Under REPLACE
//! refinement its children replace it only when all of them are ready, culled ones too, so that no hole can open. On a
//! globe's surface culled children neither count nor are requested (`ground`). Until then the tile is drawn, and the walk
//! continues below it only to request what is missing: all levels in one frame, coarse ones first.

use super::ground::ranges_above;
use super::open_tile::{self, OpenTile};
use super::tile_view::{KEPT_SHARE, MAX_ERROR_PX, TileView};
use super::walk_context::{CONTENT_KINDS, REPLACE_WITH_CONTENT, SLOW_PATH, UseStamp, WalkContext, is_settled};
use crate::cull::fading::{Fade, FadeConditions, FadeTarget, TileMark, WHOLE};
use crate::cull::stage::PageRequest;
use crate::cull::visitor::{AttachmentFrame, PageVisit, Purpose, QueuedPage, Traversal, eye_in};
use crate::scene::{NONE, NodeId, Page, TileBounds, TileRecord, TileRoot, UNBOUNDED, flag};

impl Traversal<'_> {
    /// Walks one tile tree of a page.
    pub(in crate::cull) fn scan_tiles(
        &mut self,
        page: &Page,
        visit: &PageVisit,
        root: usize,
        mask: u8,
        purpose: Purpose,
    ) {
        let Some(tile_root) = page.tiles().roots().get(root) else { return };
        let (tiles, first) = (page.tiles(), tile_root.tile);
        let tile_view = self.tile_view(page, visit, tile_root);
        let view = self.views.current();
        let (fade_s, cull_mask) = (view.camera.settings.lod_fade_s, view.camera.settings.cull_mask);
        let (frame, ahead) = (self.camera.frame, self.camera.ahead_frames);
        let has_volumes = tiles.has_request_volumes();
        let walk = WalkContext {
            page,
            page_id: self.scene.page_id_at(visit.slot),
            tiles,
            root: tile_root,
            view: tile_view,
            mask,
            ranges: tiles.ground().map_or(view.ranges, |of| ranges_above(of, view.ranges, tile_view.eye.position)),
            max_sse_px2: view.max_sse_px * view.max_sse_px,
            // From outside of a request volume a tile is the finest that may be drawn, so that no level is skipped.
            skip_px2: if has_volumes { 0.0 } else { view.skip_px2 },
            requests: !view.casts,
            cull_mask,
            may_hide: !page.masks().is_empty() || cull_mask == 0 || has_volumes,
            may_be_behind: view.camera.horizon.is_some() || self.occlusion.is_active(),
            step: self.fades.step(fade_s),
            stamp: UseStamp { frame: if view.casts { 0 } else { frame }, wanted_in: frame.saturating_add(ahead) },
        };
        let (required, shown_px2, fade) = (visit.required, visit.shown_px * visit.shown_px, visit.fade);
        let all = OpenTile { next: first, end: first + 1, mask, purpose, required, shown_px2, fade };
        if ahead > 0 {
            self.walk_tiles::<true, true>(&walk, first, &all, &mut []);
        } else if fade_s > 0.0 && purpose == Purpose::Draw {
            let mut marks = self.fades.take_tiles(walk.page_id, tiles.len());
            self.walk_tiles::<true, false>(&walk, first, &all, &mut marks);
            self.fades.give_back_tiles(walk.page_id, marks);
        } else {
            self.walk_tiles::<true, false>(&walk, first, &all, &mut []);
        }
    }

    /// Walks the tiles from `first` to the end of `all` with their subtrees. `marks` is empty where nothing can fade.
    /// `TESTS`: each tile is tested; without it all are known to be inside the frustum, as most are. `AHEAD`: the cull
    /// prefetches for a later frame.
    fn walk_tiles<const TESTS: bool, const AHEAD: bool>(
        &mut self,
        walk: &WalkContext,
        first: u32,
        all: &OpenTile,
        marks: &mut [TileMark],
    ) {
        let needs_all_tests = walk.needs_all_tests();
        let base = self.stacks.tiles.len();
        self.stacks.tiles.push(all.read());
        let mut tile = first;
        // The tile at which the fast loop stopped, and its purpose: it is visited here.
        let mut stopped_at = (NONE, Purpose::Draw);
        while self.stacks.tiles.len() > base
            && let Some(above) = self.stacks.tiles.last().map(OpenTile::read)
        {
            if tile >= above.end {
                self.stacks.tiles.pop();
                tile = self.stacks.tiles.last().map_or(NONE, |above| above.next);
                continue;
            }
            if TESTS && above.mask == 0 && !needs_all_tests {
                self.walk_tiles::<false, AHEAD>(walk, tile, &above, marks);
                tile = above.end;
                continue;
            }
            let record = &walk.tiles.records()[tile as usize];
            if record.flags & SLOW_PATH == REPLACE_WITH_CONTENT
                && above.fade.is_whole()
                && stopped_at != (tile, above.purpose)
            {
                tile = match above.purpose {
                    Purpose::Draw => self.draw_fast::<TESTS, AHEAD>(walk, tile, base, marks),
                    _ => self.request_fast::<TESTS, AHEAD>(walk, tile, base),
                };
                stopped_at = (tile, above.purpose);
                continue;
            }
            let opened = self.visit_tile::<TESTS, AHEAD>(walk, tile, &above, marks);
            tile = if opened { record.first_child } else { tile + 1 };
        }
    }

    /// Tests a tile against masks, volumes, frustum, horizon and occluders. Returns the purpose of its visit and the planes
    /// that it crosses, or `None` if it is culled. A culled tile is kept if its parent can only be replaced by all children.
    #[inline(never)]
    pub(super) fn test_tile(&mut self, walk: &WalkContext, tile: u32, above: OpenTile) -> Option<(Purpose, u8)> {
        let record = &walk.tiles.records()[tile as usize];
        let kept = (above.required && walk.requests).then_some((Purpose::Keep, above.mask));
        let mut seen = Some((above.purpose, above.mask));
        if walk.may_hide {
            if walk.is_hidden(tile) {
                seen = Some(kept?);
            }
            // A tile that stands in for its parent's missing content is drawn even outside of its volume.
            let stands_in = above.required && above.purpose == Purpose::Draw;
            let has_volume = record.has(flag::REQUEST_VOLUME) && !stands_in;
            if has_volume && !walk.tiles.may_be_requested(tile, walk.view.eye.position) {
                return None;
            }
        }
        if let Some((Purpose::Draw | Purpose::Want, mask)) = seen
            && mask != 0
        {
            let bounds = &walk.tiles.bounds()[tile as usize];
            seen = walk.test(bounds, mask).map(|crossing| (above.purpose, crossing)).or(kept);
        }
        if walk.may_be_behind
            && let Some((Purpose::Draw | Purpose::Want, mask)) = seen
            && self.is_behind(walk, tile)
        {
            seen = kept.map(|_| (Purpose::Keep, mask));
        }
        if walk.tiles.ground().is_some() {
            seen = match seen {
                // The tile above waits for this one, since the slot of its page was in sight.
                None if walk.is_top_of_ground(tile) => Some((above.purpose, above.mask)),
                Some((_, mask)) if self.has_no_part_in_sight(walk, tile, mask) => None,
                seen => seen,
            };
        }
        self.counters.tiles_visited += u32::from(seen.is_none());
        seen
    }

    /// Visits a tile: requests missing content, draws it, and opens it if its children need a visit. Returns true if it was
    /// opened.
    #[inline(never)]
    fn visit_tile<const TESTS: bool, const AHEAD: bool>(
        &mut self,
        walk: &WalkContext,
        tile: u32,
        above: &OpenTile,
        marks: &mut [TileMark],
    ) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let seen = if TESTS { self.test_tile(walk, tile, *above) } else { Some((above.purpose, 0)) };
        let Some((purpose, mask)) = seen else { return false };
        self.counters.tiles_visited += 1;
        walk.stamp.put::<AHEAD>(&walk.tiles.last_used()[tile as usize]);
        if record.flags & CONTENT_KINDS == REPLACE_WITH_CONTENT {
            self.visit_replaceable_tile(walk, tile, (purpose, mask), above, marks)
        } else {
            self.visit_uncommon_tile(walk, tile, (purpose, mask), above, marks)
        }
    }

    /// Visits a tile without content, with an external tile set, or whose content is drawn beside its children's.
    #[inline(never)]
    fn visit_uncommon_tile(
        &mut self,
        walk: &WalkContext,
        tile: u32,
        (purpose, mask): (Purpose, u8),
        above: &OpenTile,
        marks: &mut [TileMark],
    ) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let mut above = above.read();
        let resident = record.has(flag::RESIDENT);
        if purpose != Purpose::Draw || record.has(flag::PROXY | flag::ADD) {
            above.shown_px2 = self.request_missing(walk, tile, purpose, above.shown_px2, above.fade);
        }
        if record.has(flag::PROXY | flag::EXTERNAL) {
            if resident && record.has(flag::EXTERNAL) {
                let fade = above.fade;
                let (required, shown_px) = (above.required, above.shown_px2.sqrt());
                let frame = *self.queue.frame(walk.view.attachment);
                let attachment = self.queue.add_frame(AttachmentFrame { purpose, required, shown_px, ..frame });
                let state = self.states.path_state(walk.page, walk.state_path(tile, record));
                let state = self.states.faded(state, fade.band(), self.stage);
                self.queue.push(QueuedPage { first: tile, end: tile + 1, attachment, state, fade, mask });
            } else if resident && purpose == Purpose::Draw {
                self.draw(walk, tile, record, mask, above.fade);
            }
            if !resident && purpose == Purpose::Draw && walk.stands_in(record) {
                self.stand_in(walk, tile);
            }
            return purpose != Purpose::Keep
                && self.open_tile(walk, tile, (purpose, mask), false, above.shown_px2, above.fade);
        }
        if !record.has(flag::CONTENT) {
            let (range2, distance2) = walk.range_and_distance(tile, record, &walk.tiles.bounds()[tile as usize]);
            return distance2 < range2
                && self.open_tile(walk, tile, (purpose, mask), above.required, above.shown_px2, above.fade);
        }
        // Content that is drawn beside its children's.
        match purpose {
            Purpose::Keep => false,
            Purpose::Want => {
                let (range2, distance2) = walk.range_and_distance(tile, record, &walk.tiles.bounds()[tile as usize]);
                let shown_px2 = walk.below_px2(range2, distance2, above.shown_px2);
                distance2 < range2 && self.open_tile(walk, tile, (purpose, mask), false, shown_px2, above.fade)
            }
            Purpose::Draw => {
                if !resident && record.has(flag::UNAVAILABLE) {
                    self.stand_in(walk, tile);
                }
                self.fade_tile(walk, tile, mask, &above, marks)
            }
        }
    }

    /// Visits a tile with content that its children replace.
    #[inline(always)]
    fn visit_replaceable_tile(
        &mut self,
        walk: &WalkContext,
        tile: u32,
        (purpose, mask): (Purpose, u8),
        above: &OpenTile,
        marks: &mut [TileMark],
    ) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let resident = record.has(flag::RESIDENT);
        if purpose == Purpose::Keep || !record.has_children() {
            if !resident {
                self.request_missing(walk, tile, purpose, above.shown_px2, above.fade);
                if purpose == Purpose::Draw && walk.stands_in(record) {
                    self.stand_in(walk, tile);
                }
            }
            let gone = FadeTarget { is_refined: false, is_resident: false };
            let draws = purpose == Purpose::Draw && (resident || !is_settled(marks, tile as usize, walk.step, gone));
            return draws && self.fade_tile(walk, tile, mask, above, marks);
        }
        let (range2, distance2) = walk.range_and_distance(tile, record, &walk.tiles.bounds()[tile as usize]);
        let wants = distance2 < range2 && walk.may_be_replaced(record);
        let is_refined =
            purpose == Purpose::Draw && (wants || !resident) && self.can_be_replaced(walk, tile, record, mask);
        let mut above_px2 = above.shown_px2;
        let is_skipped = wants && !resident && walk.skips(record, (range2, distance2), above_px2);
        // Without a failure below, nothing needs the content of a tile that is refined, unless some child is not ready.
        let is_whole = record.not_ready_children == 0 && !record.has(flag::FAILED_BELOW);
        let is_replaced = is_refined && wants && is_whole;
        if !(resident || is_replaced || is_skipped) {
            above_px2 = self.request_missing(walk, tile, purpose, above.shown_px2, above.fade);
        }
        if purpose == Purpose::Draw && !resident && !is_refined && walk.stands_in(record) {
            self.stand_in(walk, tile);
        }
        let missing = FadeTarget { is_refined, is_resident: false };
        if purpose == Purpose::Draw && (resident || !is_settled(marks, tile as usize, walk.step, missing)) {
            let above = OpenTile { shown_px2: above_px2, ..above.read() };
            return self.fade_tile(walk, tile, mask, &above, marks);
        }
        let shown_px2 = if is_skipped { above_px2 } else { walk.below_px2(range2, distance2, above_px2) };
        let purpose = if is_refined { Purpose::Draw } else { Purpose::Want };
        if is_refined {
            walk.note_refined(tile);
        }
        let required = walk.requires_all();
        (is_refined || wants) && self.open_tile(walk, tile, (purpose, mask), required, shown_px2, above.fade)
    }

    /// Draws a tile with content and opens it if its children need a visit. While one replaces the other, both are
    /// drawn in their bands.
    #[inline(never)]
    fn fade_tile(&mut self, walk: &WalkContext, tile: u32, mask: u8, above: &OpenTile, marks: &mut [TileMark]) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let fade = above.fade;
        let resident = record.has(flag::RESIDENT);
        let replaces = !record.has(flag::ADD);
        let (range2, distance2) = walk.range_and_distance(tile, record, &walk.tiles.bounds()[tile as usize]);
        let wants = record.has_children() && distance2 < range2 && walk.may_be_replaced(record);
        let ready = self.can_be_replaced(walk, tile, record, mask);
        // If its own content is not resident, ready children stand in for it even if it does not want them.
        let is_refined = record.has_children() && (!replaces || ready) && (wants || (replaces && !resident));
        let (mut shows_own, mut shows_children) = (!replaces || !is_refined, is_refined);
        let (mut own, mut children) = (fade.band(), fade.band());
        let target = FadeTarget { is_refined, is_resident: resident };
        if let Some(mark) = marks.get_mut(tile as usize)
            && !mark.is_settled(walk.step, target)
        {
            let can_fade = !replaces || (resident && ready);
            let conditions = FadeConditions { can_fade, is_covered: fade.is_covered() };
            let shares = mark.advance(walk.step, target, conditions);
            self.counters.fading += u32::from(shares.is_fading);
            (children, own) = fade.band().split(shares.children);
            own = if replaces { own } else { fade.band() }.split(shares.own).0;
            (shows_own, shows_children) = (!replaces || shares.children < WHOLE, shares.children > 0);
        }
        if shows_own && resident {
            self.draw(walk, tile, record, mask, fade.with_band(own));
        }
        let shown_px2 = walk.below_px2(range2, distance2, above.shown_px2);
        if shows_children {
            let is_covered = fade.is_covered() || (!replaces && resident);
            let is_leaving = fade.is_leaving() || !is_refined;
            let fade = Fade::new(children, is_covered, is_leaving);
            walk.note_refined(tile);
            let required = replaces && walk.requires_all();
            self.open_tile(walk, tile, (Purpose::Draw, mask), required, shown_px2, fade)
        } else {
            wants && self.open_tile(walk, tile, (Purpose::Want, mask), walk.requires_all(), shown_px2, fade)
        }
    }

    /// Opens a tile, unless its children need no visit. The entry of its children is then the top of the stack.
    pub(super) fn open_tile(
        &mut self,
        walk: &WalkContext,
        tile: u32,
        (purpose, mask): (Purpose, u8),
        required: bool,
        shown_px2: f32,
        fade: Fade,
    ) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let is_met = record.has_children() && (walk.requests || purpose == Purpose::Draw);
        if is_met {
            let (next, end) = (record.first_child, record.end_of_children());
            open_tile::open(
                &mut self.stacks.tiles,
                tile + 1,
                OpenTile { next, end, mask, purpose, required, shown_px2, fade },
            );
        }
        is_met
    }

    /// Returns the view of a transform's frame. Kept for the next tree: pages with many tile trees have them in one frame.
    fn tile_view(&mut self, page: &Page, visit: &PageVisit, root: &TileRoot) -> TileView {
        let transform = root.transform;
        match self.tile_view {
            Some(view) if view.transform == transform => view,
            _ => {
                let eye_from_tiles = visit.eye_from_page * page.transforms().page_from_node(transform);
                let state = self.states.path_state(page, root.state_path);
                let view = self.views.current();
                let attachment = self.queue.add_frame(AttachmentFrame {
                    eye_from_frame: eye_from_tiles,
                    holder: visit.slot,
                    above: visit.attachment,
                    state,
                    view: view.index,
                    purpose: Purpose::Draw,
                    required: false,
                    shown_px: 0.0,
                });
                let tile_view = TileView::new(page, transform, attachment, &eye_from_tiles, view);
                self.occlusion.enter_tiles(&eye_from_tiles, eye_in(&eye_from_tiles));
                *self.tile_view.insert(tile_view)
            }
        }
    }

    /// Returns true if a tile is behind the horizon or an occluder.
    #[inline]
    pub(super) fn is_behind(&mut self, walk: &WalkContext, tile: u32) -> bool {
        let bounds = &walk.tiles.bounds()[tile as usize];
        let [x, y, z, _] = walk.view.eye.offset_to(bounds).to_array();
        let point = || walk.tiles.ground()?.offset_to_horizon_point(tile, walk.view.eye.position);
        let horizon = walk.view.horizon.as_ref();
        horizon.is_some_and(|h| h.hides([x, y, z], bounds.radius_m()) || point().is_some_and(|at| h.hides_in_ecef(at)))
            || (self.occlusion.is_active() && self.is_occluded_tile(walk, bounds, [x, y, z]))
    }

    /// Returns true if a tile is hidden by an occluder.
    #[cold]
    fn is_occluded_tile(&mut self, walk: &WalkContext, bounds: &TileBounds, offset: [f32; 3]) -> bool {
        let axes = walk.tiles.axes_of(bounds);
        let reach = |p: glam::Vec4| {
            if bounds.is_sphere() {
                return bounds.radius_m();
            }
            let along = |axis: &[f32; 3]| (p.x * axis[0] + p.y * axis[1] + p.z * axis[2]).abs();
            axes.iter().zip(bounds.half_m()).map(|(axis, half)| along(axis) * half).sum()
        };
        let hidden = bounds.radius_m() < UNBOUNDED && self.occlusion.hides_in_tiles(offset, reach);
        self.counters.occluded += u32::from(hidden);
        hidden
    }

    /// Queues the content of a tile for its visit.
    pub(super) fn draw(&mut self, walk: &WalkContext, tile: u32, record: &TileRecord, mask: u8, fade: Fade) {
        if fade.band().is_empty() || walk.content_is_outside(tile, record) {
            return;
        }
        let state = self.states.path_state(walk.page, walk.state_path(tile, record));
        let state = if fade.is_whole() { state } else { self.states.faded(state, fade.band(), self.stage) };
        self.counters.tiles_drawn += 1;
        let attachment = walk.view.attachment;
        self.queue.push(QueuedPage { first: tile, end: tile + 1, attachment, state, fade, mask });
    }

    /// Requests the content of a tile, unless it is resident, cannot be loaded or is out of sight. Returns the squared error of what is drawn
    /// for the tiles below, which is less after a request, so that they are loaded later.
    #[inline(never)]
    pub(super) fn request_missing(
        &mut self,
        walk: &WalkContext,
        tile: u32,
        purpose: Purpose,
        shown_px2: f32,
        fade: Fade,
    ) -> f32 {
        let record = &walk.tiles.records()[tile as usize];
        let may_load = record.has_slot() && !record.has(flag::RESIDENT | flag::FAILED | flag::NEVER);
        if !may_load || fade.is_leaving() || !walk.requests {
            return shown_px2;
        }
        let is_out_of_sight = purpose != Purpose::Keep && walk.content_is_outside(tile, record);
        // The tile above is replaced only by children that are all ready.
        let is_required = self.stacks.tiles.last().is_some_and(|above| above.required);
        if is_out_of_sight && !is_required {
            return shown_px2;
        }
        let slot = NodeId { page: walk.page_id, index: walk.tiles.nodes()[tile as usize] };
        let bounds = &walk.tiles.bounds()[tile as usize];
        // The finest tiles have no error.
        let has_error = bounds.metric_m() > 0.0;
        let error_px2 = if has_error { walk.px2(walk.range_and_distance(tile, record, bounds)) } else { 0.0 };
        let share =
            if purpose == Purpose::Keep || is_out_of_sight { KEPT_SHARE } else { walk.view.priority_share(bounds) };
        let finite = |px: f32| if px > 0.0 { px.min(MAX_ERROR_PX) } else { 0.0 };
        let priority = finite(shown_px2.sqrt() * share);
        let error_px = finite(error_px2.sqrt());
        self.stage.requests.push(PageRequest { slot, priority, error_px, ahead_frames: 0 });
        priority * priority
    }
}
