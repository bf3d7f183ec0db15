//! Drawables of an .osg file.

use std::sync::Arc;

use super::Reader;
use super::fields::{Block, Field, number_of};
use crate::formats::osg::classes::array_type;
use crate::formats::osg::error::{OsgError, Result};
use crate::formats::osg::input::{Names, Number, Values, value_of};
use crate::formats::osg::objects::{
    ArrayObject, Binding, BoundArray, DrawableClass, DrawableObject, GeometryObject, Indices, Object, PrimitiveObject,
};

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
];
/// The maximum number of texture units with coordinates.
const MAX_UNITS: usize = 16;

impl Reader {
    /// Reads a drawable; `None` if the class is none that is read.
    pub(super) fn drawable(&mut self, class: &str, block: &Block<'_>) -> Result<Option<Object>> {
        let is_rig = class == "osgAnimation::RigGeometry";
        let is_text = matches!(class, "osgText::Text" | "osgText::FadeText" | "osgText::Text3D");
        if !is_rig && !is_text && !matches!(class, "Geometry" | "ShapeDrawable" | "osgAnimation::MorphGeometry") {
            return Ok(None);
        }
        if is_text {
            // The state set of a text has a program of OSG, which the engine's shader replaces.
            let notes = std::mem::take(&mut self.notes);
            let state = Self::take_state(&mut self.objects(block)?);
            self.notes = notes;
            let (name, class) = (block.word("name").to_owned(), DrawableClass::Text(self.text(class, block)));
            return Ok(Some(Object::Drawable(Arc::new(DrawableObject { name, mask: u32::MAX, state, class }))));
        }
        if class.contains("::") {
            self.notes.add(format!("OpenSceneGraph class {class} (its rest pose is drawn)"));
        }
        let mut parts = self.objects(block)?;
        let state = Self::take_state(&mut parts);
        let rest = parts.iter().find_map(|part| match part {
            Object::Drawable(drawable) if is_rig => Some(drawable.clone()),
            _ => None,
        });
        let class = match class {
            "ShapeDrawable" => {
                let shape =
                    parts.into_iter().find_map(|part| if let Object::Shape(shape) = part { Some(shape) } else { None });
                let color = block.values("color").unwrap_or([1.0; 4]).map(|part| part as f32);
                DrawableClass::Shape { shape, color }
            }
            _ => match rest {
                // The skin has the geometry in its rest pose.
                Some(rest) => return Ok(Some(Object::Drawable(rest))),
                None => DrawableClass::Geometry(self.geometry(block)?),
            },
        };
        let name = block.word("name").to_owned();
        Ok(Some(Object::Drawable(Arc::new(DrawableObject { name, mask: u32::MAX, state, class }))))
    }

    fn geometry(&mut self, block: &Block<'_>) -> Result<GeometryObject> {
        let mut geometry = GeometryObject::default();
        for field in &block.fields {
            match field.word(0) {
                "Primitives" | "PrimitiveSets" => {
                    let sets = field.block.iter().flat_map(|sets| &sets.fields);
                    geometry.primitives.extend(sets.filter_map(primitives).map(Arc::new));
                }
                "VertexArray" => geometry.vertices = self.bound(field, 1, Some(Binding::PerVertex))?,
                "NormalArray" => geometry.normals = self.bound(field, 1, binding(block.word("NormalBinding")))?,
                "ColorArray" => geometry.colors = self.bound(field, 1, binding(block.word("ColorBinding")))?,
                "VertexIndices" => self.add_indices(&mut geometry.vertices, field, 1)?,
                "NormalIndices" => self.add_indices(&mut geometry.normals, field, 1)?,
                "ColorIndices" => self.add_indices(&mut geometry.colors, field, 1)?,
                name @ ("TexCoordArray" | "TexCoordIndices") => {
                    let number = number_of(field.word(1));
                    let (unit, from) = number.map_or((0, 1), |unit| (unit as usize, 2));
                    if unit >= MAX_UNITS {
                        continue;
                    }
                    if geometry.tex_coords.len() <= unit {
                        geometry.tex_coords.resize(unit + 1, None);
                    }
                    match name {
                        "TexCoordArray" => {
                            geometry.tex_coords[unit] = self.bound(field, from, Some(Binding::PerVertex))?;
                        }
                        _ => self.add_indices(&mut geometry.tex_coords[unit], field, from)?,
                    }
                }
                _ => {}
            }
        }
        if let Some(colors) = &mut geometry.colors {
            colors.is_normalized = true;
        }
        Ok(geometry)
    }

