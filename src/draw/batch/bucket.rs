//! Buckets: the pipeline, buffers and bind groups that leaves share. Draw thread; plain values.

use crate::draw::pipelines::key::PipelineKey;

/// The content that a bucket draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum Content {
    Height,
    /// Indexed meshes, lines or points.
    Mesh,
    /// Small meshes, many of which one call draws: the shader fetches `stride` vertices for each.
    PulledMesh {
        stride: u32,
    },
    /// Gaussian splats, one cloud a run, whose number is the first index; `state` is the index of their state in the stage.
    Splats {
        state: u32,
    },
    /// Drawables that the application draws; `state` is the index of their state in the stage.
    Custom {
        state: u32,
    },
}

/// The bindings of a run. Leaves of one bucket differ in geometry alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) struct Bucket {
    pub(in crate::draw) pipeline: PipelineKey,
    pub(in crate::draw) content: Content,
    /// Block of a pool, or set of surfaces, bound as group 1.
    pub(in crate::draw) block: u32,
    pub(in crate::draw) vertex_chunk: u32,
    /// Chunk of a mesh's indices, or the side of a height tile's grid.
    pub(in crate::draw) index_chunk: u32,
    /// Index of the bound state: dynamic state and uniforms.
    pub(in crate::draw) bound: u32,
}

/// The rank of a bucket among those whose order is free: expensive changes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct BucketRank {
    pipeline: u128,
    /// Block, vertex chunk and index chunk.
    bindings: u64,
    /// Last, since a bound state is mostly one call to set, and other buffers are two.
    bound: u32,
}

impl Bucket {
    pub(super) fn rank(&self) -> BucketRank {
        // The largest pools have thousands of blocks and chunks. With more than 2^20, the order is only less good.
        let bindings = u64::from(self.block) << 40
            | u64::from(self.vertex_chunk & 0xf_ffff) << 20
            | u64::from(self.index_chunk & 0xf_ffff);
        BucketRank { pipeline: self.pipeline.order(), bindings, bound: self.bound }
    }

    /// Returns the number of vertices that the shader fetches for each mesh; 0 if it fetches none.
    #[inline]
    pub(super) fn stride(&self) -> u32 {
        match self.content {
            Content::PulledMesh { stride } => stride,
            _ => 0,
        }
    }
}

/// The source of a leaf's vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum VertexFetch {
    /// Vertex buffers or a height grid.
    Buffers,
    /// The shader. Meshes share a call if they need the same number of triangles, rounded up to a power of two: at most
    /// 16, which are 48 vertices.
    Pulled { log2_triangles: u8 },
    /// The application.
    Custom,
}

impl VertexFetch {
    const CUSTOM_CODE: u64 = 7;

    /// Returns a number of three bits.
    #[inline]
    fn code(self) -> u64 {
        match self {
            Self::Buffers => 0,
            Self::Pulled { log2_triangles } => 1 + u64::from(log2_triangles),
            Self::Custom => Self::CUSTOM_CODE,
        }
    }
}

/// The key that a leaf's bucket is looked up by.
#[derive(Clone, Copy, Debug)]
pub(super) struct BucketKey {
    /// Equal for states that draw alike; the index of the state for custom drawables, since the application may read
    /// anything from it.
    pub(super) state_class: u32,
    /// Equal for drawables with the same bindings.
    pub(super) bind_class: u32,
    pub(super) fetch: VertexFetch,
    /// True if the leaf's transform mirrors, which swaps front and back faces.
    pub(super) is_mirrored: bool,
}

impl BucketKey {
    /// Returns the key as a number for the lookup: 20 bits of the state class, then the bind class, the fetch and the
    /// mirroring.
    #[inline]
    pub(super) fn packed(self) -> u64 {
        u64::from(self.state_class) << 44
            | u64::from(self.bind_class) << 8
            | self.fetch.code() << 1
            | u64::from(self.is_mirrored)
    }
}
