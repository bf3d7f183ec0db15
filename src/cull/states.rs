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

    #[cold]
    fn meet_state(&mut self, page: &Page, path: u32) -> u32 {
        let state = self.chain_state(page, path);
        let state = self.graph.meet(state, self.stage);
        if let Some(known) = self.memo.get_mut(path as usize) {
            *known = state;
        }
        state
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
            _ => self.find_chain(page, path),
        }
    }

    #[inline(never)]
    fn find_chain(&mut self, page: &Page, path: u32) -> u32 {
        // Up to the first chain that is known, one step down, again; chains are as deep as the graph at most.
        loop {
            let mut at = path;
            let above = loop {
                let Some(link) = page.paths.get(at as usize) else { return ROOT };
                match self.chains.get(link.parent as usize) {
                    Some(&state) if state != NONE => break state,
                    Some(_) if link.parent != at => at = link.parent,
                    _ => break ROOT,
                }
            };
            let set = page.paths[at as usize].set;
            let below = match page.state_sets.get(set as usize) {
                Some(set) => self.graph.find_or_insert(above, set),
                None if set == BLEND => self.graph.find_or_insert_blend(above),
                None if set == VIEW => self.graph.find_or_insert_view(above, self.view.index),
                None => above,
            };
            self.chains[at as usize] = below;
            if at == path {
                return below;
            }
        }
    }
}
