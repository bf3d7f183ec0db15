//! Lists of indices: equal ones once, and what they form. Decode workers.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

use gltf::mesh::Mode;
use lru::LruCache;

use crate::scene::{ContentKey, PrimitiveMode};

/// A list of indices and the largest.
#[derive(Clone)]
pub(super) struct Listed {
    pub list: Arc<[u32]>,
    pub largest: Option<u32>,
}

/// The same list as one read before from equal bytes, where there is one: tiles of a terrain often share their grid, and
/// what is one `Arc` is uploaded once. Decode workers share the few lists that are kept.
pub(super) fn shared(key: ContentKey, read: impl FnOnce() -> Option<Arc<[u32]>>) -> Option<Listed> {
    type Known = (Weak<[u32]>, Option<u32>);
    static LISTS: OnceLock<Mutex<LruCache<ContentKey, Known>>> = OnceLock::new();
    const KEPT: NonZeroUsize = NonZeroUsize::MIN.saturating_add(63);
    let lists = LISTS.get_or_init(|| Mutex::new(LruCache::new(KEPT)));
    let lock = || lists.lock().unwrap_or_else(PoisonError::into_inner);
    let known = |(list, largest): &Known| list.upgrade().map(|list| Listed { list, largest: *largest });
    if let Some(listed) = lock().get(&key).and_then(known) {
        return Some(listed);
    }
    let list = read()?;
    let largest = list.iter().copied().max();
    let mut lists = lock();
    // Another worker may have read it meanwhile.
    if let Some(listed) = lists.get(&key).and_then(known) {
        return Some(listed);
    }
    lists.put(key, (Arc::downgrade(&list), largest));
    Some(Listed { list, largest })
}

pub(super) fn list_key_of(list: &[u32]) -> ContentKey {
    ContentKey::of(&[bytemuck::cast_slice(list)])
}

/// The mode of a glTF's primitive.
pub(super) fn mode(mode: Mode) -> PrimitiveMode {
    match mode {
        Mode::Points => PrimitiveMode::Points,
        Mode::Lines => PrimitiveMode::Lines,
        Mode::LineStrip => PrimitiveMode::LineStrip,
        Mode::LineLoop => PrimitiveMode::LineLoop,
        Mode::Triangles => PrimitiveMode::Triangles,
        Mode::TriangleStrip => PrimitiveMode::TriangleStrip,
        Mode::TriangleFan => PrimitiveMode::TriangleFan,
    }
}
