//! Materials and textures of a glTF, reduced to what [`Material`](crate::scene::Material) holds.
//!
//! [`Surface`] is the reduced material before its texture is decoded. Properties that shading does not use yet are read here
//! and noted; a material with more maps adds its fields to [`Surface`].

mod surface;
mod surfaces;
mod techniques;
mod texture_ref;
mod textures;

pub(super) use surfaces::Surfaces;
pub(super) use texture_ref::TextureRef;
