//! The walk of a tile tree: which tiles are drawn, which are asked for.
//!
//! Per tile: it is stamped; it wants its children where its error is too large. Under REPLACE it gives way only
//! when all its children are ready, culled ones too, so that no hole can open; until then it is drawn and the walk
//! goes on below it only to ask for what is missing, all levels in one frame, coarse first.

use glam::{DAffine3, DVec3};

use super::fade::{Fade, Step, TileMark, WHOLE};
use super::horizon::Horizon;
use super::planes::Planes;
use super::stage::PageRequest;
use super::visitor::{Cull, PageVisit, Purpose, eye_in};
use crate::scene::{NodeId, Page, TileBounds, TileRecord, UNBOUNDED, flag};

/// What holds for the tiles up to `end`.
#[derive(Clone, Copy, Debug)]
pub(super) struct TileFrame {
    end: u32,
    mask: u8,
    purpose: Purpose,
    /// Culled tiles are kept (and asked for) too: the parent waits for all of them.
    required: bool,
    /// Squared error in pixels of what is shown while tiles here are missing.
    shown_px2: f32,
    fade: Fade,
}

/// A frame with tile trees, seen from the eye.
#[derive(Clone, Copy, Debug)]
pub(super) struct TileView {
    transform: u32,
    eye_from_tile: DAffine3,
    /// Relative to the eye.
    planes: Planes,
    eye: DVec3,
    horizon: Option<Horizon>,
}

