//! [`RequestState`]: how far each request is, for displays.

use super::entry::{Entry, Progress};
use crate::fetch;
use crate::pager::loading::page_job::LoadStage;

/// How far a request for a content is. Merged contents have no request; see [`SlotState`](crate::scene::SlotState).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RequestState {
    /// In the request list; no thread has taken it.
    Waiting,
    /// A thread reads it from a local file or archive.
    ReadingFile,
    /// It was requested from a server.
    ReadingHttp,
    /// Its bytes were read; it is being decoded, or waits for a decode thread.
    Decoding,
    /// Decoded; contexts upload it within their budgets.
    Compiling,
    /// All contexts have it; it is merged when the frame's time and the budgets allow.
    Merging,
    /// The load failed, and is retried after a back-off once the content is wanted.
    Retrying,
    /// The load failed, and is not retried.
    Failed,
}

impl Entry {
    /// Returns how far the request is; `is_uploaded` tells for an arrived page whether all contexts have it.
    pub fn state(&self, is_uploaded: bool) -> RequestState {
        match self.progress {
            // A thread may have taken it since update last looked.
            Progress::Waiting | Progress::Loading => match self.job.progress.stage() {
                LoadStage::Waiting => RequestState::Waiting,
                LoadStage::Reading if fetch::is_remote(&self.job.uri) => RequestState::ReadingHttp,
                LoadStage::Reading => RequestState::ReadingFile,
                LoadStage::Decoding => RequestState::Decoding,
            },
            Progress::Arrived if is_uploaded => RequestState::Merging,
            Progress::Arrived => RequestState::Compiling,
            Progress::Failed { retry_at: Some(_) } | Progress::Retryable => RequestState::Retrying,
            Progress::Failed { retry_at: None } => RequestState::Failed,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::super::retry_policy::RetryState;
    use super::*;
    use crate::pager::loading::job::LoadJob;
    use crate::pager::loading::page_job::tests::job;
    use crate::pager::loading::request::Request;
    use crate::pager::loading::request_list::RequestList;
    use crate::scene::PagingOptions;

    fn entry(uri: &str) -> Entry {
        Entry {
            job: job(1, uri),
            priority: 1.0,
            first_frame: 0,
            wanted_frame: 1,
            ahead_frames: 0,
            since: Instant::now(),
            retries: RetryState::default(),
            known_size: None,
            progress: Progress::Waiting,
            paging: PagingOptions::default(),
            listed: None,
            noted_in: 0,
        }
    }

    #[test]
    fn request_passes_through_the_states_as_threads_take_it() {
        let mut entry = entry("/set/a.glb");
        assert_eq!(entry.state(false), RequestState::Waiting);
        let list = RequestList::new(4, 4);
        list.lock().set_jobs([entry.job.clone()]);
        let taken = list.take_file().unwrap();
        assert_eq!(entry.state(false), RequestState::ReadingFile, "before update looks again");
        entry.progress = Progress::Loading;
        assert_eq!(entry.state(false), RequestState::ReadingFile);
        taken.mark_decoding();
        assert_eq!(entry.state(false), RequestState::Decoding);
        entry.progress = Progress::Arrived;
        assert_eq!(entry.state(false), RequestState::Compiling);
        assert_eq!(entry.state(true), RequestState::Merging);
        entry.progress = Progress::Failed { retry_at: Some(Instant::now()) };
        assert_eq!(entry.state(false), RequestState::Retrying);
        entry.progress = Progress::Failed { retry_at: None };
        assert_eq!(entry.state(false), RequestState::Failed);
    }

    #[test]
    fn remote_request_is_read_over_http() {
        let remote = entry("http://host/a.glb");
        remote.job.mark_reading();
        assert_eq!(remote.state(false), RequestState::ReadingHttp);
        remote.job.progress.set(LoadStage::Waiting);
        assert_eq!(remote.state(false), RequestState::Waiting);
    }
}
