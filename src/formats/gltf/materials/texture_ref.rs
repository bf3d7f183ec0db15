//! [`TextureRef`]: a texture with the texture coordinates that it uses.

use serde_json::Value;

/// The transform of KHR_texture_transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct UvTransform {
    pub offset: [f32; 2],
    /// Radians, counter-clockwise.
    pub rotation: f32,
    pub scale: [f32; 2],
}

impl UvTransform {
    /// Returns a function that applies the transform: scale, rotation, then offset.
    pub fn map(&self) -> impl Fn([f32; 2]) -> [f32; 2] + use<> {
        let Self { offset: [ox, oy], rotation, scale: [sx, sy] } = *self;
        let (sin, cos) = rotation.sin_cos();
        move |uv| {
            let [u, v] = [uv[0] * sx, uv[1] * sy];
            [u * cos + v * sin + ox, v * cos - u * sin + oy]
        }
    }
}

/// A texture and its texture coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct TextureRef {
    /// The index of the texture.
    pub texture: usize,
    /// The set of texture coordinates.
    pub uv_set: u32,
    pub transform: Option<UvTransform>,
}

impl TextureRef {
    pub fn new(info: &gltf::texture::Info<'_>) -> Self {
        let transform = info.texture_transform();
        let uv_set = transform.as_ref().and_then(|t| t.tex_coord()).unwrap_or_else(|| info.tex_coord());
        let transform = transform.map(|t| UvTransform { offset: t.offset(), rotation: t.rotation(), scale: t.scale() });
        Self { texture: info.texture().index(), uv_set, transform }
    }

    /// Returns a texture without a transform.
    pub fn plain(texture: usize, uv_set: u32) -> Self {
        Self { texture, uv_set, transform: None }
    }

    /// Returns true if the other texture uses the same texture coordinates in the same way.
    pub fn has_coordinates_of(&self, other: &Self) -> bool {
        (self.uv_set, self.transform) == (other.uv_set, other.transform)
    }

    /// Reads a texture reference of an extension: an object with an `index`. Returns `None` for other values.
    pub fn from_json(value: &Value) -> Option<Self> {
        let texture = usize::try_from(value.get("index")?.as_u64()?).ok()?;
        let uv_set = value.get("texCoord").and_then(Value::as_u64).and_then(|set| u32::try_from(set).ok()).unwrap_or(0);
        Some(Self { texture, uv_set, transform: None })
    }
}
