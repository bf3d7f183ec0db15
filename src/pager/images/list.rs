//! The request list of images: what the threads take their work from, and what came from servers for them.
//!
//! Update writes it anew each frame, the most urgent last. Files are read by the threads that decode; servers are asked by
//! a thread of its own, so that those that hang take nobody's.
//!
//! `tests/pager_models.rs` runs this very file under thousands of schedules.

#[cfg(feature = "http")]
use std::collections::VecDeque;
use std::sync::{Arc, PoisonError};

use crate::io::{self, IoError};
use crate::sync::primitives::{Condvar, Mutex, MutexGuard};

/// The answer of a server; `None` where it was given up.
pub(super) type Bytes = Option<Result<Vec<u8>, IoError>>;

/// What a thread that decodes has to do.
#[derive(Debug)]
pub(super) enum Work {
    /// A file to read.
    Read(Arc<str>),
    /// What came from a server.
    #[cfg(feature = "http")]
    Came(Arc<str>, Bytes),
}

/// What the mutex guards.
#[derive(Default)]
pub(super) struct Waiting {
    /// Written by update, taken from the end by the threads.
    pub uris: Vec<Arc<str>>,
    /// Taken since update last looked; written by the threads, drained by update.
    pub taken: Vec<Arc<str>>,
    /// With servers, or come and not taken up; written by the threads.
    #[cfg(feature = "http")]
    asked: Vec<Arc<str>>,
    /// Of these, what nobody wants any more; written by update.
    #[cfg(feature = "http")]
    unwanted: Vec<Arc<str>>,
    /// Written by the HTTP thread, taken by those that decode.
    #[cfg(feature = "http")]
    came: VecDeque<(Arc<str>, Bytes)>,
    /// Set once, by drop.
    closed: bool,
}

/// The list and its bells.
pub(super) struct List {
    waiting: Mutex<Waiting>,
    /// Requests that one server may have.
    #[cfg(feature = "http")]
    most_of_server: usize,
    bell: Condvar,
    /// Rings the HTTP thread.
    #[cfg(feature = "http")]
    pub http_bell: tokio::sync::Notify,
    /// Rung when something is unwanted, for requests under way.
    #[cfg(feature = "http")]
    given_up: tokio::sync::Notify,
}

impl List {
    pub fn new(_most_of_server: usize) -> Self {
        Self {
            waiting: Mutex::default(),
            #[cfg(feature = "http")]
            most_of_server: _most_of_server,
            bell: Condvar::new(),
            #[cfg(feature = "http")]
            http_bell: tokio::sync::Notify::new(),
            #[cfg(feature = "http")]
            given_up: tokio::sync::Notify::new(),
        }
    }

    pub fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn ring(&self) {
        self.bell.notify_all();
        #[cfg(feature = "http")]
        self.http_bell.notify_one();
    }

    pub fn close(&self) {
        self.lock().closed = true;
        self.ring();
    }

    /// What a thread is to do next: what came, or the most urgent file. Waits for it, `None` once closed.
    pub fn take(&self) -> Option<Work> {
        let mut waiting = self.lock();
        loop {
            if waiting.closed {
                return None;
            }
            #[cfg(feature = "http")]
            if let Some((uri, bytes)) = waiting.came.pop_front() {
                waiting.asked.retain(|asked| !Arc::ptr_eq(asked, &uri));
                drop(waiting);
                // Its server has a place again.
                self.http_bell.notify_one();
                return Some(Work::Came(uri, bytes));
            }
            if let Some(place) = waiting.uris.iter().rposition(|uri| !is_asked_for(uri)) {
                let uri = waiting.uris.remove(place);
                waiting.taken.push(uri.clone());
                return Some(Work::Read(uri));
            }
            waiting = self.bell.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// The HTTP thread asks a server for it.
fn is_asked_for(uri: &str) -> bool {
    cfg!(feature = "http") && io::is_remote(uri)
}

#[cfg(feature = "http")]
impl List {
    /// What is to be asked for now: the most urgent of each server, as many as it may have. `None` once closed.
    pub fn take_of_servers(&self) -> Option<Vec<Arc<str>>> {
        let mut waiting = self.lock();
        let Waiting { uris, taken, asked, closed, .. } = &mut *waiting;
        if *closed {
            return None;
        }
        let mut begun = Vec::new();
        for place in (0..uris.len()).rev() {
            let Some(uri) = uris.get(place).filter(|uri| is_asked_for(uri)) else { continue };
            let of = io::server(uri);
            if asked.iter().filter(|asked| io::server(asked) == of).count() < self.most_of_server {
                let uri = uris.remove(place);
                taken.push(uri.clone());
                asked.push(uri.clone());
                begun.push(uri);
            }
        }
        Some(begun)
    }

    /// Hands over what came for a URI.
    pub fn has_come(&self, uri: Arc<str>, bytes: Bytes) {
        self.lock().came.push_back((uri, bytes));
        self.bell.notify_one();
    }

    /// Gives up what is asked of servers and nobody wants any more: it is answered as such.
    pub fn give_up(&self, is_unwanted: impl Fn(&Arc<str>) -> bool) {
        let Waiting { asked, unwanted, .. } = &mut *self.lock();
        unwanted.clear();
        unwanted.extend(asked.iter().filter(|uri| is_unwanted(uri)).cloned());
        if !unwanted.is_empty() {
            self.given_up.notify_waiters();
        }
    }

    /// Waits until nobody wants an image that is under way.
    pub async fn is_given_up(&self, uri: &Arc<str>) {
        loop {
            // Rung from here on, before it is looked.
            let rung = self.given_up.notified();
            if self.lock().unwanted.contains(uri) {
                return;
            }
            rung.await;
        }
    }
}
