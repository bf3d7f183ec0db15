//! Programs of the application: parsed and checked before the device gets them, so that an error is a text and not a lost
//! device. Draw thread.

mod builtin_uniforms;
mod check;
mod compile;
mod heights;
pub(in crate::draw::pipelines) mod inputs;
mod table;
mod texture_units;
mod wgsl_types;

pub(in crate::draw) use builtin_uniforms::Builtins;
pub(in crate::draw) use heights::HEIGHT_ENTRY;
pub(in crate::draw) use table::Programs;
