//! [`TerrainTile`]: the mesh of a terrain tile: from its file, cut out of a coarser one, or of the ellipsoid. Decode threads.

use std::sync::Arc;

use glam::DAffine3;

use super::mesh;
use super::quantized;
use super::set::TerrainSet;
use super::surface::Surface;
use super::tiling::{Rectangle, Tiling};
use super::water::Water;
use crate::fetch::markup::refuse_markup;
use crate::fetch::{IoError, encoding, path_of};
use crate::formats::ignored::Notes;
use crate::formats::implicit::TileCoordinates;
use crate::formats::options::ReadOptions;
use crate::formats::tile::TileContent;
use crate::math::Ellipsoid;
use crate::scene::{Drawable, Geometry, Material, Mesh, Node, Page, ReaderData, ReaderValue};

/// The height of skirts as a multiple of the level's error, as in CesiumJS.
const SKIRT_ERRORS: f64 = 5.0;

/// The colour of ground without an image, linear.
const GROUND: [f32; 4] = [0.42, 0.41, 0.38, 1.0];

/// The file of a tile in memory.
#[derive(Debug)]
pub(super) struct HeldMesh {
    pub tile: TileCoordinates,
    pub uri: Arc<str>,
    /// The file without compression.
    pub bytes: Vec<u8>,
}

/// Returns the rectangle that the layer.json of a root page declares: west, south, east and north in radians. `None` if it
/// declares none, and for other pages.
pub fn terrain_extent(root: &Page) -> Option<[f64; 4]> {
    let tiles = root.tiles();
    let mut data = tiles.roots().iter().filter_map(|first| tiles.reader_data(first.tile as usize));
    data.find_map(|data| data.value::<TerrainTile>())?.extent()
}

/// The origin of a mesh.
#[derive(Clone, Debug)]
pub(super) enum TileMesh {
    /// The tile's own file, which is fetched.
    File,
    /// The file of the tile, or that of a tile above it.
    Held(Arc<HeldMesh>),
    /// There is no file: the tile is a part of the ellipsoid.
    Ellipsoid,
}

/// The reader data of a tile.
#[derive(Clone, Debug)]
pub(in crate::formats) struct TerrainTile {
    set: Arc<TerrainSet>,
    tile: TileCoordinates,
    mesh: TileMesh,
    /// The URI at which the file is looked for if its own has none.
    fallback: Option<Arc<str>>,
}

impl TerrainTile {
    pub(super) fn new(set: Arc<TerrainSet>, tile: TileCoordinates, mesh: TileMesh) -> Self {
        Self { set, tile, mesh, fallback: None }
    }

    /// Returns the content. `file` is the URI of the tile's own file and its fallback, if it is fetched; other contents have
    /// a URI as a name only.
    pub(super) fn content(self, file: Option<(Arc<str>, Option<Arc<str>>)>) -> TileContent {
        let TileCoordinates { level, x, y, .. } = self.tile;
        let (uri, fallback) = file.unwrap_or_else(|| {
            let name = match &self.mesh {
                TileMesh::Held(held) if held.tile == self.tile => held.uri.clone(),
                TileMesh::Held(held) => format!("{}#{level}/{x}/{y}", held.uri).into(),
                TileMesh::File | TileMesh::Ellipsoid => format!("{}#{level}/{x}/{y}", self.set.uri).into(),
            };
            (name, None)
        });
        TileContent::new(uri, Some(ReaderData::of(Self { fallback, ..self })))
    }

    /// Returns the rectangle that the uppermost layer declares: west, south, east and north in radians.
    fn extent(&self) -> Option<[f64; 4]> {
        self.set.layers.first()?.bounds
    }

    /// Returns true if nothing is fetched for the tile.
    pub fn is_in_memory(&self) -> bool {
        !matches!(self.mesh, TileMesh::File)
    }

    /// Reads the mesh. `bytes` are those of the tile's own file if it is fetched.
    pub fn read(&self, uri: &str, bytes: Vec<u8>, options: &ReadOptions, notes: &Notes) -> Result<Node, IoError> {
        if !matches!(self.mesh, TileMesh::Ellipsoid) {
            self.set
                .layers
                .iter()
                .filter_map(|layer| layer.attribution.as_ref())
                .for_each(|text| notes.add_credit(text));
        }
        let (surface, water) = match &self.mesh {
            TileMesh::File => surface_of(uri, &unpacked(uri, bytes, options)?, options, notes)?,
            TileMesh::Held(held) if held.tile == self.tile => surface_of(&held.uri, &held.bytes, options, notes)?,
            TileMesh::Held(held) => {
                let (whole, water) = surface_of(&held.uri, &held.bytes, options, &Notes::default())?;
                let shares = part_of(held.tile, self.tile);
                let part = whole.part(shares);
                let none = || IoError::invalid(uri, "quantized-mesh: the tile above has no triangles here");
                (part.ok_or_else(none)?, water.map(|water| water.part(shares)))
            }
            TileMesh::Ellipsoid => {
                (Surface::of_ellipsoid(self.set.tiling.ellipsoid_segments(&self.set.ellipsoid, self.tile)), None)
            }
        };
        Ok(node_of(&self.set.ellipsoid, &surface, water.as_ref(), self.set.tiling, self.tile))
    }
}

impl ReaderValue for TerrainTile {
    fn is_whole_content(&self) -> bool {
        self.is_in_memory()
    }

