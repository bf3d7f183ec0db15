//! The text format of OpenSceneGraph before 3.0, .osg, which its later versions still read and write.
//!
//! The file is parsed to [`fields`] first, since the fields of an object have no order. Objects are the same as those of .osgt,
//! so that [`build`](super::build) makes the same nodes of them. Classes of other libraries are left out, and their names are
//! counted; of osgAnimation the bones and the rest pose are read. The layout is that of OSG's
//! `src/osgWrappers/deprecated-dotosg`.

mod fields;
mod geometry;
mod nodes;
mod shapes;
mod states;
mod terrain;
mod texts;

use std::collections::HashMap;
use std::sync::Arc;

use self::fields::{Block, Field};
use super::classes::{PROGRAMS, ReadFile};
use super::error::{OsgError, Result};
use super::input::decoded;
use super::objects::{ArrayObject, Object, StateObject};
use crate::fetch::Limits;
use crate::formats::ignored::Notes;

/// Blocks of nodes and drawables that hold no object that is drawn, which are skipped without a note.
const SILENT: [&str; 12] = [
    "description",
    "UserData",
    "UpdateCallback",
    "UpdateCallbacks",
    "EventCallback",
    "EventCallbacks",
    "CullCallback",
    "CullCallbacks",
    "ComputeBoundingSphereCallback",
    "ComputeBoundingBoxCallback",
    "TessellationHints",
    "InvBindMatrixInSkeletonSpace",
];

/// Returns true for the beginning of an .osg file: a class of a node, and a brace.
pub(super) fn is_dot_osg(bytes: &[u8]) -> bool {
    let is_class = |byte: &u8| byte.is_ascii_alphanumeric() || *byte == b':';
    let start = bytes.iter().position(|byte| !byte.is_ascii_whitespace()).unwrap_or(0);
    let length = bytes[start..].iter().position(|byte| !is_class(byte)).unwrap_or(0);
    let (class, rest) = bytes[start..].split_at(length);
    let opens = rest.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'{');
    opens && std::str::from_utf8(class).is_ok_and(|class| class.contains("::") || nodes::is_node(class))
}

/// Reads a file.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<ReadFile> {
    let text = decoded(bytes);
    let file = fields::parse(&text, limits)?;
    let mut reader = Reader { max_depth: limits.max_depth as usize, ..Reader::default() };
    let mut roots = reader.objects(&file)?;
    let root = match roots.len() {
        0 => return Err(OsgError::Unsupported("an .osg file without a node that is read".to_owned())),
        1 => roots.remove(0),
        // OSG makes a group of several nodes.
        _ => nodes::group_of(roots),
    };
    Ok(ReadFile { root, version: 0, ignored: reader.notes.into_ignored() })
}

/// Makes objects of fields. One thread.
#[derive(Default)]
struct Reader {
    /// Objects with a UniqueID.
    objects: HashMap<String, Object>,
    arrays: HashMap<String, Arc<ArrayObject>>,
    max_depth: usize,
    notes: Notes,
}

impl Reader {
    /// Returns the objects of the fields of a block in their order; [`Object::Nothing`] for classes that are left out.
    fn objects(&mut self, block: &Block<'_>) -> Result<Vec<Object>> {
        let mut objects = Vec::new();
        for field in &block.fields {
            if let Some(object) = self.object(field)? {
                objects.push(object);
            }
        }
        Ok(objects)
    }

    /// Returns the object of a field; `None` if it has none.
    fn object(&mut self, field: &Field<'_>) -> Result<Option<Object>> {
        let class = field.word(0);
        let Some(block) = &field.block else {
            if class != "Use" {
                return Ok(None);
            }
            let known = self.objects.get(field.word(1)).cloned();
            return Ok(Some(known.unwrap_or_else(|| {
                self.notes.add("OpenSceneGraph: a reference that cannot be followed");
                Object::Nothing
            })));
        };
        let short = class.strip_prefix("osg::").or(class.strip_prefix("osgTerrain::")).unwrap_or(class);
        if field.words.len() != 1 || SILENT.contains(&short) || nodes::is_list(short) {
            return Ok(None);
        }
        let object = if let Some(node) = self.node(short, block)? {
            node
        } else if let Some(drawable) = self.drawable(short, block)? {
            drawable
        } else if let Some(attribute) = self.attribute(short, block) {
            Object::Attribute(Arc::new(attribute))
        } else if let Some(object) = self.terrain_object(short, block)? {
            object
        } else if let Some(object) = self.animation(short, block)? {
            object
        } else if let Some(shape) = shapes::shape(short, block)? {
            Object::Shape(Arc::new(shape))
        } else if short == "StateSet" || short == "GeoState" {
            Object::State(Arc::new(self.state_set(block)?))
        } else if short == "Program" {
            self.notes.add(PROGRAMS);
            Object::Nothing
        } else if matches!(short, "Uniform" | "Shader") {
            Object::Nothing
        } else {
            self.notes.add(format!("OpenSceneGraph class {}", class.chars().take(60).collect::<String>()));
            Object::Nothing
        };
        let id = block.word("UniqueID");
        if !id.is_empty() {
            self.objects.insert(id.to_owned(), object.clone());
        }
        Ok(Some(object))
    }

    /// Takes the state set out of the objects of a node or drawable.
    fn take_state(objects: &mut Vec<Object>) -> Option<Arc<StateObject>> {
        let mut state = None;
        objects.retain(|object| match object {
            Object::State(found) => {
                state = Some(found.clone());
                false
            }
            _ => true,
        });
        state
    }
}
