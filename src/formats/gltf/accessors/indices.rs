//! [`IndexLists`]: index accessors as lists of `u32`. Equal lists of different tiles share their memory.

use std::collections::HashMap;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

use gltf::accessor::{DataType, Dimensions};
use lru::LruCache;

use super::elements::Elements;
use crate::fetch::IoError;
use crate::formats::gltf::context::Context;
use crate::scene::ContentKey;

/// A list of indices, and the largest one.
#[derive(Clone)]
pub(in super::super) struct IndexList {
    pub list: Arc<[u32]>,
    pub largest: Option<u32>,
}

/// Returns the list that was read before from equal bytes, or reads it. Tiles of a terrain often have the same grid, and a shared
/// `Arc` is uploaded once. The decode threads share a few recently used lists.
fn read_shared(key: ContentKey, read: impl FnOnce() -> Option<Arc<[u32]>>) -> Option<IndexList> {
    type Known = (Weak<[u32]>, Option<u32>);
    static LISTS: OnceLock<Mutex<LruCache<ContentKey, Known>>> = OnceLock::new();
    const MAX_LISTS: NonZeroUsize = NonZeroUsize::MIN.saturating_add(63);
    let lists = LISTS.get_or_init(|| Mutex::new(LruCache::new(MAX_LISTS)));
    let lock = || lists.lock().unwrap_or_else(PoisonError::into_inner);
    let known = |(list, largest): &Known| list.upgrade().map(|list| IndexList { list, largest: *largest });
    if let Some(list) = lock().get(&key).and_then(known) {
        return Some(list);
    }
    let list = read()?;
    let largest = list.iter().copied().max();
    let mut lists = lock();
    // Another thread may have read it meanwhile.
    if let Some(list) = lists.get(&key).and_then(known) {
        return Some(list);
    }
    lists.put(key, (Arc::downgrade(&list), largest));
    Some(IndexList { list, largest })
}

/// Returns the key of a list that was not read from one accessor.
pub(in super::super) fn list_key_of(list: &[u32]) -> ContentKey {
    ContentKey::of(&[bytemuck::cast_slice(list)])
}

/// The index lists of a glTF read so far. Primitives share them.
pub(in super::super) struct IndexLists<'a> {
    context: &'a Context<'a>,
    /// By the index of the accessor.
    read: HashMap<usize, (IndexList, ContentKey)>,
}

impl<'a> IndexLists<'a> {
    pub fn new(context: &'a Context<'a>) -> Self {
        Self { context, read: HashMap::new() }
    }

    /// Returns the list of an accessor and its key. Calls `elements` for a list that was not read before; returns `None` if
    /// that has none. Fails if an index is out of range for `vertices` vertices.
    pub fn get<'e>(
        &mut self,
        accessor: &gltf::Accessor<'_>,
        vertices: usize,
        elements: impl FnOnce() -> Result<Option<Elements<'e>>, IoError>,
    ) -> Result<Option<(IndexList, ContentKey)>, IoError> {
        let indices = self.read(accessor, elements)?;
        if let Some((list, _)) = &indices {
            self.check(list.largest, vertices)?;
        }
        Ok(indices)
    }

    /// Does the same for a primitive whose indices may restart it (EXT_mesh_primitive_restart). The last value is the index
    /// that does, if there is one: the largest one of its type, unless it is a vertex.
    pub fn get_restarting<'e>(
        &mut self,
        accessor: &gltf::Accessor<'_>,
        vertices: usize,
        elements: impl FnOnce() -> Result<Option<Elements<'e>>, IoError>,
    ) -> Result<Option<(IndexList, ContentKey, Option<u32>)>, IoError> {
        let Some((list, key)) = self.read(accessor, elements)? else { return Ok(None) };
        let largest_of_type = match accessor.data_type() {
            DataType::U8 => u32::from(u8::MAX),
            DataType::U16 => u32::from(u16::MAX),
            _ => u32::MAX,
        };
        let restarts = largest_of_type as usize >= vertices && list.largest == Some(largest_of_type);
        let restart = restarts.then_some(largest_of_type);
        let largest = match restart {
            Some(restart) => list.list.iter().copied().filter(|index| *index != restart).max(),
            None => list.largest,
        };
        self.check(largest, vertices)?;
        Ok(Some((list, key, restart)))
    }

    fn check(&self, largest: Option<u32>, vertices: usize) -> Result<(), IoError> {
        match largest {
            Some(largest) if largest as usize >= vertices => {
                Err(self.context.bad(format_args!("index {largest} of {vertices} vertices")))
            }
            _ => Ok(()),
        }
    }

    fn read<'e>(
        &mut self,
        accessor: &gltf::Accessor<'_>,
        elements: impl FnOnce() -> Result<Option<Elements<'e>>, IoError>,
    ) -> Result<Option<(IndexList, ContentKey)>, IoError> {
        let indices = match self.read.get(&accessor.index()).cloned() {
            Some(indices) => indices,
            None => {
                let (uri, limit) = (self.context.uri, self.context.options.limits.max_elements);
                if accessor.count() > limit {
                    let (uri, got, limit) = (uri.to_owned(), accessor.count() as u64, limit as u64);
                    return Err(IoError::TooLarge { uri, what: "indices of an accessor", got, limit });
                }
                self.context.budget.add_indices(accessor.count())?;
                if accessor.dimensions() != Dimensions::Scalar {
                    return Err(self.context.bad("accessor of the wrong type"));
                }
                let Some(elements) = elements()? else { return Ok(None) };
                let kind = elements.data_type.as_gl_enum() as usize;
                let layout = [elements.stride, elements.count, kind].map(|n| n as u64);
                let key = ContentKey::of(&[&elements.bytes, bytemuck::cast_slice(&layout)]);
                let list = read_shared(key, || unsigned(&elements));
                let list = list.ok_or_else(|| self.context.bad("indices of a float type"))?;
                if matches!(elements.data_type, DataType::I8 | DataType::I16) {
                    self.context.notes.add("glTF: indices of a signed type");
                }
                self.read.insert(accessor.index(), (list.clone(), key));
                (list, key)
            }
        };
        Ok(Some(indices))
    }
}

/// Reads elements as unsigned integers. Negative numbers of signed types, which some writers use, are out of range. Returns
/// `None` for floats.
fn unsigned(e: &Elements<'_>) -> Option<Arc<[u32]>> {
    let at = |i: usize, n: usize| e.bytes.get(i * e.stride + n).copied().unwrap_or(0);
    Some(match e.data_type {
        DataType::U8 => (0..e.count).map(|i| u32::from(at(i, 0))).collect(),
        DataType::U16 => (0..e.count).map(|i| u32::from(u16::from_le_bytes([at(i, 0), at(i, 1)]))).collect(),
        DataType::U32 => (0..e.count).map(|i| u32::from_le_bytes([at(i, 0), at(i, 1), at(i, 2), at(i, 3)])).collect(),
        DataType::I8 => (0..e.count).map(|i| i32::from(at(i, 0) as i8) as u32).collect(),
        DataType::I16 => (0..e.count).map(|i| i32::from(i16::from_le_bytes([at(i, 0), at(i, 1)])) as u32).collect(),
        DataType::F32 => return None,
    })
}
