//! State sets: how drawables are drawn, shared by identity. Plain data, any thread.
//!
//! A state set holds modes and attributes, each with flags for inheritance and override ([`StateValue`]). Cull resolves
//! the chain of state sets above a drawable ([`ResolvedState`]), and draw creates pipelines from the result. This folder
//! knows no wgpu.

mod attributes;
mod bins;
mod hook;
mod lighting;
mod modes;
mod program;
mod raster;
mod resolved;
mod state_set;
mod texgen;
mod texture;
mod variance;

pub use attributes::Attribute;
pub use bins::{BinDetails, BinName, BinPrototype, SortKey, SortLeaf, SortMode, UnknownBin};
pub use hook::OpaqueDrawData;
pub use lighting::{ColorControl, Fog, FogMode, Light, LightModel, SurfaceMaterial};
pub use modes::{CLIP_PLANES, LIGHTS, Mode, NumberError, StateValue, TEXTURE_UNITS};
pub use program::{Program, Uniform, UniformValue};
pub use raster::{
    AlphaFunc, BlendEquation, BlendFactor, BlendFunc, ColorMask, CompareFunction, CullFace, Depth, FrontFace,
    PolygonMode, PolygonOffset, Scissor, Stencil, StencilFace, StencilOperation, Viewport,
};
pub use resolved::ResolvedState;
pub use state_set::StateSet;
pub use texgen::TexGen;
pub use texture::{FilterMode, Sampler, TextureBinding, TextureDimension, TextureFormat, TextureObject, WrapMode};
pub use variance::DataVariance;
