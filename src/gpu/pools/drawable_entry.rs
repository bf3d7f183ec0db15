//! [`DrawableEntry`]: the properties of an uploaded drawable that a draw reads. Draw thread; plain values.

use super::heights::HeightSlot;
use super::meshes::MeshSlot;
use super::surfaces::SurfaceSlot;
use super::textures::TextureLayer;
use crate::scene::{AlphaMode, Material, Mesh, SMALL_MESH_INDICES, Splats, Topology};

/// The bit of harmonics that are added to linear colours, beside their degree (src/draw/shaders/splats/splat.wgsl).
pub(crate) const LINEAR_HARMONICS: u32 = 4;

/// The geometry of a drawable and its slots in the pools.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    Height(HeightSlot),
    Mesh {
        slot: MeshSlot,
        topology: Topology,
        texture: TextureLayer,
        /// The surface of a metallic-roughness material.
        surface: Option<SurfaceSlot>,
        /// True if shaders fetch the vertices of several such meshes in one call.
        is_small: bool,
        /// The bounds of the triangles, if they are few.
        extent: Option<Extent>,
    },
    /// Gaussian splats: their number in the pool, how many they are, and the kind of their harmonics for the shader.
    Splats {
        number: u32,
        count: u32,
        harmonics: u32,
    },
    /// The index of a custom drawable.
    Custom(u32),
}

impl Shape {
    pub(in crate::gpu) fn of_mesh(
        mesh: &Mesh,
        slot: MeshSlot,
        texture: TextureLayer,
        surface: Option<SurfaceSlot>,
    ) -> Self {
        let (topology, is_small, extent) = (mesh.topology, mesh.is_small(), Extent::of_small(mesh));
        Self::Mesh { slot, topology, texture, surface, is_small, extent }
    }

    pub(in crate::gpu) fn of_splats(splats: &Splats, number: u32) -> Self {
        let harmonics = splats.harmonics();
        let linear = if harmonics.is_linear() { LINEAR_HARMONICS } else { 0 };
        let (count, harmonics) = (splats.list().len() as u32, u32::from(harmonics.degree()) | linear);
        Self::Splats { number, count, harmonics }
    }
}

/// A box in a drawable's frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Extent {
    pub(crate) center: [f32; 3],
    /// Half of the size along each axis, enlarged by the rounding errors of a transform in f32.
    pub(crate) half: [f32; 3],
}

impl Extent {
    /// Returns the bounds of a small mesh's triangles; `None` for other meshes, and if a vertex is not finite.
    fn of_small(mesh: &Mesh) -> Option<Self> {
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
        let farthest = min.into_iter().chain(max).fold(0.0, |farthest: f32, p| farthest.max(p.abs()));
        let rounding_error = farthest * 1e-6;
        let center = [0, 1, 2].map(|i| 0.5 * min[i] + 0.5 * max[i]);
        let half = [0, 1, 2].map(|i| 0.5 * max[i] - 0.5 * min[i] + rounding_error);
        half.iter().all(|h| h.is_finite()).then_some(Self { center, half })
    }
}

/// The properties of a drawable that decide, with its state, which pipeline, buffers and bind groups draw it. Drawables of
/// one class can share a draw call.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum BindClass {
    /// Height tiles of one block.
    Height { block: u32, side: u32 },
    /// Meshes that share a block of textures and chunks of vertices and indices.
    Mesh {
        topology: Topology,
        is_masked: bool,
        double_sided: bool,
        block: u32,
        /// The set of metallic-roughness surfaces.
        surface_set: Option<u32>,
        /// True if the set is one of layered surfaces.
        is_layered: bool,
        vertex_chunk: u32,
        index_chunk: u32,
    },
    /// Gaussian splats.
    Splats,
    /// Drawables that the application draws.
    Custom,
}

/// The properties of an uploaded drawable that a draw reads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DrawableEntry {
    pub(crate) shape: Shape,
    /// Index of the [`BindClass`] in the table of classes.
    pub(crate) class: u32,
    pub(crate) base_color: [f32; 4],
    pub(crate) alpha: AlphaMode,
    pub(crate) double_sided: bool,
    pub(crate) unlit: bool,
}

impl DrawableEntry {
    /// Creates an entry; the table sets its class.
    pub(in crate::gpu) fn new(shape: Shape, material: &Material) -> Self {
        Self {
            shape,
            class: 0,
            base_color: material.base_color,
            alpha: material.alpha,
            double_sided: material.double_sided,
            unlit: material.unlit,
        }
    }

    pub(super) fn bind_class(&self) -> BindClass {
        match &self.shape {
            Shape::Height(slot) => BindClass::Height { block: slot.block, side: slot.side },
            Shape::Mesh { slot, topology, texture, surface, .. } => BindClass::Mesh {
                topology: *topology,
                is_masked: matches!(self.alpha, AlphaMode::Mask(_)),
                double_sided: self.double_sided,
                block: texture.block,
                surface_set: surface.map(|surface| surface.set),
                is_layered: surface.is_some_and(|surface| surface.is_layered),
                vertex_chunk: slot.vertex_chunk,
                index_chunk: slot.index_chunk,
            },
            Shape::Splats { .. } => BindClass::Splats,
            Shape::Custom(_) => BindClass::Custom,
        }
    }
}
