//! Formats of vertex attributes, with the names that wgpu gives them. Plain values.

/// The memory layout of an attribute's elements, with wgpu's names. Programs read `Float`, `Unorm` and `Snorm` as f32, `Uint`
/// as u32 and `Sint` as i32.
#[allow(missing_docs, reason = "wgpu's names")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum AttributeFormat {
    Uint8x4,
    Sint8x4,
    Unorm8x4,
    Snorm8x4,
    Uint16x2,
    Uint16x4,
    Sint16x2,
    Sint16x4,
    Unorm16x2,
    Unorm16x4,
    Snorm16x2,
    Snorm16x4,
    Float16x2,
    Float16x4,
    Float32,
    Float32x2,
    Float32x3,
    Float32x4,
    Uint32,
    Uint32x2,
    Uint32x3,
    Uint32x4,
    Sint32,
    Sint32x2,
    Sint32x3,
    Sint32x4,
}

impl AttributeFormat {
    /// Returns the bytes of an element, a multiple of four.
    pub const fn size_bytes(self) -> usize {
        use AttributeFormat::*;
        match self {
            Uint8x4 | Sint8x4 | Unorm8x4 | Snorm8x4 => 4,
            Uint16x2 | Sint16x2 | Unorm16x2 | Snorm16x2 | Float16x2 => 4,
            Uint16x4 | Sint16x4 | Unorm16x4 | Snorm16x4 | Float16x4 => 8,
            Float32 | Uint32 | Sint32 => 4,
            Float32x2 | Uint32x2 | Sint32x2 => 8,
            Float32x3 | Uint32x3 | Sint32x3 => 12,
            Float32x4 | Uint32x4 | Sint32x4 => 16,
        }
    }

    /// Returns WGSL's name of the scalar type that programs read.
    pub const fn scalar(self) -> &'static str {
        use AttributeFormat::*;
        match self {
            Uint8x4 | Uint16x2 | Uint16x4 | Uint32 | Uint32x2 | Uint32x3 | Uint32x4 => "u32",
            Sint8x4 | Sint16x2 | Sint16x4 | Sint32 | Sint32x2 | Sint32x3 | Sint32x4 => "i32",
            Unorm8x4 | Snorm8x4 | Unorm16x2 | Unorm16x4 | Snorm16x2 | Snorm16x4 => "f32",
            Float16x2 | Float16x4 | Float32 | Float32x2 | Float32x3 | Float32x4 => "f32",
        }
    }
}
