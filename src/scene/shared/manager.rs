//! The tables of what is shared.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};

use lru::LruCache;

use super::key::ContentKey;
use super::states::{self, States};
use crate::scene::geometry::{Drawable, Geometry, HeightTile, Mesh, Texture};
use crate::scene::intersect::KdTree;
use crate::scene::page::Page;
use crate::state::DataVariance;

/// Tables that are locked apart, so that workers seldom meet.
const SHARDS: usize = 16;
/// Images that came again are kept decoded up to so many bytes, for the next tile that brings them.
const MOST_KEPT_BYTES: u64 = 16 << 20;

/// What is shared; OSG's `ShareMode`, and geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShareModes {
    /// Images of materials and height tiles, and textures of state sets that hold texels.
    pub textures: bool,
    /// State sets whose data variance is static.
    pub static_state_sets: bool,
    /// State sets that are said to change. They are replaced page by page, so that no page sees another's change;
    /// but what changes soon is seldom equal for long.
    pub dynamic_state_sets: bool,
    /// Meshes, index lists and height tiles.
    pub geometry: bool,
}

impl ShareModes {
    /// Nothing.
    pub const NONE: Self =
        Self { textures: false, static_state_sets: false, dynamic_state_sets: false, geometry: false };
    /// Everything that does not change: the default.
    pub const STATIC: Self =
        Self { textures: true, static_state_sets: true, dynamic_state_sets: false, geometry: true };
    /// Everything.
    pub const ALL: Self = Self { dynamic_state_sets: true, ..Self::STATIC };

    /// Something is shared.
    pub fn any(&self) -> bool {
        *self != Self::NONE
    }
}

impl Default for ShareModes {
    fn default() -> Self {
        Self::STATIC
    }
}

/// What sharing did, counted where it happens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SharingStats {
    /// Images and textures that another content had already.
    pub texture_hits: u64,
    /// Meshes and height tiles that another content had already.
    pub geometry_hits: u64,
    /// State sets that another content had already.
    pub state_set_hits: u64,
    /// Images that were not decoded, because the decoded one was at hand.
    pub decodes_spared: u64,
    /// Bytes of payloads of which another copy was at hand, dropped at once or never made.
    pub payload_bytes_spared: u64,
    /// Shared contents now in the tables.
    pub entries: u64,
    /// Entries that were taken out of the tables because nobody shares them any more.
    pub pruned: u64,
}

/// What pages hold of a shared content as long as they use it: places on the GPU go by its key.
#[derive(Debug)]
pub(crate) struct SharedContent {
    pub(crate) key: ContentKey,
    /// Built when first asked for.
    tree: OnceLock<Option<Arc<KdTree>>>,
}

impl SharedContent {
    fn new(key: ContentKey) -> Arc<Self> {
        Arc::new(Self { key, tree: OnceLock::new() })
    }

    /// The tree over the geometry; equal geometry has one.
    pub(crate) fn tree(&self, geometry: &Geometry) -> Option<Arc<KdTree>> {
        self.tree.get_or_init(|| KdTree::build(geometry).map(Arc::new)).clone()
    }

    /// The tree over the geometry, where one was built before it was known to be shared.
    fn tree_or(&self, built: Arc<KdTree>) -> Option<Arc<KdTree>> {
        self.tree.get_or_init(|| Some(built)).clone()
    }
}

/// What a drawable shares with others.
#[derive(Clone, Debug, Default)]
pub(crate) struct SharedParts {
    pub(crate) geometry: Option<Arc<SharedContent>>,
    pub(crate) indices: Option<Arc<SharedContent>>,
    pub(crate) texture: Option<Arc<SharedContent>>,
}

impl SharedParts {
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Arc<SharedContent>> {
        [&self.geometry, &self.indices, &self.texture].into_iter().flatten()
    }
}

struct Entry<T> {
    /// Held by the pages that use the content, and by what is on its way to one.
    content: Weak<SharedContent>,
    /// The payload, which is gone once it was uploaded.
    value: Weak<T>,
}

/// What [`Table::intern`] found.
struct Interned<T> {
    content: Arc<SharedContent>,
    value: Arc<T>,
    /// Another has the content.
    is_known: bool,
}

/// What there is of a key.
enum Found<T> {
    Nothing,
    /// Some page has the content, whose payload is gone.
    InUse,
    AtHand(Arc<SharedContent>, Arc<T>),
}

/// One kind of payload by key. Written by decode workers, pruned by the reaper.
struct Table<T> {
    shards: [Mutex<HashMap<ContentKey, Entry<T>>>; SHARDS],
    /// Entries in all shards; changed under their locks, read by anyone.
    len: AtomicU64,
}

