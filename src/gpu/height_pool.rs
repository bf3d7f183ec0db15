//! Height tiles: blocks of places, each a layer of heights, a layer of colour and a row of a table buffer.
//!
//! Draw thread only. One block is one bind group, so that every tile of a block that is drawn in a row is one
//! instanced draw of the shared grid.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use super::layouts::Layouts;
use super::memory::Memory;
use super::slots::{SlotAllocator, block_capacity};
use super::table::Table;
use super::texture_pool::{ImageSize, array_view};
use super::uploads::Destination;
use crate::scene::{ContentKey, HeightTile};
use crate::state::CLAMPED;

/// Bytes a block aims at.
const BLOCK_BYTES: u64 = 24 << 20;
/// Most tiles in a block; 256 is WebGPU's guaranteed limit of layers.
const BLOCK_TILES: u32 = 128;
/// Vectors of four floats in front of a tile's rows in the tables.
pub(crate) const HEADER_VECTORS: u32 = 3;
/// Levels a tile can morph through.
pub(crate) const MORPH_LEVELS: usize = 6;

/// The place of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TilePlace {
    pub(crate) block: u32,
    pub(crate) layer: u32,
    pub(crate) side: u32,
}

struct Block {
    side: u32,
    color_size: ImageSize,
    heights: wgpu::Texture,
    tables: wgpu::Buffer,
    color: wgpu::Texture,
    bind_group: wgpu::BindGroup,
    slots: SlotAllocator,
    capacity: u32,
    /// Per layer: number of drawables that use it, and what it is shared as.
    users: Vec<(u32, Option<ContentKey>)>,
}

/// Indices of the shared grid of one side length.
pub(crate) struct Grid {
    pub(crate) indices: wgpu::Buffer,
    pub(crate) index_count: u32,
}

/// All height tiles of a context.
#[derive(Default)]
pub(crate) struct HeightPool {
    blocks: Table<Block>,
    /// By side. Only looked up, never walked.
    grids: HashMap<u32, Grid>,
    /// Only looked up, never walked.
    shared: HashMap<ContentKey, TilePlace>,
    bytes_in_use: u64,
    bytes_allocated: u64,
}

/// Vectors of four floats a tile takes in the tables: header, rows, columns two a vector.
pub(crate) fn table_vectors(side: u32) -> u32 {
    HEADER_VECTORS + side + side.div_ceil(2)
}

/// A tile's parameters, rows and columns, as the tables have them.
pub(super) fn table_words(tile: &HeightTile) -> Vec<f32> {
    let mut errors = [0.0f32; MORPH_LEVELS];
    let count = tile.coarser_errors_m.len().min(MORPH_LEVELS);
    errors[..count].copy_from_slice(&tile.coarser_errors_m[..count]);
    let length = table_vectors(tile.side) as usize * 4;
    let mut words = Vec::with_capacity(length);
    words.extend([tile.p0_m, tile.skirt_m, tile.cell_m[0], tile.cell_m[1]]);
    words.extend(errors);
    words.extend([count as f32, 0.0]);
    words.extend(tile.rows.iter().flatten());
    words.extend(tile.columns.iter().flatten());
    words.resize(length, 0.0);
    words
}

fn tile_bytes(side: u32, color_size: &ImageSize) -> u64 {
    let padded = u64::from(side + 2);
    padded * padded * 4 + u64::from(table_vectors(side)) * 16 + color_size.bytes()
}

fn check(tile: &HeightTile) -> Result<(), String> {
    let side = tile.side;
    if !(3..=257).contains(&side) || !(side - 1).is_power_of_two() {
        return Err(format!("a height tile of {side} vertices a side; 2^k + 1 up to 257 is possible"));
    }
    let padded = (side + 2) as usize;
    for (name, got, expected) in [
        ("heights", tile.heights.len(), padded * padded),
        ("rows", tile.rows.len(), side as usize),
        ("columns", tile.columns.len(), side as usize),
    ] {
        if got != expected {
            return Err(format!("a height tile of side {side} has {got} {name} instead of {expected}"));
        }
    }
    Ok(())
}

