//! The output of cull: render stages, moved to the draw thread by value and back for reuse. They hold no reference into
//! the scene.

mod counters;
mod drawn_part;
mod leaf;
mod positioned;
mod render_stage;
mod request;
mod target;

pub use counters::CullCounters;
pub use drawn_part::{CutVolume, DrawnPart};
pub use leaf::{RenderBin, RenderLeaf};
pub(super) use positioned::move_texgen;
pub use positioned::{ClipPlane, PositionedLight, PositionedTexGen};
pub(crate) use positioned::{move_light, move_plane};
pub use render_stage::{OcclusionQuery, RenderStage, ShadowCascade, StageShadows, StageView};
pub use request::PageRequest;
pub use target::StageTarget;
