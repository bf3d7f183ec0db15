//! The members of textures, and of the attributes that make their coordinates.

use std::sync::Arc;

use glam::DMat4;

use super::Reader;
use super::attributes::COMPARISONS;
use crate::formats::osg::error::Result;
use crate::formats::osg::input::{GL_NAMES, Names, Number};
use crate::formats::osg::objects::{AttributeObject, ImageObject, TexMatObject, TextureObject, TextureTarget};

/// The modes of a TexGen.
pub(in crate::formats::osg) const TEX_GEN_MODES: Names = &[
    ("OBJECT_LINEAR", 0x2401),
    ("EYE_LINEAR", 0x2400),
    ("SPHERE_MAP", 0x2402),
    ("NORMAL_MAP", 0x8511),
    ("REFLECTION_MAP", 0x8512),
];
/// The planes of a TexGen where the file has none.
pub(in crate::formats::osg) const PLANES: [[f64; 4]; 4] = DMat4::IDENTITY.to_cols_array_2d();

impl Reader<'_> {
    pub(super) fn texture(&mut self, target: TextureTarget) -> Result<AttributeObject> {
        const FORMAT_MODES: Names = &[
            ("USE_IMAGE_DATA_FORMAT", 0),
            ("USE_USER_DEFINED_FORMAT", 1),
            ("USE_ARB_COMPRESSION", 2),
            ("USE_S3TC_DXT1_COMPRESSION", 3),
            ("USE_S3TC_DXT3_COMPRESSION", 4),
            ("USE_S3TC_DXT5_COMPRESSION", 5),
            ("USE_PVRTC_2BPP_COMPRESSION", 6),
            ("USE_PVRTC_4BPP_COMPRESSION", 7),
            ("USE_ETC_COMPRESSION", 8),
            ("USE_RGTC1_COMPRESSION", 9),
            ("USE_RGTC2_COMPRESSION", 10),
            ("USE_S3TC_DXT1c_COMPRESSION", 11),
            ("USE_S3TC_DXT1a_COMPRESSION", 12),
        ];
        const SHADOW_MODES: Names = &[("LUMINANCE", 0x1909), ("INTENSITY", 0x8049), ("ALPHA", 0x1906), ("NONE", 0)];
        self.attribute_members()?;
        let [wrap_s, wrap_t, _] = self.gl_members(["WRAP_S", "WRAP_T", "WRAP_R"], 0x2900)?;
        let [min_filter] = self.gl_members(["MIN_FILTER"], 0x2703)?;
        let [mag_filter] = self.gl_members(["MAG_FILTER"], 0x2601)?;
        self.float_member("MaxAnisotropy", 1.0)?;
        self.boolean_member("UseHardwareMipMapGeneration", true)?;
        self.boolean_member("UnRefImageDataAfterApply", false)?;
        self.boolean_member("ClientStorageHint", false)?;
        self.boolean_member("ResizeNonPowerOfTwoHint", true)?;
        let border_color =
            if self.member("BorderColor")? { self.doubles::<4>()?.map(|part| part as f32) } else { [0.0; 4] };
        self.integer_member("BorderWidth", 0)?;
        self.named_member("InternalFormatMode", FORMAT_MODES, 0)?;
        self.gl_members(["InternalFormat", "SourceFormat", "SourceType"], 0)?;
        self.boolean_member("ShadowComparison", false)?;
        self.named_member("ShadowCompareFunc", COMPARISONS, 0x203)?;
        self.named_member("ShadowTextureMode", SHADOW_MODES, 0x1909)?;
        self.float_member("ShadowAmbient", 0.0)?;
        if (95..154).contains(&self.version) && self.marked_member("ImageAttachment")? {
            for number in [Number::U32, Number::I32, Number::U8, Number::I32, Number::U32, Number::U32] {
                self.input.number(number)?;
            }
        }
        if self.version >= 98 && self.marked_member("Swizzle")? {
            self.input.word()?;
        }
        if self.version >= 155 {
            for name in ["MinLOD", "MaxLOD", "LODBias"] {
                self.float_member(name, 0.0)?;
            }
        }
        let images = match target {
            TextureTarget::Cube => self.faces()?,
            _ => vec![self.image_member("Image")?],
        };
        self.integer_member("TextureWidth", 0)?;
        if target != TextureTarget::D1 {
            self.integer_member("TextureHeight", 0)?;
        }
        if target == TextureTarget::D3 {
            self.integer_member("TextureDepth", 0)?;
        }
        let wrap = [wrap_s, wrap_t];
        let texture = TextureObject { target, wrap, min_filter, mag_filter, border_color, images };
        Ok(AttributeObject::Texture(texture))
    }

    /// Reads OpenGL's constants that are marked in binary.
    fn gl_members<const N: usize>(&mut self, names: [&str; N], default: u32) -> Result<[u32; N]> {
        let mut values = [default; N];
        for (value, name) in values.iter_mut().zip(names) {
            if self.marked_member(name)? {
                *value = self.input.named(GL_NAMES)?;
            }
        }
        Ok(values)
    }

    fn image_member(&mut self, name: &str) -> Result<Option<Arc<ImageObject>>> {
        if !self.member(name)? || !self.input.boolean()? {
            return Ok(None);
        }
        self.in_braces(Self::image)
    }

    /// Reads the faces of a TextureCubeMap.
    fn faces(&mut self) -> Result<Vec<Option<Arc<ImageObject>>>> {
        let mut faces = Vec::with_capacity(6);
        for name in ["PosX", "NegX", "PosY", "NegY", "PosZ", "NegZ"] {
            let is_there = self.marked_member(name)? && self.input.boolean()?;
            faces.push(if is_there { self.block(Self::image)? } else { None });
        }
        Ok(faces)
    }

    pub(super) fn tex_gen(&mut self) -> Result<AttributeObject> {
        self.attribute_members()?;
        let mode = self.named_member("Mode", TEX_GEN_MODES, 0x2401)?;
        let mut planes = PLANES;
        for (plane, name) in planes.iter_mut().zip(["PlaneS", "PlaneT", "PlaneR", "PlaneQ"]) {
            if self.marked_member(name)? {
                *plane = self.doubles()?;
            }
        }
        Ok(AttributeObject::TexGen { mode, planes })
    }

    pub(super) fn tex_mat(&mut self) -> Result<AttributeObject> {
        self.attribute_members()?;
        let matrix = if self.member("Matrix")? { self.matrix()? } else { DMat4::IDENTITY };
        let scales_by_size = self.boolean_member("ScaleByTextureRectangleSize", false)?;
        Ok(AttributeObject::TexMat(TexMatObject { matrix, scales_by_size }))
    }
}
