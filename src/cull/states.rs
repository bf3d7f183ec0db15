//! The states of leaves: where the chains of state sets of a page lie in the state graph and in the stage. Found once for
//! each page, remembered until the next. Thread that culls.

use super::fade::FadeBand;
use super::state_graph::ROOT;
use super::visitor::Cull;
use crate::scene::{BLEND, NONE, Page, VIEW};

impl Cull<'_> {
    /// The place in the stage of the state of the leaves of one of the page's chains.
    #[inline(always)]
    pub(super) fn state_of(&mut self, page: &Page, path: u32) -> u32 {
        match self.memo.get(path as usize) {
            Some(&state) if state != NONE => state,
            _ => self.meet_state(page, path),
        }
    }

    /// The same of four.
    #[inline(always)]
    pub(super) fn states_of(&mut self, page: &Page, paths: [u32; 4]) -> [u32; 4] {
        let memo = &self.memo[..];
        let states = paths.map(|path| memo.get(path as usize).copied().unwrap_or(NONE));
        if states.contains(&NONE) { paths.map(|path| self.state_of(page, path)) } else { states }
    }

    #[inline(never)]
    fn meet_state(&mut self, page: &Page, path: u32) -> u32 {
        let state = self.chain_state(page, path);
        let state = self.faded_state(state, self.band);
        let state = self.graph.meet(state, self.stage);
        if let Some(known) = self.memo.get_mut(path as usize) {
            *known = state;
        }
        state
    }

    /// Draws what comes in another part of the pixels; the one before.
    pub(super) fn enter_band(&mut self, band: FadeBand) -> FadeBand {
        self.memo.fill(NONE);
        std::mem::replace(&mut self.band, band)
    }

    /// A state, drawn in a part of the pixels.
    #[inline(always)]
    pub(super) fn faded_state(&mut self, state: u32, band: FadeBand) -> u32 {
        if band.is_full() { state } else { self.find_faded_state(state, band) }
    }

    #[cold]
    fn find_faded_state(&mut self, state: u32, band: FadeBand) -> u32 {
        let fades = &mut self.stage.fades;
        let place = fades.iter().position(|b| *b == band).unwrap_or_else(|| {
            fades.push(band);
            fades.len() - 1
        });
        self.graph.find_or_insert_fade(state, place as u32 + 1)
    }

    /// The state below one of the page's chains, whether or not it has leaves.
    #[inline(always)]
    pub(super) fn chain_state(&mut self, page: &Page, path: u32) -> u32 {
        match self.chains.get(path as usize) {
            Some(&state) if state != NONE => state,
            Some(_) => self.find_chain(page, path),
            None => ROOT,
        }
    }

    #[inline(always)]
    fn find_chain(&mut self, page: &Page, path: u32) -> u32 {
        match self.find_step(page, path) {
            NONE => self.find_parents(page, path),
            state => state,
        }
    }

    #[cold]
    fn find_parents(&mut self, page: &Page, path: u32) -> u32 {
        // Up to the first chain below a known one, one step down, again; chains are as deep as the graph at most.
        loop {
            let mut at = path;
            let below = loop {
                match self.find_step(page, at) {
                    NONE => at = page.state_paths()[at as usize].parent,
                    state => break state,
                }
            };
            if at == path {
                return below;
            }
        }
    }

    /// The state of a chain where that of its parent is known, which is remembered; else `NONE`.
    #[inline(always)]
    fn find_step(&mut self, page: &Page, path: u32) -> u32 {
        let Some(link) = page.state_paths().get(path as usize) else { return ROOT };
        let above = match self.chains.get(link.parent as usize) {
            Some(&NONE) if link.parent != path => return NONE,
            Some(&NONE) | None => ROOT,
            Some(&above) => above,
        };
        let below = match page.state_sets().get(link.set as usize) {
            Some(set) => self.graph.find_or_insert_path(path, above, set),
            None if link.set == BLEND => self.graph.find_or_insert_blend(above),
            None if link.set == VIEW => self.graph.find_or_insert_view(above, self.view.index),
            None => above,
        };
        self.chains[path as usize] = below;
        below
    }
}
