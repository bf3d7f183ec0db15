//! Uploads in small steps: what the pager loaded becomes drawable without a frame taking longer for it.
//!
//! Runs on the draw thread, between draws. An operation's drawables get their places one after the other, and
//! each place is filled slice by slice; the queue stops when the frame's budget is spent and goes on from there
//! in the next frame.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::DrawableEntry;
use super::custom::{CompileInfo, CustomCompile};
use super::drawable::{DrawableTable, Pools, Shape};
use super::height_pool::{TilePlace, table_vectors};
use super::mesh_pool::Range;
use super::texture_pool::{Rows, TextureLayer};
use crate::scene::{
    ContentKey, CustomGeometry, DrawSlot, Drawable, Geometry, HeightTile, Mesh, MeshVertex, SharedParts, Texture,
};

/// Most bytes of one slice: about 100 us of copying, so that the time budget is met closely.
const SLICE_BYTES: u64 = 256 << 10;
/// What the first slice of a call may have however small the budget, so that every upload ends.
const LEAST_SLICE_BYTES: u64 = 16 << 10;
/// Uploads are handed to the driver at the latest when so many bytes wait: while frames are drawn, whose submissions
/// take them along and which a submission in between may wait for; and while none are.
const FLUSH_BYTES_DRAWING: u64 = 4 << 20;
const FLUSH_BYTES: u64 = 256 << 10;

/// Drawables to upload together, usually one page's.
#[derive(Debug)]
pub struct CompileOperation {
    /// Chosen by the caller; comes back in [`Compiled`].
    pub ticket: u64,
    /// What to upload; dropped when done.
    pub drawables: Vec<Drawable>,
}

/// What a finished [`CompileOperation`] gave.
#[derive(Debug)]
pub struct Compiled {
    /// The operation's ticket.
    pub ticket: u64,
    /// One slot a drawable, in order; [`DrawSlot::NONE`] for those that could not be made.
    pub slots: Vec<DrawSlot>,
    /// Bytes of GPU memory that were newly taken by what is not shared by content.
    pub bytes: u64,
    /// What is shared by content, with the bytes of its place, whoever took it first.
    pub shared: Vec<(ContentKey, u64)>,
    /// What was wrong with those that could not be made.
    pub errors: Vec<String>,
}

impl Compiled {
    fn count(&mut self, content: Option<&ContentKey>, bytes: u64, is_new: bool) {
        match content {
            Some(key) => self.shared.push((*key, bytes)),
            None => self.bytes += if is_new { bytes } else { 0 },
        }
    }
}

/// How much of a frame uploads may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CompileBudget {
    /// Time.
    pub time: Duration,
    /// Bytes; a call may always upload 16 KiB, or one row of an image.
    pub bytes: u64,
}

impl Default for CompileBudget {
    /// 2 ms and 4 MiB: some ten height tiles with colour a frame.
    fn default() -> Self {
        Self { time: Duration::from_millis(2), bytes: 4 << 20 }
    }
}

impl CompileBudget {
    /// No limit: everything that waits, at once.
    pub const UNLIMITED: Self = Self { time: Duration::MAX, bytes: u64::MAX };
}

/// What one call of `run_compiles` did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CompileStats {
    /// Bytes uploaded.
    pub bytes: u64,
    /// Slices uploaded.
    pub slices: u32,
    /// Operations finished.
    pub finished: u32,
    /// Operations still waiting or under way.
    pub pending: usize,
    /// Time taken.
    pub time: Duration,
}

/// What is uploaded to where.
enum Source {
    Heights {
        place: TilePlace,
        tile: Arc<HeightTile>,
    },
    Tables {
        place: TilePlace,
        tile: Arc<HeightTile>,
    },
    /// A tile's image, or a white texel.
    TileColor {
        place: TilePlace,
        image: Option<Arc<Texture>>,
    },
    Texture {
        place: TextureLayer,
        image: Arc<Texture>,
    },
    Vertices {
        range: Range,
        mesh: Arc<Mesh>,
    },
    Indices {
        range: Range,
        mesh: Arc<Mesh>,
    },
}

/// One thing left to upload, and how far it is: level, and row, vertex or index in it.
struct Upload {
    source: Source,
    level: u32,
    cursor: usize,
}

struct Job {
    drawables: std::vec::IntoIter<Drawable>,
    compiled: Compiled,
}

/// Operations in the order they came, the first of them under way.
#[derive(Default)]
pub(super) struct CompileQueue {
    waiting: VecDeque<CompileOperation>,
    job: Option<Job>,
    uploads: VecDeque<Upload>,
    finished: Vec<Compiled>,
    table_scratch: Vec<f32>,
    unflushed_bytes: u64,
    /// A frame was drawn since uploads were last flushed on their own.
    drawing: bool,
}

