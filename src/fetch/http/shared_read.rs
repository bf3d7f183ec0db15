//! [`SharedRead`]: a value that many requests need and one of them reads. HTTP thread.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use tokio::sync::OnceCell;

use crate::fetch::IoError;

/// A value that the first request reads while the others wait. Waiting requests share a failure; later ones retry. If the
/// reading request is dropped, the next one that waits reads.
#[derive(Debug)]
pub(in crate::fetch) struct SharedRead<T> {
    cell: OnceCell<T>,
    /// The last failure and its time. Locked briefly.
    failed: Mutex<Option<(Instant, IoError)>>,
}

impl<T> Default for SharedRead<T> {
    fn default() -> Self {
        Self { cell: OnceCell::new(), failed: Mutex::default() }
    }
}

impl<T> SharedRead<T> {
    /// Returns true once the value has been read.
    pub fn is_done(&self) -> bool {
        self.cell.initialized()
    }

    /// Returns the value if it has been read.
    pub fn get(&self) -> Option<&T> {
        self.cell.get()
    }

    /// Returns the value if it has been read.
    pub fn into_value(self) -> Option<T> {
        self.cell.into_inner()
    }

    /// Returns the value; reads it if no request has done so.
    pub async fn get_or_read(&self, read: impl AsyncFnOnce() -> Result<T, IoError>) -> Result<&T, IoError> {
        let requested_at = Instant::now();
        let last_failure = || self.failed.lock().unwrap_or_else(PoisonError::into_inner);
        let read_once = async || {
            if let Some((at, error)) = &*last_failure()
                && *at > requested_at
            {
                return Err(error.clone());
            }
            let got = read().await;
            if let Err(error) = &got {
                *last_failure() = Some((Instant::now(), error.clone()));
            }
            got
        };
        self.cell.get_or_try_init(read_once).await
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[test]
    fn waiting_requests_share_a_failure_and_later_ones_retry() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let (once, reads) = (SharedRead::<u32>::default(), AtomicU32::new(0));
        let fails = async || {
            reads.fetch_add(1, Ordering::Relaxed);
            tokio::task::yield_now().await;
            Err(IoError::NotFound { uri: "http://h/a.3tz".to_owned() })
        };
        runtime.block_on(async {
            let (a, b, c) = tokio::join!(once.get_or_read(fails), once.get_or_read(fails), once.get_or_read(fails));
            assert!(a.is_err() && a == b && b == c);
            assert_eq!(reads.load(Ordering::Relaxed), 1);
            assert!(once.get_or_read(fails).await.is_err());
            assert_eq!(reads.load(Ordering::Relaxed), 2);
            assert_eq!(once.get_or_read(async || Ok(7)).await, Ok(&7));
            assert_eq!(once.get_or_read(fails).await, Ok(&7));
        });
        assert_eq!(reads.load(Ordering::Relaxed), 2);
    }
}