    fn needs_content(&self) -> bool {
        true
    }

    fn fallback_uri(&self) -> Option<Arc<str>> {
        self.fallback.clone()
    }

    fn region(&self) -> Option<[f64; 4]> {
        let Rectangle { west, south, east, north } = self.set.tiling.rectangle(self.tile);
        Some([west, south, east, north])
    }

    fn is_ground_of_globe(&self) -> bool {
        true
    }

    fn geometric_error_m(&self) -> Option<f64> {
        Some(self.set.geometric_error_m(self.tile))
    }

    fn size_bytes(&self) -> u64 {
        let held = match &self.mesh {
            // The first tile of a page counts the bytes that its parts share.
            TileMesh::Held(held) if held.tile == self.tile => held.bytes.len() as u64,
            _ => 0,
        };
        size_of::<Self>() as u64 + held
    }
}

/// Returns the bytes of a tile without compression. Fails for web pages.
pub(super) fn unpacked(uri: &str, bytes: Vec<u8>, options: &ReadOptions) -> Result<Vec<u8>, IoError> {
    // Tiles begin with a number, which may look like the magic of gzip; deflate, its only method, follows that.
    let bytes = if bytes.get(2) == Some(&8) { encoding::gunzip(uri, bytes, &options.limits)? } else { bytes };
    refuse_markup(uri, &bytes)?;
    Ok(bytes)
}

/// Reads a terrain file that no set refers to. The end of its path, `LEVEL/X/Y.terrain`, tells
/// its coordinates in the scheme TMS of EPSG:4326: the file itself does not.
pub(in crate::formats) fn read_alone(
    uri: &str,
    bytes: &[u8],
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Node, IoError> {
    let no_coordinates = || IoError::unsupported(uri, "a terrain tile whose path does not end in LEVEL/X/Y.terrain");
    let tile = coordinates_in(path_of(uri)).ok_or_else(no_coordinates)?;
    refuse_markup(uri, bytes)?;
    let (surface, water) = surface_of(uri, bytes, options, notes)?;
    Ok(node_of(&options.ellipsoid, &surface, water.as_ref(), Tiling::Geographic, tile))
}

/// Returns true if the name of a file is that of a terrain tile, which has no magic bytes.
pub(in crate::formats) fn is_tile_name(uri: &str) -> bool {
    path_of(uri).ends_with(".terrain")
}

fn coordinates_in(path: &str) -> Option<TileCoordinates> {
    let mut parts = path.strip_suffix(".terrain")?.rsplit('/').map(str::parse::<u32>);
    let (y, x, level) = (parts.next()?.ok()?, parts.next()?.ok()?, parts.next()?.ok()?);
    let exists = level <= super::availability::MAX_LEVEL && {
        let [columns, rows] = Tiling::Geographic.size(level);
        u64::from(x) < columns && u64::from(y) < rows
    };
    exists.then_some(TileCoordinates { level, x, y, z: 0 })
}

fn surface_of(
    uri: &str,
    bytes: &[u8],
    options: &ReadOptions,
    notes: &Notes,
) -> Result<(Surface, Option<Water>), IoError> {
    let mesh = quantized::parse(bytes, options.limits.max_elements);
    let mesh = mesh.map_err(|reason| IoError::invalid(uri, format!("quantized-mesh: {reason}")))?;
    if mesh.unknown_extensions > 0 {
        notes.add("terrain: an unknown extension of a tile");
    }
    Ok((mesh.surface, mesh.water))
}

/// Returns the part of a tile that a tile below it is: west, south, east and north as shares of its sides.
fn part_of(above: TileCoordinates, tile: TileCoordinates) -> [f64; 4] {
    let side = (f64::from(tile.level - above.level)).exp2().recip();
    let share = |own: u32, above: u32| f64::from(own) * side - f64::from(above);
    let (west, south) = (share(tile.x, above.x), share(tile.y, above.y));
    [west, south, west + side, south + side]
}

fn node_of(
    ellipsoid: &Ellipsoid,
    surface: &Surface,
    water: Option<&Water>,
    tiling: Tiling,
    tile: TileCoordinates,
) -> Node {
    let skirt_m = SKIRT_ERRORS * tiling.level_error_m(ellipsoid, tile.level);
    let (origin, mesh) = mesh::build(ellipsoid, surface, &tiling.rectangle(tile), skirt_m);
    let metallic_roughness = water.map(Water::reflection);
    let (base_color, texture) = water.map_or((GROUND, None), |water| water.color(GROUND));
    let material = Material { base_color, texture, metallic_roughness, ..Material::default() };
    let drawable = Drawable::new(Geometry::Mesh(Arc::<Mesh>::new(mesh)), material);
    Node::transform(DAffine3::from_translation(origin), vec![Node::geode(vec![drawable])])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_follow_from_coordinates() {
        let tile = |level, x, y| TileCoordinates { level, x, y, z: 0 };
        assert_eq!(part_of(tile(3, 5, 2), tile(4, 11, 4)), [0.5, 0.0, 1.0, 0.5]);
        assert_eq!(part_of(tile(3, 5, 2), tile(5, 20, 11)), [0.0, 0.75, 0.25, 1.0]);
        assert_eq!(coordinates_in("/set/10/17/5.terrain"), Some(tile(10, 17, 5)));
        assert_eq!(coordinates_in("/set/1/4/0.terrain"), None);
        assert_eq!(coordinates_in("/set/a.terrain"), None);
    }
}