impl<T> Table<T> {
    fn new() -> Self {
        Self { shards: std::array::from_fn(|_| Mutex::default()), len: AtomicU64::new(0) }
    }

    fn shard(&self, key: &ContentKey) -> MutexGuard<'_, HashMap<ContentKey, Entry<T>>> {
        self.shards[key.shard(SHARDS)].lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn find(&self, key: &ContentKey) -> Found<T> {
        let shard = self.shard(key);
        let Some(entry) = shard.get(key) else { return Found::Nothing };
        match (entry.content.upgrade(), entry.value.upgrade()) {
            (None, _) => Found::Nothing,
            (Some(_), None) => Found::InUse,
            (Some(content), Some(value)) => Found::AtHand(content, value),
        }
    }

    fn intern(&self, key: ContentKey, value: Arc<T>) -> Interned<T> {
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

    fn len(&self) -> u64 {
        self.len.load(Relaxed)
    }

    fn prune(&self, shard: usize) -> u64 {
        let mut shard = self.shards[shard % SHARDS].lock().unwrap_or_else(PoisonError::into_inner);
        let before = shard.len();
        shard.retain(|_, e| e.content.strong_count() > 0);
        let pruned = (before - shard.len()) as u64;
        self.len.fetch_sub(pruned, Relaxed);
        pruned
    }
}

/// Images that came more than once, the last used last.
struct Kept {
    images: LruCache<ContentKey, (Weak<SharedContent>, Arc<Texture>)>,
    bytes: u64,
}

/// Shares what is equal; one for each pager, used by its decode workers at the same time.
///
/// What the application changes is never another tile's: [`Scene::set_mesh`](crate::scene::Scene::set_mesh) and
/// [`Scene::replace_state_set`](crate::scene::Scene::replace_state_set) put something else in the place of one page's,
/// and the application's own pages are not shared unless it calls [`Self::share`].
pub struct SharedStateManager {
    modes: ShareModes,
    images: Table<Texture>,
    meshes: Table<Mesh>,
    tiles: Table<HeightTile>,
    /// Without payloads: a weak pointer to a list would keep its memory.
    lists: Table<()>,
    states: Mutex<States>,
    kept: Mutex<Kept>,
    counters: Counters,
}

#[derive(Default)]
struct Counters {
    texture_hits: AtomicU64,
    geometry_hits: AtomicU64,
    state_set_hits: AtomicU64,
    decodes_spared: AtomicU64,
    payload_bytes_spared: AtomicU64,
    pruned: AtomicU64,
    /// Entries of `states`.
    states: AtomicU64,
    /// The shard that is pruned next.
    next_shard: AtomicU64,
}

impl std::fmt::Debug for SharedStateManager {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SharedStateManager").field("modes", &self.modes).field("stats", &self.stats()).finish()
    }
}

fn add(counter: &AtomicU64, n: u64) {
    counter.fetch_add(n, Relaxed);
}

fn image_bytes(image: &Texture) -> u64 {
    image.mips.iter().map(|m| m.len() as u64).sum()
}

impl SharedStateManager {
    /// A manager that shares what `modes` say.
    pub fn new(modes: ShareModes) -> Self {
        Self {
            modes,
            images: Table::new(),
            meshes: Table::new(),
            tiles: Table::new(),
            lists: Table::new(),
            states: Mutex::default(),
            kept: Mutex::new(Kept { images: LruCache::unbounded(), bytes: 0 }),
            counters: Counters::default(),
        }
    }

    /// What it shares.
    pub fn modes(&self) -> ShareModes {
        self.modes
    }

    /// Counters so far.
    pub fn stats(&self) -> SharingStats {
        let c = &self.counters;
        let states = c.states.load(Relaxed);
        SharingStats {
            texture_hits: c.texture_hits.load(Relaxed),
            geometry_hits: c.geometry_hits.load(Relaxed),
            state_set_hits: c.state_set_hits.load(Relaxed),
            decodes_spared: c.decodes_spared.load(Relaxed),
            payload_bytes_spared: c.payload_bytes_spared.load(Relaxed),
            entries: self.images.len() + self.meshes.len() + self.tiles.len() + self.lists.len() + states,
            pruned: c.pruned.load(Relaxed),
        }
    }

    /// Takes out what nobody shares any more: one part of sixteen at each call, so that no worker waits for long.
    /// Called where pages are dropped, not in a frame.
    pub fn prune(&self) {
        self.prune_shard(self.counters.next_shard.fetch_add(1, Relaxed) as usize % SHARDS);
    }

