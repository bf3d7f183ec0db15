//! [`StateSet`]: the state of a node and everything below.

use super::attributes::Attribute;
use super::bins::{BinDetails, BinPrototype, SortMode, UnknownBin};
use super::hook::OpaqueDrawData;
use super::modes::{Mode, StateValue};
use super::program::{Uniform, UniformValue};
use super::variance::DataVariance;

/// State for a node and everything below.
///
/// Nodes share sets by reference; one that is shared is not changed any more but replaced, by any thread that builds nodes, or in
/// update. Cull merges the sets above a drawable; a set below wins, unless a flag says otherwise.
///
/// ```
/// use std::sync::Arc;
/// use terrane::scene::Node;
/// use terrane::state::{Mode, StateSet, StateValue};
/// let unlit = StateSet::default().with_mode(Mode::Lighting, StateValue::OFF | StateValue::OVERRIDE);
/// let node = Node::group(Vec::new()).with_state_set(Arc::new(unlit));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct StateSet {
    /// The name in logs and errors; may be empty.
    pub name: String,
    /// The bin of the leaves; `None` inherits. [`Self::set_render_bin_details`] sets it by the name of a prototype.
    pub bin: Option<BinDetails>,
    /// Flags of `bin`: [`StateValue::OVERRIDE`] ignores bins below, unless they are [`StateValue::PROTECTED`].
    pub bin_value: StateValue,
    /// The bin is nested in the bin of the state sets above, and not directly in the stage.
    pub nest_bins: bool,
    /// Draws the bin instead of the renderer (`draw::BinCallback`). Among state sets with the same bin, the callback that
    /// is met first is used.
    pub bin_callback: Option<OpaqueDrawData>,
    /// Linear colour that multiplies every drawable below; `None` changes nothing.
    pub color: Option<[f32; 4]>,
    /// Modes with their flags, see [`Self::set_mode`].
    pub modes: Vec<(Mode, StateValue)>,
    /// Attributes with their flags, see [`Self::set_attribute`].
    pub attributes: Vec<(Attribute, StateValue)>,
    /// Uniforms of programs with their flags, see [`Self::set_uniform`].
    pub uniforms: Vec<(Uniform, StateValue)>,
    /// [`DataVariance::Dynamic`] for a set that will soon be replaced: such sets are not shared between pages unless a pager's
    /// [`ShareModes`](crate::scene::ShareModes) say so.
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
    /// Switches a mode. A later call for the same mode replaces the earlier one.
    pub fn set_mode(&mut self, mode: Mode, value: StateValue) -> &mut Self {
        self.modes.retain(|(m, _)| *m != mode);
        self.modes.push((mode, value));
        self
    }

    /// Sets an attribute without switching its mode. A later one of the same type replaces the earlier one.
    pub fn set_attribute(&mut self, attribute: Attribute, value: StateValue) -> &mut Self {
        self.attributes.retain(|(a, _)| !a.is_same_kind(&attribute));
        self.attributes.push((attribute, value));
        self
    }

    /// Sets an attribute and switches its mode, if it has one, with the same flags.
    pub fn set_attribute_and_modes(&mut self, attribute: Attribute, value: StateValue) -> &mut Self {
        if let Some(mode) = attribute.mode() {
            self.set_mode(mode, value);
        }
        self.set_attribute(attribute, value)
    }

    /// Sets a uniform. A later one of the same name replaces the earlier one.
    pub fn set_uniform(&mut self, name: &str, value: UniformValue, how: StateValue) -> &mut Self {
        self.uniforms.retain(|(u, _)| &*u.name != name);
        self.uniforms.push((Uniform { name: name.into(), value }, how));
        self
    }

    /// Adds a uniform, as a builder.
    pub fn with_uniform(mut self, name: &str, value: UniformValue) -> Self {
        self.set_uniform(name, value, StateValue::ON);
        self
    }

    /// Switches a mode, as a builder.
    pub fn with_mode(mut self, mode: Mode, value: StateValue) -> Self {
        self.set_mode(mode, value);
        self
    }

    /// Adds an attribute with its mode on, as a builder.
    pub fn with(mut self, attribute: Attribute) -> Self {
        self.set_attribute_and_modes(attribute, StateValue::ON);
        self
    }

    /// Sets [`Self::bin`] and [`Self::bin_callback`] by a number and the name of a prototype; an empty name inherits.
    ///
    /// A name that is not registered is an error. The bin is then the one of that number sorted by state.
    pub fn set_render_bin_details(&mut self, number: i32, name: &str) -> Result<&mut Self, UnknownBin> {
        (self.bin, self.bin_callback) = (None, None);
        if name.is_empty() {
            return Ok(self);
        }
        let Some((name, prototype)) = BinPrototype::find(name) else {
            self.bin = Some(BinDetails::new(number, SortMode::ByState));
            return Err(UnknownBin { name: name.to_owned() });
        };
        self.bin = Some(BinDetails { number, sort: prototype.sort, name });
        self.bin_callback = prototype.draw;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::SortKey;

    fn bin(number: i32, name: &str) -> BinDetails {
        let mut set = StateSet::default();
        set.set_render_bin_details(number, name).unwrap();
        set.bin.unwrap()
    }

    #[test]
    fn bins_have_the_names_of_osg_and_registered_ones() {
        assert_eq!(bin(0, "RenderBin"), BinDetails::OPAQUE);
        assert_eq!(bin(10, "DepthSortedBin"), BinDetails::TRANSPARENT);
        assert_eq!(bin(3, "TraversalOrderBin"), BinDetails::new(3, SortMode::TraversalOrder));
        let key = SortMode::ByKey(SortKey::new(|leaf| u64::from(leaf.order)));
        let hook = OpaqueDrawData(std::sync::Arc::new(7));
        BinPrototype::register("bins: by key", BinPrototype { sort: key, draw: Some(hook.clone()) });
        BinPrototype::register("bins: plain", BinPrototype::default());
        let [keyed, plain] = [bin(2, "bins: by key"), bin(2, "bins: plain")];
        assert_eq!((keyed.sort, plain.sort), (key, SortMode::ByState));
        assert!(BinDetails::new(2, SortMode::TraversalOrder).order_key() < keyed.order_key(), "built-in bins first");
        assert!(keyed.order_key() < plain.order_key(), "then in order of registration");
        assert_ne!(plain, bin(2, "RenderBin"), "a separate bin");
        // A prototype of the same name replaces it.
        BinPrototype::register("bins: by key", BinPrototype { sort: SortMode::FrontToBack, draw: None });
        let other = bin(2, "bins: by key");
        assert_eq!((other.sort, other.name), (SortMode::FrontToBack, keyed.name));

        let mut set = StateSet { bin_callback: Some(hook), ..StateSet::default() };
        set.set_render_bin_details(4, "bins: plain").unwrap();
        assert_eq!(set.bin_callback, None);
        let error = set.set_render_bin_details(5, "bins: unknown").unwrap_err();
        assert_eq!(error.to_string(), "no render bin prototype is called \"bins: unknown\"");
        assert_eq!(set.bin, Some(BinDetails::new(5, SortMode::ByState)));
        set.set_render_bin_details(0, "").unwrap();
        assert_eq!(set.bin, None);
    }
}
