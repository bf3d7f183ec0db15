//! [`SharedStateManager`]: finds equal contents and makes them one. Used by decode workers at the same time.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use lru::LruCache;

use super::content_key::ContentKey;
use super::content_table::{Found, Interned, SHARDS, Table};
use super::modes::{ShareModes, SharingStats};
use super::shared_content::SharedContent;
use super::state_sets::{self as states, States};
use crate::scene::geometry::{Drawable, Geometry, HeightTile, Mesh, Texture};
use crate::scene::pages::Page;
use crate::state::DataVariance;

/// The maximum bytes of decoded images that are kept because they were used more than once.
const MAX_KEPT_BYTES: u64 = 16 << 20;

/// Decoded images that were used more than once, least recently used first.
struct Kept {
    images: LruCache<ContentKey, (Weak<SharedContent>, Arc<Texture>)>,
    bytes: u64,
}

/// Shares equal contents. Each pager has one, which its decode workers use at the same time.
///
/// Changes by the application affect a single page: [`Scene::set_mesh`](crate::scene::Scene::set_mesh) and
/// [`Scene::replace_state_set`](crate::scene::Scene::replace_state_set) replace contents of one page. The application's own
/// pages are not shared unless it calls [`Self::share`].
pub struct SharedStateManager {
    modes: ShareModes,
    images: Table<Texture>,
    meshes: Table<Mesh>,
    tiles: Table<HeightTile>,
    /// Index lists without payloads, since a weak pointer to a list would keep its memory.
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
    /// The number of entries of `states`.
    states: AtomicU64,
    /// The shard to be pruned next.
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

impl SharedStateManager {
    /// Creates a manager that shares the kinds of contents in `modes`.
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

    /// Returns the kinds of contents that are shared.
    pub fn modes(&self) -> ShareModes {
        self.modes
    }

    /// Returns the counters so far.
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

    /// Removes entries that no page uses any more: a sixteenth of the tables at each call, so that no worker waits for long.
    /// Called by the thread that drops pages, not in a frame.
    pub fn prune(&self) {
        self.prune_shard(self.counters.next_shard.fetch_add(1, Relaxed) as usize % SHARDS);
    }

    /// Removes all entries that no page uses any more.
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
                    kept.bytes -= image.size_bytes();
                }
            }
        }
        add(&self.counters.pruned, pruned);
    }

    /// Shares the contents of a page that are not shared yet, for pages that an application builds itself. If the payloads
    /// were taken, only state sets are shared.
    pub fn share(&self, page: &mut Page) {
        self.share_states(page);
        if !page.has_all_drawables() {
            return;
        }
        page.share_drawables(|drawable, tree| {
            self.share_drawable(drawable);
            if let (Some(shared), Some(tree)) = (&drawable.shared.geometry, tree)
                && let Some(built) = tree.take()
            {
                *tree = shared.tree_or(built);
            }
        });
    }

    /// Shares a page's state sets and their textures.
    pub(crate) fn share_states(&self, page: &mut Page) {
        if page.state_sets().is_empty() {
            return;
        }
        let lock = || self.states.lock().unwrap_or_else(PoisonError::into_inner);
        let mut shared = states::Shared::default();
        // Contents are read before the lock is taken, and copied after it is released.
        if self.modes.textures {
            for set in page.state_sets_mut() {
                let keys = states::texture_keys(set);
                let known = if keys.is_empty() { Vec::new() } else { lock().known_textures(set, &keys) };
                if !known.is_empty() {
                    shared.texture_hits += known.len() as u64;
                    *set = states::with_textures(set, known);
                }
            }
        }
        for set in page.state_sets_mut() {
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
        if let (Some(surface), true) = (&mut drawable.material.metallic_roughness, self.modes.textures) {
            for (map, shared) in surface.maps_mut().into_iter().zip(&mut drawable.shared.maps) {
                if let (Some(image), None) = (map, &shared) {
                    *shared = Some(self.intern_image(texels_key(image), image));
                }
            }
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
            Geometry::Splats(_) | Geometry::Custom(_) => {}
        }
    }

    /// Returns an image by the key of its encoded bytes; `decode` is called unless the decoded image is in memory.
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
            add(&self.counters.payload_bytes_spared, image.size_bytes());
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
        self.count(&self.counters.texture_hits, &interned, image, Texture::size_bytes);
        *image = interned.value;
        interned.content
    }

    /// Keeps an image that was used again, since it may be used once more.
    fn keep(&self, content: &Arc<SharedContent>, image: &Arc<Texture>) {
        let bytes = image.size_bytes();
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if bytes > MAX_KEPT_BYTES / 4 {
            return;
        }
        let kept_image = (Arc::downgrade(content), image.clone());
        if let Some((_, replaced)) = kept.images.put(content.key, kept_image) {
            kept.bytes -= replaced.size_bytes();
        }
        kept.bytes += bytes;
        while kept.bytes > MAX_KEPT_BYTES {
            let Some((_, (_, oldest))) = kept.images.pop_lru() else { break };
            kept.bytes -= oldest.size_bytes();
        }
    }

    /// Shares a mesh by the keys of its vertices and of its index list.
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

    /// Shares a height tile whose colour image has the key `texture`.
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
            bytemuck::cast_slice(t.coarser_errors_m.as_flattened()),
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
    let size = [image.width, image.height, image.format as u32, image.mips.len() as u32];
    let sampling = image.sampling.key();
    let mut parts: Vec<&[u8]> = vec![bytemuck::cast_slice(&size), &sampling];
    parts.extend(image.mips.iter().map(|m| &m[..]));
    ContentKey::of(&parts)
}
