//! Tables of node payloads that only some kinds of nodes have. A node finds its entry by its payload index.

use std::sync::Arc;

use glam::{DMat4, DVec3};

use crate::math::Aabb;
use crate::scene::nodes::{
    AutoScale, BillboardMode, CameraNode, ClearNode, ClipNode, ConvexPlanarOccluder, LightSource, LocalLights,
    OcclusionQueryNode, TexGenNode,
};
use crate::scene::settings::LodRecord;

/// The payload of a node of a kind that few pages have.
#[derive(Debug)]
pub(crate) enum RareNode {
    Billboard {
        mode: BillboardMode,
        auto_scale: Option<AutoScale>,
        positions: Vec<DVec3>,
        /// Bounds of the drawables in their own frames.
        bounds: Vec<Aabb>,
    },
    LightSource(LightSource),
    LocalLights {
        /// Shared by identity: culls keep what follows from it.
        lights: Arc<LocalLights>,
        /// The state path of the children.
        path: u32,
    },
    ClipNode(ClipNode),
    TexGenNode(TexGenNode),
    ClearNode(ClearNode),
    Camera {
        camera: Box<CameraNode>,
        /// The state path of the children.
        path: u32,
    },
    Projection {
        clip_from_eye: DMat4,
        /// The state path of the children.
        path: u32,
    },
    /// A transform relative to the eye; its map is in the page's transforms.
    AbsoluteTransform,
    /// The occluder itself is in [`PayloadTables::occluders`].
    Occluder,
    OcclusionQuery(OcclusionQueryNode),
}

/// An OccluderNode of a page.
#[derive(Debug)]
pub(crate) struct OccluderRecord {
    pub node: u32,
    /// The transform in whose frame the corners are given.
    pub transform: u32,
    pub occluder: ConvexPlanarOccluder,
}

/// The payloads of switches, LODs, rare nodes and occluders.
#[derive(Debug, Default)]
pub(crate) struct PayloadTables {
    /// Visibility of the children of each Switch.
    switches: Vec<Box<[bool]>>,
    lods: Vec<LodRecord>,
    rare_nodes: Vec<RareNode>,
    /// Sorted by node.
    occluders: Vec<OccluderRecord>,
}

impl PayloadTables {
    #[inline(always)]
    pub fn switches(&self) -> &[Box<[bool]>] {
        &self.switches
    }

    /// Returns the children's visibility of a Switch, to be changed.
    pub fn switch_mut(&mut self, index: usize) -> Option<&mut [bool]> {
        self.switches.get_mut(index).map(|shown| &mut shown[..])
    }

    #[inline(always)]
    pub fn lods(&self) -> &[LodRecord] {
        &self.lods
    }

    #[inline(always)]
    pub fn rare_nodes(&self) -> &[RareNode] {
        &self.rare_nodes
    }

    /// Returns the values of a camera node, to be changed.
    pub fn camera_mut(&mut self, index: usize) -> Option<&mut CameraNode> {
        match self.rare_nodes.get_mut(index)? {
            RareNode::Camera { camera, .. } => Some(camera),
            _ => None,
        }
    }

    /// Returns all occluders, sorted by node.
    pub fn occluders(&self) -> &[OccluderRecord] {
        &self.occluders
    }

    /// Returns true if a node of `first..end` is an OccluderNode.
    pub fn has_occluders_in(&self, first: u32, end: u32) -> bool {
        let at = self.occluders.partition_point(|record| record.node < first);
        self.occluders.get(at).is_some_and(|record| record.node < end)
    }

    /// Appends a Switch and returns its index.
    pub(super) fn push_switch(&mut self, shown: Vec<bool>) -> u32 {
        self.switches.push(shown.into_boxed_slice());
        self.switches.len() as u32 - 1
    }

    /// Appends the ranges of a LOD and returns their index.
    pub(super) fn push_lod(&mut self, lod: LodRecord) -> u32 {
        self.lods.push(lod);
        self.lods.len() as u32 - 1
    }

    /// Appends the payload of a rare node and returns its index.
    pub(super) fn push_rare(&mut self, rare: RareNode) -> u32 {
        self.rare_nodes.push(rare);
        self.rare_nodes.len() as u32 - 1
    }

    /// Appends an occluder. Nodes must arrive in ascending order.
    pub(super) fn push_occluder(&mut self, record: OccluderRecord) {
        self.occluders.push(record);
    }

    /// Returns the bytes of CPU memory of the occluders; the other tables are small and not counted.
    pub fn size_bytes(&self) -> usize {
        let corners = |o: &ConvexPlanarOccluder| o.corners.len() + o.holes.iter().map(Vec::len).sum::<usize>();
        let corners: usize = self.occluders.iter().map(|record| corners(&record.occluder)).sum();
        self.occluders.len() * size_of::<OccluderRecord>() + corners * size_of::<DVec3>()
    }
}
