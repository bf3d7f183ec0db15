//! The members of arrays: as objects since version 112, as types with a number before.

use std::sync::Arc;

use super::Reader;
use super::geometry::VERSION_OF_ARRAY_OBJECTS;
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{ARRAY_TYPES, Names, Number, Values};
use crate::formats::osg::objects::{ArrayObject, Binding, BoundArray, Object};

/// The types of arrays by their old numbers: class, type of the values, values of an element.
const TYPES: [(&str, Number, usize); 32] = [
    ("ByteArray", Number::I8, 1),
    ("UByteArray", Number::U8, 1),
    ("ShortArray", Number::I16, 1),
    ("UShortArray", Number::U16, 1),
    ("IntArray", Number::I32, 1),
    ("UIntArray", Number::U32, 1),
    ("FloatArray", Number::F32, 1),
    ("DoubleArray", Number::F64, 1),
    ("Vec2bArray", Number::I8, 2),
    ("Vec3bArray", Number::I8, 3),
    ("Vec4bArray", Number::I8, 4),
    ("Vec4ubArray", Number::U8, 4),
    ("Vec2sArray", Number::I16, 2),
    ("Vec3sArray", Number::I16, 3),
    ("Vec4sArray", Number::I16, 4),
    ("Vec2Array", Number::F32, 2),
    ("Vec3Array", Number::F32, 3),
    ("Vec4Array", Number::F32, 4),
    ("Vec2dArray", Number::F64, 2),
    ("Vec3dArray", Number::F64, 3),
    ("Vec4dArray", Number::F64, 4),
    ("Vec2ubArray", Number::U8, 2),
    ("Vec3ubArray", Number::U8, 3),
    ("Vec2usArray", Number::U16, 2),
    ("Vec3usArray", Number::U16, 3),
    ("Vec4usArray", Number::U16, 4),
    ("Vec2iArray", Number::I32, 2),
    ("Vec3iArray", Number::I32, 3),
    ("Vec4iArray", Number::I32, 4),
    ("Vec2uiArray", Number::U32, 2),
    ("Vec3uiArray", Number::U32, 3),
    ("Vec4uiArray", Number::U32, 4),
];

/// Returns the type of the values of an array's class, and how many an element has.
pub(in super::super) fn array_type(class: &str) -> Option<(Number, usize)> {
    // The name of the first versions.
    let class = if class == "UVec4bArray" { "Vec4ubArray" } else { class };
    TYPES.iter().find(|(name, ..)| *name == class).map(|(_, number, width)| (*number, *width))
}

impl Reader<'_> {
    /// Reads the members of an array; `None` if the class is none.
    pub(super) fn array_of(&mut self, class: &str) -> Result<Option<Object>> {
        const BINDINGS: Names = &[
            ("BIND_UNDEFINED", u32::MAX),
            ("BIND_OFF", 0),
            ("BIND_OVERALL", 1),
            ("BIND_PER_PRIMITIVE_SET", 2),
            ("BIND_PER_VERTEX", 4),
        ];
        let known = TYPES.iter().find(|(name, ..)| *name == class);
        let Some((_, number, width)) = known.filter(|_| self.version >= VERSION_OF_ARRAY_OBJECTS) else {
            return Ok(None);
        };
        self.buffer_members()?;
        let binding = binding(self.named_member("Binding", BINDINGS, u32::MAX)?);
        let is_normalized = self.boolean_member("Normalize", false)?;
        self.boolean_member("PreserveDataType", false)?;
        let values = self.values_member(*number, *width)?;
        Ok(Some(Object::Array(Arc::new(ArrayObject { width: *width, values, binding, is_normalized }))))
    }

    /// Reads the members of the classes Object and BufferData.
    pub(super) fn buffer_members(&mut self) -> Result<()> {
        self.object_members()?;
        if self.version >= 147 {
            self.object_member("BufferObject")?;
        }
        Ok(())
    }

    /// Reads the elements of an array or of a primitive set.
    pub(super) fn values_member(&mut self, number: Number, width: usize) -> Result<Values> {
        if !self.member("vector")? {
            return self.input.numbers(number, 0);
        }
        let count = self.count()?;
        if count == 0 {
            return self.input.numbers(number, 0);
        }
        self.in_braces(|reader| reader.input.numbers(number, count * width))
    }

    /// Reads an array of versions below 112 with its binding; `None` if there is no array.
    pub(super) fn old_bound_array(&mut self) -> Result<Option<BoundArray>> {
        const BINDINGS: Names = &[
            ("BIND_OFF", 0),
            ("BIND_OVERALL", 1),
            ("BIND_PER_PRIMITIVE_SET", 2),
            ("BIND_PER_PRIMITIVE", 3),
            ("BIND_PER_VERTEX", 4),
        ];
        let mut optional = |name: &str| -> Result<Option<Arc<ArrayObject>>> {
            self.input.keyword(name)?;
            if self.input.boolean()? { self.old_array().map(Some) } else { Ok(None) }
        };
        let (array, indices) = (optional("Array")?, optional("Indices")?);
        self.input.keyword("Binding")?;
        let binding = binding(self.input.named(BINDINGS)?);
        self.input.keyword("Normalize")?;
        let is_normalized = self.integer(Number::I32)? != 0;
        Ok(array.map(|array| BoundArray { array, indices, binding, is_normalized }))
    }

    /// Reads an array with a number of its own, as versions below 112 write all arrays.
    pub(super) fn old_array(&mut self) -> Result<Arc<ArrayObject>> {
        self.input.keyword("ArrayID")?;
        let id = self.unsigned()?;
        if let Some(known) = self.arrays.get(&id) {
            return Ok(known.clone());
        }
        let kind = self.input.named(ARRAY_TYPES)?;
        let Some((_, number, width)) = TYPES.get(kind as usize) else {
            return Err(OsgError::invalid(format!("array of type {kind}")));
        };
        let count = self.count()?;
        let values = self.block(|reader| reader.input.numbers(*number, count * width))?;
        let array = ArrayObject { width: *width, values, binding: None, is_normalized: false };
        Ok(self.arrays.entry(id).or_insert(Arc::new(array)).clone())
    }
}

fn binding(value: u32) -> Option<Binding> {
    match value {
        0 => Some(Binding::Off),
        1 => Some(Binding::Overall),
        2 => Some(Binding::PerPrimitiveSet),
        3 => Some(Binding::PerPrimitive),
        4 => Some(Binding::PerVertex),
        _ => None,
    }
}
