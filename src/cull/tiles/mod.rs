//! The walk of a tile tree: which tiles are drawn, which are asked for.
//!
//! Per tile: it is stamped; it wants its children where its error is too large. Under REPLACE it gives way only
//! when all its children are ready, culled ones too, so that no hole can open; until then it is drawn and the walk
//! goes on below it only to ask for what is missing, all levels in one frame, coarse first.

mod frame;
mod plain;

use std::sync::atomic::{AtomicU32, Ordering};

use glam::Vec4;

pub(super) use self::frame::TileFrame;
use super::fade::{Fade, Step, TileMark, WHOLE};
use super::horizon::Horizon;
use super::planes::{GridPlanes, Planes};
use super::stage::PageRequest;
use super::visitor::{Cull, Hanger, PageVisit, Purpose, Waiting, eye_in};
use crate::scene::{
    LodRanges, NONE, NodeId, Page, PageId, TileBounds, TileEye, TileRecord, TileRoot, Tiles, UNBOUNDED, flag,
};

/// A frame with tile trees, seen from the eye.
#[derive(Clone, Copy, Debug)]
pub(super) struct TileView {
    transform: u32,
    /// Place of the frame among those that waiting pages hang in.
    hanger: u32,
    /// Relative to the eye.
    planes: Planes,
    /// The same for tiles along the frame.
    grid_planes: GridPlanes,
    eye: TileEye,
    /// Where the eye looks, of length 1 where the frame is not stretched.
    forward: Vec4,
    horizon: Option<Horizon>,
}

/// What is constant during a walk.
struct Walk<'a> {
    page: &'a Page,
    id: PageId,
    tiles: &'a Tiles,
    root: &'a TileRoot,
    view: TileView,
    ranges: LodRanges,
    max_sse_px2: f32,
    /// Of the squared error of a tile: what is shown is asked to be finer from so much on; 0 where no level is skipped.
    skip_px2: f32,
    /// Shadows take what is there.
    asks: bool,
    cull_mask: u32,
    /// Some tile may be hidden by its mask, or outside the volume in which it is asked for.
    may_hide: bool,
    /// Some tile may be behind the horizon or an occluder.
    may_be_behind: bool,
    /// How far fades go on.
    step: Step,
    stamp: Stamp,
}

/// What tiles that are wanted are stamped with.
#[derive(Clone, Copy)]
struct Stamp {
    /// The frame of the cull; 0 where nothing is stamped.
    frame: u32,
    /// The frame of the picture.
    then: u32,
}

/// Of a tile with content that its children replace.
const PLAIN: u16 = flag::CONTENT;
/// What else tiles may be.
const KINDS: u16 = flag::CONTENT | flag::PROXY | flag::EXTERNAL | flag::ADD;
/// What tiles may be, or have, that are met one by one.
const ODD: u16 = KINDS | flag::OWN_PATH | flag::VOLUMES_BELOW;

