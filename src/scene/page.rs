//! A page: what one load produces, flattened for culling.
//!
//! Built by decode workers (any thread), owned by the [`super::Scene`] while attached: update changes it with
//! `&mut`, cull reads it with `&`.

use std::sync::Arc;

use glam::{DMat4, DVec3, Vec4};

use super::callbacks::{EventCallback, UpdateCallback};
use super::geometry::Drawable;
use super::intersect::KdTree;
use super::kinds::{
    BillboardMode, CameraNode, ClearNode, ClipNode, ConvexPlanarOccluder, CullCallback, LightSource, NormalCone,
    OcclusionQueryNode, TexGenNode,
};
use super::lod_ranges::LodRecord;
use super::shared::SharedContent;
use super::tiles::Tiles;
use super::transforms::Transforms;
use crate::math::{Aabb, BoundingSphere};
use crate::state::StateSet;

/// "No index".
pub(crate) const NONE: u32 = u32::MAX;

/// Half size of what has no usable bound: never culled, finite so that no product with it is NaN.
pub(crate) const UNBOUNDED: f32 = 1.0e36;

/// An index into a graphics context's drawable table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct DrawSlot(pub u32);

impl DrawSlot {
    /// Not drawable (not compiled, or compilation failed): skipped by the renderer.
    pub const NONE: Self = Self(u32::MAX);
}

/// Kinds of a [`NodeRecord`].
pub(crate) mod kind {
    pub const GROUP: u8 = 0;
    pub const TRANSFORM: u8 = 1;
    pub const GEODE: u8 = 2;
    pub const SWITCH: u8 = 3;
    pub const LOD: u8 = 4;
    /// PagedLod or ProxyNode: the subtree is walked by the tile walk.
    pub const TILE: u8 = 5;
    /// What `Page::specials` holds.
    pub const SPECIAL: u8 = 6;
}

/// Set where a cull callback is asked.
pub(crate) const CALLBACK: u8 = 2;
/// Set where the bound culls nothing: the node's own wish, or that of one below it.
pub(crate) const INACTIVE: u8 = 4;
/// Set where that is the node's own wish: what it draws itself is not culled either.
pub(crate) const UNCULLED: u8 = 8;
/// Set where tiles are below, or what no bound culls: however small it looks, it is visited.
pub(crate) const LARGE: u8 = 16;

/// Set where what is below has changed: the sphere holds all of it, and is to be fitted.
pub(crate) const STALE: u8 = 32;

/// Of a path: the leaves below have the view of the camera or projection node that is being scanned.
pub(crate) const VIEW: u32 = u32::MAX - 1;

/// What the rarer kinds of nodes hold.
#[derive(Debug)]
pub(crate) enum Special {
    Billboard {
        mode: BillboardMode,
        positions: Vec<DVec3>,
        /// The drawables' own bounds.
        bounds: Vec<Aabb>,
    },
    LightSource(LightSource),
    ClipNode(ClipNode),
    TexGenNode(TexGenNode),
    ClearNode(ClearNode),
    /// With the path of its children.
    Camera {
        camera: Box<CameraNode>,
        path: u32,
    },
    /// With the path of its children.
    Projection {
        clip_from_eye: DMat4,
        path: u32,
    },
    /// With the index of its transform.
    AbsoluteTransform,
    /// In `Page::occluders` too.
    Occluder,
    OcclusionQuery(OcclusionQueryNode),
}

/// Set in [`NodeRecord::flags`] where the subtree has only groups, transforms and geodes that every camera sees:
/// once wholly inside the frustum, its drawables and transforms are two ranges.
pub(crate) const PLAIN: u8 = 1;

/// What the node scan reads of every node, 16 bytes; bounds are beside it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NodeRecord {
    /// Nodes in the subtree, this one included.
    pub skip: u32,
    /// Drawables before this node; its own follow, then those of its children.
    pub first_drawable: u32,
    /// Transforms before this node, counting the page's own; a transform node's own index.
    pub first_transform: u32,
    pub kind: u8,
    pub flags: u8,
}

