//! Nodes as values: readers and applications build them on any thread, and
//! [`Page::from_node`](crate::scene::Page::from_node) flattens them.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::billboard::Billboard;
use super::callback::{EventCallback, UpdateCallback};
use super::camera_node::CameraNode;
use super::node_payloads::{
    ClearNode, ClipNode, ConvexPlanarOccluder, CullCallback, LightSource, LocalLights, TexGenNode,
};
use super::occlusion_query::OcclusionQueryNode;
use super::paged_lod::{PagedLod, ProxyNode};
use crate::scene::features::TileMetadata;
use crate::scene::geometry::Drawable;
use crate::state::StateSet;

/// A node with its children. A graph is flattened once into a page and not visited at frame time.
#[derive(Clone, Debug)]
pub struct Node {
    /// A name; may be empty.
    pub name: String,
    /// The kind of the node with its payload.
    pub kind: NodeKind,
    /// State for the node and its children; shared by identity.
    pub state_set: Option<Arc<StateSet>>,
    /// The node is drawn only if `mask & camera.cull_mask != 0`. In a tile tree, the mask of the top tile applies.
    pub mask: u32,
    /// If false, neither the node nor the nodes above are culled by their bounds, nor are its own drawables as a Geode or
    /// Billboard; OSG's `setCullingActive`. Tiles and proxies are still culled, each by its own bound.
    pub culling_active: bool,
    /// Called by cull before it visits the node; it may skip the node or push state sets. In a tile tree, the callback of the
    /// top tile applies.
    pub cull_callback: Option<CullCallback>,
    /// Called once a frame in the update phase.
    pub update_callback: Option<UpdateCallback>,
    /// Called once for each event.
    pub event_callback: Option<EventCallback>,
    /// The metadata of a tile or of a content; usually none.
    pub metadata: Option<Arc<TileMetadata>>,
    /// The children in order.
    pub children: Vec<Node>,
}

/// The closed set of node kinds.
#[derive(Clone, Debug)]
pub enum NodeKind {
    /// Holds children.
    Group,
    /// An affine parent-from-child map, metres in f64.
    Transform(DAffine3),
    /// Replaces the projection for the children: reversed-Z clip from eye.
    Projection(glam::DMat4),
    /// A transform whose children are in the eye's frame, whatever is above: they move with the eye.
    AbsoluteTransform(DAffine3),
    /// Shows or hides each child; one flag per child.
    Switch(Vec<bool>),
    /// Child i is shown while the distance to `center` times the LOD scale is in `ranges_m[i]`.
    Lod {
        /// The centre in the node's frame.
        center: DVec3,
        /// `[min, max)` of each child, metres.
        ranges_m: Vec<[f64; 2]>,
    },
    /// Levels of detail by size (OSG's LOD with `PIXEL_SIZE_ON_SCREEN`): child i is shown while the diameter of a sphere in
    /// pixels, divided by the LOD scale, is in `ranges_px[i]`. If rays are parallel, scales between the node's frame and the
    /// view are ignored, as for the errors of tiles.
    LodByPixelSize {
        /// The centre of the sphere in the node's frame.
        center: DVec3,
        /// The radius of the sphere, metres of the same frame.
        radius_m: f64,
        /// `[min, max)` of each child, pixels of diameter.
        ranges_px: Vec<[f64; 2]>,
    },
    /// A tile: paged content, and children that refine it.
    PagedLod(Box<PagedLod>),
    /// A tile with several contents, as readers of tile sets build it: an empty ADD tile whose children hold the contents.
    MultiContentTile(Box<PagedLod>),
    /// Children that are loaded from another file: an external tileset.
    ProxyNode(Box<ProxyNode>),
    /// Drawables.
    Geode(Vec<Drawable>),
    /// Drawables that turn towards the eye.
    Billboard(Box<Billboard>),
    /// A light.
    LightSource(Box<LightSource>),
    /// Lights for the children alone.
    LocalLights(LocalLights),
    /// Clip planes for the children.
    ClipNode(Box<ClipNode>),
    /// The frame of generated texture coordinates.
    TexGenNode(Box<TexGenNode>),
    /// Clears the target with another colour than its camera.
    ClearNode(ClearNode),
    /// A camera inside the graph.
    Camera(Box<CameraNode>),
    /// A convex occluder.
    OccluderNode(Box<ConvexPlanarOccluder>),
    /// Hardware occlusion query.
    OcclusionQueryNode(Box<OcclusionQueryNode>),
}

impl Node {
    /// Creates a node without children, name or state, visible to every camera.
    pub fn new(kind: NodeKind) -> Self {
        Self {
            name: String::new(),
            kind,
            state_set: None,
            mask: u32::MAX,
            culling_active: true,
            cull_callback: None,
            update_callback: None,
            event_callback: None,
            metadata: None,
            children: Vec::new(),
        }
    }

    /// Creates a group.
    pub fn group(children: Vec<Node>) -> Self {
        Self { children, ..Self::new(NodeKind::Group) }
    }

    /// Creates a transform over children.
    pub fn transform(parent_from_child: DAffine3, children: Vec<Node>) -> Self {
        Self { children, ..Self::new(NodeKind::Transform(parent_from_child)) }
    }

    /// Creates levels of detail by the distance from the centre of the children's bounding sphere, as OSG's LOD does by
    /// default (USE_BOUNDING_SPHERE_CENTER). `ranges_m[i]` is the range `[min, max)` of child i.
    pub fn lod(ranges_m: Vec<[f64; 2]>, children: Vec<Node>) -> Self {
        let group = Self::group(children);
        let sphere = group.bounding_sphere();
        let center = if sphere.is_empty() || !sphere.center.is_finite() { DVec3::ZERO } else { sphere.center };
        Self { kind: NodeKind::Lod { center, ranges_m }, ..group }
    }

    /// Creates a camera over children.
    pub fn camera(camera: CameraNode, children: Vec<Node>) -> Self {
        Self { children, ..Self::new(NodeKind::Camera(Box::new(camera))) }
    }

    /// Creates a node with drawables and without children.
    pub fn geode(drawables: Vec<Drawable>) -> Self {
        Self::new(NodeKind::Geode(drawables))
    }

    /// Names the node; [`Scene::nodes_named`](crate::scene::Scene::nodes_named) finds it by this name.
    pub fn named(mut self, name: &str) -> Self {
        self.name = name.into();
        self
    }

    /// Sets the state set.
    pub fn with_state_set(mut self, state_set: Arc<StateSet>) -> Self {
        self.state_set = Some(state_set);
        self
    }

    /// Appends a child.
    pub fn with_child(mut self, child: Node) -> Self {
        self.children.push(child);
        self
    }
}