impl HeightPool {
    /// A place for a tile; true when it must be uploaded, false when it is there already.
    pub(super) fn allocate(
        &mut self,
        memory: &mut Memory,
        layouts: &Layouts,
        tile: &HeightTile,
        content: Option<&ContentKey>,
    ) -> Result<(TilePlace, bool), String> {
        if let Some(place) = content.and_then(|key| self.shared.get(key)).copied()
            && let Some(user) = self.user_mut(place)
        {
            user.0 += 1;
            return Ok((place, false));
        }
        let place = self.take_place(memory, layouts, tile)?;
        if let Some(user) = self.user_mut(place) {
            *user = (1, content.copied());
        }
        if let Some(key) = content {
            self.shared.insert(*key, place);
        }
        Ok((place, true))
    }

    fn user_mut(&mut self, place: TilePlace) -> Option<&mut (u32, Option<ContentKey>)> {
        self.blocks.get_mut(place.block)?.users.get_mut(place.layer as usize)
    }

    /// A place with the size of the tile's colour image.
    fn take_place(&mut self, memory: &mut Memory, layouts: &Layouts, tile: &HeightTile) -> Result<TilePlace, String> {
        check(tile)?;
        let color_size = match &tile.texture {
            Some(texture) => ImageSize::of(texture, &memory.limits)?,
            None => ImageSize { width: 1, height: 1, mips: 1 },
        };
        let side = tile.side;
        if let Entry::Vacant(grid) = self.grids.entry(side) {
            let indices = grid_indices(side);
            let index_count = indices.len() as u32;
            let contents = bytemuck::cast_slice(&indices);
            let indices = memory.make_filled("grid", wgpu::BufferUsages::INDEX, contents)?;
            grid.insert(Grid { indices, index_count });
        }
        let mut like = 0;
        for (index, block) in self.blocks.iter_mut() {
            if block.side == side && block.color_size == color_size {
                like += 1;
                if let Some(layer) = block.slots.allocate() {
                    self.bytes_in_use += tile_bytes(side, &color_size);
                    return Ok(TilePlace { block: index, layer, side });
                }
            }
        }
        let most = BLOCK_TILES.min(memory.limits.max_texture_array_layers);
        let capacity = block_capacity(like, tile_bytes(side, &color_size), BLOCK_BYTES, most);
        let mut block = Block::new(memory, layouts, side, color_size, capacity)?;
        let layer = block.slots.allocate().ok_or("a height block without layers")?;
        self.bytes_allocated += tile_bytes(side, &color_size) * u64::from(capacity);
        self.bytes_in_use += tile_bytes(side, &color_size);
        Ok(TilePlace { block: self.blocks.insert(block), layer, side })
    }

    fn block(&self, place: TilePlace) -> Option<&Block> {
        self.blocks.get(place.block)
    }

    /// Where a place's heights, tables and colour lie.
    pub(super) fn destinations(&self, place: TilePlace) -> Option<[Destination; 3]> {
        let block = self.block(place)?;
        let offset = u64::from(place.layer) * u64::from(table_vectors(place.side)) * 16;
        Some([
            Destination::Layer(block.heights.clone(), place.layer),
            Destination::Buffer(block.tables.clone(), offset),
            Destination::Layer(block.color.clone(), place.layer),
        ])
    }

    /// One drawable fewer uses the tile's place; it is free when none does, and the block when it was the last.
    pub(super) fn release(&mut self, place: TilePlace) {
        let Some(user) = self.user_mut(place) else { return };
        user.0 = user.0.saturating_sub(1);
        let (count, content) = *user;
        if count > 0 {
            return;
        }
        if let Some(key) = content.filter(|key| self.shared.get(key) == Some(&place)) {
            self.shared.remove(&key);
        }
        if let Some(block) = self.blocks.get_mut(place.block) {
            block.slots.release(place.layer);
            let bytes = tile_bytes(block.side, &block.color_size);
            self.bytes_in_use -= bytes;
            if block.slots.is_empty() {
                self.bytes_allocated -= bytes * u64::from(block.capacity);
                self.blocks.remove(place.block);
            }
        }
    }

    pub(super) fn bytes_of(&self, place: TilePlace) -> u64 {
        self.block(place).map_or(0, |b| tile_bytes(b.side, &b.color_size))
    }

    pub(crate) fn bind_group(&self, block: u32) -> Option<&wgpu::BindGroup> {
        self.blocks.get(block).map(|b| &b.bind_group)
    }

