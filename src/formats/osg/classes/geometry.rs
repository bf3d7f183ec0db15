//! The members of drawables and primitive sets.

use std::sync::Arc;

use super::Reader;
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{Names, Number, PRIMITIVE_TYPES, Values};
use crate::formats::osg::objects::{
    BoundArray, DrawableClass, DrawableObject, GeometryObject, Indices, Object, PrimitiveObject, StateObject,
};

/// The version since which arrays and primitive sets are objects with members.
pub(super) const VERSION_OF_ARRAY_OBJECTS: u32 = 112;

/// The members that all drawables have.
pub(super) struct DrawableMembers {
    name: String,
    mask: u32,
    state: Option<Arc<StateObject>>,
    pub shape: Object,
}

impl DrawableMembers {
    /// Returns the drawable with the members of its class.
    pub fn with(self, class: DrawableClass) -> Object {
        let Self { name, mask, state, .. } = self;
        Object::Drawable(Arc::new(DrawableObject { name, mask, state, class }))
    }
}

impl Reader<'_> {
    /// Reads the members of the classes Object, Node (since version 154) and Drawable.
    pub(super) fn drawable_members(&mut self) -> Result<DrawableMembers> {
        let mut name = self.object_members()?;
        let mut state = None;
        if self.version >= 154 {
            let node = self.members_of_node_alone(name)?;
            (name, state) = (node.name, node.state);
        }
        let has_own_state = self.version <= 155;
        if has_own_state {
            state = self.state_member("StateSet")?.or(state);
        }
        if self.marked_member("InitialBound")? {
            self.block(|reader| {
                reader.input.keyword("Minimum")?;
                reader.doubles::<3>()?;
                reader.input.keyword("Maximum")?;
                reader.doubles::<3>()
            })?;
        }
        self.object_member("ComputeBoundingBoxCallback")?;
        let shape = self.object_member("Shape")?;
        self.boolean_member("SupportsDisplayList", true)?;
        self.boolean_member("UseDisplayList", true)?;
        self.boolean_member("UseVertexBufferObjects", false)?;
        if has_own_state {
            for callback in ["UpdateCallback", "EventCallback", "CullCallback", "DrawCallback"] {
                self.object_member(callback)?;
            }
        }
        let mask = if self.version >= 142 { self.unsigned_member("NodeMask", u32::MAX)? } else { u32::MAX };
        if self.version >= 145 {
            self.boolean_member("CullingActive", true)?;
        }
        Ok(DrawableMembers { name, mask, state, shape })
    }

    pub(super) fn geometry(&mut self) -> Result<Object> {
        let drawable = self.drawable_members()?;
        let mut geometry = GeometryObject::default();
        if self.version >= VERSION_OF_ARRAY_OBJECTS {
            let sets = self.vector_member("PrimitiveSetList", Self::object)?;
            geometry.primitives = sets.into_iter().filter_map(primitives).collect();
            geometry.vertices = self.array_member("VertexArray")?;
            geometry.normals = self.array_member("NormalArray")?;
            geometry.colors = self.array_member("ColorArray")?;
            for other in ["SecondaryColorArray", "FogCoordArray"] {
                self.array_member(other)?;
            }
            geometry.tex_coords = self.array_list("TexCoordArrayList")?;
            self.array_list("VertexAttribArrayList")?;
        } else {
            geometry.primitives = self.vector_member("PrimitiveSetList", Self::old_primitive_set)?;
            geometry.vertices = self.old_array_member("VertexData")?;
            geometry.normals = self.old_array_member("NormalData")?;
            geometry.colors = self.old_array_member("ColorData")?;
            for other in ["SecondaryColorData", "FogCoordData"] {
                self.old_array_member(other)?;
            }
            geometry.tex_coords = self.old_array_list("TexCoordData")?;
            self.old_array_list("VertexAttribData")?;
            // In binary the marker is the value.
            if self.marked_member("FastPathHint")? && self.input.is_text() {
                self.input.boolean()?;
            }
        }
        Ok(drawable.with(DrawableClass::Geometry(geometry)))
    }

    fn array_member(&mut self, name: &str) -> Result<Option<BoundArray>> {
        self.object_member(name).map(bound)
    }

    fn array_list(&mut self, name: &str) -> Result<Vec<Option<BoundArray>>> {
        self.vector_member(name, |reader| reader.object().map(bound))
    }

    fn old_array_member(&mut self, name: &str) -> Result<Option<BoundArray>> {
        if self.marked_member(name)? { self.block(Self::old_bound_array) } else { Ok(None) }
    }

    fn old_array_list(&mut self, name: &str) -> Result<Vec<Option<BoundArray>>> {
        if !self.marked_member(name)? {
            return Ok(Vec::new());
        }
        self.list(|reader| {
            reader.input.keyword("Data")?;
            reader.block(Self::old_bound_array)
        })
    }

    /// Reads a primitive set that is an object.
    pub(super) fn primitive_set(&mut self, class: &str) -> Result<Object> {
        const MODES: Names = &[
            ("POINTS", 0),
            ("LINES", 1),
            ("LINE_LOOP", 2),
            ("LINE_STRIP", 3),
            ("TRIANGLES", 4),
            ("TRIANGLE_STRIP", 5),
            ("TRIANGLE_FAN", 6),
            ("QUADS", 7),
            ("QUAD_STRIP", 8),
            ("POLYGON", 9),
            ("LINES_ADJACENCY", 10),
            ("LINE_STRIP_ADJACENCY", 11),
            ("TRIANGLES_ADJACENCY", 12),
            ("TRIANGLE_STRIP_ADJACENCY", 13),
            ("PATCHES", 14),
        ];
        self.buffer_members()?;
        let instances = self.integer_member("NumInstances", 0)?.max(0) as u32;
        let mode = self.named_member("Mode", MODES, 0)?;
        let indices = match class {
            "DrawArrays" => {
                let first = self.integer_member("First", 0)?.into();
                Indices::Arrays { first, count: self.integer_member("Count", 0)?.into() }
            }
            "DrawArrayLengths" => {
                let first = self.integer_member("First", 0)?.into();
                Indices::Lengths { first, lengths: whole(self.values_member(Number::I32, 1)?) }
            }
            "DrawElementsUByte" => Indices::Elements(self.values_member(Number::U8, 1)?),
            "DrawElementsUShort" => Indices::Elements(self.values_member(Number::U16, 1)?),
            _ => Indices::Elements(self.values_member(Number::U32, 1)?),
        };
        Ok(Object::Primitives(Arc::new(PrimitiveObject { mode, instances, indices })))
    }

    /// Reads a primitive set of versions below 112.
    fn old_primitive_set(&mut self) -> Result<Arc<PrimitiveObject>> {
        let kind = self.input.named(PRIMITIVE_TYPES)?;
        let mode = self.input.named(PRIMITIVE_TYPES)?;
        let instances = if self.version > 96 { self.unsigned()? } else { 0 };
        let mut elements = |number| -> Result<Values> {
            let count = self.count()?;
            self.block(|reader| reader.input.numbers(number, count))
        };
        let indices = match kind {
            50 => {
                let first = self.integer(Number::I32)?;
                Indices::Arrays { first, count: self.integer(Number::I32)? }
            }
            51 => {
                let first = self.integer(Number::I32)?;
                let count = self.count()?;
                Indices::Lengths {
                    first,
                    lengths: whole(self.block(|reader| reader.input.numbers(Number::I32, count))?),
                }
            }
            52 => Indices::Elements(elements(Number::U8)?),
            53 => Indices::Elements(elements(Number::U16)?),
            54 => Indices::Elements(elements(Number::U32)?),
            _ => return Err(OsgError::invalid(format!("primitive set of type {kind}"))),
        };
        Ok(Arc::new(PrimitiveObject { mode, instances, indices }))
    }
}

fn primitives(object: Object) -> Option<Arc<PrimitiveObject>> {
    match object {
        Object::Primitives(primitives) => Some(primitives),
        _ => None,
    }
}

fn bound(object: Object) -> Option<BoundArray> {
    let Object::Array(array) = object else { return None };
    let (binding, is_normalized) = (array.binding, array.is_normalized);
    Some(BoundArray { array, indices: None, binding, is_normalized })
}

fn whole(values: Values) -> Vec<i32> {
    match values {
        Values::Whole(_, values) => values,
        Values::F32(_) | Values::F64(_) => Vec::new(),
    }
}
