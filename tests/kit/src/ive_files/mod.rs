//! A writer of OpenSceneGraph's .ive files in all of their versions, as small as the tests need it.

pub mod scenes;

use std::io::Write as _;

use crate::binary_values::binary_values;

/// The newest version.
pub const VERSION: u32 = 45;
/// The number of the class Group.
pub const GROUP: u32 = 3;
/// The number of the class Geode.
pub const GEODE: u32 = 6;
/// The number of the class Transform.
pub const TRANSFORM: u32 = 0x13;

/// Writes a file.
pub struct Ive {
    /// The bytes so far.
    pub bytes: Vec<u8>,
    version: u32,
    is_big_endian: bool,
}

impl Ive {
    /// Begins a file.
    pub fn new(version: u32) -> Self {
        let mut file = Self { bytes: Vec::new(), version, is_big_endian: false };
        file.header();
        file
    }

    /// Begins a file of a machine with the other byte order.
    pub fn big_endian(version: u32) -> Self {
        let mut file = Self { bytes: Vec::new(), version, is_big_endian: true };
        file.header();
        file
    }

    fn header(&mut self) {
        let version = self.version;
        self.u32(0x0102_0304).u32(version);
        self.since(33, |file| file.u32(0));
    }

    /// Returns the file with everything behind its header compressed.
    pub fn compressed(&self) -> Vec<u8> {
        let mut file = Self { bytes: Vec::new(), ..*self };
        file.u32(0x0102_0304).u32(self.version).u32(1).u32(self.bytes.len() as u32);
        let mut encoder = flate2::write::ZlibEncoder::new(file.bytes, flate2::Compression::fast());
        encoder.write_all(&self.bytes[12..]).unwrap();
        encoder.finish().unwrap()
    }

    /// Writes what a version and those above it have.
    pub fn since<'a>(&'a mut self, version: u32, write: impl FnOnce(&'a mut Self) -> &'a mut Self) -> &'a mut Self {
        if self.version >= version { write(self) } else { self }
    }

    binary_values!();

    /// Writes numbers.
    pub fn u32s(&mut self, values: &[u32]) -> &mut Self {
        for value in values {
            self.u32(*value);
        }
        self
    }

    /// Writes indices of 16 bits.
    pub fn u16s(&mut self, values: &[u16]) -> &mut Self {
        for value in values {
            self.put(value.to_le_bytes());
        }
        self
    }

    /// Writes the members of Object: a name and an unspecified variance.
    pub fn object(&mut self, name: &str) -> &mut Self {
        self.u32(1);
        self.since(12, |file| file.text(name)).raw(&[2]).since(31, |file| file.raw(&[0]))
    }

    /// Writes the members of Object and Node, with a state set that `state` writes behind its marker.
    pub fn node_with(&mut self, name: &str, state: impl FnOnce(&mut Self)) -> &mut Self {
        self.u32(2).object(name);
        if self.version < 12 {
            self.text(name);
        }
        // Culling, no descriptions.
        self.raw(&[1]).u32(0);
        state(self);
        // No callbacks and no bound.
        self.raw(&[0])
            .since(6, |file| file.raw(&[0]))
            .since(39, |file| file.raw(&[0]))
            .since(10, |file| file.raw(&[0]));
        self.u32(u32::MAX)
    }

    /// Writes the members of Object and Node.
    pub fn node(&mut self, name: &str) -> &mut Self {
        self.node_with(name, |file| {
            file.raw(&[0]);
        })
    }

    /// Writes the members of Object, Node and Group, with as many children as `write` writes.
    pub fn group(&mut self, name: &str, count: u32, write: impl FnOnce(&mut Self)) -> &mut Self {
        self.u32(GROUP).node(name).u32(count);
        write(self);
        self
    }

    /// Writes the members of a Group and of Transform.
    pub fn transform(&mut self, count: u32, write: impl FnOnce(&mut Self)) -> &mut Self {
        self.u32(TRANSFORM).group("", count, write).u32(0)
    }

    /// Writes a Geode with its number and a triangle of the same number.
    pub fn triangle_geode(&mut self, id: u32) -> &mut Self {
        self.u32(id).u32(GEODE).node("").u32(1).triangle(id)
    }

    /// Writes the members of Object and Drawable.
    pub fn drawable(&mut self) -> &mut Self {
        self.u32(0x1000).object("").raw(&[0, 0]).since(10, |file| file.raw(&[0])).raw(&[1, 1, 0])
    }

    /// Writes the members of a primitive set besides those of its class, triangles.
    pub fn primitives(&mut self) -> &mut Self {
        self.u32(0x1_0000).object("").since(38, |file| file.u32(0)).u32(4)
    }

    /// Writes a Geometry with its number: a triangle.
    pub fn triangle(&mut self, id: u32) -> &mut Self {
        self.u32(id).u32(0x1001).drawable();
        // DrawArrays of three vertices.
        self.u32(1).u32(0x1_0001).primitives().u32s(&[0, 3]);
        // A Vec3Array without indices; no other arrays.
        self.raw(&[1, 7]).u32(3).f32s(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]).raw(&[0]);
        self.raw(&[0; 8]).u32s(&[0, 0])
    }

    /// Writes a state set with its number behind a marker. `attributes` and `textures` write the counts and the lists of
    /// attributes of the set and of its first texture unit.
    pub fn state_set(
        &mut self,
        id: u32,
        modes: &[(u32, u32)],
        attributes: impl FnOnce(&mut Self),
        texture_modes: &[(u32, u32)],
        textures: impl FnOnce(&mut Self),
    ) {
        self.raw(&[1]).u32s(&[id, 5]).object("").raw(&[0]).u32(0).text("").modes(modes);
        attributes(self);
        self.u32(1).modes(texture_modes).u32(1);
        textures(self);
        // No uniforms.
        self.since(10, |file| file.u32(0));
    }

    fn modes(&mut self, modes: &[(u32, u32)]) -> &mut Self {
        self.u32(modes.len() as u32);
        for (mode, value) in modes {
            self.u32s(&[*mode, *value]);
        }
        self
    }

    /// Writes the members of Object and Texture: repeated, with linear filters.
    pub fn texture(&mut self) -> &mut Self {
        self.u32(0x120)
            .object("")
            .u32s(&[0x2901, 0x2901, 0x2901, 0x2601, 0x2601])
            .f32s(&[1.0, 0.0, 0.0, 0.0, 0.0])
            .u32(0);
        self.since(8, |file| file.u32(0)).since(9, |file| file.u32(0).raw(&[1, 0, 0, 1]));
        self.since(14, |file| file.u32s(&[0, 0])).since(43, |file| file.raw(&[0]).u32s(&[0x203, 0x1909]))
    }

    /// Writes the mode of an image.
    pub fn image(&mut self, mode: u8) -> &mut Self {
        self.since(29, |file| file.u32(7)).raw(&[mode])
    }

    /// Writes the members of an Image of RGB pixels.
    pub fn pixels(&mut self, size: [u32; 2], bytes: &[u8]) -> &mut Self {
        self.u32(7).object("").text("").since(32, |file| file.u32(0));
        self.u32s(&[size[0], size[1], 1, 3, 0x1907, 0x1401, 1, 0, 0]).raw(&[1]).u32(bytes.len() as u32).raw(bytes)
    }
}
