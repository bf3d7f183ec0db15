//! Cross-fades between levels of detail.
//!
//! Where a tile gives way to its children, or takes their place again, both are drawn for a short time, each in its
//! part of a dither pattern of the screen, so that every pixel shows one of them. What is drawn has a [`FadeBand`]: a
//! range of the pattern's values. A tile's band is split between its own content and its children; where children
//! refine in turn, theirs is split again, so that the parts never overlap and leave nothing out.
//!
//! Kept from frame to frame by each visitor, one mark of 8 bytes a tile that was met, and one a Lod. A mark counts only
//! when the tile was met in the cull before: what was out of the view appears at once. All that is drawn is met in the
//! scene as it is now; what was expired meanwhile is not there, and ends its fade.

use std::sync::atomic::{AtomicU32, Ordering};

/// The part of the dither pattern in which leaves are drawn: pixels whose value, of 0 to 254, is at least `from` and
/// less than `to`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FadeBand {
    /// First value.
    pub from: u8,
    /// Value behind the last.
    pub to: u8,
}

/// Shares are fractions of it.
pub(super) const WHOLE: u16 = u16::MAX;

impl FadeBand {
    /// Every pixel.
    pub const FULL: Self = Self { from: 0, to: u8::MAX };

    /// True where every pixel is drawn.
    pub fn is_full(self) -> bool {
        self == Self::FULL
    }

    /// True where no pixel is drawn.
    pub fn is_empty(self) -> bool {
        self.from >= self.to
    }

    /// The first part, as large as the share, and the rest.
    pub(super) fn split(self, share: u16) -> (Self, Self) {
        let width = u32::from(self.to.saturating_sub(self.from));
        let first = (width * u32::from(share) + u32::from(WHOLE) / 2) / u32::from(WHOLE);
        let middle = self.from + first as u8;
        (Self { to: middle, ..self }, Self { from: middle, ..self })
    }
}

/// How what is below a tile or a Lod fades; one word, as tile walks hand it down very often.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Fade(u32);

impl Fade {
    pub const NONE: Self = Self::new(FadeBand::FULL, false, false);

    /// Content of a tile above is drawn too where it is `covered`, under ADD: what arrives fades in over it. What is
    /// `leaving` is being faded out: nothing is asked for any more.
    pub const fn new(band: FadeBand, covered: bool, leaving: bool) -> Self {
        Self(band.from as u32 | (band.to as u32) << 8 | (covered as u32) << 16 | (leaving as u32) << 24)
    }

    pub fn band(self) -> FadeBand {
        FadeBand { from: self.0 as u8, to: (self.0 >> 8) as u8 }
    }

    /// True where every pixel is drawn.
    pub fn is_whole(self) -> bool {
        self.0 as u16 == Self::NONE.0 as u16
    }

    pub fn covered(self) -> bool {
        self.0 & 1 << 16 != 0
    }

    pub fn leaving(self) -> bool {
        self.0 & 1 << 24 != 0
    }

    pub fn with_band(self, band: FadeBand) -> Self {
        Self::new(band, self.covered(), self.leaving())
    }
}

/// A tile as it was met last.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TileMark {
    cull: u32,
    /// Share of the children in its place, and share of its own content that has come in.
    shares: [u16; 2],
}

/// Of what a tile shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TilePart {
    /// Its content, which the tiles below replace.
    Own,
    /// Its content, to which the tiles below are added.
    Added,
    /// The tiles below.
    Below,
}

/// What a tile draws.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    /// Share of its children.
    pub refined: u16,
    /// Share of its own content, of what the children leave.
    pub own: u16,
    pub is_fading: bool,
}

/// A Lod as it was met last.
#[derive(Clone, Copy, Debug, Default)]
struct LodMark {
    cull: u32,
    share: u16,
    /// Children in range before and after the last change, a bit each.
    old: u64,
    new: u64,
}

/// What a Lod draws: children of both sets whole, others of the old and the new one in their bands.
#[derive(Clone, Copy, Debug)]
pub(super) struct LodShares {
    pub old: u64,
    pub new: u64,
    pub share: u16,
}

#[derive(Debug, Default)]
struct PageMarks {
    generation: u32,
    tiles: Vec<TileMark>,
    lods: Vec<LodMark>,
}

/// The fades of one eye.
#[derive(Debug, Default)]
pub(super) struct LodFades {
    /// Names the eye; 0 before its first cull.
    eye: u32,
    /// By place in the scene's page table.
    pages: Vec<PageMarks>,
    /// Counts culls; 0 is none.
    cull: u32,
    time_s: f64,
    /// Since the cull before.
    delta_s: f64,
}

