//! State sets: how things are drawn, shared by identity.
//!
//! A state set holds modes and attributes, each with the flags that say how it meets what others say
//! ([`StateValue`]). Cull resolves the chain of state sets above a drawable ([`ResolvedState`]); draw makes pipelines
//! of what comes out. Knows no wgpu.

mod attributes;
mod bins;
mod hook;
mod lighting;
mod program;
mod resolved;
mod texture;
mod variance;

pub use attributes::{
    AlphaFunc, Attribute, BlendEquation, BlendFactor, BlendFunc, CLIP_PLANES, ColorMask, CompareFunction, CullFace,
    Depth, FrontFace, LIGHTS, Mode, NumberError, PolygonMode, PolygonOffset, Scissor, StateValue, Stencil, StencilFace,
    StencilOperation, TEXTURE_UNITS, TexGen, Viewport,
};
pub use bins::{BinDetails, BinName, BinPrototype, SortKey, SortLeaf, SortMode, UnknownBin};
pub use hook::DrawHook;
pub use lighting::{ColorControl, Fog, FogMode, Light, LightModel, SurfaceMaterial};
pub use program::{Program, Uniform, UniformValue};
pub use resolved::ResolvedState;
pub(crate) use texture::CLAMPED;
pub use texture::{FilterMode, Sampler, TextureBinding, TextureDimension, TextureFormat, TextureObject, WrapMode};
pub use variance::DataVariance;

/// State for a node and below.
#[derive(Clone, Debug, PartialEq)]
pub struct StateSet {
    /// For people, and for errors; may be empty.
    pub name: String,
    /// Bin the leaves go to; `None` inherits. By the name of a prototype: [`Self::set_render_bin_details`].
    pub bin: Option<BinDetails>,
    /// With [`StateValue::OVERRIDE`] bins given below do not count, unless they are [`StateValue::PROTECTED`].
    pub bin_value: StateValue,
    /// The bin is a bin inside that of the state sets above, and not one of the stage.
    pub nest_bins: bool,
    /// Draws that bin in place of the renderer (`draw::BinCallback`); of the state sets that name the same bin, the
    /// first met that has one counts.
    pub bin_callback: Option<DrawHook>,
    /// Linear colour factor multiplied into every drawable below; `None` inherits.
    pub color: Option<[f32; 4]>,
    /// What is switched, see [`Self::set_mode`].
    pub modes: Vec<(Mode, StateValue)>,
    /// What is given, see [`Self::set_attribute`].
    pub attributes: Vec<(Attribute, StateValue)>,
    /// Values for programs, see [`Self::set_uniform`].
    pub uniforms: Vec<(Uniform, StateValue)>,
    /// [`DataVariance::Dynamic`] where another set is soon to take its place: such sets are not shared between pages
    /// unless a pager's [`ShareModes`](crate::scene::ShareModes) say so.
    pub data_variance: DataVariance,
}

impl Default for StateSet {
    fn default() -> Self {
        Self {
            name: String::new(),
            bin: None,
            bin_value: StateValue::ON,
            nest_bins: true,
            bin_callback: None,
            color: None,
            modes: Vec::new(),
            attributes: Vec::new(),
            uniforms: Vec::new(),
            data_variance: DataVariance::Static,
        }
    }
}

impl StateSet {
    /// Switches a mode; a second time replaces the first.
    pub fn set_mode(&mut self, mode: Mode, value: StateValue) -> &mut Self {
        self.modes.retain(|(m, _)| *m != mode);
        self.modes.push((mode, value));
        self
    }

    /// Gives an attribute without switching its mode; a second of its type replaces the first.
    pub fn set_attribute(&mut self, attribute: Attribute, value: StateValue) -> &mut Self {
        self.attributes.retain(|(a, _)| !a.is_same_kind(&attribute));
        self.attributes.push((attribute, value));
        self
    }

    /// Gives an attribute and switches its mode, where it has one, with the same value.
    pub fn set_attribute_and_modes(&mut self, attribute: Attribute, value: StateValue) -> &mut Self {
        if let Some(mode) = attribute.mode() {
            self.set_mode(mode, value);
        }
        self.set_attribute(attribute, value)
    }

    /// Gives a uniform; a second of its name replaces the first.
    pub fn set_uniform(&mut self, name: &str, value: UniformValue, how: StateValue) -> &mut Self {
        self.uniforms.retain(|(u, _)| &*u.name != name);
        self.uniforms.push((Uniform { name: name.into(), value }, how));
        self
    }

    /// The same set with a uniform, for building.
    pub fn with_uniform(mut self, name: &str, value: UniformValue) -> Self {
        self.set_uniform(name, value, StateValue::ON);
        self
    }

    /// The same set with a mode switched, for building.
    pub fn with_mode(mut self, mode: Mode, value: StateValue) -> Self {
        self.set_mode(mode, value);
        self
    }

    /// The same set with an attribute and its mode on, for building.
    pub fn with(mut self, attribute: Attribute) -> Self {
        self.set_attribute_and_modes(attribute, StateValue::ON);
        self
    }
}
