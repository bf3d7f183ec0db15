//! The threads that read and decode images.

use std::sync::{Arc, MutexGuard};
use std::thread::JoinHandle;

use crossbeam_channel::{Receiver, Sender, bounded};

use super::config::ImagePagerConfig;
use super::list::{Bytes, List, Waiting, Work};
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
        let reader = Reader {
            files: Arc::new(FileReader::new(config.limits)),
            limits: config.limits,
            #[cfg(feature = "http")]
            client: io::HttpClient::new(&config.http).map_err(PagerError::Http)?,
        };
        #[cfg(feature = "http")]
        {
            let (list, client, limits) = (list.clone(), reader.client.clone(), config.limits);
            let name = "pager-image-http".to_owned();
            let runtime = io::runtime(&name).map_err(|source| PagerError::Thread { name: name.clone(), source })?;
            threads.spawn(name, move || super::servers::run(&runtime, &list, &client, &limits))?;
        }
        for i in 0..count {
            let (list, sender, reader) = (list.clone(), sender.clone(), reader.clone());
            threads.spawn(format!("pager-image-{i}"), move || run(&list, &sender, &reader))?;
        }
        Ok(threads)
    }

    fn spawn(&mut self, name: String, run: impl FnOnce() + Send + 'static) -> Result<(), PagerError> {
        let builder = std::thread::Builder::new().name(name.clone());
        self.handles.push(builder.spawn(run).map_err(|source| PagerError::Thread { name, source })?);
        Ok(())
    }

    pub fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.list.lock()
    }

    pub fn ring(&self) {
        self.list.ring();
    }

    /// Gives up what is asked of servers and nobody wants any more; files are read to their end.
    pub fn give_up(&self, _is_unwanted: impl Fn(&Arc<str>) -> bool) {
        #[cfg(feature = "http")]
        self.list.give_up(_is_unwanted);
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
        self.list.close();
        self.loaded = None;
        for handle in self.handles.drain(..) {
            if handle.join().is_err() {
                log::error!("an image thread panicked");
            }
        }
    }
}

/// What the threads share.
#[derive(Clone)]
struct Reader {
    files: Arc<FileReader>,
    limits: Limits,
    #[cfg(feature = "http")]
    client: io::HttpClient,
}

impl Reader {
    fn read(&self, uri: &Arc<str>) -> Result<Vec<u8>, IoError> {
        if io::is_remote(uri) {
            return Err(IoError::unsupported(uri, "http (built without the feature)"));
        }
        self.files.read(uri)
    }

    /// Nothing is kept of what turned out to be no image.
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
    while let Some(work) = list.take() {
        let (uri, bytes): (_, Bytes) = match work {
            Work::Read(uri) => {
                let _span = timeline::span_of("read image", || uri.clone());
                let bytes = reader.read(&uri);
                (uri, Some(bytes))
            }
            #[cfg(feature = "http")]
            Work::Came(uri, bytes) => (uri, bytes),
        };
        let span = timeline::span_of("image", || uri.clone());
        let bytes_read = bytes.iter().flatten().map(|bytes| bytes.len() as u64).sum();
        let image = bytes.map(|bytes| bytes.and_then(|bytes| io::decode_image(&uri, &bytes, &reader.limits)));
        reader.forget_no_content(&image);
        drop(span);
        if sender.send(Loaded { uri, image, bytes_read }).is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// A codec's panic ended the thread, and its image was under way for ever.
    #[test]
    fn a_panic_while_reading_is_an_error_of_that_image() {
        let threads = Threads::start(&ImagePagerConfig { threads: 1, ..ImagePagerConfig::default() }).unwrap();
        for nth in 0..2 {
            threads.lock().uris.push(format!("/{nth}/{}", io::PANICS).into());
            threads.ring();
            let loaded = threads.wait_loaded(Duration::from_secs(60)).expect("the thread goes on");
            assert_eq!(loaded.image.unwrap().unwrap_err().reason(), io::DECODER_PANICKED);
        }
    }
}
