//! The custom attributes that programs read. Draw thread.

use super::wgsl_types::{scalar_name, type_name};

/// The first location after those of a `MeshVertex`.
const FIRST_LOCATION: u32 = 4;

/// An input of a program's vertex entry point beside a `MeshVertex`: a custom attribute.
#[derive(Debug)]
pub(in crate::draw::pipelines) struct Input {
    /// The name of the argument, or of the member of a struct.
    pub(in crate::draw::pipelines) name: String,
    pub(in crate::draw::pipelines) location: u32,
    /// WGSL's name of the scalar type.
    pub(in crate::draw::pipelines) scalar: &'static str,
    /// WGSL's name of the type.
    pub(in crate::draw::pipelines) type_name: String,
}

/// Returns the custom attributes that a vertex entry point reads.
pub(super) fn inputs_of(module: &naga::Module, entry: &naga::EntryPoint) -> Vec<Input> {
    let mut inputs = Vec::new();
    let mut add = |name: &Option<String>, ty: naga::Handle<naga::Type>, binding: &Option<naga::Binding>| {
        let Some(naga::Binding::Location { location, .. }) = *binding else { return };
        let (naga::TypeInner::Scalar(scalar) | naga::TypeInner::Vector { scalar, .. }) = module.types[ty].inner else {
            return;
        };
        if location >= FIRST_LOCATION {
            let (scalar, type_name) = (scalar_name(scalar), type_name(module, ty));
            inputs.push(Input { name: name.clone().unwrap_or_default(), location, scalar, type_name });
        }
    };
    for argument in &entry.function.arguments {
        match &module.types[argument.ty].inner {
            naga::TypeInner::Struct { members, .. } => members.iter().for_each(|m| add(&m.name, m.ty, &m.binding)),
            _ => add(&argument.name, argument.ty, &argument.binding),
        }
    }
    inputs
}
