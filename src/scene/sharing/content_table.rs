//! A table of shared payloads by content key. Written by decode workers, pruned by the thread that drops pages.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use super::content_key::ContentKey;
use super::shared_content::SharedContent;

/// The number of parts of a table that are locked apart, so that workers seldom wait for each other.
pub(super) const SHARDS: usize = 16;

struct Entry<T> {
    /// Referenced by the pages that use the content, and by contents still being decoded.
    content: Weak<SharedContent>,
    /// The payload, which is dropped once it was uploaded.
    value: Weak<T>,
}

/// The result of [`Table::intern`].
pub(super) struct Interned<T> {
    pub(super) content: Arc<SharedContent>,
    pub(super) value: Arc<T>,
    /// True if another page has the content already.
    pub(super) is_known: bool,
}

/// The result of [`Table::find`].
pub(super) enum Found<T> {
    Nothing,
    /// A page has the content, but the payload was dropped.
    InUse,
    AtHand(Arc<SharedContent>, Arc<T>),
}

/// The payloads of one kind by key.
pub(super) struct Table<T> {
    shards: [Mutex<HashMap<ContentKey, Entry<T>>>; SHARDS],
    /// The number of entries in all shards; changed under their locks, read by any thread.
    len: AtomicU64,
}

impl<T> Table<T> {
    pub(super) fn new() -> Self {
        Self { shards: std::array::from_fn(|_| Mutex::default()), len: AtomicU64::new(0) }
    }

    fn shard(&self, key: &ContentKey) -> MutexGuard<'_, HashMap<ContentKey, Entry<T>>> {
        self.shards[key.shard(SHARDS)].lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn find(&self, key: &ContentKey) -> Found<T> {
        let shard = self.shard(key);
        let Some(entry) = shard.get(key) else { return Found::Nothing };
        match (entry.content.upgrade(), entry.value.upgrade()) {
            (None, _) => Found::Nothing,
            (Some(_), None) => Found::InUse,
            (Some(content), Some(value)) => Found::AtHand(content, value),
        }
    }

    pub(super) fn intern(&self, key: ContentKey, value: Arc<T>) -> Interned<T> {
        let mut shard = self.shard(&key);
        let entry = shard.entry(key).or_insert_with(|| {
            self.len.fetch_add(1, Relaxed);
            Entry { content: Weak::new(), value: Weak::new() }
        });
        let known = entry.content.upgrade();
        let is_known = known.is_some();
        let content = known.unwrap_or_else(|| {
            let content = SharedContent::new(key);
            entry.content = Arc::downgrade(&content);
            content
        });
        let value = entry.value.upgrade().unwrap_or_else(|| {
            entry.value = Arc::downgrade(&value);
            value
        });
        Interned { content, value, is_known }
    }

    pub(super) fn len(&self) -> u64 {
        self.len.load(Relaxed)
    }

    pub(super) fn prune(&self, shard: usize) -> u64 {
        let mut shard = self.shards[shard % SHARDS].lock().unwrap_or_else(PoisonError::into_inner);
        let before = shard.len();
        shard.retain(|_, e| e.content.strong_count() > 0);
        let pruned = (before - shard.len()) as u64;
        self.len.fetch_sub(pruned, Relaxed);
        pruned
    }
}
