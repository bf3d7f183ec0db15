//! Meshes: vertex and index buffers cut into places of one size class each; equal meshes and equal index
//! lists are uploaded once.
//!
//! Draw thread only. A buffer holds places of a single size, so it cannot fragment, and meshes of like size
//! (all tiles of a set) draw from one buffer without changing state. Vertices and indices lie as they come, or in fewer
//! bytes where nothing is lost (`packing.rs`), each format in buffers of its own, as is each layout of further attributes.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use super::memory::Memory;
use super::packing::{VertexFormat, WHITE, is_short};
use super::slots::{Identity, SlotAllocator, block_capacity, size_class};
use super::table::Table;
use super::uploads::Destination;
use crate::scene::{AttributeLayout, Mesh, SharedParts, added_stride};

/// Bytes a buffer aims at.
const CHUNK_BYTES: u64 = 8 << 20;
/// Most places in a buffer.
const CHUNK_PLACES: u32 = 4096;

/// Bits of a chunk's number that say in which arena it is.
const ARENA_SHIFT: u32 = 27;
/// The first arenas of vertices, one for each format; behind them is one for each layout of further attributes.
const FORMATS: [VertexFormat; 3] = [VertexFormat::Full, VertexFormat::Packed, VertexFormat::Quantized];
/// Most layouts of further attributes at once: a pipeline's key has four bits for them, and one value for none.
pub(crate) const MOST_LAYOUTS: usize = 15;
/// The arena of indices of 16 bits; 0 is that of 32.
const SHORT: u32 = 1;

/// The arena of a chunk's number, and the chunk in it.
fn parts(chunk: u32) -> (u32, u32) {
    (chunk >> ARENA_SHIFT, chunk & ((1 << ARENA_SHIFT) - 1))
}

/// Part of a buffer of [`Arenas`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Range {
    /// With the arena it is in.
    pub(super) chunk: u32,
    place: u32,
    /// First element, counted from the start of the buffer.
    pub(super) first: u32,
}

impl Range {
    /// Of indices of 16 bits.
    pub(super) fn is_short(self) -> bool {
        parts(self.chunk).0 == SHORT
    }
}

struct Chunk {
    buffer: wgpu::Buffer,
    class: u32,
    slots: SlotAllocator,
    capacity: u32,
}

/// Buffers of elements of one kind.
struct Arena {
    label: &'static str,
    usage: wgpu::BufferUsages,
    element_bytes: u64,
    chunks: Table<Chunk>,
    bytes_in_use: u64,
    bytes_allocated: u64,
}

impl Arena {
    fn new(label: &'static str, usage: wgpu::BufferUsages, element_bytes: u64) -> Self {
        Self { label, usage, element_bytes, chunks: Table::default(), bytes_in_use: 0, bytes_allocated: 0 }
    }

    fn of_vertices(stride: usize) -> Self {
        Self::new("vertices", wgpu::BufferUsages::VERTEX, stride as u64)
    }

    fn allocate(&mut self, memory: &mut Memory, length: usize) -> Result<Range, String> {
        let too_large = || format!("{length} {} do not fit into one buffer of the adapter", self.label);
        let length = u32::try_from(length).ok().filter(|l| *l < 1 << 30).ok_or_else(too_large)?;
        let class = size_class(length);
        let class_bytes = u64::from(class) * self.element_bytes;
        // A base vertex is an i32, and buffers have a largest size.
        let most_bytes = memory.limits.max_buffer_size;
        if class_bytes > most_bytes {
            return Err(too_large());
        }
        let mut like = 0;
        for (index, chunk) in self.chunks.iter_mut() {
            if chunk.class == class {
                like += 1;
                if let Some(place) = chunk.slots.allocate() {
                    self.bytes_in_use += class_bytes;
                    return Ok(Range { chunk: index, place, first: place * class });
                }
            }
        }
        let capacity = block_capacity(like, class_bytes, CHUNK_BYTES.min(most_bytes), CHUNK_PLACES);
        let size = class_bytes * u64::from(capacity);
        let descriptor = wgpu::BufferDescriptor {
            label: Some(self.label),
            size,
            usage: self.usage | wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        };
        let buffer = memory.make(self.label, size, |device| device.create_buffer(&descriptor))?;
        let mut slots = SlotAllocator::new(capacity);
        let place = slots.allocate().ok_or("a buffer without places")?;
        self.bytes_allocated += class_bytes * u64::from(capacity);
        self.bytes_in_use += class_bytes;
        let chunk = self.chunks.insert(Chunk { buffer, class, slots, capacity });
        Ok(Range { chunk, place, first: place * class })
    }

    fn bytes_of(&self, range: Range) -> u64 {
        self.chunks.get(range.chunk).map_or(0, |chunk| u64::from(chunk.class) * self.element_bytes)
    }

