//! How far each request is, for whoever wants to show it. The threads mark the stages of their own jobs, one atomic byte
//! each; everything else is the main thread's, which reads.

use std::sync::atomic::{AtomicU8, Ordering};

use super::DatabasePager;
use super::entry::{Entry, Progress};
use crate::io;
use crate::scene::NodeId;

/// How far a request for a content is. What is merged is no request any more: see [`SlotState`](crate::scene::SlotState).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RequestState {
    /// In the list: no thread has taken it.
    Waiting,
    /// A thread reads it from a file or an archive here.
    ReadingFile,
    /// It was asked of a server.
    ReadingHttp,
    /// Its bytes are here: it is being decoded, or waits for a thread that decodes.
    Decoding,
    /// Decoded; contexts compile it: upload it within their budgets.
    Compiling,
    /// All contexts have it; it is merged as the frames' time and the budgets allow.
    Merging,
    /// Could not be loaded, and is tried again after a while, once it is wanted.
    Retrying,
    /// Could not be loaded, and is not tried again.
    Failed,
}

/// Where the threads are with a job; written by the one that has it, read by the main thread.
#[derive(Debug, Default)]
pub(super) struct Stage {
    at: AtomicU8,
    /// The servers that it asks; the HTTP thread's alone, which finds them once.
    #[cfg(feature = "http")]
    pub servers: std::sync::OnceLock<Vec<String>>,
}

impl Stage {
    const WAITING: u8 = 0;
    const READING: u8 = 1;
    const DECODING: u8 = 2;

    // Only shown, so that no other memory depends on the order.
    fn set(&self, stage: u8) {
        self.at.store(stage, Ordering::Relaxed);
    }

    pub fn waits(&self) {
        self.set(Self::WAITING);
    }

    pub fn reads(&self) {
        self.set(Self::READING);
    }

    pub fn decodes(&self) {
        self.set(Self::DECODING);
    }
}

impl Entry {
    pub fn state(&self) -> RequestState {
        match &self.progress {
            // A thread may have taken it since the list was last looked at.
            Progress::Waiting | Progress::Loading => match self.job.stage.at.load(Ordering::Relaxed) {
                Stage::WAITING => RequestState::Waiting,
                Stage::READING if io::is_remote(&self.job.uri) => RequestState::ReadingHttp,
                Stage::READING => RequestState::ReadingFile,
                _ => RequestState::Decoding,
            },
            Progress::Arrived(arrived) if arrived.contexts_left > 0 => RequestState::Compiling,
            Progress::Arrived(_) => RequestState::Merging,
            Progress::Failed { retry_at: Some(_) } | Progress::Resting => RequestState::Retrying,
            Progress::Failed { retry_at: None } => RequestState::Failed,
        }
    }
}

impl DatabasePager {
    /// How far the request for a slot's content is; `None` where nothing is asked for: it is merged, or nobody wants it.
    pub fn request_state(&self, slot: NodeId) -> Option<RequestState> {
        self.entries.get(&slot).map(Entry::state)
    }

    /// How far all requests are that are not merged, in no order. What threads have is as it is just now.
    pub fn request_states(&self) -> impl ExactSizeIterator<Item = (NodeId, RequestState)> + '_ {
        self.entries.iter().map(|(slot, entry)| (*slot, entry.state()))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::super::entry::Arrived;
    use super::super::job::tests::job;
    use super::super::list::RequestList;
    use super::super::shares::Held;
    use super::super::tries::Tries;
    use super::*;
    use crate::scene::{Node, Page, PagingOptions};

    #[test]
    fn a_request_goes_through_the_states_as_threads_take_it() {
        let entry_of = |uri: &str| {
            let job = job(1, uri);
            let (since, paging) = (Instant::now(), PagingOptions::default());
            Entry {
                job,
                priority: 1.0,
                asked_frame: 0,
                wanted_frame: 1,
                ahead_frames: 0,
                since,
                tries: Tries::default(),
                needs: None,
                progress: Progress::Waiting,
                paging,
            }
        };
        let mut entry = entry_of("/set/a.glb");
        assert_eq!(entry.state(), RequestState::Waiting);
        let list = RequestList::new(4, 4);
        list.lock().file.push(entry.job.clone());
        let taken = list.take_file().unwrap();
        assert_eq!(entry.state(), RequestState::ReadingFile, "before the list is looked at again");
        entry.progress = Progress::Loading;
        assert_eq!(entry.state(), RequestState::ReadingFile);
        taken.stage.decodes();
        assert_eq!(entry.state(), RequestState::Decoding);
        let page = Box::new(Page::from_node(Node::group(vec![])).unwrap());
        let counts = Held { cpu: 0, gpu: 0 };
        let (gpu_bytes, contexts_left) = (Vec::new(), 2);
        let arrived = Arrived { page, gpu_bytes, contexts_left, counts, reserved_gpu: 0, payload: None };
        entry.progress = Progress::Arrived(arrived);
        assert_eq!(entry.state(), RequestState::Compiling);
        if let Progress::Arrived(arrived) = &mut entry.progress {
            arrived.contexts_left = 0;
        }
        assert_eq!(entry.state(), RequestState::Merging);
        entry.progress = Progress::Failed { retry_at: Some(Instant::now()) };
        assert_eq!(entry.state(), RequestState::Retrying);
        entry.progress = Progress::Failed { retry_at: None };
        assert_eq!(entry.state(), RequestState::Failed);
        let remote = entry_of("http://host/a.glb");
        remote.job.stage.reads();
        assert_eq!(remote.state(), RequestState::ReadingHttp);
        remote.job.stage.waits();
        assert_eq!(remote.state(), RequestState::Waiting);
    }
}
