//! The reaper: drops pages off the update thread, where freeing thousands of buffers would delay a frame.

use std::sync::Arc;

use crossbeam_channel::{Sender, unbounded};

use super::thread_set::ThreadSet;
use crate::pager::config::PagerError;
use crate::scene::{Page, SharedStateManager};
use crate::trace;

/// After this many dropped pages the reaper prunes a part of the shared contents that nothing uses.
const PAGES_BETWEEN_PRUNES: usize = 16;

/// Drops pages, and prunes the shared contents from time to time.
pub(in crate::pager) struct Dropper {
    sharing: Option<Arc<SharedStateManager>>,
    count: usize,
}

impl Dropper {
    fn drop_page(&mut self, page: Box<Page>) {
        let _span = trace::span("drop page");
        drop(page);
        if let Some(sharing) = self.sharing.as_ref().filter(|_| self.count.is_multiple_of(PAGES_BETWEEN_PRUNES)) {
            sharing.prune();
        }
        self.count += 1;
    }
}

/// Drops pages, on a separate thread or at once.
pub(in crate::pager) enum Reaper {
    /// On a thread. Dropping the reaper drops all queued pages and joins the thread.
    Thread {
        /// Unbounded: thousands of pages may leave in one frame, and update must not wait for them. They count in no
        /// budget; dropping a page takes less time than loading one. `None` once closed.
        pages: Option<Sender<Box<Page>>>,
        _thread: ThreadSet,
    },
    /// At once on the calling thread, so that equal contents stop being shared at the same moment each time. For the blocking
    /// mode.
    Here(Dropper),
}

impl Reaper {
    /// Starts the thread; it prunes `sharing` from time to time.
    pub fn start(sharing: Option<Arc<SharedStateManager>>) -> Result<Self, PagerError> {
        let (pages, dropped) = unbounded::<Box<Page>>();
        let mut thread = ThreadSet::default();
        let mut dropper = Dropper { sharing, count: 0 };
        thread
            .spawn("pager-reaper".to_owned(), move || dropped.into_iter().for_each(|page| dropper.drop_page(page)))?;
        Ok(Self::Thread { pages: Some(pages), _thread: thread })
    }

    /// Returns a reaper that drops pages at once.
    pub fn here(sharing: Option<Arc<SharedStateManager>>) -> Self {
        Self::Here(Dropper { sharing, count: 0 })
    }

    /// Drops a page, on the reaper's thread if it has one.
    pub fn drop_page(&mut self, page: Box<Page>) {
        match self {
            // The thread ends only with the reaper; if it panicked, the page is dropped here.
            Self::Thread { pages, .. } => drop(pages.as_ref().map(|pages| pages.send(page))),
            Self::Here(dropper) => dropper.drop_page(page),
        }
    }
}

impl Drop for Reaper {
    fn drop(&mut self) {
        // Ends the thread, which the set joins.
        if let Self::Thread { pages, .. } = self {
            *pages = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::scene::{CullAction, CullCallback, Node};

    /// Records the name of the thread that drops it.
    struct DropRecorder(Arc<Mutex<Vec<String>>>);

    impl Drop for DropRecorder {
        fn drop(&mut self) {
            let name = std::thread::current().name().unwrap_or_default().to_owned();
            self.0.lock().unwrap().push(name);
        }
    }

    /// Regression: pages beyond 256 were dropped on the update thread.
    #[test]
    fn thousands_of_pages_are_dropped_by_the_reaper() {
        let mut reaper = Reaper::start(None).unwrap();
        let dropped: Arc<Mutex<Vec<String>>> = Arc::default();
        for _ in 0..5000 {
            let recorder = DropRecorder(dropped.clone());
            let callback = CullCallback(Arc::new(move |_| {
                let _ = &recorder;
                CullAction::Traverse
            }));
            let node = Node { cull_callback: Some(callback), ..Node::group(Vec::new()) };
            reaper.drop_page(Box::new(Page::from_node(node).unwrap()));
        }
        drop(reaper);
        let dropped = dropped.lock().unwrap();
        assert_eq!(dropped.len(), 5000);
        assert!(dropped.iter().all(|name| name == "pager-reaper"), "{:?}", dropped.last());
    }
}
