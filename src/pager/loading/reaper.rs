//! The reaper: drops pages off the update thread, where freeing thousands of buffers would delay a frame.

use std::sync::Arc;

use crossbeam_channel::{Sender, unbounded};

use super::thread_set::ThreadSet;
use crate::pager::config::PagerError;
use crate::scene::{Page, SharedStateManager};
use crate::trace;

/// After this many dropped pages the reaper prunes a part of the shared contents that nothing uses.
const PAGES_BETWEEN_PRUNES: usize = 16;

/// The thread that drops pages. Dropping the reaper drops all queued pages and joins the thread.
pub(in crate::pager) struct Reaper {
    /// Unbounded: thousands of pages may leave in one frame, and update must not wait for them. They count in no budget;
    /// dropping a page takes less time than loading one. `None` once closed.
    pages: Option<Sender<Box<Page>>>,
    _thread: ThreadSet,
}

impl Reaper {
    /// Starts the thread; it prunes `sharing` from time to time.
    pub fn start(sharing: Option<Arc<SharedStateManager>>) -> Result<Self, PagerError> {
        let (pages, dropped) = unbounded::<Box<Page>>();
        let mut thread = ThreadSet::default();
        thread.spawn("pager-reaper".to_owned(), move || {
            for (count, page) in dropped.into_iter().enumerate() {
                let _span = trace::span("drop page");
                drop(page);
                if let Some(sharing) = sharing.as_ref().filter(|_| count % PAGES_BETWEEN_PRUNES == 0) {
                    sharing.prune();
                }
            }
        })?;
        Ok(Self { pages: Some(pages), _thread: thread })
    }

    /// Drops a page on the reaper's thread.
    pub fn drop_page(&self, page: Box<Page>) {
        if let Some(pages) = &self.pages {
            // The thread ends only with the reaper; if it panicked, the page is dropped here.
            let _ = pages.send(page);
        }
    }
}

impl Drop for Reaper {
    fn drop(&mut self) {
        // Ends the thread, which the set joins.
        self.pages = None;
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
        let reaper = Reaper::start(None).unwrap();
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
