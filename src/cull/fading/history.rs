//! The state of cross-fades, kept from frame to frame: one mark of 8 bytes per tile that was met, and one per Lod. Culling
//! thread.
//!
//! A mark counts only if its tile was met in the cull before, so that tiles that were out of view appear at once. Marks
//! hold no content: the fade of a tile that expired in the meantime is over.

use std::sync::atomic::{AtomicU32, Ordering};

use super::band::WHOLE;
use crate::scene::PageId;

/// A tile as it was drawn when it was met last. Shares are fractions of [`WHOLE`].
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::cull) struct TileMark {
    cull: u32,
    /// Share of the pixels that the children have taken over from the tile, and share of the rest in which the tile's own
    /// content has faded in. Compared at once in the tile walk.
    shares: [u16; 2],
}

/// A part of what a tile shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::cull) enum TilePart {
    /// The tile's content, which its children replace.
    Own,
    /// The tile's content, to which its children are added.
    Added,
    /// The tiles below.
    Below,
}

/// Shares of the pixels in which a tile and its children are drawn.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct TileShares {
    /// Share of the children.
    pub children: u16,
    /// Share of the tile's own content in what the children leave.
    pub own: u16,
    /// Some share is neither none nor all.
    pub is_fading: bool,
}

/// A Lod as it was drawn when it was met last.
#[derive(Clone, Copy, Debug, Default)]
struct LodMark {
    cull: u32,
    /// Share of the pixels that the new children have taken over.
    share: u16,
    /// Children in range before the last change, one bit each.
    old: u64,
    /// Children in range after the last change, one bit each.
    new: u64,
}

/// The children that a Lod draws: those of both sets in all pixels, others of the old or the new set in their band.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct LodShares {
    pub old: u64,
    pub new: u64,
    /// Share of the new set.
    pub share: u16,
}

/// Identifies a Lod in its page.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct LodIndex {
    pub page: PageId,
    /// Index of the Lod in the page.
    pub index: usize,
    /// Number of Lods in the page.
    pub count: usize,
}

/// The marks of one page.
#[derive(Debug, Default)]
struct PageMarks {
    generation: u32,
    tiles: Vec<TileMark>,
    lods: Vec<LodMark>,
}

/// All fades of one eye.
#[derive(Debug, Default)]
pub(in crate::cull) struct LodFades {
    /// Identifies the eye in the process; 0 before its first cull.
    eye: u32,
    /// By slot in the scene's page table.
    pages: Vec<PageMarks>,
    /// Number of the cull; 0 stands for none.
    cull: u32,
    time_s: f64,
    /// Time since the cull before.
    delta_s: f64,
}

/// The progress of fades in one cull.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct FadeStep {
    cull: u32,
    /// Share by which each fade advances.
    share: u16,
}

impl LodFades {
    /// Starts a cull at a time of the application.
    pub fn start(&mut self, time_s: f64) {
        if self.eye == 0 {
            static EYES: AtomicU32 = AtomicU32::new(1);
            self.eye = EYES.fetch_add(1, Ordering::Relaxed).max(1);
        }
        self.cull = self.cull.wrapping_add(1).max(1);
        self.delta_s = time_s - std::mem::replace(&mut self.time_s, time_s);
    }

    /// Returns a number that identifies the eye in the process.
    pub fn eye(&self) -> u32 {
        self.eye
    }

    /// Returns the step of fades that take `fade_s` seconds. It completes them where time stands still, runs backwards or
    /// jumps.
    pub fn step(&self, fade_s: f64) -> FadeStep {
        let is_part = self.delta_s > 0.0 && self.delta_s < fade_s;
        let share = if is_part { (self.delta_s / fade_s * f64::from(WHOLE)).ceil() as u16 } else { WHOLE };
        FadeStep { cull: self.cull, share: share.max(1) }
    }

    /// Takes the marks of a page's tiles for a walk; [`Self::give_back_tiles`] stores them again.
    pub fn take_tiles(&mut self, page: PageId, count: usize) -> Vec<TileMark> {
        let mut tiles = std::mem::take(&mut self.page_mut(page).tiles);
        if tiles.len() != count {
            tiles.clear();
            tiles.resize(count, TileMark::default());
        }
        tiles
    }

    /// Stores the marks that [`Self::take_tiles`] returned.
    pub fn give_back_tiles(&mut self, page: PageId, tiles: Vec<TileMark>) {
        if let Some(marks) = self.pages.get_mut(page.slot as usize) {
            marks.tiles = tiles;
        }
    }