    /// [`Self::prune`] of everything.
    pub fn prune_all(&self) {
        (0..SHARDS).for_each(|shard| self.prune_shard(shard));
    }

    fn prune_shard(&self, shard: usize) {
        let mut pruned = self.images.prune(shard) + self.meshes.prune(shard);
        pruned += self.tiles.prune(shard) + self.lists.prune(shard);
        if shard == 0 {
            let mut states = self.states.lock().unwrap_or_else(PoisonError::into_inner);
            pruned += states.prune();
            self.counters.states.store(states.len(), Relaxed);
            drop(states);
            let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
            let unused = |(key, (content, _)): (&ContentKey, &(Weak<SharedContent>, _))| {
                (content.strong_count() == 0).then_some(*key)
            };
            for key in kept.images.iter().filter_map(unused).collect::<Vec<_>>() {
                if let Some((_, image)) = kept.images.pop(&key) {
                    kept.bytes -= image_bytes(&image);
                }
            }
        }
        add(&self.counters.pruned, pruned);
    }

    /// Shares what a page holds that is not shared yet: for pages that an application builds itself and attaches to
    /// slots. Once its payloads are taken, its state sets alone.
    pub fn share(&self, page: &mut Page) {
        self.share_states(page);
        if page.drawables.len() != page.drawable_count() {
            return;
        }
        let mut drawables = std::mem::take(&mut page.drawables);
        for drawable in &mut drawables {
            self.share_drawable(drawable);
        }
        for (tree, drawable) in page.kd_trees.iter_mut().zip(&drawables) {
            if let Some(shared) = &drawable.shared.geometry
                && let Some(built) = tree.take()
            {
                *tree = shared.tree_or(built);
            }
        }
        page.drawables = drawables;
        page.hold_shared();
    }

    /// Shares a page's state sets and their textures.
    pub(crate) fn share_states(&self, page: &mut Page) {
        if page.state_sets.is_empty() {
            return;
        }
        let lock = || self.states.lock().unwrap_or_else(PoisonError::into_inner);
        let mut shared = states::Shared::default();
        // What reads contents comes before the lock, and what copies after it.
        if self.modes.textures {
            for set in &mut page.state_sets {
                let keys = states::texture_keys(set);
                let known = if keys.is_empty() { Vec::new() } else { lock().known_textures(set, &keys) };
                if !known.is_empty() {
                    shared.texture_hits += known.len() as u64;
                    *set = states::with_textures(set, known);
                }
            }
        }
        for set in &mut page.state_sets {
            let is_wanted = match set.data_variance {
                DataVariance::Static => self.modes.static_state_sets,
                DataVariance::Dynamic => self.modes.dynamic_state_sets,
            };
            if is_wanted {
                let hash = states::hash(set);
                lock().share(set, hash, &mut shared);
            }
        }
        self.counters.states.store(lock().len(), Relaxed);
        add(&self.counters.texture_hits, shared.texture_hits);
        add(&self.counters.state_set_hits, shared.set_hits);
        add(&self.counters.pruned, shared.pruned);
    }

    fn share_drawable(&self, drawable: &mut Drawable) {
        if let (Some(image), None) = (&mut drawable.material.texture, &drawable.shared.texture)
            && self.modes.textures
        {
            let key = texels_key(image);
            drawable.shared.texture = Some(self.intern_image(key, image));
        }
        if drawable.shared.geometry.is_some() || !self.modes.geometry {
            return;
        }
        match &mut drawable.geometry {
            Geometry::Mesh(mesh) => {
                let indices = ContentKey::of(&[bytemuck::cast_slice(&mesh.indices)]);
                let vertices = ContentKey::of_vertices(&mesh.vertices, &mesh.attributes);
                (drawable.shared.geometry, drawable.shared.indices) = self.mesh(mesh, &vertices, &indices);
            }
            Geometry::Height(tile) => {
                let texture = tile.texture.as_ref().map(|t| texels_key(t));
                drawable.shared.geometry = self.height_tile(tile, texture.as_ref());
            }
            Geometry::Custom(_) => {}
        }
    }

    /// An image by the key of what it is decoded from; `decode` is called unless the decoded one is at hand.
    pub(crate) fn image<E>(
        &self,
        key: ContentKey,
        decode: impl FnOnce() -> Result<Arc<Texture>, E>,
    ) -> Result<(Arc<Texture>, Option<Arc<SharedContent>>), E> {
        if !self.modes.textures {
            return Ok((decode()?, None));
        }
        let found = self.images.find(&key);
        let is_known = !matches!(found, Found::Nothing);
        if let Found::AtHand(content, image) = found {
            add(&self.counters.texture_hits, 1);
            add(&self.counters.decodes_spared, 1);
            add(&self.counters.payload_bytes_spared, image_bytes(&image));
            self.keep(&content, &image);
            return Ok((image, Some(content)));
        }
        let mut image = decode()?;
        let content = self.intern_image(key, &mut image);
        if is_known {
            self.keep(&content, &image);
        }
        Ok((image, Some(content)))
    }