    pub(crate) fn grid(&self, side: u32) -> Option<&Grid> {
        self.grids.get(&side)
    }

    pub(super) fn bytes_in_use(&self) -> u64 {
        self.bytes_in_use
    }

    pub(super) fn bytes_allocated(&self) -> u64 {
        self.bytes_allocated
    }
}

impl Block {
    fn new(
        memory: &mut Memory,
        layouts: &Layouts,
        side: u32,
        color_size: ImageSize,
        capacity: u32,
    ) -> Result<Self, String> {
        let padded = u64::from(side + 2);
        let heights = wgpu::TextureDescriptor {
            label: Some("height block"),
            size: wgpu::Extent3d { width: side + 2, height: side + 2, depth_or_array_layers: capacity },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::R32Float,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        };
        let bytes = padded * padded * 4 * u64::from(capacity);
        let heights = memory.make("height block", bytes, |device| device.create_texture(&heights))?;
        let size = u64::from(table_vectors(side)) * 16 * u64::from(capacity);
        let tables = wgpu::BufferDescriptor {
            label: Some("height block tables"),
            size,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        };
        let tables = memory.make("height block tables", size, |device| device.create_buffer(&tables))?;
        let color = color_size.make(memory, "height block colour", capacity)?;
        let bind_group = memory.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("height block"),
            layout: &layouts.height_block,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&array_view(&heights)),
                },
                wgpu::BindGroupEntry { binding: 1, resource: tables.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: wgpu::BindingResource::TextureView(&array_view(&color)) },
                wgpu::BindGroupEntry {
                    binding: 3,
                    resource: wgpu::BindingResource::Sampler(layouts.wrapping(CLAMPED)),
                },
            ],
        });
        let slots = SlotAllocator::new(capacity);
        let users = vec![(0, None); capacity as usize];
        Ok(Self { side, color_size, heights, tables, color, bind_group, slots, capacity, users })
    }
}

/// Cells are drawn in strips as wide as this, south to north, so that a row's vertices are still in the adapter's
/// vertex cache when the next row needs them.
const STRIP_CELLS: usize = 16;

/// Indices of the grid and its skirt. Vertices `0..side^2` are the grid, row-major from the south-west; then a
/// ring of `4 (side - 1)` skirt vertices, counter-clockwise from the south-west corner, each below its edge
/// vertex (the shader knows the order). Cells are cut from south-west to north-east, so that a cell whose
/// vertices have all morphed collapses into its parent's two triangles.
fn grid_indices(side: u32) -> Vec<u32> {
    let cells = side - 1;
    let mut indices = Vec::with_capacity((cells * cells * 6 + 4 * cells * 6) as usize);
    for west in (0..cells).step_by(STRIP_CELLS) {
        let east = cells.min(west + STRIP_CELLS as u32);
        for j in 0..cells {
            for i in west..east {
                let sw = j * side + i;
                let (se, nw, ne) = (sw + 1, sw + side, sw + side + 1);
                indices.extend([sw, se, ne, sw, ne, nw]);
            }
        }
    }
    let ring = 4 * cells;
    let edge = |k: u32| {
        let k = k % ring;
        let (along, leg) = (k % cells, k / cells);
        match leg {
            0 => along,
            1 => along * side + cells,
            2 => cells * side + cells - along,
            _ => (cells - along) * side,
        }
    };
    for k in 0..ring {
        let (a, b) = (edge(k), edge(k + 1));
        let (a_low, b_low) = (side * side + k, side * side + (k + 1) % ring);
        indices.extend([a, a_low, b_low, a, b_low, b]);
    }
    indices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_covers_every_cell_and_has_a_closed_skirt() {
        let side = 5;
        let indices = grid_indices(side);
        assert_eq!(indices.len(), 4 * 4 * 6 + 16 * 6);
        let mut used: Vec<_> = indices.clone();
        used.sort_unstable();
        used.dedup();
        assert_eq!(used, (0..25 + 16).collect::<Vec<_>>());
        // The ring starts at the south-west corner and walks the border once.
        let first_of = |k: usize| indices[96 + 6 * k];
        assert_eq!([first_of(0), first_of(4), first_of(8), first_of(12)], [0, 4, 24, 20]);
    }
}
