//! The scene: pages of nodes, and what nodes draw.
//!
//! [`Node`] trees are built anywhere and flattened once into a [`Page`]. A [`Scene`] owns pages: update changes it
//! through `&mut Scene`, cull reads it through `&Scene` from any number of threads.
//!
//! | folder | contents |
//! |---|---|
//! | `nodes` | node values, callbacks, flattening |
//! | `pages` | the flat arrays of a page and their bounds |
//! | `tile_tree` | tiles of a page, content slots, attaching pages, readiness |
//! | `features` | ids of the parts of a mesh, tables of their properties, metadata of tiles |
//! | `geometry` | meshes, height tiles, materials, text |
//! | `sharing` | equal contents of several pages stored once |
//! | `intersect` | intersections with lines and volumes, heights above the terrain |
//! | `settings` | culling, levels of detail, light and air of cameras |

mod callback_pages;
mod credits;
mod draw_kinds;
mod error;
mod features;
mod geometry;
mod graph;
mod id;
mod intersect;
mod nodes;
mod occluder_pages;
mod pages;
mod positions;
mod rewritten_mesh;
mod settings;
mod sharing;
mod sparse_list;
mod tile_tree;

pub use draw_kinds::DrawKind;
pub use error::{MeshError, SceneError};
pub use features::{
    DataTexture, DrawableFeatures, Feature, FeatureIdSet, FeatureIds, Metadata, MetadataClass, PropertyColumn,
    PropertyInfo, PropertyTable, PropertyValue, SurfacePoint, SurfaceProperty, TileMetadata,
};
#[cfg(feature = "text")]
pub use geometry::Font;
pub use geometry::{
    AlphaMode, AttributeFormat, BlockFormats, Clearcoat, CustomGeometry, Dielectric, Drawable, Geometry, HeightTile,
    MAX_ATTRIBUTES, MORPH_LEVELS, MapParts, Material, Mesh, MeshVertex, MetallicRoughness, NormalCone, OverlayMode,
    PrimitiveMode, Sampling, SecondUv, Splat, SplatHarmonics, Splats, TexelFormat, Texture, Topology, VertexAttributes,
    VertexFormat,
};
pub use graph::Scene;
pub use id::{NodeId, PageId, SceneNumber};
pub use intersect::{
    Dimensions, EyePoint, GroundPoint, GroundSnapshot, HeightQuery, Intersection, IntersectionLimit,
    IntersectionVisitor, Intersector, KdTree, LineSegmentIntersector, LodSelection, PolytopeIntersector,
    RayIntersector, Vertical, WindowView,
};
pub use nodes::{
    Attachment, AutoScale, Billboard, BillboardMode, CallbackStateSet, CameraNode, CameraTarget, ClampProjection,
    ClearNode, ClipNode, ConvexPlanarOccluder, CullAction, CullCallback, CullInfo, CullPass, EventCallback,
    LightSource, LocalLights, MAX_DEPTH, Node, NodeCallback, NodeKind, OcclusionQueryNode, OcclusionResults, PagedLod,
    PagingOptions, Picture, PictureSink, ProxyLoading, ProxyNode, RangeMode, ReaderData, ReaderValue, ReferenceFrame,
    Refine, RenderOrder, TexGenNode, Traverse, UpdateCallback, UpdateInfo,
};
pub use pages::{DrawSlot, Page};
pub use settings::{
    CameraEnvironment, CameraShadows, ComputeNearFar, CullSettings, CullingMode, DistanceFog, Environment, Inherit,
    MAX_CASCADES, SMALL_FEATURE_PX, ShadowError, Sky, SunShadows, ToneMapping, Water,
};
pub use sharing::{ContentKey, ShareModes, SharedStateManager, SharingStats};
pub use tile_tree::{SlotInfo, SlotState, TileInfo};

pub(crate) use features::{Column, SurfaceValues, ValueDecoder};
#[cfg(test)]
pub(crate) use geometry::SPLAT_SIGMAS;
#[cfg(feature = "text")]
pub(crate) use geometry::coverage_texture;
pub(crate) use geometry::{AttributeLayout, SMALL_MESH_INDICES, added_stride};
pub(crate) use id::NONE;
pub(crate) use nodes::ReadBack;
pub(crate) use occluder_pages::OccluderPage;
pub(crate) use pages::{
    BLEND, CALLBACK, INACTIVE, LARGE, OccluderRecord, RareNode, SIMPLE_SUBTREE, SingleDrawable, UNBOUNDED, UNCULLED,
    VIEW, kind,
};
pub(crate) use settings::{LodRanges, MORPH_START, has_parallel_rays, px_per_radian};
pub(crate) use sharing::{SharedContent, SharedParts};
pub(crate) use tile_tree::{
    ContentShape, GroundTiles, Readiness, TileBounds, TileEye, TileRecord, TileRoot, Tiles, flag,
};
