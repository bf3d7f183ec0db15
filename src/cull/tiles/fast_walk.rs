//! Fast loops for the usual tiles of a walk: with content that their children replace, and in no fade. Culling thread.
//!
//! Separate loops, so that their variables stay in registers. They stop at any other tile, which the general walk visits.

use std::ops::Range;

use super::open_tile::{self, OpenTile};
use super::walk_context::{REPLACE_WITH_CONTENT, SLOW_PATH, WalkContext, is_settled};
use crate::cull::fading::{Fade, FadeTarget, TileMark};
use crate::cull::visitor::{Purpose, QueuedPage, Traversal};
use crate::scene::{TileBounds, TileRecord, flag};

/// Adjacent tiles whose contents are drawn with the same planes and fade.
struct Run {
    tiles: Range<u32>,
    mask: u8,
    fade: Fade,
}

impl Traversal<'_> {
    /// Walks tiles with resident content, each drawn or replaced by all its children, and stops at the first other tile.
    /// Returns that tile, or one past the last of its siblings; the entry of the siblings is then the top of the stack.
    #[inline(never)]
    pub(super) fn draw_fast<const TESTS: bool, const AHEAD: bool>(
        &mut self,
        walk: &WalkContext,
        mut tile: u32,
        base: usize,
        marks: &mut [TileMark],
    ) -> u32 {
        // Slices of equal length let the compiler check the index once per tile.
        let records = walk.tiles.records();
        let bounds = &walk.tiles.bounds()[..records.len()];
        let last_used = &walk.tiles.last_used()[..records.len()];
        let needs_all_tests = walk.needs_all_tests();
        let Some(open) = self.stacks.tiles.last() else { return tile };
        let mut above = open.read();
        // A local counter: one behind `self` would be a load and a store for each tile.
        let mut visited = 0;
        let mut run = Run { tiles: tile..tile, mask: 0, fade: above.fade };
        loop {
            if tile >= above.end {
                if self.stacks.tiles.len() == base + 1 {
                    break;
                }
                self.stacks.tiles.pop();
                let Some(open) = self.stacks.tiles.last() else { break };
                above = open.read();
                tile = above.next;
                if above.purpose != Purpose::Draw || !above.fade.is_whole() {
                    break;
                }
                continue;
            }
            let index = tile as usize;
            let record = &records[index];
            if record.flags & (SLOW_PATH | flag::RESIDENT) != REPLACE_WITH_CONTENT | flag::RESIDENT {
                break;
            }
            let mut mask = 0;
            if TESTS {
                let seen = self.test_tile_fast(walk, tile, &bounds[index], above);
                match seen {
                    Some((Purpose::Draw, crossing)) => mask = crossing,
                    _ => {
                        if seen.is_some() {
                            visited += 1;
                            walk.stamp.put::<AHEAD>(&last_used[index]);
                        }
                        tile += 1;
                        continue;
                    }
                }
            }
            let (range2, distance2) = match record.has_children() {
                true => walk.range_and_distance(tile, record, &bounds[index]),
                false => (0.0, 1.0),
            };
            let wants = distance2 < range2;
            if wants && !self.can_be_replaced(walk, tile, record, mask) {
                let next = Run { tiles: tile..tile, mask, fade: above.fade };
                self.draw_run(walk, std::mem::replace(&mut run, next));
                let far = (range2, distance2);
                let Some(next) = self.wait_for_children::<TESTS, AHEAD>(walk, tile, mask, far, above, marks) else {
                    break;
                };
                tile = next;
                let Some(open) = self.stacks.tiles.last() else { break };
                above = open.read();
                if above.purpose != Purpose::Draw {
                    break;
                }
                continue;
            }
            if !is_settled(marks, index, walk.step, FadeTarget { is_refined: wants, is_resident: true }) {
                break;
            }
            visited += 1;
            walk.stamp.put::<AHEAD>(&last_used[index]);
            if wants {
                let shown_px2 = walk.below_px2(range2, distance2, above.shown_px2);
                let (next, end) = (record.first_child, record.end_of_children());
                above = OpenTile { next, end, mask, required: walk.requires_all(), shown_px2, ..above };
                open_tile::open(&mut self.stacks.tiles, tile + 1, above);
                walk.note_refined(tile);
                tile = next;
                if TESTS && mask == 0 && !needs_all_tests {
                    // Changing to the loop without tests pays where the children are replaced too, whose range is half
                    // of this one.
                    let has_grandchildren = records.get(next as usize).is_some_and(TileRecord::has_children);
                    if has_grandchildren && 4.0 * distance2 < range2 {
                        break;
                    }
                }
                continue;
            }
            if run.tiles.end != tile || run.mask != mask || run.fade != above.fade {
                let next = Run { tiles: tile..tile, mask, fade: above.fade };
                self.draw_run(walk, std::mem::replace(&mut run, next));
            }
            tile += 1;
            run.tiles.end = tile;
        }
        self.draw_run(walk, run);
        self.counters.tiles_visited += visited;
        tile
    }

    /// Queues the contents of a run for their visits.
    #[inline(always)]
    fn draw_run(&mut self, walk: &WalkContext, run: Run) {
        let Run { tiles, mask, fade } = run;
        if !tiles.is_empty() {
            let state = self.states.path_state(walk.page, walk.root.state_path);
            self.queue.push(QueuedPage {
                first: tiles.start,
                end: tiles.end,
                attachment: walk.view.attachment,
                state,
                fade,
                mask,
            });
            self.counters.tiles_drawn += tiles.len() as u32;
        }
    }

    /// Draws a tile whose children are not all ready, and requests what they lack. Returns the tile to continue with, or
    /// `None` if the tile fades and was not visited.
    #[cold]
    #[inline(never)]
    fn wait_for_children<const TESTS: bool, const AHEAD: bool>(
        &mut self,
        walk: &WalkContext,
        tile: u32,
        mask: u8,
        (range2, distance2): (f32, f32),
        above: OpenTile,
        marks: &mut [TileMark],
    ) -> Option<u32> {
        let as_drawn = FadeTarget { is_refined: false, is_resident: true };
        if !is_settled(marks, tile as usize, walk.step, as_drawn) {
            return None;
        }
        let record = &walk.tiles.records()[tile as usize];
        self.counters.tiles_visited += 1;
        walk.stamp.put::<AHEAD>(&walk.tiles.last_used()[tile as usize]);
        self.draw(walk, tile, record, mask, above.fade);
        let shown_px2 = walk.below_px2(range2, distance2, above.shown_px2);
        let base = self.stacks.tiles.len();
        let required = walk.requires_all();
        if !self.open_tile(walk, tile, (Purpose::Want, mask), required, shown_px2, above.fade) {
            return Some(tile + 1);
        }
        let next = self.request_fast::<TESTS, AHEAD>(walk, record.first_child, base);
        if self.stacks.tiles.len() == base + 1 && next >= record.end_of_children() {
            self.stacks.tiles.truncate(base);
            return Some(tile + 1);
        }
        Some(next)
    }

    /// Walks tiles for which an ancestor is drawn, and requests what is missing: all levels in one frame. Stops and returns
    /// as [`Self::draw_fast`].
    #[inline(never)]
    pub(super) fn request_fast<const TESTS: bool, const AHEAD: bool>(
        &mut self,
        walk: &WalkContext,
        mut tile: u32,
        base: usize,
    ) -> u32 {
        let records = walk.tiles.records();
        let bounds = &walk.tiles.bounds()[..records.len()];
        let last_used = &walk.tiles.last_used()[..records.len()];
        let needs_all_tests = walk.needs_all_tests();
        let Some(open) = self.stacks.tiles.last() else { return tile };
        let mut above = open.read();
        let mut visited = 0;
        loop {
            if tile >= above.end {
                if self.stacks.tiles.len() == base + 1 {
                    break;
                }
                self.stacks.tiles.pop();
                let Some(open) = self.stacks.tiles.last() else { break };
                above = open.read();
                tile = above.next;
                if above.purpose == Purpose::Draw {
                    break;
                }
                continue;
            }
            let index = tile as usize;
            let record = &records[index];
            if record.flags & SLOW_PATH != REPLACE_WITH_CONTENT {
                break;
            }
            let (mut purpose, mut mask) = (above.purpose, 0);
            if TESTS {
                match self.test_tile_fast(walk, tile, &bounds[index], above) {
                    Some(seen) => (purpose, mask) = seen,
                    None => {
                        tile += 1;
                        continue;
                    }
                }
            }
            visited += 1;
            walk.stamp.put::<AHEAD>(&last_used[index]);
            let mut above_px2 = above.shown_px2;
            let (range2, distance2) = match purpose == Purpose::Want && record.has_children() {
                true => walk.range_and_distance(tile, record, &bounds[index]),
                false => (0.0, 1.0),
            };
            let wants = distance2 < range2;
            let mut is_skipped = false;
            if !record.has(flag::RESIDENT) {
                is_skipped = wants && walk.skips(record, (range2, distance2), above_px2);
                if !is_skipped {
                    above_px2 = self.request_missing(walk, tile, purpose, above_px2, above.fade);
                }
            }
            if wants {
                let shown_px2 = if is_skipped { above_px2 } else { walk.below_px2(range2, distance2, above_px2) };
                let (next, end) = (record.first_child, record.end_of_children());
                above = OpenTile { next, end, mask, shown_px2, required: walk.requires_all(), ..above };
                open_tile::open(&mut self.stacks.tiles, tile + 1, above);
                tile = next;
                if TESTS && mask == 0 && !needs_all_tests {
                    break;
                }
                continue;
            }
            tile += 1;
        }
        self.counters.tiles_visited += visited;
        tile
    }

    /// Tests a tile as [`Self::test_tile`], with a short path where only the frustum culls.
    #[inline(always)]
    fn test_tile_fast(
        &mut self,
        walk: &WalkContext,
        tile: u32,
        bounds: &TileBounds,
        above: OpenTile,
    ) -> Option<(Purpose, u8)> {
        if walk.needs_all_tests() {
            self.test_tile(walk, tile, above)
        } else if above.mask == 0 || above.purpose == Purpose::Keep {
            Some((above.purpose, above.mask))
        } else {
            match walk.test(bounds, above.mask) {
                Some(crossing) => Some((above.purpose, crossing)),
                None if above.required && walk.requests => Some((Purpose::Keep, above.mask)),
                None if walk.is_top_of_ground(tile) => Some((above.purpose, above.mask)),
                None => {
                    self.counters.tiles_visited += 1;
                    None
                }
            }
        }
    }
}
