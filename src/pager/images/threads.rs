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
    /// `None` where it was given up.
    pub image: Option<Result<Arc<Texture>, IoError>>,
    pub bytes_read: u64,
}

/// What the mutex guards.
#[derive(Default)]
pub(super) struct Waiting {
    /// Written by update, taken from the end by the threads.
    pub uris: Vec<Arc<str>>,
    /// Taken since update last looked; written by the threads, drained by update.
    pub taken: Vec<Arc<str>>,
    /// Asked of servers now; written by the threads.
    asked: Vec<Arc<str>>,
    /// Of these, what nobody wants any more; written by update.
    #[cfg(feature = "http")]
    unwanted: Vec<Arc<str>>,
    /// Set once, by drop.
    closed: bool,
}

/// The list and its bells.
struct List {
    waiting: Mutex<Waiting>,
    /// Threads that one server may have: one that hangs leaves files and other servers theirs.
    most_of_server: usize,
    bell: Condvar,
    /// Rung when the list closes or something is unwanted, for a thread that waits for a server.
    #[cfg(feature = "http")]
    given_up: tokio::sync::Notify,
}

impl List {
    fn new(threads: usize) -> Self {
        Self {
            waiting: Mutex::default(),
            most_of_server: threads.saturating_sub(1).max(1),
            bell: Condvar::new(),
            #[cfg(feature = "http")]
            given_up: tokio::sync::Notify::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The most urgent image that may be read now; waits for one, `None` once closed. [`Self::has_read`] is to follow.
    fn take(&self) -> Option<Arc<str>> {
        let mut waiting = self.lock();
        loop {
            if waiting.closed {
                return None;
            }
            let has_place = |uri: &Arc<str>| {
                let of = server_of(uri);
                of.is_none()
                    || waiting.asked.iter().filter(|asked| server_of(asked) == of).count() < self.most_of_server
            };
            if let Some(place) = waiting.uris.iter().rposition(has_place) {
                let uri = waiting.uris.remove(place);
                waiting.taken.push(uri.clone());
                if server_of(&uri).is_some() {
                    waiting.asked.push(uri.clone());
                }
                return Some(uri);
            }
            waiting = self.bell.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// The bytes of what was taken are there, or will not come.
    fn has_read(&self, uri: &Arc<str>) {
        let mut waiting = self.lock();
        if let Some(place) = waiting.asked.iter().position(|asked| Arc::ptr_eq(asked, uri)) {
            waiting.asked.swap_remove(place);
            drop(waiting);
            // Others may be waiting for the place.
            self.bell.notify_all();
        }
    }
}

#[cfg(feature = "http")]
impl List {
    /// Waits until nobody wants an image that is under way, or the list closes.
    async fn is_given_up(&self, uri: &Arc<str>) {
        loop {
            let rung = self.given_up.notified();
            tokio::pin!(rung);
            rung.as_mut().enable();
            {
                let waiting = self.lock();
                if waiting.closed || waiting.unwanted.contains(uri) {
                    return;
                }
            }
            rung.await;
        }
    }
}

/// `None` for files.
#[cfg(feature = "http")]
fn server_of(uri: &str) -> Option<&str> {
    io::is_remote(uri).then(|| io::server(uri))
}

#[cfg(not(feature = "http"))]
fn server_of(_: &str) -> Option<&str> {
    None
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
        let count = config.threads.max(1);
        let list = Arc::new(List::new(count));
        // A thread whose result does not fit waits with it: decoded images are bounded by the request list.
        let (sender, loaded) = bounded(count);
        let mut threads = Self { list: list.clone(), loaded: Some(loaded), handles: Vec::new() };
        for i in 0..count {
            let name = format!("pager-image-{i}");
            let reader = Reader::new(config, &name)?;
            let (list, sender) = (list.clone(), sender.clone());
            let builder = std::thread::Builder::new().name(name.clone());
            let handle = builder.spawn(move || {
                run(&list, &sender, &reader);
            });
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

    /// Gives up what is asked of servers and nobody wants any more: it is answered as such.
    #[cfg(feature = "http")]
    pub fn give_up(&self, is_unwanted: impl Fn(&Arc<str>) -> bool) {
        let Waiting { asked, unwanted, .. } = &mut *self.lock();
        unwanted.clear();
        unwanted.extend(asked.iter().filter(|uri| is_unwanted(uri)).cloned());
        if !unwanted.is_empty() {
            self.list.given_up.notify_waiters();
        }
    }

    /// Files are read to their end.
    #[cfg(not(feature = "http"))]
    pub fn give_up(&self, _is_unwanted: impl Fn(&Arc<str>) -> bool) {}

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
        self.list.given_up.notify_waiters();
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

    /// `None` when it was given up, or the list closed.
    fn read(&self, uri: &Arc<str>, _list: &List) -> Option<Result<Vec<u8>, IoError>> {
        if !io::is_remote(uri) {
            return Some(self.files.read(uri));
        }
        #[cfg(feature = "http")]
        return self.runtime.block_on(async {
            let get = async {
                let body = self.client.get(uri, &self.limits).await;
                self.client.flush().await;
                body.map(|body| body.bytes)
            };
            tokio::select! {
                bytes = get => Some(bytes),
                () = _list.is_given_up(uri) => None,
            }
        });
        #[cfg(not(feature = "http"))]
        Some(Err(IoError::unsupported(uri, "http (built without the feature)")))
    }
}

impl Reader {
    /// The cache does not keep what turned out to be no image.
    fn forget_no_content(&self, _image: &Option<Result<Arc<Texture>, IoError>>) {
        #[cfg(feature = "http")]
        if let Some(Err(error)) = _image
            && error.is_no_content()
            && io::is_remote(error.uri())
        {
            self.client.forget(error.uri());
        }
    }
}

fn run(list: &List, sender: &Sender<Loaded>, reader: &Reader) {
    while let Some(uri) = list.take() {
        let span = timeline::span_of("image", || uri.clone());
        let bytes = reader.read(&uri, list);
        list.has_read(&uri);
        let bytes_read = bytes.iter().flatten().map(|bytes| bytes.len() as u64).sum();
        let image = bytes.map(|bytes| bytes.and_then(|bytes| io::decode_image(&uri, &bytes, &reader.limits)));
        reader.forget_no_content(&image);
        drop(span);
        if sender.send(Loaded { uri, image, bytes_read }).is_err() {
            return;
        }
    }
}

#[cfg(all(test, feature = "http"))]
mod tests {
    use super::*;

    #[test]
    fn one_server_leaves_files_and_other_servers_a_thread() {
        let list = List::new(3);
        let uris = ["http://b/1", "/files/1.png", "http://a/4", "http://a/3", "http://a/2", "http://a/1"];
        list.lock().uris = uris.map(Arc::from).to_vec();
        let take = || list.take().unwrap();
        let first = take();
        let taken = [first.clone(), take(), take(), take()];
        assert_eq!(taken.map(|uri| uri.to_string()), ["http://a/1", "http://a/2", "/files/1.png", "http://b/1"]);
        assert_eq!(list.lock().uris.len(), 2);
        list.has_read(&first);
        assert_eq!(&*take(), "http://a/3");
        assert_eq!(list.lock().taken.len(), 5);
        // With a single thread there is nothing to leave.
        assert_eq!(List::new(1).most_of_server, 1);
    }
}
