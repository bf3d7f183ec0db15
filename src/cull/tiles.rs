//! The walk of a tile tree: which tiles are drawn, which are asked for.
//!
//! Per tile: it is stamped; it wants its children where its error is too large. Under REPLACE it gives way only
//! when all its children are ready, culled ones too, so that no hole can open; until then it is drawn and the walk
//! goes on below it only to ask for what is missing, all levels in one frame, coarse first.

use std::sync::atomic::Ordering;

use glam::DVec3;

use super::fade::{Fade, Step, TileMark, WHOLE};
use super::horizon::Horizon;
use super::planes::Planes;
use super::stage::PageRequest;
use super::visitor::{Cull, Hanger, PageVisit, Purpose, Waiting, eye_in};
use crate::scene::{NodeId, Page, PageId, TileRecord, Tiles, UNBOUNDED, flag};

/// What holds for the tiles up to `end`.
#[derive(Clone, Copy, Debug)]
pub(super) struct TileFrame {
    end: u32,
    mask: u8,
    purpose: Purpose,
    /// Culled tiles are kept (and asked for) too: the parent waits for all of them.
    required: bool,
    /// Error in pixels of what is shown while tiles here are missing.
    shown_px: f32,
    fade: Fade,
}

/// A frame with tile trees, seen from the eye.
#[derive(Clone, Copy, Debug)]
pub(super) struct TileView {
    transform: u32,
    /// Place of the frame among those that waiting pages hang in.
    hanger: u32,
    /// Relative to the eye.
    planes: Planes,
    eye: DVec3,
    horizon: Option<Horizon>,
}

/// What is constant during a walk.
struct Walk<'a> {
    page: &'a Page,
    id: PageId,
    tiles: &'a Tiles,
    view: TileView,
    /// Ranges of a metre of error and of a metre of range.
    ranges: (f32, f32),
    max_sse_px: f32,
    /// Shadows take what is there.
    asks: bool,
}

/// A tile that is not culled, or kept all the same.
#[derive(Clone, Copy)]
struct Met {
    tile: u32,
    record: TileRecord,
    purpose: Purpose,
    /// Planes that it crosses.
    mask: u8,
}

/// Marks of the page's tiles, and how far fades go on.
type Fades<'a> = Option<(&'a mut [TileMark], Step)>;

