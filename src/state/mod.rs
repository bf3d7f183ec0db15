//! State sets: how drawables are drawn, shared by identity. Plain data, any thread.
//!
//! A state set holds modes and attributes, each with flags for inheritance and override ([`StateValue`]). Cull resolves
//! the chain of state sets above a drawable ([`ResolvedState`]), and draw creates pipelines from the result. This folder
//! knows no wgpu.

mod attributes;
mod bins;
mod hook;
mod inherited;
mod lighting;
mod modes;
mod program;
mod raster;
mod resolved;
mod state_set;
mod texture;
mod texture_units;
mod variance;

pub use attributes::Attribute;
pub use bins::{BinDetails, BinName, BinPrototype, SortKey, SortLeaf, SortMode, UnknownBin};
pub use hook::OpaqueDrawData;
pub use lighting::{ColorControl, Fog, FogMode, Light, LightModel, SurfaceMaterial};
pub use modes::{CLIP_PLANES, COLOR_LOCATIONS, LIGHTS, Mode, NumberError, StateValue, TEXTURE_UNITS};
pub use program::{Program, Uniform, UniformValue};
pub use raster::{
    AlphaFunc, BlendEquation, BlendFactor, BlendFunc, ColorMask, CompareFunction, CullFace, Depth, FrontFace,
    PolygonMode, PolygonOffset, SampleMask, Scissor, Stencil, StencilFace, StencilOperation, Viewport,
};
pub use resolved::ResolvedState;
pub use state_set::StateSet;
pub use texture::{FilterMode, Sampler, TextureBinding, TextureDimension, TextureFormat, TextureObject, WrapMode};
pub use texture_units::{CombineFunction, CombineOperand, CombineSource, TexEnv, TexEnvCombine, TexGen};
pub use variance::DataVariance;
