//! Nodes: the values that graphs are built of, their callbacks, and the step that flattens them into pages.

mod billboard;
mod callback;
mod callback_traversal;
mod camera_node;
mod flatten;
mod mesh_changes;
mod node;
mod node_payloads;
mod occlusion_query;
mod paged_lod;
mod readback_image;
mod reader_data;

pub use billboard::{AutoScale, Billboard, BillboardMode};
pub use callback::{CallbackStateSet, EventCallback, NodeCallback, Traverse, UpdateCallback, UpdateInfo};
pub use camera_node::{Attachment, CameraNode, CameraTarget, ClampProjection, RenderOrder};
pub use flatten::MAX_DEPTH;
pub use node::{Node, NodeKind};
pub use node_payloads::{
    ClearNode, ClipNode, ConvexPlanarOccluder, CullAction, CullCallback, CullInfo, CullPass, LightSource, LocalLights,
    ReferenceFrame, TexGenNode,
};
pub use occlusion_query::{OcclusionQueryNode, OcclusionResults};
pub use paged_lod::{PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, Refine};
pub use readback_image::{Picture, PictureSink};
pub use reader_data::{ReaderData, ReaderValue};

pub(crate) use readback_image::ReadBack;