impl Cull<'_> {
    /// Walks one tile tree of a page.
    pub(super) fn scan_tiles(&mut self, page: &Page, visit: &PageVisit, root: usize, mask: u8, purpose: Purpose) {
        let Some(tile_root) = page.tiles.roots.get(root) else { return };
        let walk = Walk {
            page,
            id: self.scene.page_id_at(visit.place),
            tiles: &page.tiles,
            view: self.tile_view(page, visit, tile_root.transform),
            ranges: (self.view.range_per_error, self.view.range_per_metre),
            max_sse_px: self.view.max_sse_px,
            asks: !self.view.casts,
        };
        let first = tile_root.tile;
        let end = first + page.tiles.records[first as usize].skip;
        let (required, shown_px, fade) = (visit.required, visit.shown_px, visit.fade);
        let all = TileFrame { end, mask, purpose, required, shown_px, fade };
        let fade_s = self.view.settings.lod_fade_s;
        if fade_s > 0.0 && purpose == Purpose::Draw {
            let mut marks = self.fades.take_tiles(visit.place, walk.id.generation, page.tiles.len());
            let step = self.fades.step(fade_s);
            self.walk_tiles(&walk, first, all, Some((&mut marks, step)));
            self.fades.give_back_tiles(visit.place, marks);
        } else {
            self.walk_tiles(&walk, first, all, None);
        }
    }

    fn walk_tiles(&mut self, walk: &Walk, first: u32, all: TileFrame, mut fades: Fades) {
        let tiles = walk.tiles;
        let cull_mask = self.view.settings.cull_mask;
        let may_hide = !walk.page.masks.is_empty() || cull_mask == 0;
        let may_be_behind = walk.view.horizon.is_some() || !self.occluders.is_empty();
        let stamp = if walk.asks { self.camera.frame } else { 0 };
        let (mut tile, mut above) = (first, all);
        // Counted here: a counter behind `self` is a load and a store for each tile.
        let mut visited = 0;
        self.tile_stack.clear();
        loop {
            while tile >= above.end {
                match self.tile_stack.pop() {
                    Some(open) => above = open,
                    None => {
                        self.counters.tiles_visited += visited;
                        return;
                    }
                }
            }
            let index = tile as usize;
            let record = tiles.records[index];
            let next = tile + record.skip;
            // What this camera does not see is kept with its siblings all the same: the parent waits for all of them.
            let mut purpose = above.purpose;
            if may_hide && walk.is_hidden(index, cull_mask) {
                if !above.required {
                    tile = next;
                    continue;
                }
                purpose = Purpose::Keep;
            }
            if record.has(flag::REQUEST_VOLUME) && !tiles.may_be_requested(tile, walk.view.eye) {
                tile = next;
                continue;
            }
            visited += 1;
            let mut mask = above.mask;
            if mask != 0 && purpose != Purpose::Keep {
                match walk.test(index, &record, mask) {
                    Some(crossing) => mask = crossing,
                    None if above.required => purpose = Purpose::Keep,
                    None => {
                        tile = next;
                        continue;
                    }
                }
            }
            if may_be_behind && purpose != Purpose::Keep && self.is_behind(walk, index, &record) {
                if !above.required {
                    tile = next;
                    continue;
                }
                purpose = Purpose::Keep;
            }
            if stamp != 0 {
                tiles.last_used[index].store(stamp, Ordering::Relaxed);
            }
            let met = Met { tile, record, purpose, mask };
            let below = if record.flags & (flag::CONTENT | flag::PROXY | flag::EXTERNAL | flag::ADD) == flag::CONTENT {
                self.meet_plain_tile(walk, met, &above, &mut fades)
            } else {
                self.meet_tile(walk, met, &above, &mut fades)
            };
            match below {
                Some(below) if record.has_children() => {
                    self.tile_stack.push(above);
                    above = below;
                    tile += 1;
                }
                _ => tile = next,
            }
        }
    }

    /// [`Self::meet_tile`] for nearly all tiles: content that its children replace, at once or not at all.
    #[inline(always)]
    fn meet_plain_tile(&mut self, walk: &Walk, met: Met, above: &TileFrame, fades: &mut Fades) -> Option<TileFrame> {
        let Met { tile, record, purpose, .. } = met;
        let resident = record.has(flag::RESIDENT);
        if !record.has_children() {
            if !resident {
                self.request_missing(walk, met, above);
            } else if purpose == Purpose::Draw {
                if !stays(fades, tile, false, resident) {
                    return self.meet_tile(walk, met, above, fades);
                }
                self.draw(walk, met, above.fade);
            }
            return None;
        }
        if purpose == Purpose::Keep {
            if !resident {
                self.request_missing(walk, met, above);
            }
            return None;
        }
        let (range2, distance2) = walk.range_and_distance(tile, &record);
        let wants = distance2 < range2;
        let ready = record.not_ready_children == 0;
        let is_refined = purpose == Purpose::Draw && ready && (wants || !resident);
        if purpose == Purpose::Draw && !stays(fades, tile, is_refined, resident) {
            return self.meet_tile(walk, met, above, fades);
        }
        if !resident {
            if purpose == Purpose::Want || !(wants && ready) {
                self.request_missing(walk, met, above);
            }
        } else if purpose == Purpose::Draw && !is_refined {
            self.draw(walk, met, above.fade);
        }
        let purpose = if is_refined { Purpose::Draw } else { Purpose::Want };
        if is_refined || (wants && walk.asks) {
            let shown_px = walk.below_px(range2, distance2, above);
            Some(TileFrame {
                end: tile + record.skip,
                mask: met.mask,
                purpose,
                required: walk.asks,
                shown_px,
                ..*above
            })
        } else {
            None
        }
    }

    /// Draws a tile, asks for what it lacks, and says what holds for its children, where they are to be met.
    #[inline(never)]
    fn meet_tile(&mut self, walk: &Walk, met: Met, above: &TileFrame, fades: &mut Fades) -> Option<TileFrame> {
        let Met { tile, record, purpose, mask } = met;
        let fade = above.fade;
        let resident = record.has(flag::RESIDENT);
        let replaces = !record.has(flag::ADD);
        let below = |purpose, required, shown_px, fade| {
            let is_met = walk.asks || purpose == Purpose::Draw;
            let required = required && walk.asks;
            is_met.then_some(TileFrame { end: tile + record.skip, mask, purpose, required, shown_px, fade })
        };
        if purpose != Purpose::Draw || record.has(flag::PROXY | flag::ADD) {
            self.request_missing(walk, met, above);
        }
        if record.has(flag::PROXY | flag::EXTERNAL) {
            if resident && record.has(flag::EXTERNAL) {
                self.enter(walk, met, above.required, above.shown_px, fade);
            } else if resident && purpose == Purpose::Draw {
                self.draw(walk, met, fade);
            }
            return if purpose == Purpose::Keep { None } else { below(purpose, false, above.shown_px, fade) };
        }
        if !record.has(flag::CONTENT) {
            return below(purpose, above.required, above.shown_px, fade);
        }
        if purpose == Purpose::Keep {
            return None;
        }
        let (range2, distance2) = walk.range_and_distance(tile, &record);
        let wants = record.has_children() && distance2 < range2;
        let below_px = || walk.below_px(range2, distance2, above);
        if purpose == Purpose::Want {
            return if wants { below(purpose, replaces, below_px(), fade) } else { None };
        }
        let ready = record.not_ready_children == 0;
        // Children in the tile's place; also where it has no content itself.
        let gives_way = ready && record.has_children() && (wants || !resident);
        let is_refined = if replaces { gives_way } else { wants };
        let (mut shows_own, mut shows_children) = (!replaces || !is_refined, is_refined);
        let (mut own, mut children) = (fade.band(), fade.band());
        if !stays(fades, tile, is_refined, resident)
            && let Some((marks, step)) = fades
        {
            let can_fade = !replaces || (resident && ready);
            let turn = marks[tile as usize].turn(*step, is_refined, can_fade, resident, fade.covered());
            self.counters.fading += u32::from(turn.is_fading);
            (children, own) = fade.band().split(turn.refined);
            own = if replaces { own } else { fade.band() }.split(turn.own).0;
            (shows_own, shows_children) = (!replaces || turn.refined < WHOLE, turn.refined > 0);
        }
        if shows_own && resident {
            self.draw(walk, met, fade.with_band(own));
        }
        if replaces && !(wants && ready) {
            self.request_missing(walk, met, above);
        }
        if shows_children {
            let covered = fade.covered() || (!replaces && resident);
            let leaving = fade.leaving() || !is_refined;
            below(Purpose::Draw, replaces, below_px(), Fade::new(children, covered, leaving))
        } else if wants {
            below(Purpose::Want, true, below_px(), fade)
        } else {
            None
        }
    }

    /// The frame of a transform; pages with many tile trees have them in one frame.
    fn tile_view(&mut self, page: &Page, visit: &PageVisit, transform: u32) -> TileView {
        match self.tile_view {
            Some(view) if view.transform == transform => view,
            _ => {
                let eye_from_tile = visit.eye_from_page * page.transforms.page_from_node(transform);
                let eye = eye_in(&eye_from_tile);
                let planes = self.view.planes.in_frame(&eye_from_tile, eye);
                if !self.occluders.is_empty() {
                    self.occluders.in_frame(&eye_from_tile, eye, self.tile_occluders);
                }
                let horizon = self.view.horizon.as_ref().and_then(|body| {
                    let world_from_eye = self.view.eye_from_world.inverse();
                    Horizon::new(body, &(world_from_eye * eye_from_tile), world_from_eye.translation)
                });
                let hanger = self.hangers.len() as u32;
                self.hangers.push(Hanger { eye_from_frame: eye_from_tile, page: visit.place, view: self.view.index });
                *self.tile_view.insert(TileView { transform, hanger, planes, eye, horizon })
            }
        }
    }

    /// True for a tile behind the horizon or in the shadow of an occluder.
    #[inline]
    fn is_behind(&mut self, walk: &Walk, tile: usize, record: &TileRecord) -> bool {
        let bounds = &walk.tiles.bounds[tile];
        let offset = bounds.offset_from(walk.view.eye);
        walk.view.horizon.as_ref().is_some_and(|h| h.hides(offset, bounds.radius_m))
            || (!self.occluders.is_empty() && self.is_in_shadow(walk, tile, record))
    }

    /// True for a tile in the shadow of an occluder.
    #[cold]
    fn is_in_shadow(&mut self, walk: &Walk, tile: usize, record: &TileRecord) -> bool {
        let bounds = &walk.tiles.bounds[tile];
        let axes = walk.tiles.axes_of(bounds);
        let reach = |p: glam::Vec4| {
            if record.has(flag::SPHERE) {
                return bounds.radius_m;
            }
            let along = |axis: &[f32; 3]| (p.x * axis[0] + p.y * axis[1] + p.z * axis[2]).abs();
            axes.iter().zip(bounds.half_m).map(|(axis, half)| along(axis) * half).sum()
        };
        let offset = bounds.offset_from(walk.view.eye);
        let hidden = bounds.radius_m < UNBOUNDED && self.occluders.hide(self.tile_occluders, offset, reach);
        self.counters.occluded += u32::from(hidden);
        hidden
    }

    /// Lets the content of a tile wait for its visit.
    #[inline(always)]
    fn draw(&mut self, walk: &Walk, met: Met, fade: Fade) {
        if !fade.band().is_empty() {
            self.counters.tiles_drawn += 1;
            self.enter(walk, met, false, 0.0, fade);
        }
    }

    /// Lets what hangs at a tile wait for its visit.
    #[inline(always)]
    fn enter(&mut self, walk: &Walk, met: Met, required: bool, shown_px: f32, fade: Fade) {
        let Met { tile, record, purpose, mask } = met;
        let state = self.chain_state(walk.page, walk.tiles.state_paths[tile as usize]);
        let state = self.faded_state(state, fade.band());
        let hanger = walk.view.hanger;
        self.queue.push(Waiting {
            place: record.resident,
            hanger,
            tile,
            state,
            shown_px,
            mask,
            purpose,
            required,
            fade,
        });
    }

    /// What a tile's place in the picture makes of its priority: all in the middle, a half at 45 degrees from it. Of what
    /// lies in something else it is never more.
    fn share_of_place(&self, walk: &Walk, tile: u32) -> f32 {
        let bounds = &walk.tiles.bounds[tile as usize];
        let eye_from_frame = &self.hangers[walk.view.hanger as usize].eye_from_frame;
        let center = eye_from_frame.transform_point3(DVec3::from_array(bounds.center)).as_vec3();
        let (aside, ahead) = (center.x.hypot(center.y), -center.z);
        let half_angle = (bounds.radius_m / center.length()).min(1.0).asin();
        let angle = aside.atan2(ahead) - half_angle;
        if angle > 0.0 { angle.cos().max(0.0).powi(2).max(KEPT_SHARE) } else { 1.0 }
    }

    /// Asks for the content of a tile, unless it is there or cannot come.
    #[inline(never)]
    fn request_missing(&mut self, walk: &Walk, met: Met, above: &TileFrame) {
        let Met { tile, record, purpose, .. } = met;
        let may_come = record.has_slot() && !record.has(flag::RESIDENT | flag::FAILED | flag::NEVER);
        if !may_come || above.fade.leaving() || !walk.asks {
            return;
        }
        let slot = NodeId { page: walk.id, index: walk.tiles.nodes[tile as usize] };
        let (range2, distance2) = walk.range_and_distance(tile, &record);
        let share = if purpose == Purpose::Keep { KEPT_SHARE } else { self.share_of_place(walk, tile) };
        let finite = |px: f32| if px > 0.0 { px.min(MOST_PX) } else { 0.0 };
        let priority = finite(above.shown_px * share);
        let error_px = finite(walk.px(range2, distance2));
        self.stage.requests.push(PageRequest { slot, priority, error_px });
    }
}