    fn intern_image(&self, key: ContentKey, image: &mut Arc<Texture>) -> Arc<SharedContent> {
        let interned = self.images.intern(key, image.clone());
        self.count(&self.counters.texture_hits, &interned, image, image_bytes);
        *image = interned.value;
        interned.content
    }

    /// An image that came again may come once more.
    fn keep(&self, content: &Arc<SharedContent>, image: &Arc<Texture>) {
        let bytes = image_bytes(image);
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if bytes > MOST_KEPT_BYTES / 4 {
            return;
        }
        let kept_image = (Arc::downgrade(content), image.clone());
        if let Some((_, replaced)) = kept.images.put(content.key, kept_image) {
            kept.bytes -= image_bytes(&replaced);
        }
        kept.bytes += bytes;
        while kept.bytes > MOST_KEPT_BYTES {
            let Some((_, (_, oldest))) = kept.images.pop_lru() else { break };
            kept.bytes -= image_bytes(&oldest);
        }
    }

    /// A mesh by the keys of its vertices and of its index list.
    pub(crate) fn mesh(
        &self,
        mesh: &mut Arc<Mesh>,
        vertices: &ContentKey,
        indices: &ContentKey,
    ) -> (Option<Arc<SharedContent>>, Option<Arc<SharedContent>>) {
        if !self.modes.geometry {
            return (None, None);
        }
        let list = self.lists.intern(*indices, Arc::new(())).content;
        let b = mesh.bounds;
        let bounds = [b.min.to_array(), b.max.to_array()];
        let shape: &[u8] = &[mesh.topology as u8];
        let key = ContentKey::of(&[&vertices.bytes(), &indices.bytes(), shape, bytemuck::cast_slice(&bounds)]);
        let interned = self.meshes.intern(key, mesh.clone());
        self.count(&self.counters.geometry_hits, &interned, mesh, |m| {
            let vertices = size_of_val::<[_]>(&m.vertices) as u64 + m.attributes.size_bytes();
            vertices + size_of_val::<[u32]>(&m.indices) as u64
        });
        *mesh = interned.value;
        (Some(interned.content), Some(list))
    }

    /// A height tile whose colour has the key `texture`.
    pub(crate) fn height_tile(
        &self,
        tile: &mut Arc<HeightTile>,
        texture: Option<&ContentKey>,
    ) -> Option<Arc<SharedContent>> {
        if !self.modes.geometry || (tile.texture.is_some() && texture.is_none()) {
            return None;
        }
        let t = &**tile;
        let b = [t.bounds.min.to_array(), t.bounds.max.to_array()];
        let texture = texture.map_or([0; 32], ContentKey::bytes);
        let key = ContentKey::of(&[
            bytemuck::cast_slice(&t.heights),
            bytemuck::cast_slice(&t.rows),
            bytemuck::cast_slice(&t.columns),
            bytemuck::cast_slice(&[t.p0_m, t.skirt_m, t.cell_m[0], t.cell_m[1]]),
            bytemuck::cast_slice(&[t.side, t.level, u32::from(t.texture.is_some())]),
            bytemuck::cast_slice(&t.coarser_errors_m),
            bytemuck::cast_slice(&b),
            &texture,
        ]);
        let interned = self.tiles.intern(key, tile.clone());
        self.count(&self.counters.geometry_hits, &interned, tile, |t| {
            (t.heights.len() * 4 + t.rows.len() * 16 + t.columns.len() * 8) as u64
        });
        *tile = interned.value;
        Some(interned.content)
    }

    fn count<T>(&self, hits: &AtomicU64, interned: &Interned<T>, own: &Arc<T>, bytes: impl Fn(&T) -> u64) {
        if interned.is_known {
            add(hits, 1);
        }
        if !Arc::ptr_eq(&interned.value, own) {
            add(&self.counters.payload_bytes_spared, bytes(own));
        }
    }
}

fn texels_key(image: &Texture) -> ContentKey {
    let [u, v] = image.wrap.map(|mode| mode as u32);
    let size = [image.width, image.height, u, v, image.mips.len() as u32];
    let mut parts: Vec<&[u8]> = vec![bytemuck::cast_slice(&size)];
    parts.extend(image.mips.iter().map(|m| &m[..]));
    ContentKey::of(&parts)
}