/// How far a fade goes on in a cull.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    cull: u32,
    share: u16,
}

impl LodFades {
    /// Starts a cull.
    pub fn start(&mut self, time_s: f64) {
        if self.eye == 0 {
            static EYES: AtomicU32 = AtomicU32::new(1);
            self.eye = EYES.fetch_add(1, Ordering::Relaxed).max(1);
        }
        self.cull = self.cull.wrapping_add(1).max(1);
        self.delta_s = time_s - std::mem::replace(&mut self.time_s, time_s);
    }

    /// A number that no other eye has.
    pub fn eye(&self) -> u32 {
        self.eye
    }

    /// How far fades of a length go on; all the way where time stands still, goes back or leaps.
    pub fn step(&self, fade_s: f64) -> Step {
        let is_part = self.delta_s > 0.0 && self.delta_s < fade_s;
        let share = if is_part { (self.delta_s / fade_s * f64::from(WHOLE)).ceil() as u16 } else { WHOLE };
        Step { cull: self.cull, share: share.max(1) }
    }

    /// The marks of a page's tiles, to be given back; kept while the page is the same one.
    pub fn take_tiles(&mut self, place: u32, generation: u32, count: usize) -> Vec<TileMark> {
        let mut tiles = std::mem::take(&mut self.page(place, generation).tiles);
        if tiles.len() != count {
            tiles.clear();
            tiles.resize(count, TileMark::default());
        }
        tiles
    }

    pub fn give_back_tiles(&mut self, place: u32, tiles: Vec<TileMark>) {
        if let Some(page) = self.pages.get_mut(place as usize) {
            page.tiles = tiles;
        }
    }

    /// False for a tile that gives way to its children or comes in: what it shows is not yet (or no more) there in every
    /// pixel. Before the tile is met in a cull.
    pub fn tile_rests(&self, place: u32, generation: u32, tile: u32, shown: TilePart) -> bool {
        let mark = self.met(place, generation).and_then(|p| p.tiles.get(tile as usize));
        let rests = |m: &TileMark| match (shown, m.shares) {
            (TilePart::Below, [refined, _]) => refined == WHOLE,
            (TilePart::Added, [_, own]) => own == WHOLE,
            (TilePart::Own, shares) => shares == [0, WHOLE],
        };
        mark.is_none_or(|m| !self.is_recent(m.cull) || rests(m))
    }

    /// False for a child of a Lod that comes in.
    pub fn lod_rests(&self, place: u32, generation: u32, lod: usize, child: usize) -> bool {
        let mark = self.met(place, generation).and_then(|p| p.lods.get(lod));
        let rests = |m: &LodMark| m.share == WHOLE && m.new.checked_shr(child as u32).is_none_or(|bits| bits & 1 != 0);
        mark.is_none_or(|m| !self.is_recent(m.cull) || rests(m))
    }

    fn met(&self, place: u32, generation: u32) -> Option<&PageMarks> {
        self.pages.get(place as usize).filter(|p| p.generation == generation)
    }

    /// In this cull or in the one before.
    fn is_recent(&self, cull: u32) -> bool {
        cull == self.cull || cull == before(self.cull)
    }

    fn page(&mut self, place: u32, generation: u32) -> &mut PageMarks {
        let place = place as usize;
        if self.pages.len() <= place {
            self.pages.resize_with(place + 1, PageMarks::default);
        }
        let page = &mut self.pages[place];
        if page.generation != generation {
            page.generation = generation;
            page.tiles.clear();
            page.lods.clear();
        }
        page
    }