impl Cull<'_> {
    /// Walks one tile tree of a page.
    pub(super) fn scan_tiles(&mut self, page: &Page, visit: &PageVisit, root: usize, mask: u8, purpose: Purpose) {
        let fade_s = self.view.settings.lod_fade_s;
        if fade_s > 0.0 && purpose == Purpose::Draw {
            let generation = self.scene.page_id_at(visit.place).generation;
            let mut marks = self.fades.take_tiles(visit.place, generation, page.tiles.len());
            let step = self.fades.step(fade_s);
            self.walk_tiles(page, visit, root, mask, purpose, Some((&mut marks, step)));
            self.fades.give_back_tiles(visit.place, marks);
        } else {
            self.walk_tiles(page, visit, root, mask, purpose, None);
        }
    }

    fn walk_tiles(
        &mut self,
        page: &Page,
        visit: &PageVisit,
        root: usize,
        mask: u8,
        purpose: Purpose,
        mut fades: Option<(&mut [TileMark], Step)>,
    ) {
        let Some(tile_root) = page.tiles.roots.get(root) else { return };
        let view = self.tile_view(page, visit, tile_root.transform);
        let eye_from_tile = view.eye_from_tile;
        let tiles = &page.tiles;
        let frame = self.camera.frame;
        let cull_mask = self.view.settings.cull_mask;
        let has_occluders = !self.occluders.is_empty();
        // Shadows take what is there.
        let asks = !self.view.casts;
        let mut tile = tile_root.tile;
        let last = tile + tiles.records[tile as usize].skip;
        let (required, shown_px2, fade) = (visit.required, visit.shown_px2, visit.fade);
        let mut above = TileFrame { end: last, mask, purpose, required, shown_px2, fade };
        self.tile_stack.clear();
        loop {
            while tile >= above.end {
                match self.tile_stack.pop() {
                    Some(open) => above = open,
                    None => return,
                }
            }
            let index = tile as usize;
            let record = tiles.records[index];
            let skip = record.skip;
            let node_mask = page.masks.get(tiles.nodes[index] as usize).copied().unwrap_or(u32::MAX);
            let hidden = node_mask & cull_mask == 0;
            if hidden && !above.required {
                tile += skip;
                continue;
            }
            if record.has(flag::REQUEST_VOLUME) && !tiles.may_be_requested(tile, view.eye) {
                tile += skip;
                continue;
            }
            self.counters.tiles_visited += 1;
            let bounds = &tiles.bounds[index];
            let offset = bounds.offset_from(view.eye);
            // What this camera does not see is kept with its siblings all the same: the parent waits for all of them.
            let mut purpose = if hidden { Purpose::Keep } else { above.purpose };
            let mut mask = above.mask;
            if mask != 0 && purpose != Purpose::Keep {
                match test(&view.planes, bounds, &record, offset, mask) {
                    Some(crossing) => mask = crossing,
                    None if above.required => purpose = Purpose::Keep,
                    None => {
                        tile += skip;
                        continue;
                    }
                }
            }
            let is_behind = purpose != Purpose::Keep
                && (view.horizon.as_ref().is_some_and(|h| h.hides(offset, bounds.radius_m))
                    || (has_occluders && self.hides_tile(bounds, &record, offset)));
            if is_behind {
                if !above.required {
                    tile += skip;
                    continue;
                }
                purpose = Purpose::Keep;
            }
            if asks {
                tiles.stamp(index, frame);
            }
            let per = (self.view.range_per_error, self.view.range_per_metre);
            let (range2, distance2) = tiles.range_and_distance(tile, &record, bounds, offset, view.eye, per);
            let ready = record.not_ready_children == 0;
            let fade = above.fade;
            let missing =
                record.has_slot() && !record.has(flag::RESIDENT | flag::FAILED | flag::NEVER) && !fade.leaving;
            let px2 = self.view.max_sse_px * self.view.max_sse_px;
            let own_px2 = || px2 * range2 / distance2;
            // Never as large as what is shown above it: coarse comes first whatever the bounds are.
            let below_px2 = || own_px2().min(above.shown_px2 * 0.998);
            if missing && (purpose != Purpose::Draw || record.has(flag::PROXY | flag::ADD)) {
                self.request(page, visit, tile, purpose, above.shown_px2, own_px2());
            }
            let mut descend = None;
            let resident = record.has(flag::RESIDENT);
            if record.has(flag::PROXY | flag::EXTERNAL) {
                if resident {
                    self.enter(page, &eye_from_tile, tile, mask, purpose, above.required, above.shown_px2, fade);
                }
                if purpose != Purpose::Keep {
                    descend = Some((purpose, false, above.shown_px2, fade));
                }
            } else if !record.has(flag::CONTENT) {
                descend = Some((purpose, above.required, above.shown_px2, fade));
            } else if purpose != Purpose::Keep {
                let wants = record.has_children() && distance2 < range2;
                let replaces = !record.has(flag::ADD);
                if purpose == Purpose::Want {
                    if wants {
                        descend = Some((purpose, replaces, below_px2(), fade));
                    }
                } else {
                    // Children in the tile's place; also where it has no content itself.
                    let gives_way = ready && record.has_children() && (wants || !resident);
                    let is_refined = if replaces { gives_way } else { wants };
                    let (mut shows_own, mut shows_children) = (!replaces || !is_refined, is_refined);
                    let (mut own, mut below) = (fade.band, fade.band);
                    if let Some((marks, step)) = &mut fades
                        && !marks[index].stays(*step, is_refined, resident)
                    {
                        let can_fade = !replaces || (resident && ready);
                        let turn = marks[index].turn(*step, is_refined, can_fade, resident, fade.covered);
                        self.counters.fading += u32::from(turn.is_fading);
                        (below, own) = fade.band.split(turn.refined);
                        own = if replaces { own } else { fade.band }.split(turn.own).0;
                        (shows_own, shows_children) = (!replaces || turn.refined < WHOLE, turn.refined > 0);
                    }
                    if shows_own && resident {
                        let fade = Fade { band: own, ..fade };
                        self.enter(page, &eye_from_tile, tile, mask, purpose, false, 0.0, fade);
                    }
                    if missing && replaces && !(wants && ready) {
                        self.request(page, visit, tile, purpose, above.shown_px2, own_px2());
                    }
                    let covered = fade.covered || (!replaces && resident);
                    let leaving = fade.leaving || !is_refined;
                    if shows_children {
                        descend = Some((purpose, replaces, below_px2(), Fade { band: below, covered, leaving }));
                    } else if wants {
                        descend = Some((Purpose::Want, true, below_px2(), fade));
                    }
                }
            }
            match descend {
                Some((purpose, required, shown_px2, fade)) if skip > 1 && (asks || purpose == Purpose::Draw) => {
                    let required = required && asks;
                    self.tile_stack.push(above);
                    above = TileFrame { end: tile + skip, mask, purpose, required, shown_px2, fade };
                    tile += 1;
                }
                _ => tile += skip,
            }
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
                *self.tile_view.insert(TileView { transform, eye_from_tile, planes, eye, horizon })
            }
        }
    }

    /// True for a tile in the shadow of an occluder.
    #[cold]
    fn hides_tile(&mut self, bounds: &TileBounds, record: &TileRecord, offset: [f32; 3]) -> bool {
        let reach = |p: glam::Vec4| {
            if record.has(flag::SPHERE) {
                return bounds.radius_m;
            }
            let along = |axis: &[f32; 3]| (p.x * axis[0] + p.y * axis[1] + p.z * axis[2]).abs();
            bounds.axes.iter().zip(bounds.half_m).map(|(axis, half)| along(axis) * half).sum()
        };
        let hidden = bounds.radius_m < UNBOUNDED && self.occluders.hide(self.tile_occluders, offset, reach);
        self.counters.occluded += u32::from(hidden);
        hidden
    }

    #[allow(clippy::too_many_arguments, reason = "a row of the page queue")]
    fn enter(
        &mut self,
        page: &Page,
        eye_from_tile: &DAffine3,
        tile: u32,
        mask: u8,
        purpose: Purpose,
        required: bool,
        shown_px2: f32,
        fade: Fade,
    ) {
        let tiles = &page.tiles;
        let index = tile as usize;
        let record = &tiles.records[index];
        if purpose == Purpose::Draw && !record.has(flag::EXTERNAL) {
            if fade.band.is_empty() {
                return;
            }
            self.counters.tiles_drawn += 1;
        } else if purpose != Purpose::Draw && !record.has(flag::EXTERNAL) {
            return; // plain content: nothing in it to ask for
        }
        let state = self.chain_state(page, tiles.state_paths[index]);
        let state = self.faded_state(state, fade.band);
        let view = self.view.index;
        let content = &tiles.content_transforms[tiles.content_transform_of[index] as usize];
        self.queue.push(PageVisit {
            place: record.resident,
            eye_from_page: *eye_from_tile * *content,
            mask,
            purpose,
            required,
            state,
            view,
            shown_px2,
            fade,
        });
    }

    fn request(&mut self, page: &Page, visit: &PageVisit, tile: u32, purpose: Purpose, shown_px2: f32, own_px2: f32) {
        if self.view.casts {
            return;
        }
        let slot = NodeId { page: self.scene.page_id_at(visit.place), index: page.tiles.nodes[tile as usize] };
        // Squares, until the end of the cull: roots are cheaper one after the other.
        let share = if purpose == Purpose::Keep { KEPT_SHARE * KEPT_SHARE } else { 1.0 };
        self.stage.requests.push(PageRequest { slot, priority: shown_px2 * share, error_px: own_px2 });
        self.counters.wanted_missing += 1;
    }
}

#[inline(always)]
fn test(planes: &Planes, bounds: &TileBounds, record: &TileRecord, offset: [f32; 3], mask: u8) -> Option<u8> {
    if record.has(flag::SPHERE) {
        planes.test_sphere(glam::Vec4::new(offset[0], offset[1], offset[2], bounds.radius_m), mask)
    } else {
        planes.test_oriented(offset, &bounds.axes, bounds.half_m, mask)
    }
}

/// Priority of tiles outside the frustum, as a share of what it would be inside.
const KEPT_SHARE: f32 = 0.25;

/// Makes pixels of the squares that the walk left, ordered and finite whatever the input was.
pub(super) fn finish_requests(requests: &mut [PageRequest]) {
    let pixels = |px2: f32| if px2.is_nan() { 0.0 } else { px2.clamp(0.0, f32::MAX).sqrt() };
    for request in requests {
        request.priority = pixels(request.priority);
        request.error_px = pixels(request.error_px);
    }
}
