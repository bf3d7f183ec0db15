//! The cache of decoded blocks. All threads share it.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lru::LruCache;
use terrane::fetch::AllowedHost;

use super::servers::Servers;
use super::spill::SpillFile;
use crate::GenError;

/// The pixels of a block.
pub(crate) type Block = Arc<[u32]>;

/// A block of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct BlockKey {
    /// The number that [`BlockCache::new_image`] gave the image.
    pub image: u64,
    pub index: u64,
}

/// Decoded blocks of all images of a run. The least recently used ones are evicted when their bytes exceed the budget;
/// blocks that a [`super::Cursor`] holds stay in memory until it lets go of them.
pub(crate) struct BlockCache {
    budget_bytes: AtomicUsize,
    images: AtomicU64,
    spill: Arc<SpillFile>,
    servers: Servers,
    /// No thread decodes while it holds this lock.
    held: Mutex<Held>,
}

struct Held {
    entries: LruCache<BlockKey, Entry>,
    bytes: usize,
    /// The most bytes that stayed after an eviction.
    peak_bytes: usize,
}

struct Entry {
    /// Locked while a thread decodes the block, so that others wait for it instead of decoding it again.
    block: Arc<Mutex<Option<Block>>>,
    /// The bytes of the decoded block that count; 0 while it is decoded.
    bytes: usize,
}

impl BlockCache {
    /// Creates a cache for this many bytes of decoded blocks.
    pub fn new(budget_bytes: usize) -> Self {
        let held = Held { entries: LruCache::unbounded(), bytes: 0, peak_bytes: 0 };
        Self {
            budget_bytes: AtomicUsize::new(budget_bytes),
            images: AtomicU64::new(0),
            spill: Arc::default(),
            servers: Servers::default(),
            held: Mutex::new(held),
        }
    }

    /// Lets the redirects of servers lead to some hosts whatever their addresses are.
    pub fn allowing(self, hosts: &[AllowedHost]) -> Self {
        Self { servers: Servers::new(hosts), ..self }
    }

    /// Changes the number of bytes of decoded blocks. Blocks beyond it leave when the next one is decoded.
    pub fn set_budget(&self, bytes: usize) {
        self.budget_bytes.store(bytes, Ordering::Relaxed);
    }

    /// Returns the number of bytes of decoded blocks.
    pub fn budget(&self) -> usize {
        self.budget_bytes.load(Ordering::Relaxed)
    }

    /// Returns the temporary file for images that are decoded as a whole.
    pub fn spill(&self) -> &Arc<SpillFile> {
        &self.spill
    }

    /// Returns the files on servers.
    pub fn servers(&self) -> &Servers {
        &self.servers
    }

    /// Returns a number for an image that no other image of this cache has.
    pub(super) fn new_image(&self) -> u64 {
        self.images.fetch_add(1, Ordering::Relaxed)
    }

    /// Returns a block, decoded by `decode` if the cache does not hold it. A decoder may ask for other blocks, but not for
    /// one whose decoder asks for this one.
    pub(super) fn block(
        &self,
        key: BlockKey,
        decode: impl FnOnce() -> Result<Vec<u32>, GenError>,
    ) -> Result<Block, GenError> {
        let block = {
            let mut held = self.held();
            let new = || Entry { block: Arc::default(), bytes: 0 };
            Arc::clone(&held.entries.get_or_insert(key, new).block)
        };
        // After a panic of a decoder there is no block, and the next thread decodes it.
        let mut block = block.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(block) = &*block {
            return Ok(Arc::clone(block));
        }
        match decode() {
            Ok(pixels) => {
                let pixels = Block::from(pixels);
                *block = Some(Arc::clone(&pixels));
                self.count(key, size_of_val(&*pixels));
                Ok(pixels)
            }
            Err(error) => {
                self.held().entries.pop(&key);
                Err(error)
            }
        }
    }

    /// Counts the bytes of a new block, and evicts others until the budget is kept.
    fn count(&self, key: BlockKey, bytes: usize) {
        let mut evicted = Vec::new();
        {
            let mut held = self.held();
            let Held { entries, bytes: total, peak_bytes } = &mut *held;
            let Some(entry) = entries.peek_mut(&key) else { return };
            *total += bytes - std::mem::replace(&mut entry.bytes, bytes).min(bytes);
            while *total > self.budget_bytes.load(Ordering::Relaxed)
                && let Some((_, entry)) = entries.pop_lru()
            {
                *total -= entry.bytes;
                evicted.push(entry);
            }
            *peak_bytes = (*peak_bytes).max(*total);
        }
        // Memory is freed here, without the lock.
        drop(evicted);
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the most bytes that the blocks in the cache have had.
    #[cfg(test)]
    pub fn peak_bytes(&self) -> usize {
        self.held().peak_bytes
    }

    /// Returns the bytes of the blocks in the cache.
    #[cfg(test)]
    pub fn bytes(&self) -> usize {
        self.held().bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Barrier;

    fn key(index: u64) -> BlockKey {
        BlockKey { image: 0, index }
    }

    #[test]
    fn least_recently_used_blocks_are_evicted() {
        let cache = BlockCache::new(3 * 400);
        let decoded = AtomicUsize::new(0);
        let get = |index: u64| {
            let decode = || {
                decoded.fetch_add(1, Ordering::Relaxed);
                Ok(vec![index as u32; 100])
            };
            assert_eq!(cache.block(key(index), decode).unwrap()[99], index as u32);
            decoded.load(Ordering::Relaxed)
        };
        assert_eq!([0, 1, 2, 0, 1, 2].map(get), [1, 2, 3, 3, 3, 3]);
        assert_eq!(cache.bytes(), 1200);
        // 3 evicts 0, which is decoded again and evicts 1.
        assert_eq!([3, 2, 0, 3, 2, 1].map(get), [4, 4, 5, 5, 5, 6]);
        assert_eq!(cache.bytes(), 1200);
        // A block above the budget is returned, but not kept.
        assert_eq!(cache.block(key(9), || Ok(vec![7; 1000])).unwrap().len(), 1000);
        assert!(cache.bytes() <= 1200);
    }

    #[test]
    fn threads_wait_for_a_block_instead_of_decoding_it_again() {
        let (cache, decoded, start) = (BlockCache::new(1 << 20), AtomicUsize::new(0), Barrier::new(4));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    start.wait();
                    for index in 0..200 {
                        let decode = || {
                            decoded.fetch_add(1, Ordering::Relaxed);
                            std::thread::yield_now();
                            Ok(vec![1; 16])
                        };
                        cache.block(key(index), decode).unwrap();
                    }
                });
            }
        });
        assert_eq!(decoded.into_inner(), 200);
    }

    #[test]
    fn errors_are_not_kept() {
        let cache = BlockCache::new(1 << 20);
        let fail = || Err(GenError::Argument("no".to_owned()));
        assert!(cache.block(key(1), fail).is_err());
        assert_eq!(cache.block(key(1), || Ok(vec![5])).unwrap()[0], 5);
    }
}
