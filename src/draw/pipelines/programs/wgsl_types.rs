//! WGSL's names of types, for comparing uniforms and attributes with a program's declarations.

/// Returns WGSL's name of a scalar type.
pub(super) fn scalar_name(scalar: naga::Scalar) -> &'static str {
    match scalar.kind {
        naga::ScalarKind::Float => "f32",
        naga::ScalarKind::Sint => "i32",
        naga::ScalarKind::Uint => "u32",
        _ => "?",
    }
}

/// Returns WGSL's name of a type; arrays without their length.
pub(super) fn type_name(module: &naga::Module, ty: naga::Handle<naga::Type>) -> String {
    match &module.types[ty].inner {
        naga::TypeInner::Scalar(scalar) => scalar_name(*scalar).into(),
        naga::TypeInner::Vector { size, scalar } => format!("vec{}<{}>", *size as u8, scalar_name(*scalar)),
        naga::TypeInner::Matrix { columns, rows, scalar } => {
            format!("mat{}x{}<{}>", *columns as u8, *rows as u8, scalar_name(*scalar))
        }
        naga::TypeInner::Array { base, .. } => format!("array<{}>", type_name(module, *base)),
        _ => "?".into(),
    }
}