impl Cull<'_> {
    /// Walks one tile tree of a page.
    pub(super) fn scan_tiles(&mut self, page: &Page, visit: &PageVisit, root: usize, mask: u8, purpose: Purpose) {
        let Some(tile_root) = page.tiles().roots().get(root) else { return };
        let (tiles, first) = (&page.tiles(), tile_root.tile);
        let (fade_s, cull_mask) = (self.view.settings.lod_fade_s, self.view.settings.cull_mask);
        let (frame, ahead) = (self.camera.frame, self.camera.ahead_frames);
        let walk = Walk {
            page,
            id: self.scene.page_id_at(visit.place),
            tiles,
            root: tile_root,
            view: self.tile_view(page, visit, tile_root.transform),
            ranges: self.view.ranges,
            max_sse_px2: self.view.max_sse_px * self.view.max_sse_px,
            // From outside a volume a tile is all that there is of what is below it.
            skip_px2: if tiles.has_request_volumes() { 0.0 } else { self.view.skip_px2 },
            asks: !self.view.casts,
            cull_mask,
            may_hide: !page.masks().is_empty() || cull_mask == 0 || tiles.has_request_volumes(),
            may_be_behind: self.view.horizon.is_some() || !self.occluders.is_empty(),
            step: self.fades.step(fade_s),
            stamp: Stamp { frame: if self.view.casts { 0 } else { frame }, then: frame.saturating_add(ahead) },
        };
        let (required, shown_px2, fade) = (visit.required, visit.shown_px * visit.shown_px, visit.fade);
        let all = TileFrame { next: first, end: first + 1, mask, purpose, required, shown_px2, fade };
        if ahead > 0 {
            self.walk_tiles::<true, true>(&walk, first, &all, &mut []);
        } else if fade_s > 0.0 && purpose == Purpose::Draw {
            let mut marks = self.fades.take_tiles(visit.place, walk.id.generation, tiles.len());
            self.walk_tiles::<true, false>(&walk, first, &all, &mut marks);
            self.fades.give_back_tiles(visit.place, marks);
        } else {
            self.walk_tiles::<true, false>(&walk, first, &all, &mut []);
        }
    }

    /// Walks the tiles from `first` to the end of `all` and what is below them. There are no `marks` where
    /// nothing can fade. `LOOKS` at each tile, or takes for granted that it is not culled: wholly inside the frustum
    /// that is most of them. `AHEAD` where the picture is one of later.
    fn walk_tiles<const LOOKS: bool, const AHEAD: bool>(
        &mut self,
        walk: &Walk,
        first: u32,
        all: &TileFrame,
        marks: &mut [TileMark],
    ) {
        let looks_everywhere = walk.looks_everywhere();
        let base = self.tile_stack.len();
        self.tile_stack.push(all.read());
        let mut tile = first;
        // The tile at which there were no more that are plain, and what it was met for.
        let mut odd = (NONE, Purpose::Draw);
        while self.tile_stack.len() > base
            && let Some(above) = self.tile_stack.last().map(TileFrame::read)
        {
            if tile >= above.end {
                self.tile_stack.pop();
                tile = self.tile_stack.last().map_or(NONE, |above| above.next);
                continue;
            }
            if LOOKS && above.mask == 0 && !looks_everywhere {
                self.walk_tiles::<false, AHEAD>(walk, tile, &above, marks);
                tile = above.end;
                continue;
            }
            let record = &walk.tiles.records()[tile as usize];
            if record.flags & ODD == PLAIN && above.fade.is_whole() && odd != (tile, above.purpose) {
                tile = match above.purpose {
                    Purpose::Draw => self.draw_plain_tiles::<LOOKS, AHEAD>(walk, tile, base, marks),
                    _ => self.want_plain_tiles::<LOOKS, AHEAD>(walk, tile, base),
                };
                odd = (tile, above.purpose);
                continue;
            }
            let opened = self.meet_tile::<LOOKS, AHEAD>(walk, tile, &above, marks);
            tile = if opened { record.first_child } else { tile + 1 };
        }
    }

    /// Why a tile is met, and the planes that it crosses; `None` where it is culled. What this camera does not see is
    /// kept with its siblings all the same where the parent waits for all of them.
    #[inline(never)]
    fn look(&mut self, walk: &Walk, tile: u32, above: TileFrame) -> Option<(Purpose, u8)> {
        let record = &walk.tiles.records()[tile as usize];
        let kept = (above.required && walk.asks).then_some((Purpose::Keep, above.mask));
        let mut seen = Some((above.purpose, above.mask));
        if walk.may_hide {
            if walk.is_hidden(tile) {
                seen = Some(kept?);
            }
            // What stands for its parent's content, which is not there or fades in, goes on to.
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
        self.counters.tiles_visited += u32::from(seen.is_none());
        seen
    }

    /// Asks for what a tile lacks, draws it, and opens it where its children are to be met.
    #[inline(never)]
    fn meet_tile<const LOOKS: bool, const AHEAD: bool>(
        &mut self,
        walk: &Walk,
        tile: u32,
        above: &TileFrame,
        marks: &mut [TileMark],
    ) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let seen = if LOOKS { self.look(walk, tile, *above) } else { Some((above.purpose, 0)) };
        let Some((purpose, mask)) = seen else { return false };
        self.counters.tiles_visited += 1;
        walk.stamp.put::<AHEAD>(&walk.tiles.last_used()[tile as usize]);
        if record.flags & KINDS == PLAIN {
            self.meet_replaced_tile(walk, tile, (purpose, mask), above, marks)
        } else {
            self.meet_odd_tile(walk, tile, (purpose, mask), above, marks)
        }
    }

    /// The same of tiles without content, of other tile sets, and of content that stays with its children.
    #[inline(never)]
    fn meet_odd_tile(
        &mut self,
        walk: &Walk,
        tile: u32,
        (purpose, mask): (Purpose, u8),
        above: &TileFrame,
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
                let (hanger, fade) = (self.hangers.len() as u32, above.fade);
                let (required, shown_px) = (above.required, above.shown_px2.sqrt());
                self.hangers.push(Hanger { purpose, required, shown_px, ..self.hangers[walk.view.hanger as usize] });
                let state = self.chain_state(walk.page, walk.state_path(tile, record));
                let state = self.faded_state(state, fade.band());
                self.queue.push(Waiting { first: tile, end: tile + 1, hanger, state, fade, mask });
            } else if resident && purpose == Purpose::Draw {
                self.draw(walk, tile, record, mask, above.fade);
            }
            return purpose != Purpose::Keep
                && self.open_tile(walk, tile, (purpose, mask), false, above.shown_px2, above.fade);
        }
        if !record.has(flag::CONTENT) {
            let (range2, distance2) = walk.range_and_distance(tile, record, &walk.tiles.bounds()[tile as usize]);
            return distance2 < range2
                && self.open_tile(walk, tile, (purpose, mask), above.required, above.shown_px2, above.fade);
        }
        // Content that stays with its children.
        match purpose {
            Purpose::Keep => false,
            Purpose::Want => {
                let (range2, distance2) = walk.range_and_distance(tile, record, &walk.tiles.bounds()[tile as usize]);
                let shown_px2 = walk.below_px2(range2, distance2, above.shown_px2);
                distance2 < range2 && self.open_tile(walk, tile, (purpose, mask), false, shown_px2, above.fade)
            }
            Purpose::Draw => self.fade_tile(walk, tile, mask, &above, marks),
        }
    }

    /// The same of content that its children replace.
    #[inline(always)]
    fn meet_replaced_tile(
        &mut self,
        walk: &Walk,
        tile: u32,
        (purpose, mask): (Purpose, u8),
        above: &TileFrame,
        marks: &mut [TileMark],
    ) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let resident = record.has(flag::RESIDENT);
        if purpose == Purpose::Keep || !record.has_children() {
            if !resident {
                self.request_missing(walk, tile, purpose, above.shown_px2, above.fade);
            }
            let draws = purpose == Purpose::Draw && (resident || !stays(marks, tile as usize, walk.step, false, false));
            return draws && self.fade_tile(walk, tile, mask, above, marks);
        }
        let (range2, distance2) = walk.range_and_distance(tile, record, &walk.tiles.bounds()[tile as usize]);
        let wants = distance2 < range2 && walk.may_be_replaced(record);
        let is_refined = purpose == Purpose::Draw && record.not_ready_children == 0 && (wants || !resident);
        let mut above_px2 = above.shown_px2;
        let is_skipped = wants && !resident && walk.skips(record, (range2, distance2), above_px2);
        if !(resident || (is_refined && wants) || is_skipped) {
            above_px2 = self.request_missing(walk, tile, purpose, above.shown_px2, above.fade);
        }
        if purpose == Purpose::Draw && (resident || !stays(marks, tile as usize, walk.step, is_refined, false)) {
            let above = TileFrame { shown_px2: above_px2, ..above.read() };
            return self.fade_tile(walk, tile, mask, &above, marks);
        }
        let shown_px2 = if is_skipped { above_px2 } else { walk.below_px2(range2, distance2, above_px2) };
        let purpose = if is_refined { Purpose::Draw } else { Purpose::Want };
        (is_refined || wants) && self.open_tile(walk, tile, (purpose, mask), true, shown_px2, above.fade)
    }

    /// Draws a tile with content, and opens it where its children are to be met. One gives way to the other in time.
    #[inline(never)]
    fn fade_tile(&mut self, walk: &Walk, tile: u32, mask: u8, above: &TileFrame, marks: &mut [TileMark]) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let fade = above.fade;
        let resident = record.has(flag::RESIDENT);
        let replaces = !record.has(flag::ADD);
        let ready = record.not_ready_children == 0;
        let (range2, distance2) = walk.range_and_distance(tile, record, &walk.tiles.bounds()[tile as usize]);
        let is_near = distance2 < range2 && walk.may_be_replaced(record);
        let wants = record.has_children() && is_near;
        let is_refined = shows_children(record, is_near);
        let (mut shows_own, mut shows_children) = (!replaces || !is_refined, is_refined);
        let (mut own, mut children) = (fade.band(), fade.band());
        if let Some(mark) = marks.get_mut(tile as usize)
            && !mark.stays(walk.step, is_refined, resident)
        {
            let can_fade = !replaces || (resident && ready);
            let turn = mark.turn(walk.step, is_refined, can_fade, resident, fade.covered());
            self.counters.fading += u32::from(turn.is_fading);
            (children, own) = fade.band().split(turn.refined);
            own = if replaces { own } else { fade.band() }.split(turn.own).0;
            (shows_own, shows_children) = (!replaces || turn.refined < WHOLE, turn.refined > 0);
        }
        if shows_own && resident {
            self.draw(walk, tile, record, mask, fade.with_band(own));
        }
        let shown_px2 = walk.below_px2(range2, distance2, above.shown_px2);
        if shows_children {
            let covered = fade.covered() || (!replaces && resident);
            let leaving = fade.leaving() || !is_refined;
            let fade = Fade::new(children, covered, leaving);
            self.open_tile(walk, tile, (Purpose::Draw, mask), replaces, shown_px2, fade)
        } else {
            wants && self.open_tile(walk, tile, (Purpose::Want, mask), true, shown_px2, fade)
        }
    }

    /// Goes on below a tile, unless nothing is to be met there. What holds for its children is the last of the stack.
    fn open_tile(
        &mut self,
        walk: &Walk,
        tile: u32,
        (purpose, mask): (Purpose, u8),
        required: bool,
        shown_px2: f32,
        fade: Fade,
    ) -> bool {
        let record = &walk.tiles.records()[tile as usize];
        let is_met = record.has_children() && (walk.asks || purpose == Purpose::Draw);
        if is_met {
            let (next, end) = (record.first_child, record.end_of_children());
            frame::open(self.tile_stack, tile + 1, TileFrame { next, end, mask, purpose, required, shown_px2, fade });
        }
        is_met
    }

    /// The frame of a transform; pages with many tile trees have them in one frame.
    fn tile_view(&mut self, page: &Page, visit: &PageVisit, transform: u32) -> TileView {
        match self.tile_view {
            Some(view) if view.transform == transform => view,
            _ => {
                let eye_from_tile = visit.eye_from_page * page.transforms().page_from_node(transform);
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
                self.hangers.push(Hanger {
                    eye_from_frame: eye_from_tile,
                    page: visit.place,
                    view: self.view.index,
                    purpose: Purpose::Draw,
                    required: false,
                    shown_px: 0.0,
                });
                let m = &eye_from_tile.matrix3;
                let forward = (m.row(2) / -m.x_axis.length()).as_vec3().extend(0.0);
                let eye = page.tiles().grid().eye(eye);
                let grid_planes = planes.on_grid(eye.step_m(), eye.rest_m());
                *self.tile_view.insert(TileView { transform, hanger, planes, grid_planes, eye, forward, horizon })
            }
        }
    }

    /// True for a tile behind the horizon or in the shadow of an occluder.
    #[inline]
    fn is_behind(&mut self, walk: &Walk, tile: u32) -> bool {
        let bounds = &walk.tiles.bounds()[tile as usize];
        let [x, y, z, _] = walk.view.eye.offset_to(bounds).to_array();
        walk.view.horizon.as_ref().is_some_and(|h| h.hides([x, y, z], bounds.radius_m()))
            || (!self.occluders.is_empty() && self.is_in_shadow(walk, bounds, [x, y, z]))
    }

    /// True for a tile in the shadow of an occluder.
    #[cold]
    fn is_in_shadow(&mut self, walk: &Walk, bounds: &TileBounds, offset: [f32; 3]) -> bool {
        let axes = walk.tiles.axes_of(bounds);
        let reach = |p: glam::Vec4| {
            if bounds.is_sphere() {
                return bounds.radius_m();
            }
            let along = |axis: &[f32; 3]| (p.x * axis[0] + p.y * axis[1] + p.z * axis[2]).abs();
            axes.iter().zip(bounds.half_m()).map(|(axis, half)| along(axis) * half).sum()
        };
        let hidden = bounds.radius_m() < UNBOUNDED && self.occluders.hide(self.tile_occluders, offset, reach);
        self.counters.occluded += u32::from(hidden);
        hidden
    }

    /// Lets the content of a tile wait for its visit.
    fn draw(&mut self, walk: &Walk, tile: u32, record: &TileRecord, mask: u8, fade: Fade) {
        if fade.band().is_empty() {
            return;
        }
        let state = self.chain_state(walk.page, walk.state_path(tile, record));
        let state = if fade.is_whole() { state } else { self.faded_state(state, fade.band()) };
        self.counters.tiles_drawn += 1;
        let hanger = walk.view.hanger;
        self.queue.push(Waiting { first: tile, end: tile + 1, hanger, state, fade, mask });
    }

    /// Asks for the content of a tile, unless it is there or cannot come. What tiles below may have for a squared error
    /// of what is shown, so that they come later.
    #[inline(never)]
    fn request_missing(&mut self, walk: &Walk, tile: u32, purpose: Purpose, shown_px2: f32, fade: Fade) -> f32 {
        let record = &walk.tiles.records()[tile as usize];
        let may_come = record.has_slot() && !record.has(flag::RESIDENT | flag::FAILED | flag::NEVER);
        if !may_come || fade.leaving() || !walk.asks {
            return shown_px2;
        }
        let slot = NodeId { page: walk.id, index: walk.tiles.nodes()[tile as usize] };
        let bounds = &walk.tiles.bounds()[tile as usize];
        // The finest tiles have none.
        let has_error = bounds.metric_m() > 0.0;
        let error_px2 = if has_error { walk.px2(walk.range_and_distance(tile, record, bounds)) } else { 0.0 };
        let share = if purpose == Purpose::Keep { KEPT_SHARE } else { walk.view.share_of_place(bounds) };
        let finite = |px: f32| if px > 0.0 { px.min(MOST_PX) } else { 0.0 };
        let priority = finite(shown_px2.sqrt() * share);
        let error_px = finite(error_px2.sqrt());
        self.stage.requests.push(PageRequest { slot, priority, error_px, ahead_frames: 0 });
        priority * priority
    }
}