    /// What a Lod draws that has these children in range. Another change waits until a fade is at its end, but for
    /// the way back.
    pub fn turn_lod(&mut self, place: u32, generation: u32, lod: (usize, usize), active: u64, step: Step) -> LodShares {
        let lods = &mut self.page(place, generation).lods;
        let (index, count) = lod;
        if lods.len() != count {
            lods.clear();
            lods.resize(count, LodMark::default());
        }
        let mark = &mut lods[index];
        let LodMark { cull, share, old, new } = *mark;
        if cull != step.cull {
            let at_once = cull != before(step.cull) || step.share == WHOLE;
            let (share, old, new) = match share {
                _ if at_once => (WHOLE, active, active),
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

fn before(cull: u32) -> u32 {
    cull.wrapping_sub(1).max(1)
}

impl TileMark {
    /// True for a tile that is what it is to be; all there is to do in a steady frame.
    #[inline(always)]
    pub fn stays(&mut self, step: Step, is_refined: bool, is_resident: bool) -> bool {
        let whole = |is: bool| if is { WHOLE } else { 0 };
        let stays = self.shares == [whole(is_refined), whole(is_resident)];
        if stays {
            self.cull = step.cull;
        }
        stays
    }

    /// The shares of a tile that is to give way to its children or not. `can_fade` is false where only one of the two
    /// can be drawn. Its own content comes in at once where it is not `covered`.
    #[cold]
    pub fn turn(&mut self, step: Step, is_refined: bool, can_fade: bool, is_resident: bool, covered: bool) -> Turn {
        let target = if is_refined { WHOLE } else { 0 };
        let [mut refined, mut own] = self.shares;
        if self.cull != step.cull {
            own = match (is_resident, covered) {
                (true, true) => self.next(step, own, WHOLE),
                (true, false) => WHOLE,
                (false, _) => 0,
            };
            refined = self.next(step, refined, target);
            self.cull = step.cull;
        }
        if !can_fade {
            refined = target;
        }
        self.shares = [refined, own];
        Turn { refined, own, is_fading: (refined > 0 && refined < WHOLE) || (is_resident && own < WHOLE) }
    }

    fn next(&self, step: Step, share: u16, target: u16) -> u16 {
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
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn parts_of_a_band_neither_overlap_nor_leave_anything_out(shares in prop::collection::vec(any::<u16>(), 1..6)) {
            let mut band = FadeBand::FULL;
            let mut drawn = [0; 255];
            let mut draw = |band: FadeBand| (band.from..band.to).for_each(|value| drawn[usize::from(value)] += 1);
            for share in shares {
                let (children, own) = band.split(share);
                draw(own);
                band = children;
            }
            draw(band);
            prop_assert_eq!(drawn, [1; 255]);
        }
    }

    #[test]
    fn the_ends_of_a_fade_are_whole() {
        let band = FadeBand { from: 20, to: 90 };
        assert_eq!(band.split(0), (FadeBand { from: 20, to: 20 }, band));
        assert_eq!(band.split(WHOLE), (band, FadeBand { from: 90, to: 90 }));
        assert!(band.split(0).0.is_empty() && FadeBand::FULL.is_full());
    }

    #[test]
    fn a_tile_turns_there_and_back() {
        let mut fades = LodFades::default();
        let mut mark = TileMark::default();
        let mut shares = |times: &[f64], is_refined| -> Vec<u16> {
            let turn = |time: &f64| {
                fades.start(*time);
                let step = fades.step(0.25);
                let share = mark.turn(step, is_refined, true, true, false).refined;
                assert_eq!(mark.turn(step, !is_refined, true, true, false).refined, share, "met twice in a cull");
                assert_eq!(mark.stays(step, is_refined, true), share == if is_refined { WHOLE } else { 0 });
                share
            };
            times.iter().map(turn).collect()
        };
        assert_eq!(shares(&[10.0, 10.1], false), [0, 0]);
        let coming = shares(&[10.2, 10.3, 10.4, 10.5], true);
        assert!(coming[0] > 0 && coming[0] < coming[1] && coming[1] < WHOLE, "{coming:?}");
        assert_eq!(coming[2..], [WHOLE, WHOLE]);
        let back = shares(&[10.6, 10.7], false);
        assert_eq!(back[0], WHOLE - coming[0]);
        assert!(shares(&[10.75], true)[0] > back[1], "turned round half way");
        assert_eq!(shares(&[10.75], false), [0], "time stands still");
        assert_eq!(shares(&[11.75], true), [WHOLE], "a leap");
        fades.start(11.8);
        fades.start(11.85);
        let step = fades.step(0.25);
        assert_eq!(mark.turn(step, false, true, true, false).refined, 0, "was not met in the cull before");
    }

    #[test]
    fn a_lod_goes_on_with_the_change_it_has_begun() {
        let mut fades = LodFades::default();
        let mut turn = |time: f64, active: u64| {
            fades.start(time);
            let step = fades.step(1.0);
            let LodShares { old, new, share } = fades.turn_lod(3, 7, (0, 1), active, step);
            (old, new, (f64::from(share) / f64::from(WHOLE) * 100.0).round() as u32)
        };
        assert_eq!(turn(0.0, 1), (1, 1, 100));
        assert_eq!(turn(0.3, 1), (1, 1, 100));
        assert_eq!(turn(0.6, 2), (1, 2, 30));
        assert_eq!(turn(0.9, 1), (2, 1, 100), "back, and there");
        assert_eq!(turn(1.2, 2), (1, 2, 30));
        assert_eq!(turn(1.5, 4), (1, 2, 60), "another change waits");
        assert_eq!(turn(2.0, 4), (1, 2, 100));
        assert_eq!(turn(2.1, 4), (2, 4, 10));
        assert_eq!(turn(9.9, 4), (4, 4, 100));
    }
}
