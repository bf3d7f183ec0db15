//! Arrays, primitive sets and the members of Geometry.

use std::sync::Arc;

use super::{Reader, ids};
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{Input as _, Number};
use crate::formats::osg::objects::{ArrayObject, Binding, BoundArray, GeometryObject, Indices, PrimitiveObject};

/// The types of arrays by their numbers: type of the values, values of an element.
const TYPES: [(Number, usize); 18] = [
    (Number::I32, 1),
    (Number::U8, 1),
    (Number::U16, 1),
    (Number::U32, 1),
    (Number::U8, 4),
    (Number::F32, 1),
    (Number::F32, 2),
    (Number::F32, 3),
    (Number::F32, 4),
    (Number::I16, 2),
    (Number::I16, 3),
    (Number::I16, 4),
    (Number::I8, 2),
    (Number::I8, 3),
    (Number::I8, 4),
    (Number::F64, 2),
    (Number::F64, 3),
    (Number::F64, 4),
];
/// The numbers of types that are read by name.
const VEC3: u8 = 7;
const U64: u8 = 18;
/// The maximum number of texture units with coordinates.
const MAX_UNITS: usize = 16;

impl Reader<'_> {
    /// Reads the members of the class Geometry alone.
    pub(super) fn geometry(&mut self) -> Result<GeometryObject> {
        let primitives = self.list(4, Self::primitive_set)?;
        let array = self.optional(Self::array)?.flatten();
        let vertices = self.bound(array, Some(Binding::PerVertex))?;
        // Normals had no choice of types at first.
        let normals = match self.version >= 13 {
            true => self.array_with_binding(Self::array)?,
            false => self.array_with_binding(|reader| reader.elements(VEC3))?,
        };
        let mut colors = self.array_with_binding(Self::array)?;
        if let Some(colors) = &mut colors {
            colors.is_normalized = true;
        }
        // Secondary colours and coordinates of fog.
        self.array_with_binding(Self::array)?;
        self.array_with_binding(Self::array)?;
        let mut tex_coords = Vec::new();
        for unit in 0..self.count(2)? {
            let array = self.optional(Self::array)?.flatten();
            let array = self.bound(array, Some(Binding::PerVertex))?;
            if unit < MAX_UNITS {
                tex_coords.push(array);
            }
        }
        // Vertex attributes, which only programs read: binding, whether they are normalized, array and indices.
        for _ in 0..self.count(4)? {
            self.binding()?;
            self.boolean()?;
            self.optional(Self::array)?;
            self.optional(Self::array)?;
        }
        Ok(GeometryObject { primitives, vertices, normals, colors, tex_coords })
    }

    /// Reads an array behind its binding, and its indices.
    fn array_with_binding(
        &mut self,
        read: impl FnOnce(&mut Self) -> Result<Option<Arc<ArrayObject>>>,
    ) -> Result<Option<BoundArray>> {
        let found = self.optional(|reader| Ok((reader.binding()?, read(reader)?)))?;
        let (binding, array) = found.unwrap_or_default();
        self.bound(array, binding)
    }

    /// Reads the indices of an array, if it has any.
    fn bound(&mut self, array: Option<Arc<ArrayObject>>, binding: Option<Binding>) -> Result<Option<BoundArray>> {
        let indices = self.optional(Self::array)?.flatten();
        Ok(array.map(|array| BoundArray { array, indices, binding, is_normalized: false }))
    }

    fn binding(&mut self) -> Result<Option<Binding>> {
        Ok(Some(match self.byte()? {
            0 => Binding::Off,
            1 => Binding::Overall,
            2 => Binding::PerPrimitive,
            3 => Binding::PerPrimitiveSet,
            4 => Binding::PerVertex,
            binding => return Err(OsgError::invalid(format!(".ive: binding {binding} of an array"))),
        }))
    }

    /// Reads an array; `None` if it is empty.
    pub(super) fn array(&mut self) -> Result<Option<Arc<ArrayObject>>> {
        let kind = self.byte()?;
        self.elements(kind)
    }

    /// Reads the elements of an array of a type.
    fn elements(&mut self, kind: u8) -> Result<Option<Arc<ArrayObject>>> {
        if kind == U64 {
            // Values of uniforms.
            let count = self.count(8)?;
            self.skip(count * 8)?;
            return Ok(None);
        }
        let Some((number, width)) = TYPES.get(usize::from(kind)).copied() else {
            return Err(OsgError::invalid(format!(".ive: array of type {kind}")));
        };
        let count = self.count(number.size_bytes() * width)?;
        let values = self.input.numbers(number, count * width)?;
        let array = ArrayObject { width, values, binding: None, is_normalized: false };
        Ok((count > 0).then(|| Arc::new(array)))
    }

    fn primitive_set(&mut self) -> Result<Arc<PrimitiveObject>> {
        let class = self.unsigned()?;
        self.expect(ids::PRIMITIVE_SET)?;
        self.object_members()?;
        let instances = if self.version >= 38 { self.integer()?.max(0) as u32 } else { 0 };
        let mode = self.unsigned()?;
        let mut elements = |number: Number| {
            let count = self.count(number.size_bytes())?;
            self.input.numbers(number, count).map(Indices::Elements)
        };
        let indices = match class {
            ids::DRAW_ARRAYS => {
                let first = self.integer()?.into();
                Indices::Arrays { first, count: self.integer()?.into() }
            }
            ids::DRAW_ARRAY_LENGTHS => {
                let first = self.integer()?.into();
                Indices::Lengths { first, lengths: self.list(4, Self::integer)? }
            }
            ids::DRAW_ELEMENTS_U8 => elements(Number::U8)?,
            ids::DRAW_ELEMENTS_U16 => elements(Number::U16)?,
            ids::DRAW_ELEMENTS_U32 => elements(Number::U32)?,
            _ => return Err(Self::unknown("a primitive set", class)),
        };
        Ok(Arc::new(PrimitiveObject { mode, instances, indices }))
    }
}
