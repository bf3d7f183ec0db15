//! [`TextureRef`]: a texture with the texture coordinates that it uses.

use glam::{Affine2, Mat2, Vec2};
use serde_json::Value;

/// The extension with the transform of texture coordinates.
pub(super) const TRANSFORM: &str = "KHR_texture_transform";

/// The transform of KHR_texture_transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct UvTransform {
    pub offset: [f32; 2],
    /// Radians, counter-clockwise.
    pub rotation: f32,
    pub scale: [f32; 2],
}

impl UvTransform {
    /// Returns the transform: scale, rotation, then offset.
    pub fn affine(&self) -> Affine2 {
        let (sin, cos) = self.rotation.sin_cos();
        let matrix2 = Mat2::from_cols_array(&[cos, -sin, sin, cos]) * Mat2::from_diagonal(Vec2::from_array(self.scale));
        Affine2 { matrix2, translation: Vec2::from_array(self.offset) }
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

    /// Returns a texture with the object KHR_texture_transform if there is one, whose set replaces `uv_set`.
    pub fn with_extension(texture: usize, uv_set: u32, extension: Option<&Value>) -> Self {
        let own_set = extension.and_then(|of| of.get("texCoord")?.as_u64()).and_then(|set| u32::try_from(set).ok());
        let transform = extension.map(|of| {
            let number = |value: &Value| value.as_f64().map(|number| number as f32);
            let pair = |name: &str| Some([number(of.get(name)?.get(0)?)?, number(of.get(name)?.get(1)?)?]);
            UvTransform {
                offset: pair("offset").unwrap_or([0.0; 2]),
                rotation: of.get("rotation").and_then(number).unwrap_or(0.0),
                scale: pair("scale").unwrap_or([1.0; 2]),
            }
        });
        Self { texture, uv_set: own_set.unwrap_or(uv_set), transform }
    }

    /// Returns true if the other texture uses the same texture coordinates in the same way.
    pub fn has_coordinates_of(&self, other: &Self) -> bool {
        (self.uv_set, self.transform) == (other.uv_set, other.transform)
    }

    /// Returns the transform from the set of texture coordinates to those of the image.
    pub fn affine(&self) -> Affine2 {
        self.transform.map_or(Affine2::IDENTITY, |transform| transform.affine())
    }

    /// Reads a texture reference of an extension: an object with an `index`. Returns `None` for other values.
    pub fn from_json(value: &Value) -> Option<Self> {
        let texture = usize::try_from(value.get("index")?.as_u64()?).ok()?;
        let uv_set = value.get("texCoord").and_then(Value::as_u64).and_then(|set| u32::try_from(set).ok());
        let extension = value.get("extensions").and_then(|extensions| extensions.get(TRANSFORM));
        Some(Self::with_extension(texture, uv_set.unwrap_or(0), extension))
    }
}
