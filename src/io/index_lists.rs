//! Lists of indices: equal ones once, strips and fans as triangles. Decode workers.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

use gltf::mesh::Mode;
use lru::LruCache;

use crate::scene::{ContentKey, Topology};

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

/// Indices, at most, that [`assemble`] makes of so many; none where it takes the list as it is.
pub(super) fn assembled(mode: Mode, count: usize) -> usize {
    match mode {
        Mode::Points => 0,
        Mode::Lines if count.is_multiple_of(2) => 0,
        Mode::Triangles if count.is_multiple_of(3) => 0,
        Mode::Lines | Mode::Triangles => count,
        Mode::LineStrip | Mode::LineLoop => count.saturating_mul(2),
        Mode::TriangleStrip | Mode::TriangleFan => count.saturating_mul(3),
    }
}

/// Strips, fans and loops as lists.
pub(super) fn assemble(mode: Mode, i: Arc<[u32]>) -> (Topology, Arc<[u32]>) {
    let whole = |n: usize| -> Arc<[u32]> {
        if i.len().is_multiple_of(n) { i.clone() } else { i[..i.len() - i.len() % n].into() }
    };
    match mode {
        Mode::Points => (Topology::Points, i.clone()),
        Mode::Lines => (Topology::Lines, whole(2)),
        Mode::LineStrip | Mode::LineLoop => {
            let mut out: Vec<u32> = i.windows(2).flatten().copied().collect();
            if let (Mode::LineLoop, Some(first), Some(last)) = (mode, i.first(), i.last()) {
                out.extend([*last, *first]);
            }
            (Topology::Lines, out.into())
        }
        Mode::Triangles => (Topology::Triangles, whole(3)),
        Mode::TriangleStrip => {
            let flip = |(k, t): (usize, &[u32])| if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
            (Topology::Triangles, i.windows(3).enumerate().flat_map(flip).collect())
        }
        Mode::TriangleFan => {
            let fan = i.first().map_or(Vec::new(), |first| {
                i.get(1..).unwrap_or(&[]).windows(2).flat_map(|t| [*first, t[0], t[1]]).collect()
            });
            (Topology::Triangles, fan.into())
        }
    }
}