impl TileView {
    /// What a tile's place in the picture makes of its priority: all in the middle and around the eye, a half where its
    /// bounds begin 45 degrees from it.
    #[inline(always)]
    fn share_of_place(&self, bounds: &TileBounds) -> f32 {
        let offset = self.eye.offset_to(bounds);
        let (distance2, along, radius2) = (offset.length_squared(), offset.dot(self.forward), bounds.radius2_m2());
        if radius2 >= distance2 {
            return 1.0;
        }
        // Each times the distance: the sine of the angle to the centre, and of half the angle that the bounds take in
        // its cosine and sine.
        let [across, half_cos, half_sin] =
            [(distance2 - along * along).max(0.0), distance2 - radius2, radius2].map(f32::sqrt);
        if across * half_cos > along * half_sin {
            let cos = (along * half_cos + across * half_sin).max(0.0) / distance2;
            (cos * cos).max(KEPT_SHARE)
        } else {
            1.0
        }
    }
}

/// Whether a tile with content that is met to be drawn shows its children, where it `is_near` enough for them: in its own
/// place also where its content is not there.
pub(super) fn shows_children(record: &TileRecord, is_near: bool) -> bool {
    let replaces = !record.has(flag::ADD);
    let may = !replaces || record.not_ready_children == 0;
    record.has_children() && may && (is_near || (replaces && !record.has(flag::RESIDENT)))
}

