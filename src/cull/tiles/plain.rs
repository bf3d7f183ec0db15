//! The walk of a tile tree while tiles are as nearly all are: with content that its children replace, drawn in every
//! pixel. Threads that cull, as the rest of the walk.
//!
//! Loops by themselves, so that what they need stays in registers. What they leave is met one by one.

use std::ops::Range;

use super::{ODD, PLAIN, TileFrame, Walk, frame, stays};
use crate::cull::fade::{Fade, TileMark};
use crate::cull::visitor::{Cull, Purpose, Waiting};
use crate::scene::{TileBounds, TileRecord, flag};

/// Tiles side by side whose contents are drawn alike.
struct Run {
    tiles: Range<u32>,
    mask: u8,
    fade: Fade,
}

impl Cull<'_> {
    /// Walks on while tiles have content that is there, drawn or replaced by all its children at once. The tile after
    /// those, or behind the last of its siblings; their frame is the last of the stack.
    #[inline(never)]
    pub(super) fn draw_plain_tiles<const LOOKS: bool, const AHEAD: bool>(
        &mut self,
        walk: &Walk,
        mut tile: u32,
        base: usize,
        marks: &mut [TileMark],
    ) -> u32 {
        // With one length for all, places are checked once a tile.
        let records = &walk.tiles.records()[..];
        let bounds = &walk.tiles.bounds()[..records.len()];
        let last_used = &walk.tiles.last_used()[..records.len()];
        let looks_everywhere = walk.looks_everywhere();
        let Some(open) = self.tile_stack.last() else { return tile };
        let mut above = open.read();
        // Counted here: a counter behind `self` is a load and a store for each tile.
        let mut visited = 0;
        let mut run = Run { tiles: tile..tile, mask: 0, fade: above.fade };
        loop {
            if tile >= above.end {
                if self.tile_stack.len() == base + 1 {
                    break;
                }
                self.tile_stack.pop();
                let Some(open) = self.tile_stack.last() else { break };
                above = open.read();
                tile = above.next;
                if above.purpose != Purpose::Draw || !above.fade.is_whole() {
                    break;
                }
                continue;
            }
            let place = tile as usize;
            let record = &records[place];
            if record.flags & (ODD | flag::RESIDENT) != PLAIN | flag::RESIDENT {
                break;
            }
            let mut mask = 0;
            if LOOKS {
                let seen = self.see(walk, tile, &bounds[place], above);
                match seen {
                    Some((Purpose::Draw, crossing)) => mask = crossing,
                    _ => {
                        if seen.is_some() {
                            visited += 1;
                            walk.stamp.put::<AHEAD>(&last_used[place]);
                        }
                        tile += 1;
                        continue;
                    }
                }
            }
            let (range2, distance2) = match record.has_children() {
                true => walk.range_and_distance(tile, record, &bounds[place]),
                false => (0.0, 1.0),
            };
            let wants = distance2 < range2;
            if wants && record.not_ready_children != 0 {
                let next = Run { tiles: tile..tile, mask, fade: above.fade };
                self.draw_run(walk, std::mem::replace(&mut run, next));
                let far = (range2, distance2);
                let Some(next) = self.wait_for_children::<LOOKS, AHEAD>(walk, tile, mask, far, above, marks) else {
                    break;
                };
                tile = next;
                let Some(open) = self.tile_stack.last() else { break };
                above = open.read();
                if above.purpose != Purpose::Draw {
                    break;
                }
                continue;
            }
            if !stays(marks, place, walk.step, wants, true) {
                break;
            }
            visited += 1;
            walk.stamp.put::<AHEAD>(&last_used[place]);
            if wants {
                let shown_px2 = walk.below_px2(range2, distance2, above.shown_px2);
                let (next, end) = (record.first_child, record.end_of_children());
                above = TileFrame { next, end, mask, required: true, shown_px2, ..above };
                frame::open(self.tile_stack, tile + 1, above);
                tile = next;
                if LOOKS && mask == 0 && !looks_everywhere {
                    // Going over to the loop that does not look pays where children are replaced too: theirs is half
                    // the range.
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

    /// Lets the contents of a run wait for their visits.
    #[inline(always)]
    fn draw_run(&mut self, walk: &Walk, run: Run) {
        let Run { tiles, mask, fade } = run;
        if !tiles.is_empty() {
            let state = self.chain_state(walk.page, walk.root.state_path);
            self.queue.push(Waiting {
                first: tiles.start,
                end: tiles.end,
                hanger: walk.view.hanger,
                state,
                fade,
                mask,
            });
            self.counters.tiles_drawn += tiles.len() as u32;
        }
    }

    /// Draws a tile whose children are not all ready, and asks for what they lack. The tile after what was met, unless
    /// the tile fades.
    #[cold]
    #[inline(never)]
    fn wait_for_children<const LOOKS: bool, const AHEAD: bool>(
        &mut self,
        walk: &Walk,
        tile: u32,
        mask: u8,
        (range2, distance2): (f32, f32),
        above: TileFrame,
        marks: &mut [TileMark],
    ) -> Option<u32> {
        if !stays(marks, tile as usize, walk.step, false, true) {
            return None;
        }
        let record = &walk.tiles.records()[tile as usize];
        self.counters.tiles_visited += 1;
        walk.stamp.put::<AHEAD>(&walk.tiles.last_used()[tile as usize]);
        self.draw(walk, tile, record, mask, above.fade);
        let shown_px2 = walk.below_px2(range2, distance2, above.shown_px2);
        let base = self.tile_stack.len();
        if !self.open_tile(walk, tile, (Purpose::Want, mask), true, shown_px2, above.fade) {
            return Some(tile + 1);
        }
        let next = self.want_plain_tiles::<LOOKS, AHEAD>(walk, record.first_child, base);
        if self.tile_stack.len() == base + 1 && next >= record.end_of_children() {
            self.tile_stack.truncate(base);
            return Some(tile + 1);
        }
        Some(next)
    }

    /// Walks on where something above is drawn instead: what is missing is asked for, all levels in one frame.
    #[inline(never)]
    pub(super) fn want_plain_tiles<const LOOKS: bool, const AHEAD: bool>(
        &mut self,
        walk: &Walk,
        mut tile: u32,
        base: usize,
    ) -> u32 {
        let records = &walk.tiles.records()[..];
        let bounds = &walk.tiles.bounds()[..records.len()];
        let last_used = &walk.tiles.last_used()[..records.len()];
        let looks_everywhere = walk.looks_everywhere();
        let Some(open) = self.tile_stack.last() else { return tile };
        let mut above = open.read();
        let mut visited = 0;
        loop {
            if tile >= above.end {
                if self.tile_stack.len() == base + 1 {
                    break;
                }
                self.tile_stack.pop();
                let Some(open) = self.tile_stack.last() else { break };
                above = open.read();
                tile = above.next;
                if above.purpose == Purpose::Draw {
                    break;
                }
                continue;
            }
            let place = tile as usize;
            let record = &records[place];
            if record.flags & ODD != PLAIN {
                break;
            }
            let (mut purpose, mut mask) = (above.purpose, 0);
            if LOOKS {
                match self.see(walk, tile, &bounds[place], above) {
                    Some(seen) => (purpose, mask) = seen,
                    None => {
                        tile += 1;
                        continue;
                    }
                }
            }
            visited += 1;
            walk.stamp.put::<AHEAD>(&last_used[place]);
            let mut above_px2 = above.shown_px2;
            let (range2, distance2) = match purpose == Purpose::Want && record.has_children() {
                true => walk.range_and_distance(tile, record, &bounds[place]),
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
                above = TileFrame { next, end, mask, shown_px2, required: true, ..above };
                frame::open(self.tile_stack, tile + 1, above);
                tile = next;
                if LOOKS && mask == 0 && !looks_everywhere {
                    break;
                }
                continue;
            }
            tile += 1;
        }
        self.counters.tiles_visited += visited;
        tile
    }

    /// [`Self::look`], by itself where only the frustum culls.
    #[inline(always)]
    fn see(&mut self, walk: &Walk, tile: u32, bounds: &TileBounds, above: TileFrame) -> Option<(Purpose, u8)> {
        if walk.looks_everywhere() {
            self.look(walk, tile, above)
        } else if above.mask == 0 || above.purpose == Purpose::Keep {
            Some((above.purpose, above.mask))
        } else {
            match walk.test(bounds, above.mask) {
                Some(crossing) => Some((above.purpose, crossing)),
                None if above.required && walk.asks => Some((Purpose::Keep, above.mask)),
                None => {
                    self.counters.tiles_visited += 1;
                    None
                }
            }
        }
    }
}
