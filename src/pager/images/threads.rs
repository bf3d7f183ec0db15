//! The request list and the threads that read and decode images.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use crossbeam_channel::{Receiver, Sender, bounded};

use super::config::ImagePagerConfig;
use crate::io::{self, FileReader, IoError, Limits};
use crate::pager::PagerError;
use crate::scene::Texture;
use crate::timeline;

/// What became of a request.
pub(super) struct Loaded {
    pub uri: Arc<str>,
    pub image: Result<Arc<Texture>, IoError>,
    pub bytes_read: u64,
}

/// What the mutex guards.
#[derive(Default)]
pub(super) struct Waiting {
    /// Written by update, taken from the end by the threads.
    pub uris: Vec<Arc<str>>,
    /// Taken since update last looked; written by the threads, drained by update.
    pub taken: Vec<Arc<str>>,
    /// Set once, by drop.
    closed: bool,
}

/// The list and its bells.
#[derive(Default)]
struct List {
    waiting: Mutex<Waiting>,
    bell: Condvar,
    /// Rung when the list closes, for a thread that waits for a server.
    #[cfg(feature = "http")]
    closed: tokio::sync::Notify,
}

impl List {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The most urgent image; waits for one, `None` once closed.
    fn take(&self) -> Option<Arc<str>> {
        let mut waiting = self.lock();
        loop {
            if waiting.closed {
                return None;
            }
            if let Some(uri) = waiting.uris.pop() {
                waiting.taken.push(uri.clone());
                return Some(uri);
            }
            waiting = self.bell.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// All threads of an image pager; dropping it stops and joins them.
pub(super) struct Threads {
    list: Arc<List>,
    /// `None` once closed.
    loaded: Option<Receiver<Loaded>>,
    handles: Vec<JoinHandle<()>>,
}

impl Threads {
    pub fn start(config: &ImagePagerConfig) -> Result<Self, PagerError> {
        let list = Arc::new(List::default());
        let count = config.threads.max(1);
        // A thread whose result does not fit waits with it: decoded images are bounded by the request list.
        let (sender, loaded) = bounded(count);
        let mut threads = Self { list: list.clone(), loaded: Some(loaded), handles: Vec::new() };
        for i in 0..count {
            let name = format!("pager-image-{i}");
            let reader = Reader::new(config, &name)?;
            let (list, sender) = (list.clone(), sender.clone());
            let builder = std::thread::Builder::new().name(name.clone());
            let handle = builder.spawn(move || run(&list, &sender, &reader));
            threads.handles.push(handle.map_err(|source| PagerError::Thread { name, source })?);
        }
        Ok(threads)
    }

    pub fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.list.lock()
    }

    pub fn ring(&self) {
        self.list.bell.notify_all();
    }

    pub fn try_loaded(&self) -> Option<Loaded> {
        self.loaded.as_ref()?.try_recv().ok()
    }

    /// Waits for the next result, for a while.
    pub fn wait_loaded(&self, timeout: std::time::Duration) -> Option<Loaded> {
        self.loaded.as_ref()?.recv_timeout(timeout).ok()
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.list.lock().closed = true;
        self.list.bell.notify_all();
        #[cfg(feature = "http")]
        self.list.closed.notify_waiters();
        self.loaded = None;
        for handle in self.handles.drain(..) {
            if handle.join().is_err() {
                log::error!("an image thread panicked");
            }
        }
    }
}

/// One thread's way to bytes.
struct Reader {
    files: FileReader,
    limits: Limits,
    #[cfg(feature = "http")]
    runtime: tokio::runtime::Runtime,
    /// Its connections live in this thread's runtime.
    #[cfg(feature = "http")]
    client: io::HttpClient,
}

impl Reader {
    fn new(config: &ImagePagerConfig, _name: &str) -> Result<Self, PagerError> {
        Ok(Self {
            files: FileReader::new(config.limits),
            limits: config.limits,
            #[cfg(feature = "http")]
            runtime: io::runtime(_name).map_err(|source| PagerError::Thread { name: _name.to_owned(), source })?,
            #[cfg(feature = "http")]
            client: io::HttpClient::new(&config.http).map_err(PagerError::Http)?,
        })
    }

    /// `None` when the list closed meanwhile.
    fn read(&self, uri: &str, _list: &List) -> Option<Result<Vec<u8>, IoError>> {
        if !io::is_remote(uri) {
            return Some(self.files.read(uri));
        }
        #[cfg(feature = "http")]
        return self.runtime.block_on(async {
            let closed = _list.closed.notified();
            tokio::pin!(closed);
            closed.as_mut().enable();
            if _list.lock().closed {
                return None;
            }
            let get = async {
                let body = self.client.get(uri, &self.limits).await;
                self.client.flush().await;
                body.map(|body| body.bytes)
            };
            tokio::select! {
                bytes = get => Some(bytes),
                () = closed => None,
            }
        });
        #[cfg(not(feature = "http"))]
        Some(Err(IoError::unsupported(uri, "http (built without the feature)")))
    }
}

fn run(list: &List, sender: &Sender<Loaded>, reader: &Reader) {
    while let Some(uri) = list.take() {
        let span = timeline::span_of("image", || uri.clone());
        let Some(bytes) = reader.read(&uri, list) else { return };
        let bytes_read = bytes.as_ref().map_or(0, |b| b.len() as u64);
        let image = bytes.and_then(|bytes| io::decode_image(&uri, &bytes, &reader.limits));
        drop(span);
        if sender.send(Loaded { uri, image, bytes_read }).is_err() {
            return;
        }
    }
}
