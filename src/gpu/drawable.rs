//! The table from [`DrawSlot`] to what a draw needs. Draw thread only.

use std::collections::HashMap;

use super::custom::CustomShapes;
use super::height_pool::{HeightPool, TilePlace};
use super::layouts::Layouts;
use super::memory::Memory;
use super::mesh_pool::{MeshPlace, MeshPool};
use super::table::Table;
use super::texture_pool::{TextureLayer, TexturePool};
use crate::scene::{AlphaMode, DrawSlot, Material, Mesh, SMALL_MESH_INDICES, Topology};

/// Where a drawable's data lies.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    Height(TilePlace),
    Mesh {
        place: MeshPlace,
        topology: Topology,
        texture: TextureLayer,
        /// Shaders fetch the vertices of several such meshes in one call.
        is_small: bool,
        /// Where its triangles are, where they are few.
        extent: Option<Extent>,
    },
    /// By its place among the custom shapes.
    Custom(u32),
}

impl Shape {
    pub(super) fn of_mesh(mesh: &Mesh, place: MeshPlace, texture: TextureLayer) -> Self {
        let (topology, is_small, extent) = (mesh.topology, mesh.is_small(), Extent::of_few(mesh));
        Self::Mesh { place, topology, texture, is_small, extent }
    }
}

/// A box in a drawable's frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Extent {
    pub(crate) center: [f32; 3],
    /// Half of its size along each axis, with room for what f32 loses where the matrix is applied.
    pub(crate) half: [f32; 3],
}

impl Extent {
    /// Around the triangles of a mesh that has few; `None` for others, and where a vertex is not finite.
    fn of_few(mesh: &Mesh) -> Option<Self> {
        if mesh.topology != Topology::Triangles || mesh.indices.len() > SMALL_MESH_INDICES as usize {
            return None;
        }
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for index in mesh.indices.iter() {
            let position = mesh.vertices.get(*index as usize)?.position;
            for (axis, p) in position.into_iter().enumerate() {
                (min[axis], max[axis]) = (min[axis].min(p), max[axis].max(p));
            }
        }
        let farthest = min.into_iter().chain(max).fold(0.0, |most: f32, p| most.max(p.abs()));
        let lost = farthest * 1e-6;
        let center = [0, 1, 2].map(|i| 0.5 * min[i] + 0.5 * max[i]);
        let half = [0, 1, 2].map(|i| 0.5 * max[i] - 0.5 * min[i] + lost);
        half.iter().all(|h| h.is_finite()).then_some(Self { center, half })
    }
}

/// What of a drawable decides what has to be bound to draw it, its state apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct BindClass {
    /// `None` for height tiles.
    pub(crate) topology: Option<Topology>,
    pub(crate) is_masked: bool,
    pub(crate) double_sided: bool,
    /// Drawn by the application.
    pub(crate) is_custom: bool,
    pub(crate) block: u32,
    pub(crate) vertex_chunk: u32,
    /// Chunk of meshes, side of height tiles.
    pub(crate) index_chunk: u32,
}

/// Everything a draw reads of a drawable.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DrawableEntry {
    pub(crate) shape: Shape,
    /// Index of its [`BindClass`] in the table.
    pub(crate) class: u32,
    pub(crate) base_color: [f32; 4],
    pub(crate) alpha: AlphaMode,
    pub(crate) double_sided: bool,
    pub(crate) unlit: bool,
}

impl DrawableEntry {
    pub(super) fn new(shape: Shape, material: &Material) -> Self {
        Self {
            shape,
            class: 0,
            base_color: material.base_color,
            alpha: material.alpha,
            double_sided: material.double_sided,
            unlit: material.unlit,
        }
    }
}

impl DrawableEntry {
    fn bind_class(&self) -> BindClass {
        match &self.shape {
            Shape::Height(place) => BindClass {
                topology: None,
                is_masked: false,
                double_sided: true,
                is_custom: false,
                block: place.block,
                vertex_chunk: 0,
                index_chunk: place.side,
            },
            Shape::Mesh { place, topology, texture, .. } => BindClass {
                topology: Some(*topology),
                is_masked: matches!(self.alpha, AlphaMode::Mask(_)),
                double_sided: self.double_sided,
                is_custom: false,
                block: texture.block,
                vertex_chunk: place.vertex_chunk,
                index_chunk: place.index_chunk,
            },
            Shape::Custom(_) => BindClass {
                topology: Some(Topology::Triangles),
                is_masked: false,
                double_sided: false,
                is_custom: true,
                block: 0,
                vertex_chunk: 0,
                index_chunk: 0,
            },
        }
    }
}

/// Drawables by slot; slots are reused, last freed first.
#[derive(Default)]
pub(super) struct DrawableTable {
    classes: Vec<BindClass>,
    /// Only looked up.
    class_of: HashMap<BindClass, u32>,
    entries: Table<DrawableEntry>,
}

impl DrawableTable {
    fn classify(&mut self, entry: &mut DrawableEntry) {
        let class = entry.bind_class();
        entry.class = *self.class_of.entry(class).or_insert_with(|| {
            self.classes.push(class);
            self.classes.len() as u32 - 1
        });
    }

    /// Puts something else in a slot.
    pub(super) fn replace(&mut self, slot: DrawSlot, mut entry: DrawableEntry) {
        self.classify(&mut entry);
        if let Some(place) = self.entries.get_mut(slot.0) {
            *place = entry;
        }
    }

    pub(super) fn insert(&mut self, mut entry: DrawableEntry) -> DrawSlot {
        self.classify(&mut entry);
        DrawSlot(self.entries.insert(entry))
    }

    pub(super) fn classes(&self) -> &[BindClass] {
        &self.classes
    }

    pub(super) fn entry(&self, slot: DrawSlot) -> Option<&DrawableEntry> {
        self.entries.get(slot.0)
    }

    pub(super) fn remove(&mut self, slot: DrawSlot) -> Option<DrawableEntry> {
        self.entries.remove(slot.0)
    }
}

/// The pools of a context.
pub(crate) struct Pools {
    pub(crate) heights: HeightPool,
    pub(crate) meshes: MeshPool,
    pub(crate) textures: TexturePool,
    pub(crate) customs: CustomShapes,
    pub(super) layouts: Layouts,
    pub(super) memory: Memory,
}

impl Pools {
    pub(super) fn new(device: &wgpu::Device, layouts: Layouts) -> Self {
        Self {
            heights: HeightPool::default(),
            meshes: MeshPool::default(),
            textures: TexturePool::default(),
            customs: CustomShapes::default(),
            layouts,
            memory: Memory::new(device),
        }
    }

    pub(crate) fn layouts(&self) -> &Layouts {
        &self.layouts
    }

    pub(super) fn release(&mut self, entry: &DrawableEntry) {
        match &entry.shape {
            Shape::Height(place) => self.heights.release(*place),
            Shape::Mesh { place, texture, .. } => {
                self.meshes.release(place);
                self.textures.release(*texture);
            }
            Shape::Custom(place) => self.customs.release(*place),
        }
    }

    pub(super) fn bytes_in_use(&self) -> u64 {
        self.heights.bytes_in_use() + self.meshes.bytes_in_use() + self.textures.bytes_in_use() + self.customs.bytes()
    }

    pub(super) fn bytes_allocated(&self) -> u64 {
        self.heights.bytes_allocated()
            + self.meshes.bytes_allocated()
            + self.textures.bytes_allocated()
            + self.customs.bytes()
    }
}
