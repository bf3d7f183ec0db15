//! What goes: room in the budgets, pages that are not wanted any more, and requests that are given up. Update thread.

use std::time::Duration;

use super::DatabasePager;
use super::config::CompileContext;
use super::entry::{Entry, Progress};
use super::residents::Unused;
use super::scenes::Scenes;
use crate::io;
use crate::scene::{NodeId, Page, PageId, ProxyLoading, Scene};
use crate::timeline;

/// Pages looked at for expiry in one frame while less than [`EXPIRY_TENTHS`] are free: twice as many as in the frame
/// before while something goes, half as many while all are in use.
pub(super) const EXPIRY_LOOKS: std::ops::RangeInclusive<usize> = 16..=256;
/// Tenths of each budget that are kept free of what was not wanted for long.
pub(super) const EXPIRY_TENTHS: u64 = 1;
/// What is wanted in about as many frames as something else is not worth its place.
pub(super) const AHEAD_MARGIN: u32 = 2;

/// In want of room, the last two frames' tiles alone are safe.
pub(super) const UNSEEN: Unused = Unused { frames: 2, time: Duration::ZERO };

/// A budget without some tenths of it.
pub(super) fn less_tenths(budget: u64, tenths: u64) -> u64 {
    budget.saturating_sub(budget.div_ceil(10) * tenths)
}

impl DatabasePager {
    /// Of merged pages, what they share once.
    pub(super) fn cpu_bytes(&self) -> u64 {
        self.residents.cpu_bytes + self.shares.held.cpu
    }

    /// Of merged pages, what they share once.
    pub(super) fn gpu_bytes(&self) -> u64 {
        self.residents.gpu_bytes + self.shares.held.gpu
    }

    /// Frames until all pages have been looked at for what may go, where there is want of room.
    pub(crate) fn frames_to_look(&self) -> u32 {
        self.residents.len().div_ceil(*EXPIRY_LOOKS.end()) as u32
    }

    /// True while so many tenths of each budget are free.
    pub(super) fn has_free(&self, tenths: u64) -> bool {
        let is_free = |used: u64, max: u64| used <= less_tenths(max, tenths);
        let held = self.held();
        is_free(held.cpu, self.config.max_bytes_cpu)
            && is_free(held.gpu, self.config.max_bytes_gpu)
            && is_free(self.pages_held(), self.config.max_tiles as u64)
    }

    /// Takes out what was not wanted for long, while less than [`EXPIRY_TENTHS`] of a budget are free; where there is no
    /// room beside them for what will be wanted soon, what was not wanted for longer; where there is none for what is
    /// missing in a picture, what is in none just now.
    pub(super) fn expire(&mut self, scenes: &mut dyn Scenes, contexts: &mut [&mut dyn CompileContext]) {
        let config = &self.config;
        let mut unused = Unused { frames: config.expiry_frames, time: config.expiry_time };
        if let Some(ahead) = self.ahead_short {
            unused.frames = unused.frames.min(ahead.frames.saturating_add(AHEAD_MARGIN));
        }
        if self.is_short || self.lacks.is_some() {
            unused = UNSEEN;
        }
        if self.is_short || self.lacks.is_some() || self.ahead_short.is_some() {
            self.expiry_looks = *EXPIRY_LOOKS.end();
        }
        let expired_before = self.stats.expired;
        let mut looks = self.residents.len().min(self.expiry_looks);
        while !self.has_free(EXPIRY_TENTHS) || self.lacks_room_ahead() || self.lacks_room_now() {
            let Some(id) = self.residents.pop_expired(scenes, self.frame, unused, &mut looks) else { break };
            self.detach(scenes, id, contexts);
        }
        self.forget_gone(contexts);
        let next = if self.stats.expired > expired_before { 2 * self.expiry_looks } else { self.expiry_looks / 2 };
        self.expiry_looks = next.clamp(*EXPIRY_LOOKS.start(), *EXPIRY_LOOKS.end());
    }

    /// Pages that an application took out hold nothing any more.
    fn forget_gone(&mut self, contexts: &mut [&mut dyn CompileContext]) {
        for (id, shared) in std::mem::take(&mut self.residents.gone) {
            self.stats.expired += 1;
            self.shares.forget(&shared);
            if self.above.remove(&id).is_some() {
                self.drop_entries(contexts, |slot, _| slot.page == id);
            }
        }
    }

    /// Something is missing in a picture, and not one page of the mean size has room, or it is known to have none.
    fn lacks_room_now(&self) -> bool {
        self.is_short && self.room_within(0) == 0 || self.lacks.is_some_and(|needs| !self.fits(&needs))
    }

    fn lacks_room_ahead(&self) -> bool {
        self.ahead_short.is_some_and(|ahead| self.room_within(EXPIRY_TENTHS) < ahead.count)
    }

    pub(super) fn detach(&mut self, scenes: &mut dyn Scenes, id: PageId, contexts: &mut [&mut dyn CompileContext]) {
        // Requests for slots inside an expired tileset go with it.
        if self.above.remove(&id).is_some() {
            self.drop_entries(contexts, |slot, _| slot.page == id);
        }
        let Some(scene) = scenes.numbered_mut(id.scene) else { return };
        match scene.detach(id) {
            Ok(page) => {
                self.stats.expired += 1;
                self.shares.unmerge(&page);
                self.retire(Box::new(page), contexts);
            }
            Err(e) => log::error!("an expired page could not be taken out: {e}"),
        }
    }