/// How many units of a slice fit; the first slice of a call has at least one.
fn fitting(left: usize, unit_bytes: usize, most_bytes: u64, is_first: bool) -> usize {
    let most_bytes = if is_first { most_bytes.max(LEAST_SLICE_BYTES) } else { most_bytes };
    let fit = (most_bytes.min(SLICE_BYTES) / unit_bytes.max(1) as u64) as usize;
    // A unit larger than a slice (a row of a huge image) goes alone.
    let fit = if fit == 0 && (is_first || unit_bytes as u64 <= most_bytes) { 1 } else { fit };
    fit.min(left)
}

impl CompileQueue {
    pub(super) fn push(&mut self, operation: CompileOperation) {
        self.waiting.push_back(operation);
    }

    /// Everything written so far went to the driver with a draw.
    pub(super) fn flushed(&mut self) {
        self.unflushed_bytes = 0;
        self.drawing = true;
    }

    pub(super) fn pending(&self) -> usize {
        self.waiting.len() + usize::from(self.job.is_some())
    }

    pub(super) fn take_finished(&mut self) -> Vec<Compiled> {
        std::mem::take(&mut self.finished)
    }

    pub(super) fn run(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        pools: &mut Pools,
        drawables: &mut DrawableTable,
        pipeline_cache: Option<&wgpu::PipelineCache>,
        budget: &CompileBudget,
    ) -> CompileStats {
        let start = Instant::now();
        let mut stats = CompileStats::default();
        // As it was made: another borrow than that of the pools.
        let frame_layout = pools.layouts.frame.clone();
        let info = CompileInfo { device, queue, frame_layout: &frame_layout, pipeline_cache };
        loop {
            let left_bytes = budget.bytes.saturating_sub(stats.bytes);
            if stats.slices > 0 && (left_bytes == 0 || start.elapsed() >= budget.time) {
                break;
            }
            if let Some(upload) = self.uploads.front_mut() {
                let bytes = upload.step(queue, pools, &mut self.table_scratch, left_bytes, stats.slices == 0);
                if bytes == 0 {
                    break;
                }
                stats.bytes += bytes;
                stats.slices += 1;
                if upload.is_done() {
                    self.uploads.pop_front();
                }
            } else if let Some(job) = &mut self.job {
                match job.drawables.next() {
                    Some(drawable) => {
                        let made = prepare(&info, pools, drawables, drawable, job, &mut self.uploads);
                        stats.bytes += made.unwrap_or(0);
                        stats.slices += u32::from(made.is_some());
                    }
                    None => {
                        self.finished.extend(self.job.take().map(|j| j.compiled));
                        stats.finished += 1;
                    }
                }
            } else if let Some(operation) = self.waiting.pop_front() {
                let count = operation.drawables.len();
                self.job = Some(Job {
                    drawables: operation.drawables.into_iter(),
                    compiled: Compiled {
                        ticket: operation.ticket,
                        slots: Vec::with_capacity(count),
                        bytes: 0,
                        shared: Vec::new(),
                        errors: Vec::new(),
                    },
                });
            } else {
                break;
            }
        }
        // A finished upload whose operation has nothing left is reported now, not a frame later.
        if self.uploads.is_empty() && self.job.as_ref().is_some_and(|j| j.drawables.len() == 0) {
            self.finished.extend(self.job.take().map(|j| j.compiled));
            stats.finished += 1;
        }
        self.unflushed_bytes += stats.bytes;
        let most = if self.drawing { FLUSH_BYTES_DRAWING } else { FLUSH_BYTES };
        if self.unflushed_bytes >= most {
            // Staging memory (several times the bytes for small images) is only given back once it was submitted and
            // the device was polled.
            queue.submit([]);
            if let Err(error) = device.poll(wgpu::PollType::Poll) {
                log::error!("uploads: {error}");
            }
            self.unflushed_bytes = 0;
            self.drawing = false;
        }
        stats.pending = self.pending();
        stats.time = start.elapsed();
        stats
    }
}

