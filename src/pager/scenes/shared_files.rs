//! [`SharedFiles`]: files on servers that several contents refer to, such as the images of many models. Each is requested
//! once while it is used often.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lru::LruCache;
use tokio::sync::OnceCell;

use crate::fetch::{HttpClient, IoError, Limits, Permit};

/// The maximum bytes of received files that are kept for further contents.
const MAX_KEPT_BYTES: usize = 32 << 20;
/// The maximum number of files that are kept or known to be missing.
const MAX_FILES: usize = 1024;

/// A file that is being requested, or that was received. An error is kept if a retry would not help.
type File = OnceCell<Result<Arc<[u8]>, IoError>>;

/// The shared files of a scene. Clones share them. Used by the HTTP thread; decode threads forget damaged files.
#[derive(Clone, Debug, Default)]
pub(in crate::pager) struct SharedFiles(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    /// By URL, least recently used first.
    files: LruCache<Arc<str>, Arc<File>>,
    /// The bytes of all received files.
    bytes: usize,
}

impl Default for State {
    fn default() -> Self {
        Self { files: LruCache::unbounded(), bytes: 0 }
    }
}

impl State {
    fn remove(&mut self, uri: &str) {
        if let Some(file) = self.files.pop(uri) {
            self.bytes = self.bytes.saturating_sub(received_bytes(&file));
        }
    }

    fn shrink(&mut self) {
        while self.bytes > MAX_KEPT_BYTES || self.files.len() > MAX_FILES {
            let Some((_, oldest)) = self.files.pop_lru() else { return };
            self.bytes = self.bytes.saturating_sub(received_bytes(&oldest));
        }
    }
}

fn received_bytes(file: &File) -> usize {
    file.get().and_then(|received| received.as_ref().ok()).map_or(0, |bytes| bytes.len())
}

impl SharedFiles {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the bytes of a file, and how many of them this call received over the network. Calls for the same file at the
    /// same time make one request; if that is aborted, the next call takes over.
    /// The permit holds the bytes.
    pub async fn get(
        &self,
        client: &HttpClient,
        uri: &Arc<str>,
        limits: &Limits,
        permit: &Permit,
    ) -> (Result<Vec<u8>, IoError>, u64) {
        let file = self.lock().files.get_or_insert(uri.clone(), || Arc::new(File::new())).clone();
        let mut received = None;
        let request = async {
            match client.get_holding(uri, limits, permit).await {
                Ok(body) => {
                    received = Some((body.network_bytes, body.bytes.len()));
                    Ok(Ok(Arc::from(body.bytes)))
                }
                Err(error) if error.is_transient() || matches!(error, IoError::NoRoom { .. }) => Err(error),
                Err(error) => Ok(Err(error)),
            }
        };
        let bytes = match file.get_or_try_init(|| request).await {
            Ok(bytes) => bytes.as_ref().map(|bytes| bytes.to_vec()).map_err(IoError::clone),
            Err(error) => Err(error),
        };
        let Some((network_bytes, size)) = received else {
            // A copy of what another call has received.
            let size = bytes.as_ref().map_or(0, |bytes| bytes.len() as u64);
            return match permit.claim(size) {
                Ok(claim) => {
                    claim.keep(size);
                    (bytes, 0)
                }
                Err(no_room) => (Err(IoError::no_room(uri, no_room)), 0),
            };
        };
        let mut state = self.lock();
        // The file may have been forgotten meanwhile.
        if state.files.peek(uri).is_some_and(|known| Arc::ptr_eq(known, &file)) {
            state.bytes += size;
            state.shrink();
        }
        (bytes, network_bytes)
    }

    /// Forgets a file whose bytes are damaged, so that the next content requests it again.
    pub fn forget(&self, uri: &str) {
        self.lock().remove(uri);
    }
}
