//! What many requests need and one of them reads. The HTTP thread, and whoever reads on a thread of its own.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use tokio::sync::OnceCell;

use crate::io::IoError;

/// Read by whoever needs it first, while the others wait. They share its failure too; who comes later tries again.
#[derive(Debug)]
pub(super) struct Once<T> {
    cell: OnceCell<T>,
    /// The last failure, and when it was one.
    failed: Mutex<Option<(Instant, IoError)>>,
}

impl<T> Default for Once<T> {
    fn default() -> Self {
        Self { cell: OnceCell::new(), failed: Mutex::default() }
    }
}

impl<T> Once<T> {
    pub fn is_read(&self) -> bool {
        self.cell.initialized()
    }

    /// What was read.
    pub fn get(&self) -> Option<&T> {
        self.cell.get()
    }

    pub async fn get_or_read(&self, read: impl AsyncFnOnce() -> Result<T, IoError>) -> Result<&T, IoError> {
        let asked = Instant::now();
        let last_failure = || self.failed.lock().unwrap_or_else(PoisonError::into_inner);
        let read_once = async || {
            if let Some((at, error)) = &*last_failure()
                && *at > asked
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
    fn those_who_wait_share_a_failure_and_later_ones_try_again() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let (once, reads) = (Once::<u32>::default(), AtomicU32::new(0));
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