/// State-set chain from the page's root to a drawable or tile; path 0 is the page's root.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StatePath {
    pub parent: u32,
    /// Index into `state_sets`, or [`BLEND`].
    pub set: u32,
}

/// The pseudo state set of drawables whose material blends.
pub(crate) const BLEND: u32 = u32::MAX;

/// Frame and state of a drawable.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DrawableRef {
    pub state_path: u32,
    pub transform: u32,
}

/// Boxes of four drawables, component by component, relative to the page's origin.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Boxes4 {
    pub center: [Vec4; 3],
    pub half: [Vec4; 3],
}

/// A shared content that a page uses.
#[derive(Debug)]
pub(crate) struct SharedUse {
    pub content: Arc<SharedContent>,
    /// Of its k-d tree, where the page has it.
    pub tree_bytes: u64,
}

/// What one load produces: nodes and drawables in flat depth-first arrays, tile trees in arrays of their own.
#[derive(Debug)]
pub struct Page {
    /// One more than there are nodes: the last holds the totals.
    pub(crate) nodes: Vec<NodeRecord>,
    /// Centre relative to `origin` and radius, page frame.
    pub(crate) spheres: Vec<Vec4>,
    pub(crate) parents: Vec<u32>,
    /// Node masks; empty where every camera sees every node.
    pub(crate) masks: Vec<u32>,
    /// Index into `switches`, `lods` or the tiles by node; empty where the page has none of them.
    pub(crate) payloads: Vec<u32>,
    pub(crate) switches: Vec<Box<[bool]>>,
    pub(crate) lods: Vec<LodRecord>,
    /// Of nodes that have one, in order.
    pub(crate) names: Vec<(Box<str>, u32)>,
    /// By payload of nodes of kind [`kind::SPECIAL`].
    pub(crate) specials: Vec<Special>,
    /// Cull callbacks by node, in order.
    pub(crate) callbacks: Vec<(u32, CullCallback)>,
    /// By node, in order.
    pub(crate) update_callbacks: Vec<(u32, UpdateCallback)>,
    /// By node, in order.
    pub(crate) event_callbacks: Vec<(u32, EventCallback)>,
    /// Occluders with their nodes and enclosing transforms.
    pub(crate) occluders: Vec<(u32, u32, ConvexPlanarOccluder)>,
    /// Normal cones by drawable, in order.
    pub(crate) clusters: Vec<(u32, NormalCone)>,
    pub(crate) transforms: Transforms,
    pub(crate) boxes: Vec<Boxes4>,
    /// Boxes in the frames of their transforms, from which `boxes` are fitted again.
    pub(crate) local_boxes: Vec<Aabb>,
    pub(crate) drawable_refs: Vec<DrawableRef>,
    pub(crate) paths: Vec<StatePath>,
    pub(crate) state_sets: Vec<Arc<StateSet>>,
    pub(crate) tiles: Tiles,
    /// Spheres of the top tiles in their own frames, by tile root.
    pub(crate) tile_root_spheres: Vec<BoundingSphere>,
    /// Bounds are stored relative to this point of the page's frame.
    pub(crate) origin: DVec3,
    /// Some drawable has no transform above it.
    pub(crate) uses_page_frame: bool,
    pub(crate) drawables: Vec<Drawable>,
    pub(crate) payload_bytes: u64,
    /// By drawable; empty where none were built.
    pub(crate) kd_trees: Vec<Option<Arc<KdTree>>>,
    pub(crate) draw_slots: Vec<(u32, Vec<DrawSlot>)>,
    /// What the page shares with others, each once.
    pub(crate) shared: Vec<SharedUse>,
    /// Of the bytes of the k-d trees, those of shared ones.
    pub(crate) shared_tree_bytes: u64,
    /// Pages in this page's slots.
    pub(crate) attached_pages: u32,
    /// Nodes that are [`STALE`], in no order.
    pub(crate) stale: Vec<u32>,
    /// Spheres that were fitted so far.
    pub(crate) fitted_spheres: u64,
}