/// Puts another mesh in the place of a drawable's, with all of its data at once; the bytes that were written.
pub(super) fn rewrite(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    pools: &mut Pools,
    table: &mut DrawableTable,
    slot: DrawSlot,
    mesh: &Arc<Mesh>,
) -> Result<u64, String> {
    let entry = *table.entry(slot).ok_or("a mesh is to be rewritten that is not there")?;
    let Shape::Mesh { place: old, texture, .. } = entry.shape else {
        return Err("what is no mesh is not to be rewritten as one".into());
    };
    let placed = pools.meshes.allocate(device, &pools.limits, mesh, &SharedParts::default())?;
    let vertices = placed.vertices.map(|range| Source::Vertices { range, mesh: mesh.clone() });
    let indices = placed.indices.map(|range| Source::Indices { range, mesh: mesh.clone() });
    let mut bytes = 0;
    for source in [vertices, indices].into_iter().flatten() {
        if let Some((units, unit_bytes)) = source.extent(0) {
            source.write(queue, pools, &mut Vec::new(), 0, 0..units);
            bytes += (units * unit_bytes) as u64;
        }
    }
    let shape = Shape::Mesh { place: placed.place, topology: mesh.topology, texture };
    table.replace(slot, DrawableEntry { shape, ..entry });
    // Free at once: later uploads run after the draws already submitted.
    pools.meshes.release(&old);
    Ok(bytes)
}

/// Gives a drawable its places and queues what has to be uploaded to them. What the application makes is made at once:
/// its bytes.
fn prepare(
    info: &CompileInfo<'_>,
    pools: &mut Pools,
    table: &mut DrawableTable,
    drawable: Drawable,
    job: &mut Job,
    uploads: &mut VecDeque<Upload>,
) -> Option<u64> {
    let CompileInfo { device, queue, .. } = *info;
    let material = &drawable.material;
    let bytes_before = job.compiled.bytes;
    let placed = match &drawable.geometry {
        Geometry::Height(tile) => place_tile(device, pools, tile, &drawable, &mut job.compiled, uploads),
        Geometry::Mesh(mesh) => place_mesh(device, queue, pools, mesh, &drawable, &mut job.compiled, uploads),
        Geometry::Custom(custom) => place_custom(info, pools, custom, &mut job.compiled),
    };
    let is_custom = matches!(drawable.geometry, Geometry::Custom(_));
    let slot = match placed {
        Ok(shape) => table.insert(DrawableEntry::new(shape, material)),
        Err(error) => {
            job.compiled.errors.push(error);
            DrawSlot::NONE
        }
    };
    job.compiled.slots.push(slot);
    is_custom.then(|| job.compiled.bytes - bytes_before)
}

fn place_custom(
    info: &CompileInfo<'_>,
    pools: &mut Pools,
    custom: &CustomGeometry,
    compiled: &mut Compiled,
) -> Result<Shape, String> {
    let hook = custom.hook.0.downcast_ref::<CustomCompile>();
    let compile = hook.ok_or("a custom geometry that was not made by `draw::custom_geometry`")?;
    let shape = (compile.0)(info, &pools.customs.targets)?;
    compiled.bytes += shape.bytes;
    Ok(Shape::Custom(pools.customs.insert(shape)))
}

fn place_tile(
    device: &wgpu::Device,
    pools: &mut Pools,
    tile: &Arc<HeightTile>,
    drawable: &Drawable,
    compiled: &mut Compiled,
    uploads: &mut VecDeque<Upload>,
) -> Result<Shape, String> {
    let content = drawable.shared.geometry.as_ref().map(|s| &s.key);
    let (place, is_new) = pools.heights.allocate(device, &pools.layouts, &pools.limits, tile, content)?;
    compiled.count(content, pools.heights.bytes_of(place), is_new);
    if !is_new {
        return Ok(Shape::Height(place));
    }
    uploads.push_back(Upload::new(Source::Tables { place, tile: tile.clone() }));
    uploads.push_back(Upload::new(Source::Heights { place, tile: tile.clone() }));
    uploads.push_back(Upload::new(Source::TileColor { place, image: tile.texture.clone() }));
    Ok(Shape::Height(place))
}

fn place_mesh(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    pools: &mut Pools,
    mesh: &Arc<Mesh>,
    drawable: &Drawable,
    compiled: &mut Compiled,
    uploads: &mut VecDeque<Upload>,
) -> Result<Shape, String> {
    let image = drawable.material.texture.as_ref();
    let [geometry, indices, texture_content] =
        [&drawable.shared.geometry, &drawable.shared.indices, &drawable.shared.texture]
            .map(|s| s.as_ref().map(|s| &s.key));
    let placed = pools.meshes.allocate(device, &pools.limits, mesh, &drawable.shared)?;
    let texture = match image {
        Some(image) => pools.textures.allocate(device, &pools.layouts, &pools.limits, image, texture_content),
        None => pools.textures.white(device, queue, &pools.layouts, &pools.limits).map(|place| (place, false)),
    };
    let (texture, is_new_texture) = match texture {
        Ok(texture) => texture,
        Err(error) => {
            pools.meshes.release(&placed.place);
            return Err(error);
        }
    };
    let [vertex_bytes, index_bytes] = placed.place_bytes;
    compiled.count(geometry, vertex_bytes, placed.vertices.is_some());
    compiled.count(indices, index_bytes, placed.indices.is_some());
    if image.is_some() {
        compiled.count(texture_content, pools.textures.bytes_of(texture), is_new_texture);
    }
    if let Some(range) = placed.vertices {
        uploads.push_back(Upload::new(Source::Vertices { range, mesh: mesh.clone() }));
    }
    if let Some(range) = placed.indices {
        uploads.push_back(Upload::new(Source::Indices { range, mesh: mesh.clone() }));
    }
    if let Some(image) = image.filter(|_| is_new_texture) {
        uploads.push_back(Upload::new(Source::Texture { place: texture, image: image.clone() }));
    }
    Ok(Shape::Mesh { place: placed.place, topology: mesh.topology, texture })
}