    fn bound(&mut self, field: &Field<'_>, from: usize, binding: Option<Binding>) -> Result<Option<BoundArray>> {
        let array = self.array(field, from)?;
        Ok(array.map(|array| BoundArray { array, indices: None, binding, is_normalized: false }))
    }

    fn add_indices(&mut self, to: &mut Option<BoundArray>, field: &Field<'_>, from: usize) -> Result<()> {
        let indices = self.array(field, from)?;
        if let Some(to) = to {
            to.indices = indices;
        }
        Ok(())
    }

    /// Reads an array whose type begins at a word of its field; `None` for a reference that leads nowhere.
    fn array(&mut self, field: &Field<'_>, mut from: usize) -> Result<Option<Arc<ArrayObject>>> {
        let mut id = "";
        match field.word(from) {
            "Use" => {
                let known = self.arrays.get(field.word(from + 1)).cloned();
                if known.is_none() {
                    self.notes.add("OpenSceneGraph: a reference that cannot be followed");
                }
                return Ok(known);
            }
            "UniqueID" => (id, from) = (field.word(from + 1), from + 2),
            _ => {}
        }
        let class = field.word(from);
        let (number, width) = match number_of(class) {
            // Files before 0.9.3 have points of three floats.
            Some(_) => (Number::F32, 3),
            None => array_type(class).ok_or_else(|| {
                OsgError::invalid(format!("array of type {}", class.chars().take(40).collect::<String>()))
            })?,
        };
        let numbers = field.block.as_ref().map_or(&[][..], |block| &block.numbers);
        let numbers = &numbers[..numbers.len() / width * width];
        let values = match number {
            Number::F32 => Values::F32(numbers.iter().map(|number| *number as f32).collect()),
            Number::F64 => Values::F64(numbers.to_vec()),
            Number::U32 => Values::Whole(number, numbers.iter().map(|number| *number as u32 as i32).collect()),
            _ => Values::Whole(number, numbers.iter().map(|number| *number as i32).collect()),
        };
        let array = Arc::new(ArrayObject { width, values, binding: None, is_normalized: false });
        if !id.is_empty() {
            self.arrays.insert(id.to_owned(), array.clone());
        }
        Ok(Some(array))
    }
}

/// Reads a primitive set; `None` if it is none.
fn primitives(field: &Field<'_>) -> Option<PrimitiveObject> {
    let mode = value_of(MODES, field.word(1))?;
    let numbers = || field.block.iter().flat_map(|block| &block.numbers);
    let first_and_count = || field.numbers(2).map(|[first, count]| (first as i64, count as i64));
    let elements = |number| Indices::Elements(Values::Whole(number, numbers().map(|i| *i as u32 as i32).collect()));
    let indices = match field.word(0) {
        "DrawArrays" => {
            let (first, count) = first_and_count()?;
            Indices::Arrays { first, count }
        }
        "DrawArrayLengths" => {
            let (first, _) = first_and_count()?;
            Indices::Lengths { first, lengths: numbers().map(|length| *length as i32).collect() }
        }
        "DrawElementsUByte" => elements(Number::U8),
        "DrawElementsUShort" => elements(Number::U16),
        "DrawElementsUInt" => elements(Number::U32),
        _ => return None,
    };
    Some(PrimitiveObject { mode, instances: 0, indices })
}

fn binding(word: &str) -> Option<Binding> {
    Some(match word {
        "OVERALL" => Binding::Overall,
        "PER_PRIMITIVE_SET" => Binding::PerPrimitiveSet,
        "PER_PRIMITIVE" => Binding::PerPrimitive,
        "PER_VERTEX" => Binding::PerVertex,
        _ => Binding::Off,
    })
}