    /// Gives a page's slots back and drops it on the reaper's thread.
    pub(super) fn retire(&mut self, mut page: Box<Page>, contexts: &mut [&mut dyn CompileContext]) {
        self.shares.give_back(&page);
        for (id, slots) in page.take_draw_slots() {
            if let Some(context) = contexts.iter_mut().find(|c| c.id() == id) {
                context.release(slots);
            }
        }
        self.threads.reap(page);
    }

    /// Takes every page of a scene out that nothing else hangs in, and what was loaded for it and not merged: all of it is
    /// loaded and uploaded again when it is wanted, and at once what no camera asks for: ProxyNodes that are loaded
    /// immediately or for the application. For contexts that come later.
    pub fn page_anew(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        let number = scene.number();
        self.drop_uploads_if(contexts, |slot| slot.page.scene == number);
        self.residents.drop_gone(|id| id.scene == number && scene.page(id).is_none());
        self.forget_gone(contexts);
        // What hangs deepest goes first; each round takes a level.
        loop {
            let expirable = self.residents.take_if(|id| scene.is_expirable(id));
            if expirable.is_empty() {
                break;
            }
            for id in expirable {
                let slot = scene.slot_at(id.slot);
                self.detach(scene, id, contexts);
                self.asked.extend(slot.filter(|slot| {
                    matches!(scene.proxy_loading(*slot), Some(ProxyLoading::Immediately | ProxyLoading::Never))
                }));
            }
        }
    }

    /// Takes every page of a scene out and forgets every request for it, also what failed: as it was before the first
    /// frame. Those of other scenes stay.
    pub fn clear(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        self.page_anew(scene, contexts);
        let number = scene.number();
        let has_failed = |slot: &NodeId, e: &Entry| slot.page.scene == number && e.has_failed();
        for (slot, _) in self.entries.iter().filter(|(slot, e)| has_failed(slot, e)) {
            scene.set_failed(*slot, false);
            self.asked.push(*slot);
        }
        self.asked
            .retain(|slot| slot.page.scene != number || scene.proxy_loading(*slot) == Some(ProxyLoading::Immediately));
        self.drop_entries(contexts, |slot, _| slot.page.scene == number);
        self.rewrite_list();
        self.threads.list.ring_if_due();
        self.count();
    }

    /// Forgets a context that is gone: what pages held there counts no more, and what waits for its upload or its merge
    /// is dropped, to be asked for again. `contexts` are those that stay.
    pub fn forget_context(&mut self, context: u32, contexts: &mut [&mut dyn CompileContext]) {
        self.drop_uploads(contexts);
        self.residents.forget_context(context);
        self.shares.forget_context(context);
        self.count();
    }

    /// Drops what was loaded and waits for its upload or its merge, to be asked for again: nobody would finish what a
    /// context that goes has begun.
    pub fn drop_uploads(&mut self, contexts: &mut [&mut dyn CompileContext]) {
        self.drop_uploads_if(contexts, |_| true);
    }

    fn drop_uploads_if(&mut self, contexts: &mut [&mut dyn CompileContext], drops: impl Fn(&NodeId) -> bool) {
        self.drop_entries(contexts, |slot, entry| matches!(entry.progress, Progress::Arrived(_)) && drops(slot));
        self.compiling.retain(|_, slot| !drops(slot));
        self.ready.retain(|slot| !drops(slot));
        self.uploads.retain(|slot| !drops(slot));
    }

    /// Forgets requests, with what was loaded and uploaded for them, and what was to be; late answers and uploads find
    /// nobody.
    pub(super) fn drop_entries(
        &mut self,
        contexts: &mut [&mut dyn CompileContext],
        drops: impl Fn(&NodeId, &Entry) -> bool,
    ) {
        let dropped: Vec<Entry> =
            self.entries.extract_if(|slot, entry| drops(slot, entry)).map(|(_, entry)| entry).collect();
        self.is_listed &= dropped.is_empty();
        let compiling = |entry: &Entry| matches!(&entry.progress, Progress::Arrived(arrived) if arrived.is_uploading());
        let tickets: Vec<u64> = dropped.iter().filter(|e| compiling(e)).map(|entry| entry.job.ticket).collect();
        if !tickets.is_empty() {
            contexts.iter_mut().for_each(|context| context.cancel(&tickets));
        }
        for Entry { job, progress, .. } in dropped.into_iter().filter(|entry| !entry.has_failed()) {
            self.stats.dropped += 1;
            timeline::request_ends(self.threads.list.ticket_source | job.ticket, "dropped");
            match progress {
                Progress::Arrived(arrived) => {
                    self.arrived.take(&arrived);
                    self.compiling.remove(&job.ticket);
                    self.uploads.retain(|slot| *slot != job.slot);
                    self.retire(arrived.page, contexts);
                }
                // Aborted, unless its answer is there already.
                Progress::Loading if cfg!(feature = "http") && io::is_remote(&job.uri) => {
                    self.threads.list.lock().abort.push(job.ticket)
                }
                _ => {}
            }
        }
    }
}