impl Upload {
    fn new(source: Source) -> Self {
        Self { source, level: 0, cursor: 0 }
    }

    fn is_done(&self) -> bool {
        self.source.extent(self.level).is_none()
    }

    /// Uploads the next slice and returns its bytes; 0 when the budget has no room for it.
    fn step(
        &mut self,
        queue: &wgpu::Queue,
        pools: &Pools,
        scratch: &mut Vec<f32>,
        most_bytes: u64,
        is_first: bool,
    ) -> u64 {
        let Some((units, unit_bytes)) = self.source.extent(self.level) else { return 0 };
        let count = fitting(units - self.cursor, unit_bytes, most_bytes, is_first);
        if count == 0 {
            return 0;
        }
        let end = self.cursor + count;
        self.source.write(queue, pools, scratch, self.level, self.cursor..end);
        self.cursor = end;
        if end >= units {
            self.level += 1;
            self.cursor = 0;
        }
        (count * unit_bytes) as u64
    }
}

impl Source {
    /// Units (rows, vertices, indices) of a level and the bytes of one; `None` beyond the last level. Never
    /// without units: the pools refuse empty meshes and images.
    fn extent(&self, level: u32) -> Option<(usize, usize)> {
        let image_extent = |image: &Texture| {
            image.mips.get(level as usize)?;
            let [width, height] = level_size(image, level);
            Some((height, width * 4))
        };
        match self {
            Self::TileColor { image: Some(image), .. } | Self::Texture { image, .. } => image_extent(image),
            _ if level > 0 => None,
            Self::Heights { tile, .. } => Some((tile.side as usize + 2, (tile.side as usize + 2) * 4)),
            Self::Tables { tile, .. } => Some((1, table_vectors(tile.side) as usize * 16)),
            Self::TileColor { image: None, .. } => Some((1, 4)),
            Self::Vertices { mesh, .. } => Some((mesh.vertices.len(), size_of::<MeshVertex>())),
            Self::Indices { mesh, .. } => Some((mesh.indices.len(), 4)),
        }
    }

    /// Writes some units. The ranges lie inside the data: the pools have checked its lengths.
    fn write(
        &self,
        queue: &wgpu::Queue,
        pools: &Pools,
        scratch: &mut Vec<f32>,
        level: u32,
        units: std::ops::Range<usize>,
    ) {
        let image_rows = |image: &'_ Texture, layer: u32| {
            let [width, _] = level_size(image, level);
            let rows = Rows { layer, level, first: units.start as u32, count: units.len() as u32, width: width as u32 };
            (rows, units.start * width * 4..units.end * width * 4)
        };
        match self {
            Self::Heights { place, tile } => {
                let width = place.side as usize + 2;
                let data = &tile.heights[units.start * width..units.end * width];
                pools.heights.write_heights(queue, *place, units.start as u32, units.len() as u32, data);
            }
            Self::Tables { place, tile } => pools.heights.write_tables(queue, *place, tile, scratch),
            Self::TileColor { place, image: Some(image) } => {
                let (rows, bytes) = image_rows(image, place.layer);
                pools.heights.write_color(queue, *place, &rows, &image.mips[level as usize][bytes]);
            }
            Self::TileColor { place, image: None } => {
                let rows = Rows { layer: place.layer, level: 0, first: 0, count: 1, width: 1 };
                pools.heights.write_color(queue, *place, &rows, &[255; 4]);
            }
            Self::Texture { place, image } => {
                let (rows, bytes) = image_rows(image, place.layer);
                pools.textures.write(queue, *place, &rows, &image.mips[level as usize][bytes]);
            }
            Self::Vertices { range, mesh } => {
                pools.meshes.write_vertices(queue, *range, units.start, &mesh.vertices[units]);
            }
            Self::Indices { range, mesh } => {
                pools.meshes.write_indices(queue, *range, units.start, &mesh.indices[units]);
            }
        }
    }
}

fn level_size(image: &Texture, level: u32) -> [usize; 2] {
    [(image.width >> level).max(1) as usize, (image.height >> level).max(1) as usize]
}
