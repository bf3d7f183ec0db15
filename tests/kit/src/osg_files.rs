//! Writers of OpenSceneGraph's own files in both encodings, as small as the tests need them.

use crate::binary_values::binary_values;

/// The version of OSG 3.6.5.
pub const VERSION: u32 = 161;

/// Returns a text file.
pub fn osgt(version: u32, root: &str) -> String {
    format!("#Ascii Scene \n#Version {version} \n#Generator OpenSceneGraph 3.6.5 \n\n{root}\n")
}

/// A triangle in text with the members of a geometry besides its vertices, and a name for the ids of its objects.
pub fn triangle(id: u32, members: &str) -> String {
    let [set, array] = [id + 1, id + 2];
    format!(
        "osg::Geometry {{ UniqueID {id}
        PrimitiveSetList 1 {{ osg::DrawArrays {{ UniqueID {set} Mode TRIANGLES Count 3 }} }}
        VertexArray TRUE {{ osg::Vec3Array {{ UniqueID {array} Binding BIND_PER_VERTEX
            vector 3 {{ 0 0 0 \n 1 0 0 \n 0 1 0 }} }} }} {members} }}"
    )
}

/// A geode in text with drawables and the members of a node.
pub fn geode(id: u32, members: &str, drawables: &[String]) -> String {
    format!("osg::Geode {{ UniqueID {id} {members} Drawables {} {{ {} }} }}", drawables.len(), drawables.join("\n"))
}

/// A group in text.
pub fn group(id: u32, children: &[String]) -> String {
    format!("osg::Group {{ UniqueID {id} Children {} {{ {} }} }}", children.len(), children.join("\n"))
}

/// A tile of osgTerrain in text: the members of its Locator, the columns and rows of its HeightField, further members of that,
/// the heights, and the members of the tile behind its elevation layer. It takes the ids up to `id + 3`.
pub fn terrain_tile(
    id: u32,
    locator: &str,
    [columns, rows]: [u32; 2],
    field: &str,
    heights: &str,
    more: &str,
) -> String {
    let [locator_id, layer_id, field_id] = [id + 1, id + 2, id + 3];
    let count = columns * rows;
    format!(
        "osgTerrain::TerrainTile {{ UniqueID {id} TileID 0 0 0
        TerrainTechnique TRUE {{ osgTerrain::GeometryTechnique {{ UniqueID 99 FilterMatrix {{ 0 0 0 0 1 0 0 0 0 }} }} }}
        Locator TRUE {{ osgTerrain::Locator {{ UniqueID {locator_id} {locator} }} }}
        ElevationLayer TRUE {{ osgTerrain::HeightFieldLayer {{ UniqueID {layer_id}
            Locator TRUE {{ osgTerrain::Locator {{ UniqueID {locator_id} }} }}
            HeightField TRUE {{ osg::HeightField {{ UniqueID {field_id} Area {columns} {rows} {field}
                Heights ArrayID {field_id} FloatArray {count} {{ {heights} }} }} }} }} }} {more} }}"
    )
}

/// Writes a binary file.
pub struct Osgb {
    /// The bytes so far.
    pub bytes: Vec<u8>,
    version: u32,
    has_sizes: bool,
    is_big_endian: bool,
}

impl Osgb {
    /// Begins a file. Blocks have sizes with `has_sizes`.
    pub fn new(version: u32, has_sizes: bool) -> Self {
        Self::with_compressor(version, has_sizes, "0")
    }

    /// Begins a file that names a compressor. What follows is written as it is.
    pub fn with_compressor(version: u32, has_sizes: bool, compressor: &str) -> Self {
        let mut file = Self { bytes: Vec::new(), version, has_sizes, is_big_endian: false };
        file.header(compressor);
        file
    }

    /// Begins a file of a machine with the other byte order.
    pub fn big_endian(version: u32) -> Self {
        let mut file = Self { bytes: Vec::new(), version, has_sizes: true, is_big_endian: true };
        file.header("0");
        file
    }

    fn header(&mut self, compressor: &str) {
        let (version, attributes) = (self.version, if self.has_sizes { 4 } else { 0 });
        self.u32(0x6c91_0ea1).u32(0x1afb_4545).u32(1).u32(version).u32(attributes).text(compressor);
    }

