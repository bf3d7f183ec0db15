//! Removing: pages and requests of a scene, of a context, or all.

use super::DatabasePager;
use crate::pager::loading::request::Request as _;
use crate::pager::loading::ticket::RequestEnd;
use crate::pager::requests::entry::{Entry, Progress};
use crate::pager::upload::context::CompileContext;
use crate::scene::{NodeId, ProxyLoading, Scene};

impl DatabasePager {
    /// Detaches every page of a scene that has no page of the application attached in it, and drops what was loaded for it
    /// and not merged. All of it is loaded and uploaded again when it is wanted; what no camera requests (ProxyNodes loaded
    /// immediately or by the application) at once. For contexts that are added.
    pub fn page_anew(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        let number = scene.number();
        self.note_formats(contexts);
        self.drop_uploads_if(contexts, |slot| slot.page.scene == number);
        self.residency.find_removed(scene);
        self.forget_removed_pages(contexts);
        // The deepest pages are detached first; each round detaches a level.
        loop {
            let expirable = self.residency.pop_expirable(scene);
            if expirable.is_empty() {
                break;
            }
            for id in expirable {
                let slot = scene.slot_at(id.slot);
                self.detach(scene, id, contexts);
                self.forced.extend(slot.filter(|slot| {
                    matches!(scene.proxy_loading(*slot), Some(ProxyLoading::Immediately | ProxyLoading::Never))
                }));
            }
        }
    }

    /// Detaches every page of a scene and forgets every request for it, including failures: the scene is as it was before
    /// the first frame. Other scenes keep theirs.
    pub fn clear(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        self.page_anew(scene, contexts);
        let number = scene.number();
        let failed = self.table.iter().filter(|(slot, entry)| slot.page.scene == number && entry.has_failed());
        for (slot, _) in failed {
            scene.forget_failure(slot);
            self.forced.extend([slot]);
        }
        let is_immediate = |slot| scene.proxy_loading(slot) == Some(ProxyLoading::Immediately);
        self.forced.retain(|slot| slot.page.scene != number || is_immediate(slot));
        self.drop_requests(contexts, |slot, _| slot.page.scene == number);
        // The pager may have no further update.
        for (id, slots) in self.arrivals.take_late() {
            if let Some(context) = contexts.iter_mut().find(|context| context.id() == id) {
                context.release(slots);
            }
        }
        self.write_list();
        self.threads.list().ring_if_due();
        self.count();
    }

    /// Forgets a context that has closed: the memory of pages there no longer counts, and what waits for its upload or its
    /// merge is dropped, to be requested again. `contexts` are those that stay.
    pub fn forget_context(&mut self, context: u32, contexts: &mut [&mut dyn CompileContext]) {
        self.drop_uploads(contexts);
        self.arrivals.forget_context(context);
        self.residency.forget_context(context);
        self.count();
    }

    /// Drops what was loaded and waits for its upload or its merge, to be requested again: a context that closes does not
    /// finish its uploads.
    pub fn drop_uploads(&mut self, contexts: &mut [&mut dyn CompileContext]) {
        self.drop_uploads_if(contexts, |_| true);
    }

    fn drop_uploads_if(&mut self, contexts: &mut [&mut dyn CompileContext], condition: impl Fn(NodeId) -> bool) {
        self.drop_requests(contexts, |slot, entry| entry.progress == Progress::Arrived && condition(slot));
    }

    /// Forgets the requests for which `condition` holds, with what was loaded and uploaded for them. Late answers and
    /// uploads are ignored.
    pub(super) fn drop_requests(
        &mut self,
        contexts: &mut [&mut dyn CompileContext],
        condition: impl Fn(NodeId, &Entry) -> bool,
    ) {
        let dropped = self.table.extract_if(condition);
        let uploads = dropped.iter().filter_map(|entry| self.arrivals.get(entry.job.slot)?.upload_ticket());
        let uploads: Vec<u64> = uploads.collect();
        if !uploads.is_empty() {
            contexts.iter_mut().for_each(|context| context.cancel(&uploads));
        }
        for Entry { job, progress, .. } in dropped.into_iter().filter(|entry| !entry.has_failed()) {
            self.stats.dropped += 1;
            job.ticket.trace_end(RequestEnd::Dropped);
            match progress {
                Progress::Arrived => {
                    if let Some(arrived) = self.arrivals.remove(job.slot) {
                        self.drop_page(arrived.into_page().0, contexts);
                    }
                }
                // Aborted, unless its answer has arrived.
                Progress::Loading if cfg!(feature = "http") && job.is_remote() => {
                    self.threads.list().lock().abort(job.ticket);
                }
                _ => {}
            }
        }
    }
}
