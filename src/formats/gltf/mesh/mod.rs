//! Meshes of a glTF as drawables.
//!
//! [`PrimitiveData`](primitive::PrimitiveData) gives access to the attributes of a primitive, [`vertices`] assembles them,
//! [`deform`] applies morph targets and skins, [`outline`] adds lines, and [`MeshReader`] builds the drawables.

mod attributes;
mod deform;
mod draco;
mod outline;
mod primitive;
mod reader;
mod skin;
mod vertices;

pub(super) use reader::MeshReader;
pub(super) use skin::SkinPose;