    /// Returns true if a part of a tile is drawn in all of its pixels, with no fade under way. Valid before the tile is met
    /// in the current cull.
    pub fn tile_is_settled(&self, page: PageId, tile: u32, part: TilePart) -> bool {
        let mark = self.page(page).and_then(|p| p.tiles.get(tile as usize));
        let is_settled = |m: &TileMark| match (part, m.shares) {
            (TilePart::Below, [children, _]) => children == WHOLE,
            (TilePart::Added, [_, own]) => own == WHOLE,
            (TilePart::Own, shares) => shares == [0, WHOLE],
        };
        mark.is_none_or(|m| !self.is_recent(m.cull) || is_settled(m))
    }

    /// Returns true if a child of a Lod has completely faded in. Valid before the Lod is met in the current cull.
    pub fn lod_is_settled(&self, page: PageId, lod: usize, child: usize) -> bool {
        let mark = self.page(page).and_then(|p| p.lods.get(lod));
        let is_settled =
            |m: &LodMark| m.share == WHOLE && m.new.checked_shr(child as u32).is_none_or(|bits| bits & 1 != 0);
        mark.is_none_or(|m| !self.is_recent(m.cull) || is_settled(m))
    }

    fn page(&self, page: PageId) -> Option<&PageMarks> {
        self.pages.get(page.slot as usize).filter(|p| p.generation == page.generation)
    }

    /// Returns true for the current cull and the one before.
    fn is_recent(&self, cull: u32) -> bool {
        cull == self.cull || cull == before(self.cull)
    }

    /// Returns the marks of a page; those of another page in the same slot are dropped.
    fn page_mut(&mut self, page: PageId) -> &mut PageMarks {
        let slot = page.slot as usize;
        if self.pages.len() <= slot {
            self.pages.resize_with(slot + 1, PageMarks::default);
        }
        let marks = &mut self.pages[slot];
        if marks.generation != page.generation {
            marks.generation = page.generation;
            marks.tiles.clear();
            marks.lods.clear();
        }
        marks
    }

    /// Advances the fade of a Lod whose children in range are the bits of `active`, and returns what it draws.
    ///
    /// A further change waits until the fade has finished, except for the change back, which reverses the fade.
    pub fn advance_lod(&mut self, lod: LodIndex, active: u64, step: FadeStep) -> LodShares {
        let lods = &mut self.page_mut(lod.page).lods;
        if lods.len() != lod.count {
            lods.clear();
            lods.resize(lod.count, LodMark::default());
        }
        let mark = &mut lods[lod.index];
        let LodMark { cull, share, old, new } = *mark;
        if cull != step.cull {
            let is_immediate = cull != before(step.cull) || step.share == WHOLE;
            let (share, old, new) = match share {
                _ if is_immediate => (WHOLE, active, active),
                WHOLE if active != new => (step.share, new, active),
                WHOLE => (WHOLE, new, new),
                _ if active == old && old != new => ((WHOLE - share).saturating_add(step.share), new, old),
                _ => (share.saturating_add(step.share), old, new),
            };
            *mark = LodMark { cull: step.cull, share, old, new };
        }
        LodShares { old: mark.old, new: mark.new, share: mark.share }
    }
}

/// Returns the number of the cull before.
fn before(cull: u32) -> u32 {
    cull.wrapping_sub(1).max(1)
}

/// The state towards which the fade of a tile moves.
#[derive(Clone, Copy, Debug)]
pub struct FadeTarget {
    /// True if the children are drawn in the end.
    pub is_refined: bool,
    /// True if the tile's content is on the GPU.
    pub is_resident: bool,
}

/// The circumstances of a tile's fade.
#[derive(Clone, Copy, Debug)]
pub struct FadeConditions {
    /// False where only one of the tile and its children can be drawn.
    pub can_fade: bool,
    /// True if content above is drawn behind the tile's own, which then fades in; otherwise it appears at once.
    pub is_covered: bool,
}

impl TileMark {
    /// Returns true if the tile's fade has finished and its refinement and residency have not changed: the usual case in
    /// a steady frame. The mark is then up to date.
    #[inline(always)]
    pub fn is_settled(&mut self, step: FadeStep, target: FadeTarget) -> bool {
        let whole = |is: bool| if is { WHOLE } else { 0 };
        let is_settled = self.shares == [whole(target.is_refined), whole(target.is_resident)];
        if is_settled {
            self.cull = step.cull;
        }
        is_settled
    }

