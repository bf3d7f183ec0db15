//! The binary format of OpenSceneGraph before 3.0, .ive, which its later versions still read and write.
//!
//! Each class begins with its number and the members of the class that it derives from. Members have no names and blocks no
//! sizes, so that every class that OSG writes is read member by member, by the version of the format (0 to 45). Nodes, drawables
//! and so on have numbers, each kind its own, and stand in the file once. Objects are the same as those of .osgb, so that
//! [`build`](super::build) makes the same nodes of them. The layout is that of OSG's `src/osgPlugins/ive`.

mod attributes;
mod callbacks;
mod drawables;
mod effects;
mod geometry;
mod ids;
mod images;
mod lods;
mod nodes;
mod shapes;
mod states;
mod terrain;
mod values;

use std::collections::HashMap;

use super::classes::ReadFile;
use super::error::{OsgError, Result};
use super::input::{BinaryInput, Input as _, Number, inflate};
use super::objects::{OBJECT_BYTES, Object};
use crate::fetch::{Limits, about_to_allocate};
use crate::formats::ignored::Notes;

/// The first number of a file, in the byte order of the writer.
const MAGIC: u32 = 0x0102_0304;
/// The newest version of the format: that of OSG 3.0 to 3.7.
const MAX_VERSION: u32 = 45;
/// The version since which a file may be compressed.
const VERSION_OF_COMPRESSION: u32 = 33;

/// Kinds of objects with numbers of their own.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Kind {
    Node,
    Drawable,
    StateSet,
    Attribute,
    Uniform,
    Shader,
    Shape,
    Layer,
    Locator,
    VolumeLayer,
    VolumeLocator,
    VolumeProperty,
}

/// Reads the objects of one file. One thread.
struct Reader<'a> {
    input: BinaryInput<'a>,
    version: u32,
    objects: HashMap<(Kind, i32), Object>,
    /// The number of objects that are being read.
    depth: usize,
    max_depth: usize,
    /// The number of heights that took no bytes in the file.
    equal_heights: usize,
    notes: Notes,
}

/// Returns true for the first bytes of an .ive file: its magic, and a version that is no large number.
pub(super) fn is_ive(bytes: &[u8]) -> bool {
    matches!(bytes, [4, 3, 2, 1, _, 0, 0, 0, ..] | [1, 2, 3, 4, 0, 0, 0, _, ..])
}

/// Reads a file.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<ReadFile> {
    let (input, version) = open(bytes, limits.max_file_bytes)?;
    let mut reader = Reader {
        input,
        version,
        objects: HashMap::new(),
        depth: 0,
        max_depth: limits.max_depth as usize,
        equal_heights: 0,
        notes: Notes::default(),
    };
    let root = reader.node()?;
    Ok(ReadFile { root, version, ignored: reader.notes.into_ignored() })
}

/// Reads the header of a file, and decompresses what follows. `max_bytes` limits the result.
fn open(bytes: &[u8], max_bytes: u64) -> Result<(BinaryInput<'_>, u32)> {
    let is_big_endian = bytes.starts_with(&MAGIC.to_be_bytes());
    let mut input = BinaryInput::new(bytes, size_of::<u32>(), is_big_endian);
    let version = input.number(Number::U32)? as u32;
    if version > MAX_VERSION {
        return Err(OsgError::Unsupported(format!("version {version} of .ive, of which {MAX_VERSION} is the newest")));
    }
    if version >= VERSION_OF_COMPRESSION && input.number(Number::I32)? > 0.0 {
        // OSG reserves so much memory.
        input.number(Number::U32)?;
        let plain = inflate(input.rest(), max_bytes)?;
        input.replace(plain);
    }
    Ok((input, version))
}

impl Reader<'_> {
    /// Reads the number of an object, and the object itself unless one with its number was read before.
    fn shared(&mut self, kind: Kind, read: impl FnOnce(&mut Self) -> Result<Object>) -> Result<Object> {
        let id = self.integer()?;
        self.shared_as(kind, id, read)
    }

    /// Does the same as [`shared`](Self::shared), for kinds whose negative numbers stand for no object.
    fn shared_or_none(&mut self, kind: Kind, read: impl FnOnce(&mut Self) -> Result<Object>) -> Result<Object> {
        match self.integer()? {
            ..0 => Ok(Object::Nothing),
            id => self.shared_as(kind, id, read),
        }
    }

    fn shared_as(&mut self, kind: Kind, id: i32, read: impl FnOnce(&mut Self) -> Result<Object>) -> Result<Object> {
        if let Some(known) = self.objects.get(&(kind, id)) {
            return Ok(known.clone());
        }
        about_to_allocate(OBJECT_BYTES)?;
        let object = self.nested(read)?;
        if object.height() > self.max_depth {
            // References to nodes that were read before can be deeper than the nesting of the file.
            let (got, limit) = (object.height() as u64, self.max_depth as u64);
            return Err(OsgError::TooLarge { what: "depth of nodes", got, limit });
        }
        self.objects.insert((kind, id), object.clone());
        Ok(object)
    }

    /// Reads something that can be nested.
    fn nested<T>(&mut self, read: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        if self.depth >= self.max_depth {
            let (got, limit) = (self.depth as u64 + 1, self.max_depth as u64);
            return Err(OsgError::TooLarge { what: "depth of objects", got, limit });
        }
        self.depth += 1;
        let value = read(self)?;
        self.depth -= 1;
        Ok(value)
    }

    /// Counts a class that is left out.
    fn note_class(&self, class: u32) {
        self.notes.add(format!("OpenSceneGraph class {}", ids::name(class)));
    }

    /// Counts a class of which the children are drawn alone.
    fn note_children(&self, class: u32) {
        self.notes.add(format!("OpenSceneGraph class {} (its children are drawn)", ids::name(class)));
    }

    /// Returns the error of a class that is not read here. OSG's own reader does not know it either.
    fn unknown(what: &str, class: u32) -> OsgError {
        OsgError::Unsupported(format!(".ive: {what} of class {}", ids::name(class)))
    }

    /// Reads the members of the class Object, and returns its name.
    fn object_members(&mut self) -> Result<String> {
        self.expect(ids::OBJECT)?;
        let name = if self.version >= 12 { self.string()? } else { String::new() };
        // The data variance.
        self.byte()?;
        if self.version >= 31 {
            self.optional(Self::user_data)?;
        }
        Ok(name)
    }

    /// Reads over user data of the kinds that OSG writes.
    fn user_data(&mut self) -> Result<()> {
        match self.integer()? as u32 {
            ids::NODE => self.node().map(drop),
            ids::STATE_SET => self.state_set().map(drop),
            ids::STATE_ATTRIBUTE => self.attribute().map(drop),
            ids::DRAWABLE => self.drawable().map(drop),
            ids::SHAPE_ATTRIBUTE_LIST => self.shape_attributes(),
            _ => Ok(()),
        }
    }

    /// Reads over osgSim's attributes of a shapefile.
    fn shape_attributes(&mut self) -> Result<()> {
        const INTEGER: u32 = 1;
        const DOUBLE: u32 = 2;
        const STRING: u32 = 3;
        self.expect(ids::SHAPE_ATTRIBUTE_LIST)?;
        for _ in 0..self.count(8)? {
            self.string()?;
            match self.unsigned()? {
                INTEGER => drop(self.integer()?),
                DOUBLE => drop(self.double()?),
                STRING => drop(self.optional(Self::string)?),
                _ => {}
            }
        }
        Ok(())
    }
}
