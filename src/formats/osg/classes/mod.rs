//! One function per class of OpenSceneGraph reads its members, in OSG's order and by the version of the file.
//!
//! The layout is that of OSG 2.9.9 to 3.7, whose numbers of versions (SOVERSION) are 65 to 162. A class that is unknown is
//! skipped where the file has the sizes of its blocks; elsewhere it is an error, since what follows cannot be found.

mod animation;
mod arrays;
mod attributes;
mod geometry;
mod images;
mod libraries;
mod lights;
mod lods;
mod members;
mod nodes;
mod shapes;
mod states;
mod terrain;
mod textures;

use std::collections::HashMap;
use std::sync::Arc;

pub(super) use self::arrays::array_type;
pub(super) use self::libraries::{Freedom, LIKE_GEODES, LIKE_GROUPS, LIKE_TRANSFORMS, ORDERS, light_points};
pub(super) use self::lights::{EQUATIONS, FOG_MODES, clip_planes};
pub(super) use self::terrain::{
    CHILDREN_OF_TILES, COMPOSITES, FURTHER_LAYERS, HEIGHTS_ELSEWHERE, LAYERS_ELSEWHERE, LAYERS_WITHOUT_COLORS,
    image_of_file,
};
pub(super) use self::textures::{PLANES, TEX_GEN_MODES};

use super::error::{OsgError, Result};
use super::input::{Input, Opened, open};
use super::objects::{ArrayObject, OBJECT_BYTES, Object};
use crate::fetch::{Limits, about_to_allocate};
use crate::formats::ignored::{Ignored, Notes};

/// Classes without effect on what is drawn, which are skipped without a note.
const SILENT: [&str; 8] = [
    "osg::VertexBufferObject",
    "osg::ElementBufferObject",
    "osg::PixelBufferObject",
    "osg::DefaultUserDataContainer",
    "osg::TessellationHints",
    // Each frame decides by itself whether a tile shows only its back.
    "osg::ClusterCullingCallback",
    // They belong to programs, which are noted.
    "osg::Shader",
    "osg::Uniform",
];
/// The name under which programs are counted, in all encodings.
pub(super) const PROGRAMS: &str = "OpenSceneGraph: shader programs in GLSL (not run)";

/// Reads the objects of one file. One thread.
pub(super) struct Reader<'a> {
    input: Box<dyn Input + 'a>,
    version: u32,
    objects: HashMap<u32, Object>,
    /// Arrays of versions below 112, by their separate ids.
    arrays: HashMap<u32, Arc<ArrayObject>>,
    /// The ids of the objects that are being read, outermost first.
    open: Vec<u32>,
    max_depth: usize,
    notes: Notes,
}

/// The root object of a file, the version of OSG that wrote it, and what was left out.
#[derive(Debug)]
pub(super) struct ReadFile {
    pub root: Object,
    pub version: u32,
    pub ignored: Ignored,
}

#[cfg(test)]
thread_local! {
    /// The number of files that were parsed on a thread.
    pub(super) static PARSED: std::cell::Cell<u32> = const { std::cell::Cell::new(0) };
}

/// Reads a file.
pub(super) fn read_file(bytes: &[u8], limits: &Limits) -> Result<ReadFile> {
    #[cfg(test)]
    PARSED.set(PARSED.get() + 1);
    let Opened { input, version } = open(bytes, limits.max_file_bytes)?;
    let mut reader = Reader {
        input,
        version,
        objects: HashMap::new(),
        arrays: HashMap::new(),
        open: Vec::new(),
        max_depth: limits.max_depth as usize,
        notes: Notes::default(),
    };
    let root = reader.object()?;
    Ok(ReadFile { root, version, ignored: reader.notes.into_ignored() })
}

impl Reader<'_> {
    /// Reads an object, or returns the one that was read before if its id is known.
    fn object(&mut self) -> Result<Object> {
        let class = self.input.word()?;
        if class == "NULL" {
            return Ok(Object::Nothing);
        }
        self.input.begin()?;
        self.input.keyword("UniqueID")?;
        let id = self.unsigned()?;
        if let Some(known) = self.objects.get(&id).cloned() {
            self.input.leave()?;
            return Ok(known);
        }
        if self.open.contains(&id) || self.input.is_at_end_of_block() {
            // A reference to an object above, or to a part of something that was skipped.
            self.notes.add(format!("OpenSceneGraph: a reference to {} that cannot be followed", shortened(&class)));
            self.input.leave()?;
            return Ok(Object::Nothing);
        }
        if self.open.len() >= self.max_depth {
            let (got, limit) = (self.open.len() as u64 + 1, self.max_depth as u64);
            return Err(OsgError::TooLarge { what: "depth of objects", got, limit });
        }
        about_to_allocate(OBJECT_BYTES)?;
        self.open.push(id);
        let object = self.members_of(&class)?;
        if object.height() > self.max_depth {
            // References to nodes that were read before can be deeper than the nesting of the file.
            let (got, limit) = (object.height() as u64, self.max_depth as u64);
            return Err(OsgError::TooLarge { what: "depth of nodes", got, limit });
        }
        self.open.pop();
        self.input.leave()?;
        self.objects.insert(id, object.clone());
        Ok(object)
    }

    /// Reads the members of a class.
    fn members_of(&mut self, class: &str) -> Result<Object> {
        let short = class.strip_prefix("osg::").unwrap_or(class);
        if let Some(object) = self.node_of(class, short)? {
            return Ok(object);
        }
        if let Some(object) = self.attribute_of(short)? {
            return Ok(object);
        }
        if let Some(object) = self.animation_of(short)? {
            return Ok(object);
        }
        if let Some(object) = self.terrain_of(class)? {
            return Ok(object);
        }
        match short {
            "Geometry" => self.geometry(),
            "ShapeDrawable" => self.shape_drawable(),
            "StateSet" => self.state_set(),
            "DrawArrays" | "DrawArrayLengths" | "DrawElementsUByte" | "DrawElementsUShort" | "DrawElementsUInt" => {
                self.primitive_set(short)
            }
            "Box" | "Sphere" | "Cone" | "Cylinder" | "Capsule" | "CompositeShape" | "TriangleMesh" | "HeightField" => {
                self.shape(short)
            }
            _ => match self.array_of(short)? {
                Some(array) => Ok(array),
                None => self.unknown(class),
            },
        }
    }

    /// Leaves out an object of a class that is not read.
    fn unknown(&mut self, class: &str) -> Result<Object> {
        if class == "osg::DefaultUserDataContainer" && !self.input.can_skip() {
            self.user_data()?;
            return Ok(Object::Nothing);
        }
        if !self.input.can_skip() {
            let what = format!("class {} in a file without sizes of blocks", shortened(class));
            return Err(OsgError::Unsupported(what));
        }
        if class == "osg::Program" {
            self.notes.add(PROGRAMS);
        } else if !SILENT.contains(&class) {
            self.notes.add(format!("OpenSceneGraph class {}", shortened(class)));
        }
        Ok(Object::Nothing)
    }
}

/// Returns the beginning of a name from a file.
fn shortened(name: &str) -> String {
    name.chars().take(60).collect()
}