    fn release(&mut self, range: Range) {
        let bytes = self.bytes_of(range);
        if let Some(chunk) = self.chunks.get_mut(range.chunk) {
            chunk.slots.release(range.place);
            self.bytes_in_use -= bytes;
            if chunk.slots.is_empty() {
                self.bytes_allocated -= bytes * u64::from(chunk.capacity);
                self.chunks.remove(range.chunk);
            }
        }
    }

    fn destination(&self, range: Range) -> Option<Destination> {
        let buffer = self.buffer(range.chunk)?.clone();
        Some(Destination::Buffer(buffer, u64::from(range.first) * self.element_bytes))
    }

    fn buffer(&self, chunk: u32) -> Option<&wgpu::Buffer> {
        self.chunks.get(chunk).map(|c| &c.buffer)
    }
}

/// Buffers of elements of some formats.
struct Arenas(Vec<Arena>);

impl Arenas {
    fn allocate(&mut self, arena: u32, memory: &mut Memory, length: usize) -> Result<Range, String> {
        let of = self.0.get_mut(arena as usize).ok_or("a format without buffers")?;
        let range = of.allocate(memory, length)?;
        Ok(Range { chunk: range.chunk | arena << ARENA_SHIFT, ..range })
    }

    fn bytes_of(&self, range: Range) -> u64 {
        let (arena, chunk) = parts(range.chunk);
        self.0.get(arena as usize).map_or(0, |arena| arena.bytes_of(Range { chunk, ..range }))
    }

    fn release(&mut self, range: Range) {
        let (arena, chunk) = parts(range.chunk);
        if let Some(arena) = self.0.get_mut(arena as usize) {
            arena.release(Range { chunk, ..range });
        }
    }

    fn destination(&self, range: Range) -> Option<Destination> {
        let (arena, chunk) = parts(range.chunk);
        self.0.get(arena as usize)?.destination(Range { chunk, ..range })
    }

    fn buffer(&self, chunk: u32) -> Option<&wgpu::Buffer> {
        let (arena, chunk) = parts(chunk);
        self.0.get(arena as usize)?.buffer(chunk)
    }

    fn bytes_in_use(&self) -> u64 {
        self.0.iter().map(|arena| arena.bytes_in_use).sum()
    }

    fn bytes_allocated(&self) -> u64 {
        self.0.iter().map(|arena| arena.bytes_allocated).sum()
    }
}

struct MeshRecord {
    /// Keeps the address from being used for another mesh while the record stands.
    source: Weak<Mesh>,
    identity: Identity,
    vertices: Range,
    indices: u32,
    users: u32,
}

struct IndexRecord {
    /// Set while the list is shared by its address.
    source: Option<Weak<[u32]>>,
    identity: Identity,
    range: Range,
    /// Largest index, to check further meshes that share the list.
    largest: u32,
    users: u32,
}

/// What drawing a mesh needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MeshPlace {
    /// Equal for drawables that share a mesh.
    pub(crate) mesh: u32,
    pub(crate) vertex_chunk: u32,
    pub(crate) index_chunk: u32,
    pub(crate) base_vertex: i32,
    pub(crate) first_index: u32,
    pub(crate) index_count: u32,
}

/// What of a newly placed mesh has to be uploaded.
pub(super) struct MeshUploads {
    pub(super) place: MeshPlace,
    pub(super) vertices: Option<Range>,
    pub(super) indices: Option<Range>,
    /// Bytes of the vertices' place and of the indices', new or not.
    pub(super) place_bytes: [u64; 2],
}

/// All meshes of a context.
pub(crate) struct MeshPool {
    vertices: Arenas,
    indices: Arenas,
    /// Of the arenas behind those of [`FORMATS`].
    layouts: Vec<Arc<AttributeLayout>>,
    /// The color of packed and quantized vertices, once there are some.
    white: Option<wgpu::Buffer>,
    meshes: Table<MeshRecord>,
    index_lists: Table<IndexRecord>,
    /// Only looked up, never walked.
    mesh_by_identity: HashMap<Identity, u32>,
    index_list_by_identity: HashMap<Identity, u32>,
}

impl Default for MeshPool {
    fn default() -> Self {
        let vertices = |format: VertexFormat| Arena::of_vertices(format.stride());
        let indices = |bytes| Arena::new("indices", wgpu::BufferUsages::INDEX, bytes);
        Self {
            vertices: Arenas(FORMATS.map(vertices).into()),
            indices: Arenas([4, 2].map(indices).into()),
            layouts: Vec::new(),
            white: None,
            meshes: Table::default(),
            index_lists: Table::default(),
            mesh_by_identity: HashMap::new(),
            index_list_by_identity: HashMap::new(),
        }
    }
}

