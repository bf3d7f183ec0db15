//! Materials and textures of a glTF, reduced to what [`Material`](crate::scene::Material) holds.
//!
//! [`Surface`] is the reduced material before its textures are decoded, with its [`Reflection`] if it is not matte and the
//! [`Layers`] of it. Properties that are not drawn are noted.

mod layers;
mod reflection;
mod specular_glossiness;
mod surface;
mod surfaces;
mod techniques;
mod texture_ref;
mod textures;

pub(super) use surfaces::Surfaces;
pub(super) use texture_ref::TextureRef;