impl Page {
    /// The payloads in drawable order, to be compiled; their bounds stay in the page.
    pub fn take_drawables(&mut self) -> Vec<Drawable> {
        self.payload_bytes = 0;
        std::mem::take(&mut self.drawables)
    }

    /// Payloads that were taken come back, all of them or none.
    pub(crate) fn put_drawables(&mut self, drawables: Vec<Drawable>) {
        self.payload_bytes = drawables.iter().map(Drawable::size_bytes).sum();
        self.drawables = drawables;
    }

    /// How many drawables the page has, taken or not.
    pub fn drawable_count(&self) -> usize {
        self.drawable_refs.len()
    }

    /// How many nodes the page has.
    pub fn node_count(&self) -> usize {
        self.nodes.len() - 1
    }

    /// Bytes of CPU memory the page holds, payloads that were not taken included.
    pub fn size_bytes(&self) -> u64 {
        let nodes = self.nodes.len() * (size_of::<NodeRecord>() + size_of::<Vec4>() + 4)
            + (self.masks.len() + self.payloads.len()) * 4;
        let drawables = self.boxes.len() * size_of::<Boxes4>()
            + self.drawable_refs.len() * (size_of::<DrawableRef>() + size_of::<Aabb>());
        let slots: usize = self.draw_slots.iter().map(|(_, slots)| slots.len() * 4).sum();
        let states = self.paths.len() * size_of::<StatePath>() + self.state_sets.len() * size_of::<StateSet>();
        let corners = |o: &ConvexPlanarOccluder| o.corners.len() + o.holes.iter().map(Vec::len).sum::<usize>();
        let corners: usize = self.occluders.iter().map(|(_, _, o)| corners(o)).sum();
        let occluders =
            self.occluders.len() * size_of::<(u32, u32, ConvexPlanarOccluder)>() + corners * size_of::<DVec3>();
        (size_of::<Self>() + nodes + drawables + slots + states + occluders) as u64
            + self.transforms.size_bytes()
            + self.tiles.size_bytes()
            + self.payload_bytes
            + self.kd_trees.iter().flatten().map(|tree| tree.size_bytes()).sum::<u64>()
    }

    /// Builds a tree over the primitives of each drawable, which stays when the payloads are taken: about 20 bytes a
    /// triangle, 3 a triangle of a height tile. Without one a drawable is met only while its payload is in the page.
    pub fn build_kd_trees(&mut self) {
        if self.drawables.len() == self.drawable_refs.len() {
            let tree = |d: &Drawable| match &d.shared.geometry {
                Some(shared) => shared.tree(&d.geometry),
                None => KdTree::build(&d.geometry).map(Arc::new),
            };
            self.kd_trees = self.drawables.iter().map(tree).collect();
            self.hold_shared();
        }
    }

    /// Notes what its drawables share, so that it stays shared when the payloads are taken.
    pub(crate) fn hold_shared(&mut self) {
        let mut uses: Vec<SharedUse> = Vec::new();
        self.shared_tree_bytes = 0;
        for (i, drawable) in self.drawables.iter().enumerate() {
            for content in drawable.shared.iter() {
                let is_geometry = drawable.shared.geometry.as_ref().is_some_and(|g| Arc::ptr_eq(g, content));
                let tree = self.kd_trees.get(i).and_then(Option::as_ref).filter(|_| is_geometry);
                let tree_bytes = tree.map_or(0, |t| t.size_bytes());
                self.shared_tree_bytes += tree_bytes;
                uses.push(SharedUse { content: content.clone(), tree_bytes });
            }
        }
        uses.sort_by_key(|u| Arc::as_ptr(&u.content));
        uses.dedup_by(|a, b| Arc::ptr_eq(&a.content, &b.content));
        uses.shrink_to_fit();
        self.shared = uses;
    }

    /// [`Self::size_bytes`] without what it shares with other pages.
    pub(crate) fn own_bytes(&self) -> u64 {
        self.size_bytes().saturating_sub(self.shared_tree_bytes)
    }

    /// The tree of a drawable, where one was built.
    pub fn kd_tree(&self, drawable: u32) -> Option<&Arc<KdTree>> {
        self.kd_trees.get(drawable as usize)?.as_ref()
    }