fn check_indices(largest: u32, mesh: &Mesh) -> Result<(), String> {
    if (largest as usize) < mesh.vertices.len() {
        Ok(())
    } else {
        Err(format!("a mesh of {} vertices has the index {largest}", mesh.vertices.len()))
    }
}

impl MeshPool {
    /// Places for a mesh, and which of them are new.
    pub(super) fn allocate(
        &mut self,
        memory: &mut Memory,
        mesh: &Arc<Mesh>,
        shared: &SharedParts,
        format: VertexFormat,
    ) -> Result<MeshUploads, String> {
        let content = shared.geometry.as_ref().map(|s| &s.key);
        let identity = Identity::new(content, Arc::as_ptr(mesh));
        if let Some(&id) = self.mesh_by_identity.get(&identity)
            && let Some(record) = self.meshes.get_mut(id)
            && (content.is_some() || std::ptr::eq(record.source.as_ptr(), Arc::as_ptr(mesh)))
        {
            record.users += 1;
            let (vertices, indices) = (record.vertices, record.indices);
            let place = self.place(id, vertices, indices, mesh)?;
            let place_bytes = [self.vertices.bytes_of(vertices), self.index_bytes(indices)];
            return Ok(MeshUploads { place, vertices: None, indices: None, place_bytes });
        }
        if mesh.vertices.is_empty() || mesh.indices.is_empty() {
            return Err("a mesh without vertices or indices".into());
        }
        let arena = self.arena_of(mesh, format)?;
        let (index_list, new_indices) = self.allocate_indices(memory, mesh, shared)?;
        let white = match format == VertexFormat::Full || self.white.is_some() {
            true => Ok(()),
            false => memory
                .make_filled("white vertex", wgpu::BufferUsages::VERTEX, &WHITE)
                .map(|white| self.white = Some(white)),
        };
        let vertices = white.and_then(|()| self.vertices.allocate(arena, memory, mesh.vertices.len()));
        let vertices = match vertices {
            Ok(range) => range,
            Err(e) => {
                self.release_indices(index_list);
                return Err(e);
            }
        };
        let record = MeshRecord { source: Arc::downgrade(mesh), identity, vertices, indices: index_list, users: 1 };
        let id = self.meshes.insert(record);
        self.mesh_by_identity.insert(identity, id);
        let place_bytes = [self.vertices.bytes_of(vertices), self.index_bytes(index_list)];
        let place = self.place(id, vertices, index_list, mesh)?;
        Ok(MeshUploads { place, vertices: Some(vertices), indices: new_indices, place_bytes })
    }

    /// Where the vertices of a mesh lie.
    fn arena_of(&mut self, mesh: &Mesh, format: VertexFormat) -> Result<u32, String> {
        if mesh.attributes.is_empty() {
            return Ok(format as u32);
        }
        mesh.attributes.check(mesh.vertices.len()).map_err(|error| error.to_string())?;
        let place = self.layout_place(mesh.attributes.layout()).ok_or_else(|| {
            let names: Vec<&str> = mesh.attributes.iter().map(|(name, ..)| name).collect();
            format!("a mesh with the attributes {names:?}: there are {MOST_LAYOUTS} other lists of attributes in use")
        })?;
        Ok(FORMATS.len() as u32 - 1 + place)
    }

    /// The place, from 1 on, of a layout of further attributes: its own while vertices lie in it, of others until it is
    /// needed for another. `None` where all are in use.
    pub(crate) fn layout_place(&mut self, layout: &Arc<AttributeLayout>) -> Option<u32> {
        if let Some(known) = self.layouts.iter().position(|known| known == layout) {
            return Some(known as u32 + 1);
        }
        let arena = Arena::of_vertices(VertexFormat::Full.stride() + added_stride(layout));
        if self.layouts.len() < MOST_LAYOUTS {
            self.layouts.push(layout.clone());
            self.vertices.0.push(arena);
            return Some(self.layouts.len() as u32);
        }
        let arenas = self.vertices.0.iter_mut().skip(FORMATS.len());
        let (unused, place) = arenas.zip(0..).find(|(arena, _)| arena.bytes_in_use == 0)?;
        *unused = arena;
        self.layouts[place] = layout.clone();
        Some(place as u32 + 1)
    }

    fn place(&self, mesh_id: u32, vertices: Range, index_list: u32, mesh: &Mesh) -> Result<MeshPlace, String> {
        let record = self.index_lists.get(index_list);
        let range = record.map(|r| r.range).ok_or("an index list that is gone")?;
        Ok(MeshPlace {
            mesh: mesh_id,
            vertex_chunk: vertices.chunk,
            index_chunk: range.chunk,
            base_vertex: vertices.first as i32,
            first_index: range.first,
            index_count: mesh.indices.len() as u32,
        })
    }

