//! Conversions from the enums of state sets to wgpu's. Plain values.

use crate::gpu::compare_function;
use crate::state::{BlendEquation, BlendFactor, CompareFunction, PolygonOffset, StencilFace, StencilOperation};

pub(super) fn stencil_face(face: &StencilFace) -> wgpu::StencilFaceState {
    let operation = |operation| match operation {
        StencilOperation::Keep => wgpu::StencilOperation::Keep,
        StencilOperation::Zero => wgpu::StencilOperation::Zero,
        StencilOperation::Replace => wgpu::StencilOperation::Replace,
        StencilOperation::Invert => wgpu::StencilOperation::Invert,
        StencilOperation::Increment => wgpu::StencilOperation::IncrementClamp,
        StencilOperation::Decrement => wgpu::StencilOperation::DecrementClamp,
        StencilOperation::IncrementWrap => wgpu::StencilOperation::IncrementWrap,
        StencilOperation::DecrementWrap => wgpu::StencilOperation::DecrementWrap,
    };
    wgpu::StencilFaceState {
        compare: compare_function(face.function),
        fail_op: operation(face.fail),
        depth_fail_op: operation(face.depth_fail),
        pass_op: operation(face.pass),
    }
}

/// Converts a depth test. Depths are stored reversed, so that nearer is greater.
pub(super) fn reversed(function: CompareFunction) -> wgpu::CompareFunction {
    match function {
        CompareFunction::Never => wgpu::CompareFunction::Never,
        CompareFunction::Less => wgpu::CompareFunction::Greater,
        CompareFunction::Equal => wgpu::CompareFunction::Equal,
        CompareFunction::LessOrEqual => wgpu::CompareFunction::GreaterEqual,
        CompareFunction::Greater => wgpu::CompareFunction::Less,
        CompareFunction::NotEqual => wgpu::CompareFunction::NotEqual,
        CompareFunction::GreaterOrEqual => wgpu::CompareFunction::LessEqual,
        CompareFunction::Always => wgpu::CompareFunction::Always,
    }
}

/// Converts a polygon offset. Depths are stored reversed, so that an offset away from the eye is negative.
pub(super) fn bias(offset: PolygonOffset) -> wgpu::DepthBiasState {
    wgpu::DepthBiasState { constant: (-offset.units) as i32, slope_scale: -offset.factor, clamp: 0.0 }
}

pub(super) fn factor(factor: BlendFactor) -> wgpu::BlendFactor {
    match factor {
        BlendFactor::Zero => wgpu::BlendFactor::Zero,
        BlendFactor::One => wgpu::BlendFactor::One,
        BlendFactor::SrcColor => wgpu::BlendFactor::Src,
        BlendFactor::OneMinusSrcColor => wgpu::BlendFactor::OneMinusSrc,
        BlendFactor::SrcAlpha => wgpu::BlendFactor::SrcAlpha,
        BlendFactor::OneMinusSrcAlpha => wgpu::BlendFactor::OneMinusSrcAlpha,
        BlendFactor::DstColor => wgpu::BlendFactor::Dst,
        BlendFactor::OneMinusDstColor => wgpu::BlendFactor::OneMinusDst,
        BlendFactor::DstAlpha => wgpu::BlendFactor::DstAlpha,
        BlendFactor::OneMinusDstAlpha => wgpu::BlendFactor::OneMinusDstAlpha,
        BlendFactor::SrcAlphaSaturate => wgpu::BlendFactor::SrcAlphaSaturated,
        // The constant itself is its alpha in all components where factors ask for that.
        BlendFactor::ConstantColor | BlendFactor::ConstantAlpha => wgpu::BlendFactor::Constant,
        BlendFactor::OneMinusConstantColor | BlendFactor::OneMinusConstantAlpha => wgpu::BlendFactor::OneMinusConstant,
    }
}

pub(super) fn operation(equation: BlendEquation) -> wgpu::BlendOperation {
    match equation {
        BlendEquation::Add => wgpu::BlendOperation::Add,
        BlendEquation::Subtract => wgpu::BlendOperation::Subtract,
        BlendEquation::ReverseSubtract => wgpu::BlendOperation::ReverseSubtract,
        BlendEquation::Min => wgpu::BlendOperation::Min,
        BlendEquation::Max => wgpu::BlendOperation::Max,
    }
}

/// Returns a stencil test that sets the stencil to 0; none for formats without stencil.
pub(super) fn zeroed(format: wgpu::TextureFormat) -> wgpu::StencilState {
    if !format.has_stencil_aspect() {
        return wgpu::StencilState::default();
    }
    let zero = wgpu::StencilOperation::Zero;
    let compare = wgpu::CompareFunction::Always;
    let face = wgpu::StencilFaceState { compare, fail_op: zero, depth_fail_op: zero, pass_op: zero };
    wgpu::StencilState { front: face, back: face, read_mask: 0xff, write_mask: 0xff }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_out_of_range_are_clamped() {
        let constant = |units| bias(PolygonOffset { factor: 1.0, units }).constant;
        assert_eq!([0.0, 1.0, -2.9].map(constant), [0, -1, 2]);
        assert_eq!([1e30, f32::INFINITY, i32::MAX as f32].map(constant), [i32::MIN; 3]);
        assert_eq!([-1e30, f32::NEG_INFINITY, i32::MIN as f32].map(constant), [i32::MAX; 3]);
        assert_eq!(constant(f32::NAN), 0);
    }
}