    /// True when the page holds tiles: an external tileset. A tile whose content is such a page is always refined.
    pub fn is_tile_tree(&self) -> bool {
        !self.tiles.records.is_empty()
    }

    /// Sets where a context keeps the page's drawables, in drawable order.
    pub fn set_draw_slots(&mut self, context: u32, slots: Vec<DrawSlot>) {
        match self.draw_slots.iter_mut().find(|(c, _)| *c == context) {
            Some(entry) => entry.1 = slots,
            None => self.draw_slots.push((context, slots)),
        }
    }

    /// Takes the slots of every context, to be released.
    pub fn take_draw_slots(&mut self) -> Vec<(u32, Vec<DrawSlot>)> {
        std::mem::take(&mut self.draw_slots)
    }

    /// The slots of a context; empty when the page was not compiled for it.
    pub(crate) fn draw_slots_of(&self, context: u32) -> &[DrawSlot] {
        self.draw_slots.iter().find(|(c, _)| *c == context).map_or(&[], |(_, slots)| slots)
    }

    /// The tile of a node, if it is one.
    pub(crate) fn tile_of(&self, node: u32) -> Option<usize> {
        let record = self.nodes.get(node as usize)?;
        if record.kind != kind::TILE || node as usize >= self.node_count() {
            return None;
        }
        self.payloads.get(node as usize).map(|t| *t as usize)
    }

    /// What a camera node holds, if it is one.
    pub(crate) fn camera(&self, node: u32) -> Option<&CameraNode> {
        let index = node as usize;
        self.nodes.get(index).filter(|r| r.kind == kind::SPECIAL && index < self.node_count())?;
        match self.specials.get(*self.payloads.get(index)? as usize)? {
            Special::Camera { camera, .. } => Some(camera),
            _ => None,
        }
    }

    /// Cull must know where the eye is in the page's frame.
    pub(crate) fn needs_eye(&self) -> bool {
        !self.lods.is_empty() || !self.callbacks.is_empty() || !self.clusters.is_empty()
    }

    /// A node and those above it, each with the one below it that the way came from.
    pub(crate) fn path_to_root(&self, node: u32) -> impl Iterator<Item = (u32, Option<u32>)> + '_ {
        let mut at = (node, None);
        std::iter::from_fn(move || {
            let this = at;
            let parent = *self.parents.get(this.0 as usize)?;
            at = (parent, Some(this.0));
            Some(this)
        })
    }

    /// The transform in whose frame a node lies.
    pub(crate) fn enclosing_transform(&self, node: u32) -> u32 {
        let mut at = self.parents[node as usize];
        while let Some(record) = self.nodes.get(at as usize) {
            let is_absolute = record.kind == kind::SPECIAL
                && matches!(self.specials.get(self.payloads[at as usize] as usize), Some(Special::AbsoluteTransform));
            if record.kind == kind::TRANSFORM || is_absolute {
                return record.first_transform;
            }
            at = self.parents[at as usize];
        }
        0
    }

    /// The flags of a Switch.
    pub(crate) fn switch_mut(&mut self, node: u32) -> Option<&mut [bool]> {
        let record = self.nodes.get(node as usize).filter(|r| r.kind == kind::SWITCH)?;
        debug_assert!(record.skip > 0);
        let payload = *self.payloads.get(node as usize)?;
        self.switches.get_mut(payload as usize).map(|s| &mut s[..])
    }

    /// Whether a node, if it is a Switch, shows one of its children.
    pub(crate) fn switch_shows(&self, node: u32, child: u32) -> bool {
        let record = &self.nodes[node as usize];
        if record.kind != kind::SWITCH {
            return true;
        }
        let shown = &self.switches[self.payloads[node as usize] as usize];
        shown.get(self.child_index(node, child)).copied().unwrap_or(false)
    }

    /// Which of a node's children one is.
    pub(crate) fn child_index(&self, node: u32, child: u32) -> usize {
        let mut at = node + 1;
        let mut index = 0;
        while at < child {
            at += self.nodes[at as usize].skip;
            index += 1;
        }
        index
    }
}
