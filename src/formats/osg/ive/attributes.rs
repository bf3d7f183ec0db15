//! State attributes.

use std::sync::Arc;

use glam::DMat4;

use super::{Kind, Reader, ids};
use crate::formats::osg::classes::{PLANES, PROGRAMS};
use crate::formats::osg::error::Result;
use crate::formats::osg::objects::{
    AttributeObject, ClipPlaneObject, CombineObject, CombinePart, FogObject, ImageObject, LightModelObject,
    LightObject, MaterialObject, Object, TexMatObject, TextureObject, TextureTarget,
};

impl Reader<'_> {
    /// Reads a state attribute. Those that are read over are counted.
    pub(super) fn attribute(&mut self) -> Result<Object> {
        self.shared(Kind::Attribute, |reader| {
            let class = reader.class()?;
            let object = reader.attribute_in_place()?;
            match object {
                Object::Nothing if class == ids::PROGRAM => reader.notes.add(PROGRAMS),
                Object::Nothing => reader.note_class(class),
                _ => {}
            }
            Ok(object)
        })
    }

    /// Reads a state attribute without a number; [`Object::Nothing`] for those that are read over.
    pub(super) fn attribute_in_place(&mut self) -> Result<Object> {
        let class = self.unsigned()?;
        let attribute = match class {
            ids::TEXTURE_1D => Some(self.texture(TextureTarget::D1)?),
            ids::TEXTURE_2D => Some(self.texture(TextureTarget::D2)?),
            ids::TEXTURE_RECTANGLE => Some(self.texture(TextureTarget::Rectangle)?),
            ids::TEXTURE_CUBE_MAP => Some(self.texture(TextureTarget::Cube)?),
            ids::TEXTURE_3D => Some(self.texture(TextureTarget::D3)?),
            ids::TEXTURE_2D_ARRAY => {
                self.texture_members()?;
                let [_width, _height, depth, _levels] = self.integers()?;
                for _ in 0..(depth as i32).max(0) {
                    self.image()?;
                }
                None
            }
            _ => {
                self.object_members()?;
                self.drawn_attribute(class)?
            }
        };
        Ok(attribute.map_or(Object::Nothing, |attribute| Object::Attribute(Arc::new(attribute))))
    }

    /// Reads the members of a class behind those of Object.
    fn drawn_attribute(&mut self, class: u32) -> Result<Option<AttributeObject>> {
        Ok(Some(match class {
            ids::MATERIAL => self.material()?,
            ids::ALPHA_FUNC => AttributeObject::AlphaFunc { function: self.unsigned()?, reference: self.float()? },
            ids::BLEND_FUNC => {
                let [source, destination] = self.integers()?;
                AttributeObject::BlendFunc([source, destination, source, destination])
            }
            ids::BLEND_FUNC_SEPARATE => {
                let [source, destination, source_alpha, destination_alpha] = self.integers()?;
                AttributeObject::BlendFunc([source, destination, source_alpha, destination_alpha])
            }
            ids::CULL_FACE => AttributeObject::CullFace(self.unsigned()?),
            ids::FRONT_FACE => AttributeObject::FrontFace(self.unsigned()?),
            ids::DEPTH => {
                let (function, write) = (self.unsigned()?, self.boolean()?);
                AttributeObject::Depth { function, range: self.floats()?.map(f64::from), write }
            }
            ids::POLYGON_OFFSET => AttributeObject::PolygonOffset { factor: self.float()?, units: self.float()? },
            ids::COLOR_MASK => {
                let mut mask = [true; 4];
                for is_written in &mut mask {
                    *is_written = self.boolean()?;
                }
                AttributeObject::ColorMask(mask)
            }
            ids::TEX_ENV => AttributeObject::TexEnv { mode: self.unsigned()?, color: self.floats()? },
            ids::TEX_ENV_COMBINE => self.combine()?,
            ids::TEX_GEN => {
                let mode = self.unsigned()?;
                let mut planes = PLANES;
                if self.version >= 5 {
                    for plane in &mut planes {
                        let is_of_floats = self.version <= 18;
                        *plane = if is_of_floats { self.floats()?.map(f64::from) } else { self.doubles()? };
                    }
                }
                AttributeObject::TexGen { mode, planes }
            }
            ids::TEX_MAT => {
                let matrix = DMat4::from_cols_array(&self.floats()?.map(f64::from));
                let scales_by_size = self.version >= 17 && self.boolean()?;
                AttributeObject::TexMat(TexMatObject { matrix, scales_by_size })
            }
            ids::SHADE_MODEL => {
                self.unsigned()?;
                AttributeObject::Other("ShadeModel")
            }
            ids::LINE_WIDTH => {
                self.float()?;
                AttributeObject::Other("LineWidth")
            }
            ids::POINT => {
                // The fade threshold is after the size, and the limits of the size are at the end.
                let [size_px, _, a, b, c, _, _] = self.floats()?;
                AttributeObject::of_point(size_px, [a, b, c])
            }
            _ => return self.lighting(class),
        }))
    }

    /// Reads the members of lights, clip planes, fog and further attributes of pixels; `None` for classes that are read over.
    fn lighting(&mut self, class: u32) -> Result<Option<AttributeObject>> {
        Ok(Some(match class {
            ids::LIGHT_MODEL => {
                let (two_sided, local_viewer) = (self.boolean()?, self.boolean()?);
                let ambient = self.floats()?;
                let has_separate_specular = self.unsigned()? == LightModelObject::SEPARATE_SPECULAR;
                AttributeObject::LightModel(LightModelObject {
                    ambient,
                    has_separate_specular,
                    local_viewer,
                    two_sided,
                })
            }
            ids::LIGHT => {
                let number = self.integer()?;
                let [ambient, diffuse, specular] = [self.floats()?, self.floats()?, self.floats()?];
                let position = self.floats()?.map(f64::from);
                let direction = self.floats()?.map(f64::from);
                let attenuation = self.floats()?;
                let [spot_exponent, spot_cutoff_deg] = self.floats()?;
                AttributeObject::Light(LightObject {
                    number,
                    ambient,
                    diffuse,
                    specular,
                    position,
                    direction,
                    attenuation,
                    spot_exponent,
                    spot_cutoff_deg,
                })
            }
            ids::FOG => {
                let mode = self.unsigned()?;
                let [density, start, end] = self.floats()?;
                let color = self.floats()?;
                // The source of the coordinates.
                self.unsigned()?;
                AttributeObject::Fog(FogObject { mode, start, end, density, color })
            }
            ids::CLIP_PLANE => {
                let plane = self.doubles()?;
                AttributeObject::ClipPlane(ClipPlaneObject { number: self.unsigned()?, plane })
            }
            ids::POLYGON_MODE => {
                let [front, _back] = self.integers()?;
                AttributeObject::PolygonMode(front)
            }
            ids::BLEND_COLOR => AttributeObject::BlendColor(self.floats()?),
            ids::BLEND_EQUATION => {
                let color = self.unsigned()?;
                let alpha = if self.version >= 40 { self.unsigned()? } else { color };
                AttributeObject::BlendEquation([color, alpha])
            }
            _ => {
                self.skipped_attribute(class)?;
                return Ok(None);
            }
        }))
    }

    /// Reads over the members of a class that is not drawn.
    fn skipped_attribute(&mut self, class: u32) -> Result<()> {
        match class {
            ids::VIEWPORT | ids::SCISSOR => self.skip(4 * 4),
            ids::STENCIL => self.skip(7 * 4),
            ids::STENCIL_TWO_SIDED => self.skip(14 * 4),
            ids::POINT_SPRITE => self.skip(4),
            ids::MULTISAMPLE => self.skip(4 + 1 + 4),
            ids::LINE_STIPPLE => self.skip(2 + 4),
            ids::POLYGON_STIPPLE => {
                let count = self.count(1)?;
                self.skip(count)
            }
            ids::FRAGMENT_PROGRAM => {
                let parameters = self.count(5 * 4)?;
                self.skip(parameters * 5 * 4)?;
                self.string().map(drop)
            }
            ids::VERTEX_PROGRAM => self.string().map(drop),
            ids::PROGRAM => {
                if self.version >= 30 {
                    // The primitives that a geometry shader makes.
                    self.integers::<3>()?;
                }
                // Locations of attributes.
                for _ in 0..self.count(8)? {
                    self.string()?;
                    self.unsigned()?;
                }
                for _ in 0..self.count(4)? {
                    self.shader()?;
                }
                Ok(())
            }
            _ => Err(Self::unknown("a state attribute", class)),
        }
    }

    fn material(&mut self) -> Result<AttributeObject> {
        /// Reads a value of front and back.
        fn sides<const N: usize>(reader: &mut Reader<'_>) -> Result<[[f32; N]; 2]> {
            let is_same = reader.boolean()?;
            let (front, back) = (reader.floats()?, reader.floats()?);
            Ok(if is_same { [front; 2] } else { [front, back] })
        }
        let color_mode = self.unsigned()?;
        let (ambient, diffuse, specular, emission) = (sides(self)?, sides(self)?, sides(self)?, sides(self)?);
        let shininess = sides(self)?.map(|[value]| value);
        Ok(AttributeObject::Material(MaterialObject { color_mode, ambient, diffuse, specular, emission, shininess }))
    }

    fn combine(&mut self) -> Result<AttributeObject> {
        let functions = self.integers::<2>()?;
        let sources = [self.integers()?, self.integers()?];
        let operands = [self.integers()?, self.integers()?];
        let scales = self.floats::<2>()?;
        let part = |i: usize| CombinePart {
            function: functions[i],
            sources: sources[i],
            operands: operands[i],
            scale: scales[i],
        };
        let constant = self.floats()?;
        Ok(AttributeObject::Combine(CombineObject { color: part(0), alpha: part(1), constant }))
    }

    fn texture(&mut self, target: TextureTarget) -> Result<AttributeObject> {
        let mut texture = self.texture_members()?;
        texture.target = target;
        texture.images = match target {
            TextureTarget::Cube => self.faces()?,
            _ => vec![self.image()?],
        };
        Ok(AttributeObject::Texture(texture))
    }

    /// Reads the faces of a TextureCubeMap.
    fn faces(&mut self) -> Result<Vec<Option<Arc<ImageObject>>>> {
        // The size and the number of levels.
        self.integers::<3>()?;
        if self.version >= 29 {
            return (0..6).map(|_| self.image()).collect();
        }
        let mode = self.byte()?;
        (0..6).map(|_| self.image_of_mode(mode)).collect()
    }

    /// Reads the members of the classes Object and Texture. The texture has no image yet.
    fn texture_members(&mut self) -> Result<TextureObject> {
        self.expect(ids::TEXTURE)?;
        self.object_members()?;
        let [wrap_s, wrap_t, _wrap_r, min_filter, mag_filter] = self.integers()?;
        // The anisotropy.
        self.float()?;
        let border_color = self.floats()?;
        // The mode of the internal format.
        self.unsigned()?;
        if self.version >= 8 {
            self.unsigned()?;
        }
        if self.version >= 9 {
            // The width of the border, and four switches.
            self.skip(4 + 4)?;
        }
        if self.version >= 14 {
            // Format and type of the source.
            self.integers::<2>()?;
        }
        if self.version >= 43 {
            // Comparison with shadows.
            self.boolean()?;
            self.integers::<2>()?;
        }
        let (target, wrap, images) = (TextureTarget::D2, [wrap_s, wrap_t], Vec::new());
        Ok(TextureObject { target, wrap, min_filter, mag_filter, border_color, images })
    }
}