/// True for a tile that is what it is to be.
#[inline(always)]
fn stays(marks: &mut [TileMark], tile: usize, step: Step, is_refined: bool, resident: bool) -> bool {
    marks.get_mut(tile).is_none_or(|mark| mark.stays(step, is_refined, resident))
}

impl Stamp {
    /// Stamps a tile; one of later only where it is neither in use nor wanted sooner.
    #[inline(always)]
    fn put<const AHEAD: bool>(self, last_used: &AtomicU32) {
        if self.frame != 0 && (!AHEAD || !(self.frame - 1..self.then).contains(&last_used.load(Ordering::Relaxed))) {
            last_used.store(self.then, Ordering::Relaxed);
        }
    }
}

impl Walk<'_> {
    /// Not only the frustum culls.
    #[inline(always)]
    fn looks_everywhere(&self) -> bool {
        self.may_hide || self.may_be_behind
    }

    #[inline]
    fn state_path(&self, tile: u32, record: &TileRecord) -> u32 {
        if record.has(flag::OWN_PATH) { self.tiles.state_path(tile, self.root) } else { self.root.state_path }
    }

    /// True of whatever has no content that children replace, too.
    #[inline(always)]
    fn may_be_replaced(&self, record: &TileRecord) -> bool {
        self.tiles.may_be_replaced(record, self.view.eye.position)
    }

    #[inline]
    fn is_hidden(&self, tile: u32) -> bool {
        let node = self.tiles.nodes()[tile as usize] as usize;
        self.page.masks().get(node).copied().unwrap_or(u32::MAX) & self.cull_mask == 0
    }

    #[inline(always)]
    fn test(&self, bounds: &TileBounds, mask: u8) -> Option<u8> {
        if bounds.is_along_frame() {
            return self.view.grid_planes.test_aligned(self.view.eye.steps_to(bounds), bounds.extent(), mask);
        }
        let offset = self.view.eye.offset_to(bounds);
        if bounds.is_sphere() {
            self.view.planes.test_sphere(offset.with_w(bounds.radius_m()), mask)
        } else {
            self.view.planes.test_oriented(offset, self.tiles.axes_of(bounds), bounds.half_m(), mask)
        }
    }

    /// The squared error of a tile in pixels. Roots are left to those that ask for something.
    #[inline(always)]
    fn px2(&self, (range2, distance2): (f32, f32)) -> f32 {
        self.max_sse_px2 * (range2 / distance2)
    }

    /// True for a tile that its children will replace, and that is not much finer than what is shown meanwhile.
    #[inline(always)]
    fn skips(&self, record: &TileRecord, (range2, distance2): (f32, f32), shown_px2: f32) -> bool {
        shown_px2 * distance2 < self.skip_px2 * range2
            && record.flags & (flag::CONTENT_BELOW | flag::FAILED_BELOW) == flag::CONTENT_BELOW
    }

    /// The squared error of what is shown while tiles below are missing: never as large as what is shown above, so that
    /// coarse comes first whatever the bounds are.
    #[inline(always)]
    fn below_px2(&self, range2: f32, distance2: f32, above_px2: f32) -> f32 {
        let (own, most) = (self.px2((range2, distance2)), above_px2 * 0.998);
        if own < most { own } else { most }
    }

    /// Squared distance at which a tile wants its children, and squared distance now.
    #[inline(always)]
    fn range_and_distance(&self, tile: u32, record: &TileRecord, bounds: &TileBounds) -> (f32, f32) {
        self.tiles.range_and_distance(tile, record, bounds, &self.view.eye, &self.ranges)
    }
}

/// Priority of tiles outside the frustum, as a share of what it would be inside.
const KEPT_SHARE: f32 = 0.25;

/// Errors above it are said to be so large; its square is finite.
pub(super) const MOST_PX: f32 = 1.8e19;
