//! Nodes as values: readers and applications build them on any thread, and
//! [`Page::from_node`](crate::scene::Page::from_node) flattens them.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::billboard::Billboard;
use super::callback::{EventCallback, UpdateCallback};
use super::camera_node::CameraNode;
use super::node_payloads::{ClearNode, ClipNode, ConvexPlanarOccluder, CullCallback, LightSource, TexGenNode};
use super::occlusion_query::OcclusionQueryNode;
use super::paged_lod::{PagedLod, ProxyNode};
use crate::scene::geometry::Drawable;
use crate::state::StateSet;

/// A node and what hangs below it. Flattened once into a page; not walked at frame time.
#[derive(Clone, Debug)]
pub struct Node {
    /// Name for people; may be empty.
    pub name: String,
    /// What the node does.
    pub kind: NodeKind,
    /// State for the node and below; shared by identity.
    pub state_set: Option<Arc<StateSet>>,
    /// Drawn only where `mask & camera.cull_mask != 0`. Of tiles and proxies below each other the topmost one's.
    pub mask: u32,
    /// False: never culled by its bound, nor is what is above it, nor what it draws itself as a Geode or Billboard (tiles
    /// and proxies are, each by its own bound); OSG's `setCullingActive`.
    pub culling_active: bool,
    /// Asked each time cull is about to visit it. Of tiles and proxies below each other the topmost one's.
    pub cull_callback: Option<CullCallback>,
    /// Called once a frame in update.
    pub update_callback: Option<UpdateCallback>,
    /// Called once an event.
    pub event_callback: Option<EventCallback>,
    /// Children in order.
    pub children: Vec<Node>,
}

/// The closed set of node kinds.
#[derive(Clone, Debug)]
pub enum NodeKind {
    /// Holds children.
    Group,
    /// Parent-from-child affine map, metres in f64.
    Transform(DAffine3),
    /// Replaces the projection below: reversed-Z clip from eye.
    Projection(glam::DMat4),
    /// A transform whose children are in the eye's frame, whatever is above: what it holds moves with the eye.
    AbsoluteTransform(DAffine3),
    /// Children shown by index; one flag a child.
    Switch(Vec<bool>),
    /// Child i is shown while the distance to `center` times the LOD scale is in `ranges_m[i]`.
    Lod {
        /// Centre in the node's frame.
        center: DVec3,
        /// `[min, max)` a child, metres.
        ranges_m: Vec<[f64; 2]>,
    },
    /// The same by size (OSG's LOD with `PIXEL_SIZE_ON_SCREEN`): child i is shown while a sphere covers so many pixels of
    /// the picture, over the LOD scale, that they are in `ranges_px[i]`.
    /// Where rays are parallel, metres of the node's frame count as the picture's, as those of tiles' errors do.
    LodByPixelSize {
        /// The sphere's centre in the node's frame.
        center: DVec3,
        /// Its radius, metres of the same frame.
        radius_m: f64,
        /// `[min, max)` a child, pixels across.
        ranges_px: Vec<[f64; 2]>,
    },
    /// A tile: content that is paged in, children that refine it.
    PagedLod(Box<PagedLod>),
    /// A tile with several contents, as readers of tile sets build it: an empty ADD tile whose children hold the contents.
    MultiContentTile(Box<PagedLod>),
    /// Children that are loaded from elsewhere: an external tileset.
    ProxyNode(Box<ProxyNode>),
    /// Drawables.
    Geode(Vec<Drawable>),
    /// Drawables that turn towards the eye.
    Billboard(Box<Billboard>),
    /// A light.
    LightSource(Box<LightSource>),
    /// Clip planes for the children.
    ClipNode(Box<ClipNode>),
    /// The frame of generated texture coordinates.
    TexGenNode(Box<TexGenNode>),
    /// Clears the target otherwise.
    ClearNode(ClearNode),
    /// A camera inside the graph.
    Camera(Box<CameraNode>),
    /// A convex occluder.
    OccluderNode(Box<ConvexPlanarOccluder>),
    /// Hardware occlusion query.
    OcclusionQueryNode(Box<OcclusionQueryNode>),
}

impl Node {
    /// A node of a kind, without children, name or state, visible to every camera.
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
            children: Vec::new(),
        }
    }

    /// A group of children.
    pub fn group(children: Vec<Node>) -> Self {
        Self { children, ..Self::new(NodeKind::Group) }
    }

    /// A transform over children.
    pub fn transform(parent_from_child: DAffine3, children: Vec<Node>) -> Self {
        Self { children, ..Self::new(NodeKind::Transform(parent_from_child)) }
    }

    /// Levels of detail by the distance from the middle of what they hold; OSG's LOD as it comes
    /// (USE_BOUNDING_SPHERE_CENTER). `ranges_m[i]` is that of child i, `[min, max)`.
    pub fn lod(ranges_m: Vec<[f64; 2]>, children: Vec<Node>) -> Self {
        let group = Self::group(children);
        let sphere = group.bounding_sphere();
        let center = if sphere.is_empty() || !sphere.center.is_finite() { DVec3::ZERO } else { sphere.center };
        Self { kind: NodeKind::Lod { center, ranges_m }, ..group }
    }

    /// A camera over children.
    pub fn camera(camera: CameraNode, children: Vec<Node>) -> Self {
        Self { children, ..Self::new(NodeKind::Camera(Box::new(camera))) }
    }

    /// Drawables without children.
    pub fn geode(drawables: Vec<Drawable>) -> Self {
        Self::new(NodeKind::Geode(drawables))
    }

    /// The same node with a name, by which [`Scene::nodes_named`](super::Scene::nodes_named) finds it.
    pub fn named(mut self, name: &str) -> Self {
        self.name = name.into();
        self
    }

    /// The same node with a state set.
    pub fn with_state_set(mut self, state_set: Arc<StateSet>) -> Self {
        self.state_set = Some(state_set);
        self
    }

    /// The same node with one more child.
    pub fn with_child(mut self, child: Node) -> Self {
        self.children.push(child);
        self
    }
}
