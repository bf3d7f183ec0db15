//! The scene: pages of nodes, and what nodes draw.
//!
//! [`Node`] trees are built anywhere and flattened once into a [`Page`]. A [`Scene`] owns pages: update changes it
//! through `&mut Scene`, cull reads it through `&Scene` from any number of threads.

mod callbacks;
mod cull_settings;
mod draw_kinds;
mod environment;
mod error;
mod external_volumes;
mod flatten;
mod geometry;
mod graph;
mod id;
mod intersect;
mod kinds;
mod lod_ranges;
mod lone;
mod node;
mod occluders;
mod page;
mod page_bounds;
mod pictures;
mod primitive_modes;
mod shapes;
mod shared;
mod slots;
mod sun_shadows;
#[cfg(feature = "text")]
mod text;
mod tile_bounds;
mod tiles;
mod transforms;
mod variance;
mod vertex_attributes;
mod world;

pub use callbacks::{EventCallback, Traverse, UpdateCallback, UpdateInfo};
pub use cull_settings::{ComputeNearFar, CullSettings, CullingMode, Inherit, SMALL_FEATURE_PX};
pub use draw_kinds::DrawKind;
pub(crate) use environment::is_over_globe;
pub use environment::{CameraEnvironment, CameraShadows, Environment, Fog, Sky, Water};
pub use error::{MeshError, SceneError};
pub use flatten::MAX_DEPTH;
pub use geometry::{
    AlphaMode, CustomGeometry, Drawable, Geometry, HeightTile, Material, Mesh, MeshVertex, Texture, Topology,
    VertexFormat,
};
pub use graph::Scene;
pub use id::{NodeId, PageId, SceneNumber};
pub use intersect::{
    Dimensions, EyePoint, GroundPoint, GroundSnapshot, HeightQuery, Intersection, IntersectionLimit,
    IntersectionVisitor, Intersector, KdTree, LineSegmentIntersector, LodSelection, PolytopeIntersector,
    RayIntersector, Vertical, WindowView,
};
pub use kinds::{
    Attachment, Billboard, BillboardMode, CameraNode, CameraTarget, ClampProjection, ClearNode, ClipNode,
    ConvexPlanarOccluder, CullAction, CullCallback, CullInfo, DrawHook, LightSource, NormalCone, OcclusionQueryNode,
    OcclusionResults, ReferenceFrame, RenderOrder, TexGenNode,
};
pub use node::{Node, NodeKind, PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, Refine};
pub use page::{DrawSlot, Page};
pub(crate) use pictures::ReadBack;
pub use pictures::{Picture, PictureSink};
pub use primitive_modes::PrimitiveMode;
pub use shared::{ContentKey, ShareModes, SharedStateManager, SharingStats};
pub use slots::{SlotInfo, SlotState};
pub use sun_shadows::{MOST_CASCADES, ShadowError, SunShadows};
#[cfg(feature = "text")]
pub use text::Font;
pub use vertex_attributes::{AttributeFormat, MOST_ATTRIBUTES, VertexAttributes};
pub use world::TileInfo;

pub use crate::state::DataVariance;

pub(crate) use draw_kinds::SMALL_MESH_INDICES;
pub(crate) use lod_ranges::{LodRanges, MORPH_START, has_parallel_rays, px_per_radian};
pub(crate) use lone::LoneDrawable;
pub(crate) use occluders::OccluderPage;
pub(crate) use page::{BLEND, CALLBACK, INACTIVE, LARGE, NONE, PLAIN, Special, UNBOUNDED, UNCULLED, VIEW, kind};
pub(crate) use shared::{SharedContent, SharedParts};
pub(crate) use tile_bounds::{TileBounds, TileEye};
pub(crate) use tiles::{TileRecord, TileRoot, Tiles, flag};
pub(crate) use vertex_attributes::{AttributeLayout, added_stride};
