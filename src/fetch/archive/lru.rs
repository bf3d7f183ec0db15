//! Limits on the archive directories that readers keep in memory.

use std::hash::Hash;
use std::num::NonZeroUsize;

use lru::LruCache;

/// The maximum number of archives whose directories a reader keeps.
pub(crate) const MAX_CACHED_ARCHIVES: NonZeroUsize = NonZeroUsize::new(64).expect("not zero");
/// The maximum size of these directories together, in bytes. The most recently used one stays even if it alone is larger.
pub(crate) const MAX_CACHED_DIRECTORY_BYTES: usize = 256 << 20;

/// Removes the least recently used values until their sizes sum to at most `max_size`, or one value is left.
pub(crate) fn evict_lru<K: Hash + Eq, V>(cache: &mut LruCache<K, V>, max_size: usize, size: impl Fn(&V) -> usize) {
    if cache.len() < 2 {
        return;
    }
    let mut total: usize = cache.iter().map(|(_, value)| size(value)).sum();
    while total > max_size && cache.len() > 1 {
        total -= cache.pop_lru().map_or(0, |(_, value)| size(&value));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_archive_used_last_is_kept_whatever_its_size() {
        let mut cache = LruCache::new(MAX_CACHED_ARCHIVES);
        let mut put = |name, size| {
            cache.put(name, size);
            evict_lru(&mut cache, 100, |size| *size);
            cache.iter().map(|(name, _)| *name).collect::<String>()
        };
        assert_eq!((put('a', 60), put('b', 40), put('c', 1)), ("a".into(), "ba".into(), "cb".into()));
        assert_eq!((put('d', 500), put('e', 1)), ("d".into(), "e".into()));
    }
}