/// True for a tile that is what it is to be.
#[inline(always)]
fn stays(fades: &mut Fades, tile: u32, is_refined: bool, resident: bool) -> bool {
    match fades {
        Some((marks, step)) => marks[tile as usize].stays(*step, is_refined, resident),
        None => true,
    }
}

impl Walk<'_> {
    #[inline]
    fn is_hidden(&self, tile: usize, cull_mask: u32) -> bool {
        let mask = self.page.masks.get(self.tiles.nodes[tile] as usize).copied().unwrap_or(u32::MAX);
        mask & cull_mask == 0
    }

    #[inline(always)]
    fn test(&self, tile: usize, record: &TileRecord, mask: u8) -> Option<u8> {
        let bounds = &self.tiles.bounds[tile];
        let offset = bounds.offset_from(self.view.eye);
        if record.has(flag::SPHERE) {
            self.view.planes.test_sphere(glam::Vec4::new(offset[0], offset[1], offset[2], bounds.radius_m), mask)
        } else if bounds.is_along_frame() {
            self.view.planes.test_aligned(offset, bounds.half_m, mask)
        } else {
            self.view.planes.test_oriented(offset, self.tiles.axes_of(bounds), bounds.half_m, mask)
        }
    }

    /// The error of a tile in pixels.
    #[inline(always)]
    fn px(&self, range2: f32, distance2: f32) -> f32 {
        self.max_sse_px * (range2 / distance2).sqrt()
    }

    /// The error of what is shown while tiles below are missing: never as large as what is shown above, so that coarse
    /// comes first whatever the bounds are.
    #[inline(always)]
    fn below_px(&self, range2: f32, distance2: f32, above: &TileFrame) -> f32 {
        let (own, most) = (self.px(range2, distance2), above.shown_px * 0.999);
        if own < most { own } else { most }
    }

    /// Squared distance at which a tile wants its children, and squared distance now.
    #[inline(always)]
    fn range_and_distance(&self, tile: u32, record: &TileRecord) -> (f32, f32) {
        let bounds = &self.tiles.bounds[tile as usize];
        let offset = bounds.offset_from(self.view.eye);
        self.tiles.range_and_distance(tile, record, bounds, offset, self.view.eye, self.ranges)
    }
}

/// Priority of tiles outside the frustum, as a share of what it would be inside.
const KEPT_SHARE: f32 = 0.25;

/// Errors above it are said to be so large; its square is finite.
pub(super) const MOST_PX: f32 = 1.8e19;