    /// Advances the fade between a tile and its children and returns their shares.
    #[cold]
    pub fn advance(&mut self, step: FadeStep, target: FadeTarget, conditions: FadeConditions) -> TileShares {
        let FadeTarget { is_refined, is_resident } = target;
        let FadeConditions { can_fade, is_covered } = conditions;
        let target = if is_refined { WHOLE } else { 0 };
        let [mut children, mut own] = self.shares;
        if self.cull != step.cull {
            own = match (is_resident, is_covered) {
                (true, true) => self.next(step, own, WHOLE),
                (true, false) => WHOLE,
                (false, _) => 0,
            };
            children = self.next(step, children, target);
            self.cull = step.cull;
        }
        if !can_fade {
            children = target;
        }
        self.shares = [children, own];
        let is_fading = (children > 0 && children < WHOLE) || (is_resident && own < WHOLE);
        TileShares { children, own, is_fading }
    }

    /// Moves a share one step towards a target; all the way if the tile was not met in the cull before.
    fn next(&self, step: FadeStep, share: u16, target: u16) -> u16 {
        if self.cull != before(step.cull) || step.share == WHOLE {
            target
        } else if share < target {
            share.saturating_add(step.share)
        } else {
            share.saturating_sub(step.share).max(target)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tile_fades_to_its_children_and_back() {
        let mut fades = LodFades::default();
        let mut mark = TileMark::default();
        let alone = FadeConditions { can_fade: true, is_covered: false };
        let mut shares = |times: &[f64], is_refined| -> Vec<u16> {
            let advance = |time: &f64| {
                fades.start(*time);
                let step = fades.step(0.25);
                let target = FadeTarget { is_refined, is_resident: true };
                let share = mark.advance(step, target, alone).children;
                let other = FadeTarget { is_refined: !is_refined, ..target };
                assert_eq!(mark.advance(step, other, alone).children, share, "met twice in one cull");
                assert_eq!(mark.is_settled(step, target), share == if is_refined { WHOLE } else { 0 });
                share
            };
            times.iter().map(advance).collect()
        };
        assert_eq!(shares(&[10.0, 10.1], false), [0, 0]);
        let shares_in = shares(&[10.2, 10.3, 10.4, 10.5], true);
        assert!(shares_in[0] > 0 && shares_in[0] < shares_in[1] && shares_in[1] < WHOLE, "{shares_in:?}");
        assert_eq!(shares_in[2..], [WHOLE, WHOLE]);
        let back = shares(&[10.6, 10.7], false);
        assert_eq!(back[0], WHOLE - shares_in[0]);
        assert!(shares(&[10.75], true)[0] > back[1], "reversed half way");
        assert_eq!(shares(&[10.75], false), [0], "time stands still");
        assert_eq!(shares(&[11.75], true), [WHOLE], "time jumps");
        fades.start(11.8);
        fades.start(11.85);
        let step = fades.step(0.25);
        let coarse = FadeTarget { is_refined: false, is_resident: true };
        assert_eq!(mark.advance(step, coarse, alone).children, 0, "not met in the cull before");
    }

    #[test]
    fn lod_finishes_its_fade_before_another_change_but_reverses_at_once() {
        let mut fades = LodFades::default();
        let page = PageId { scene: crate::scene::Scene::new().number(), slot: 3, generation: 7 };
        let lod = LodIndex { page, index: 0, count: 1 };
        let mut advance = |time: f64, active: u64| {
            fades.start(time);
            let step = fades.step(1.0);
            let LodShares { old, new, share } = fades.advance_lod(lod, active, step);
            (old, new, (f64::from(share) / f64::from(WHOLE) * 100.0).round() as u32)
        };
        assert_eq!(advance(0.0, 1), (1, 1, 100));
        assert_eq!(advance(0.3, 1), (1, 1, 100));
        assert_eq!(advance(0.6, 2), (1, 2, 30));
        assert_eq!(advance(0.9, 1), (2, 1, 100), "reversed, and finished");
        assert_eq!(advance(1.2, 2), (1, 2, 30));
        assert_eq!(advance(1.5, 4), (1, 2, 60), "another change waits");
        assert_eq!(advance(2.0, 4), (1, 2, 100));
        assert_eq!(advance(2.1, 4), (2, 4, 10));
        assert_eq!(advance(9.9, 4), (4, 4, 100));
    }
}
