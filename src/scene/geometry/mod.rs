//! Geometry: shapes, materials and textures as plain CPU data.
//!
//! Decode workers fill it on any thread; the draw thread reads it once when it uploads a page.

mod attribute_format;
mod drawable;
mod height_tile;
mod material;
mod mesh;
mod normal_cone;
mod primitive_modes;
mod shape;
mod shapes;
mod splats;
#[cfg(feature = "text")]
mod text;
mod texture;
mod vertex_attributes;

pub use attribute_format::AttributeFormat;
pub use drawable::Drawable;
pub use height_tile::{HeightTile, MORPH_LEVELS};
pub use material::{AlphaMode, Clearcoat, Dielectric, MapParts, Material, MetallicRoughness, OverlayMode, SecondUv};
pub use mesh::{Mesh, MeshVertex, Topology, VertexFormat};
pub use normal_cone::NormalCone;
pub use primitive_modes::PrimitiveMode;
pub use shape::{CustomGeometry, Geometry};
pub use splats::{Splat, SplatHarmonics, Splats};
#[cfg(feature = "text")]
pub use text::Font;
pub use texture::{BlockFormats, Sampling, TexelFormat, Texture};
pub use vertex_attributes::{MAX_ATTRIBUTES, VertexAttributes};

pub(crate) use mesh::SMALL_MESH_INDICES;
#[cfg(test)]
pub(crate) use splats::SPLAT_SIGMAS;
#[cfg(feature = "text")]
pub(crate) use text::coverage_texture;
pub(crate) use vertex_attributes::{AttributeLayout, added_stride};