    fn allocate_indices(
        &mut self,
        memory: &mut Memory,
        mesh: &Mesh,
        shared: &SharedParts,
    ) -> Result<(u32, Option<Range>), String> {
        let content = shared.indices.as_ref().map(|s| &s.key);
        let identity = Identity::new(content, Arc::as_ptr(&mesh.indices));
        let address = Arc::as_ptr(&mesh.indices);
        let is_same = |r: &IndexRecord| {
            content.is_some() || r.source.as_ref().is_some_and(|s| std::ptr::addr_eq(s.as_ptr(), address))
        };
        if let Some(&id) = self.index_list_by_identity.get(&identity)
            && let Some(record) = self.index_lists.get_mut(id)
            && is_same(record)
        {
            check_indices(record.largest, mesh)?;
            record.users += 1;
            return Ok((id, None));
        }
        let largest = mesh.indices.iter().copied().max().unwrap_or(0);
        check_indices(largest, mesh)?;
        let arena = if is_short(largest, mesh.indices.len()) { SHORT } else { 0 };
        let range = self.indices.allocate(arena, memory, mesh.indices.len())?;
        // A weak pointer keeps the list's memory, so it is kept for lists that others hold as well.
        let by_address = content.is_none() && Arc::strong_count(&mesh.indices) > 1;
        let source = by_address.then(|| Arc::downgrade(&mesh.indices));
        let id = self.index_lists.insert(IndexRecord { source, identity, range, largest, users: 1 });
        if by_address || content.is_some() {
            self.index_list_by_identity.insert(identity, id);
        }
        Ok((id, Some(range)))
    }

    fn index_bytes(&self, id: u32) -> u64 {
        let record = self.index_lists.get(id);
        record.map_or(0, |r| self.indices.bytes_of(r.range))
    }

    pub(super) fn vertex_destination(&self, range: Range) -> Option<Destination> {
        self.vertices.destination(range)
    }

    pub(super) fn index_destination(&self, range: Range) -> Option<Destination> {
        self.indices.destination(range)
    }

    /// One drawable fewer uses the mesh.
    pub(super) fn release(&mut self, place: &MeshPlace) {
        let Some(record) = self.meshes.get_mut(place.mesh) else { return };
        record.users = record.users.saturating_sub(1);
        if record.users > 0 {
            return;
        }
        let Some(record) = self.meshes.remove(place.mesh) else { return };
        if self.mesh_by_identity.get(&record.identity) == Some(&place.mesh) {
            self.mesh_by_identity.remove(&record.identity);
        }
        self.vertices.release(record.vertices);
        self.release_indices(record.indices);
    }

    fn release_indices(&mut self, id: u32) {
        let Some(record) = self.index_lists.get_mut(id) else { return };
        record.users = record.users.saturating_sub(1);
        if record.users > 0 {
            return;
        }
        let Some(record) = self.index_lists.remove(id) else { return };
        if self.index_list_by_identity.get(&record.identity) == Some(&id) {
            self.index_list_by_identity.remove(&record.identity);
        }
        self.indices.release(record.range);
    }

    pub(crate) fn vertex_buffer(&self, chunk: u32) -> Option<&wgpu::Buffer> {
        self.vertices.buffer(chunk)
    }

    pub(crate) fn index_buffer(&self, chunk: u32) -> Option<(&wgpu::Buffer, wgpu::IndexFormat)> {
        let format = if parts(chunk).0 == SHORT { wgpu::IndexFormat::Uint16 } else { wgpu::IndexFormat::Uint32 };
        self.indices.buffer(chunk).map(|buffer| (buffer, format))
    }

    /// How vertices lie in a chunk.
    pub(crate) fn format_of(&self, vertex_chunk: u32) -> VertexFormat {
        FORMATS.get(parts(vertex_chunk).0 as usize).copied().unwrap_or_default()
    }

    /// The further attributes of what lies in a chunk, with the place of their layout.
    pub(crate) fn layout_of(&self, vertex_chunk: u32) -> Option<(u32, &Arc<AttributeLayout>)> {
        let place = (parts(vertex_chunk).0 as usize + 1).checked_sub(FORMATS.len())?;
        Some((place as u32, self.layouts.get(place.checked_sub(1)?)?))
    }

    /// One white vertex.
    pub(crate) fn white(&self) -> Option<&wgpu::Buffer> {
        self.white.as_ref()
    }

    pub(super) fn bytes_in_use(&self) -> u64 {
        self.vertices.bytes_in_use() + self.indices.bytes_in_use()
    }

    pub(super) fn bytes_allocated(&self) -> u64 {
        self.vertices.bytes_allocated() + self.indices.bytes_allocated()
    }
}