    binary_values!();

    /// Writes a block with its size, if the file has sizes.
    pub fn block(&mut self, write: impl FnOnce(&mut Self)) -> &mut Self {
        let start = self.bytes.len();
        let size_bytes = if self.version > 148 { 8 } else { 4 };
        if self.has_sizes {
            self.bytes.resize(start + size_bytes, 0);
        }
        write(self);
        if self.has_sizes {
            let size = (self.bytes.len() - start) as u64;
            let bytes = if self.is_big_endian { size.to_be_bytes() } else { size.to_le_bytes() };
            let used = match (self.is_big_endian, size_bytes) {
                (_, 8) => &bytes[..],
                (true, _) => &bytes[4..],
                (false, _) => &bytes[..4],
            };
            self.bytes[start..start + size_bytes].copy_from_slice(used);
        }
        self
    }

    /// Writes an object.
    pub fn object(&mut self, class: &str, id: u32, write: impl FnOnce(&mut Self)) -> &mut Self {
        self.text(class).block(|file| {
            file.u32(id);
            write(file);
        })
    }

    /// The members of Object: a name, an unspecified variance, and no user data.
    pub fn object_members(&mut self, name: &str) -> &mut Self {
        self.text(name).u32(2).raw(&[0])
    }

    /// The members of Object and Node: no bound, no callbacks, culling, a mask, no descriptions before version 77, and no
    /// state set.
    pub fn node_members(&mut self, name: &str) -> &mut Self {
        self.object_members(name).raw(&[0, 0, 0, 0, 0, 1]).u32(u32::MAX);
        if self.version < 77 {
            self.raw(&[0]);
        }
        self.raw(&[0])
    }

    /// The members of Group, with as many children as `write` writes.
    pub fn children(&mut self, count: u32, write: impl FnOnce(&mut Self)) -> &mut Self {
        self.raw(&[1]).u32(count).block(write)
    }

    /// A geode with one triangle, whose version is below 112 or at least 156.
    pub fn triangle_geode(&mut self, id: u32) -> &mut Self {
        let version = self.version;
        self.object("osg::Geode", id, |file| {
            file.node_members("geode").raw(&[1]).u32(1).block(|file| {
                file.object("osg::Geometry", id + 1, |file| {
                    if version < 112 {
                        file.old_triangle()
                    } else {
                        file.new_triangle(id)
                    };
                });
            });
        })
    }

    /// The members of a Geometry with arrays that are objects.
    fn new_triangle(&mut self, id: u32) -> &mut Self {
        // Drawable: no bound, callback or shape; display lists; mask; culling.
        self.node_members("").raw(&[0, 0, 0, 1, 1, 0]).u32(u32::MAX).raw(&[1]);
        self.u32(1).object("osg::DrawElementsUShort", id + 2, |file| {
            file.object_members("").raw(&[0]).u32(0).u32(4).u32(3).raw(&[0, 0, 1, 0, 2, 0]);
        });
        self.raw(&[1]).object("osg::Vec3Array", id + 3, |file| {
            // No buffer object; per vertex; not normalized.
            file.object_members("").raw(&[0]).u32(4).raw(&[0, 0]);
            file.u32(3).f32s(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        });
        // No other arrays.
        self.raw(&[0, 0, 0, 0]).u32(0).u32(0)
    }

    /// The members of a Geometry with arrays that have a number.
    fn old_triangle(&mut self) -> &mut Self {
        // Drawable: no state set, bound, callback or shape; display lists; no callbacks.
        self.object_members("").raw(&[0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0]);
        // DrawElementsUShort of triangles.
        self.u32(1).u32(53).u32(4);
        if self.version > 96 {
            self.u32(0);
        }
        self.u32(3).block(|file| {
            file.raw(&[0, 0, 1, 0, 2, 0]);
        });
        self.raw(&[1]).block(|file| {
            // Array 1 of Vec3f without indices, per vertex.
            file.raw(&[1]).u32(1).u32(16).u32(3).block(|file| {
                file.f32s(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
            });
            file.raw(&[0]).u32(4).u32(0);
        });
        // No other arrays, and the hint of a fast path.
        self.raw(&[0, 0, 0, 0, 0, 0, 1])
    }
}
