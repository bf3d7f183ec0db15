//! Builds mesh content: the triangles of a tile with skirts, in the east-north-up frame at the tile's centre.

use glam::{DAffine3, DMat3, DMat4, DVec3};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};
use terrane::formats::writers::{GlbMesh, GlbNormalMap, GlbRoughness, write_compressed_glb, write_glb};
use terrane::math::{Ellipsoid, Geodetic};

use super::encoding::Triangles;
use super::options::Tiling;
use super::tin::Tin;
use crate::pyramid::{Block, CELLS, TileKey};
use crate::{ContentKind, Extent, GenArgs, GenError};

/// Returns which triangles of a cell have data: the south-eastern and the north-western one. Cells from -1 to 64.
type HasData<'a> = Box<dyn Fn(i64, i64) -> [bool; 2] + 'a>;

/// The samples of a tile that becomes a mesh: those of a block, or of a world.
pub(crate) struct MeshTile<'a> {
    pub key: TileKey,
    /// The rectangle of the set, and that of the tile.
    pub set: Extent,
    pub extent: Extent,
    /// The height of the origin of the mesh's frame in metres.
    pub origin_m: f64,
    /// The heights in metres of the vertices and of those next to the tile, southern row first.
    pub heights_m: Vec<f32>,
    /// `None` if all triangles have data.
    pub has_data: Option<HasData<'a>>,
    pub ellipsoid: Ellipsoid,
}

/// The form of mesh files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MeshForm {
    pub triangles: Triangles,
    pub has_normal_map: bool,
    pub is_quantized: bool,
    /// True for EXT_meshopt_compression.
    pub is_compressed: bool,
    /// True if the vertices of files are on the earth, so that tiles need no transform.
    pub is_placed: bool,
}

impl MeshForm {
    pub fn new(args: &GenArgs) -> Self {
        // Beside height tiles meshes have all vertices of a common edge.
        let triangles = if args.content == ContentKind::Height { Triangles::Grid } else { args.tiles.triangles };
        Self {
            triangles,
            has_normal_map: args.tiles.normal_maps && triangles == Triangles::Tin,
            is_quantized: !args.float_vertices,
            is_compressed: !args.float_vertices && !args.tiles.no_meshopt,
            // Tiles of implicit tilings have no transform.
            is_placed: args.output.tiling == Tiling::Implicit,
        }
    }
}

/// The look of a mesh.
#[derive(Clone, Debug, Default)]
pub(crate) struct Look {
    /// The file of its texture; `None` without one.
    pub image: Option<Vec<u8>>,
    /// Maps of it need a texture.
    pub roughness: GlbRoughness,
}

/// Returns the height of the origin of the frame of a block's tile, in metres.
fn origin_m(block: &Block<'_>, key: TileKey) -> f64 {
    let facts = block.facts(key);
    0.5 * (f64::from(facts.min_height_m) + f64::from(facts.max_height_m))
}

/// Returns the transform to ECEF from the east-north-up frame in the middle of a rectangle, at a height.
fn ecef_from_middle(ellipsoid: &Ellipsoid, e: &Extent, height_m: f64) -> DAffine3 {
    ellipsoid.ecef_from_enu(&Geodetic {
        longitude: 0.5 * (e.west + e.east),
        latitude: 0.5 * (e.south + e.north),
        height_m,
    })
}

/// Returns the transform from the frame of the mesh of a block's tile to ECEF.
pub(super) fn ecef_from_tile(block: &Block<'_>, key: TileKey) -> DAffine3 {
    ecef_from_middle(&block.ellipsoid(), &block.extent(key), origin_m(block, key))
}

impl<'a> MeshTile<'a> {
    /// Returns the samples of a tile with data.
    pub fn of_block(block: &'a Block<'a>, key: TileKey) -> Self {
        let last = CELLS as i64 + 1;
        let mut heights_m = Vec::with_capacity(SIDE * SIDE);
        (-1..=last).for_each(|j| block.add_heights(key, -1..=last, j, &mut heights_m));
        let cells = (CELLS as i64) << key.level;
        let has_data = move |i: i64, j: i64| {
            // Cells beyond the edge belong to neighbours; beyond the edge of the block they repeat the nearest ones. So at
            // borders of voids on such an edge, tiles of two blocks may keep different vertices, within the allowed distance
            // and covered by skirts.
            let [x, y] =
                [(key.x, i), (key.y, j)].map(|(tile, c)| (i64::from(tile) * CELLS as i64 + c).clamp(0, cells - 1));
            let [(x, i), (y, j)] = [x, y].map(|c| ((c as usize / CELLS) as u32, c as usize % CELLS));
            block.triangles(TileKey { level: key.level, x, y }, i, j)
        };
        Self {
            key,
            set: block.extent(TileKey::ROOT),
            extent: block.extent(key),
            origin_m: origin_m(block, key),
            heights_m,
            ellipsoid: block.ellipsoid(),
            has_data: if block.is_whole() { None } else { Some(Box::new(has_data)) },
        }
    }

    /// Returns the heights in metres of a row, from the vertex west of the tile on; -1 and 65 are the rows next to the tile.
    fn row_m(&self, j: i64) -> &[f32] {
        &self.heights_m[(j + 1) as usize * SIDE..][..SIDE]
    }

    /// Returns the triangles of the tile. [`Tin::of_samples`] describes the limits of triangulations.
    pub fn triangles(&self, kind: Triangles, limits_m: &[f64], most_m: f64) -> Tin {
        let has_data = self.has_data.as_deref();
        match kind {
            Triangles::Grid => Tin::grid(|i, j| has_data.map_or([true; 2], |has_data| has_data(i as i64, j as i64))),
            Triangles::Tin => {
                let curvature_m = |row: i64| self.curvature_m(row);
                let height_m = |i: i64, j: i64| self.row_m(j)[(i + 1) as usize];
                let has_data = has_data.map(|f| f as &dyn Fn(i64, i64) -> [bool; 2]);
                Tin::of_samples(&height_m, &curvature_m, has_data, limits_m, most_m)
            }
        }
    }

    /// Returns the height in metres by which the earth falls within a cell at a row, eastwards and northwards.
    fn curvature_m(&self, row: i64) -> [f64; 2] {
        let cells = (CELLS as i64) << self.key.level;
        curvature_m(&self.ellipsoid, &self.set, cells, i64::from(self.key.y) * CELLS as i64 + row)
    }

    /// Returns the largest vertical distance between the edges of the tile and those that tiles one or two levels coarser have
    /// there, in metres, if their vertices are some of the tile's.
    pub fn edge_step_m(&self) -> f64 {
        let last = CELLS as i64;
        let edge = |at: fn(i64, i64) -> [i64; 2]| -> Vec<f64> {
            (0..=last).map(|k| at(k, last)).map(|[i, j]| f64::from(self.row_m(j)[(i + 1) as usize])).collect()
        };
        let north_m = self.curvature_m(last / 2)[1];
        let edges = [
            (edge(|k, _| [k, 0]), self.curvature_m(0)[0]),
            (edge(|k, last| [k, last]), self.curvature_m(last)[0]),
            (edge(|k, _| [0, k]), north_m),
            (edge(|k, last| [last, k]), north_m),
        ];
        let mut step_m = 0.0f64;
        for ((heights_m, fall_m), cells) in edges.iter().flat_map(|edge| [(edge, 2usize), (edge, 4)]) {
            let bulge_m = fall_m * (cells * cells) as f64;
            for (k, height_m) in heights_m.iter().enumerate().filter(|(k, _)| k % cells != 0) {
                let (start, t) = (k - k % cells, (k % cells) as f64 / cells as f64);
                let chord_m = heights_m[start] + t * (heights_m[start + cells] - heights_m[start]);
                step_m = step_m.max((chord_m - bulge_m * t * (1.0 - t) - height_m).abs());
            }
        }
        step_m
    }

    /// Returns the glb file of triangles of the tile. Skirts hang `skirt_m` down from its edges.
    pub fn glb(&self, form: &MeshForm, tin: &Tin, skirt_m: f64, look: Look) -> Result<Vec<u8>, GenError> {
        let failed = |e| GenError::Encode(format!("normal map of tile {:?}: {e}", self.key));
        let mut mesh = build(self, form, tin, skirt_m, look).map_err(failed)?;
        mesh.file_from_mesh = form.is_placed.then(|| self.file_from_mesh());
        Ok(if form.is_compressed { write_compressed_glb(&mesh) } else { write_glb(&mesh) })
    }

    /// Returns the transform from the mesh to a file whose frame, y up, is the earth's.
    fn file_from_mesh(&self) -> DMat4 {
        // glTF's y axis points up; a quarter turn about x maps it to z.
        let z_up_from_y_up = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y));
        let ecef_from_mesh = ecef_from_middle(&self.ellipsoid, &self.extent, self.origin_m);
        DMat4::from(z_up_from_y_up.inverse() * ecef_from_mesh * z_up_from_y_up)
    }
}

/// Returns the height in metres by which the earth falls below its tangent plane within one cell eastwards and one northwards at
/// a row of a set with `cells` cells along a side. Tiles that share the row get the same bits.
pub(crate) fn curvature_m(ellipsoid: &Ellipsoid, set: &Extent, cells: i64, row: i64) -> [f64; 2] {
    let latitude = set.south + (set.north - set.south) * (row as f64 / cells as f64);
    let [d_lon, d_lat] = [set.east - set.west, set.north - set.south].map(|side| side / cells as f64);
    let radius_m = ellipsoid.prime_vertical_radius_m(latitude);
    let flatter = 1.0 - ellipsoid.eccentricity_squared() * latitude.sin().powi(2);
    let meridian_m = radius_m * (1.0 - ellipsoid.eccentricity_squared()) / flatter;
    [0.5 * radius_m * (latitude.cos() * d_lon).powi(2), 0.5 * meridian_m * d_lat.powi(2)]
}

/// The samples along a side of a [`Lattice`].
const SIDE: usize = CELLS + 3;

/// The samples of a tile and those next to it, in the frame of the tile's mesh.
pub(super) struct Lattice {
    /// Rows from south to north, each from west to east.
    places: Vec<DVec3>,
    /// The axes of ECEF in the frame of the mesh.
    axes: DMat3,
    /// Sine and cosine of the longitudes of columns, and of the latitudes of rows.
    columns: [[f64; 2]; SIDE],
    rows: [[f64; 2]; SIDE],
}

impl Lattice {
    fn new(tile: &MeshTile<'_>) -> Self {
        let e = tile.extent;
        let angles = |from: f64, to: f64| {
            std::array::from_fn::<f64, SIDE, _>(|k| from + (to - from) * ((k as f64 - 1.0) / CELLS as f64))
        };
        let (longitudes, latitudes) = (angles(e.west, e.east), angles(e.south, e.north));
        let of = |angle: f64| <[f64; 2]>::from(angle.sin_cos());
        let (columns, rows) = (longitudes.map(of), latitudes.map(of));
        let tile_from_ecef = ecef_from_middle(&tile.ellipsoid, &e, tile.origin_m).inverse();
        let (axes, centre) = (tile_from_ecef.matrix3, tile_from_ecef.translation);
        let mut places = Vec::with_capacity(SIDE * SIDE);
        for (j, ([sin_lat, cos_lat], latitude)) in (-1..).zip(rows.into_iter().zip(latitudes)) {
            let radius_m = tile.ellipsoid.prime_vertical_radius_m(latitude);
            let polar_m = radius_m * (1.0 - tile.ellipsoid.eccentricity_squared());
            places.extend(columns.iter().zip(tile.row_m(j)).map(|([sin_lon, cos_lon], height_m)| {
                let height_m = f64::from(*height_m);
                let r = (radius_m + height_m) * cos_lat;
                axes * DVec3::new(r * cos_lon, r * sin_lon, (polar_m + height_m) * sin_lat) + centre
            }));
        }
        Self { places, axes, columns, rows }
    }

    /// Returns the place of a sample; -1 and 65 are those next to the tile.
    fn at(&self, i: i64, j: i64) -> DVec3 {
        self.places[(j + 1) as usize * SIDE + (i + 1) as usize]
    }

    /// Returns the direction upwards at a sample.
    fn up(&self, i: i64, j: i64) -> DVec3 {
        let ([sin_lon, cos_lon], [sin_lat, cos_lat]) = (self.columns[(i + 1) as usize], self.rows[(j + 1) as usize]);
        self.axes * DVec3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat)
    }

    /// Returns the directions eastwards, northwards and upwards at a sample. At a pole each column has its own east.
    pub fn frame(&self, i: i64, j: i64) -> [DVec3; 3] {
        let [sin_lon, cos_lon] = self.columns[(i + 1) as usize];
        let (east, up) = (self.axes * DVec3::new(-sin_lon, cos_lon, 0.0), self.up(i, j));
        [east, up.cross(east), up]
    }

    /// Returns the normal of the surface at a sample of the tile, from the samples next to it. At a pole, where they coincide,
    /// it is the direction upwards.
    pub fn normal(&self, i: i64, j: i64) -> DVec3 {
        let east = self.at(i + 1, j) - self.at(i - 1, j);
        let north = self.at(i, j + 1) - self.at(i, j - 1);
        east.cross(north).normalize_or(self.up(i, j))
    }
}

/// The vertices of a mesh, numbered by their first use.
struct Numbers {
    /// The vertex of the triangles, and whether it is the one at the bottom of the skirt.
    vertices: Vec<(u16, bool)>,
    /// The numbers of the vertices of the triangles, at the top and at the bottom; [`Self::UNUSED`] before their first use.
    numbers: [Vec<u16>; 2],
}

impl Numbers {
    /// Tiles with their skirts have fewer vertices.
    const UNUSED: u16 = u16::MAX;

    fn new(tin: &Tin) -> Self {
        let numbers = [0; 2].map(|_| vec![Self::UNUSED; tin.vertices.len()]);
        Self { vertices: Vec::with_capacity(tin.vertices.len() + 4 * CELLS), numbers }
    }

    #[inline(always)]
    fn of(&mut self, vertex: u16, is_bottom: bool) -> u16 {
        let number = &mut self.numbers[usize::from(is_bottom)][usize::from(vertex)];
        if *number == Self::UNUSED {
            *number = self.vertices.len() as u16;
            self.vertices.push((vertex, is_bottom));
        }
        *number
    }
}

/// Returns the edges of the tile that a vertex lies on, a bit for each.
fn edges_of([i, j]: [u16; 2]) -> u8 {
    let last = CELLS as u16;
    u8::from(i == 0) | u8::from(i == last) << 1 | u8::from(j == 0) << 2 | u8::from(j == last) << 3
}

/// Builds the mesh of [`MeshTile::glb`]. Normals are those of the tile's samples, also where there are fewer vertices. With a
/// normal map, the map has them, and the normals of vertices point upwards. The error says why the map cannot be encoded.
fn build(tile: &MeshTile<'_>, form: &MeshForm, tin: &Tin, skirt_m: f64, look: Look) -> Result<GlbMesh, String> {
    // A triangle whose edge lies on an edge of the tile has a skirt there. Its front faces outwards.
    let mut numbers = Numbers::new(tin);
    let mut indices = Vec::with_capacity(3 * tin.triangles.len() + 24 * CELLS);
    let edges: Vec<u8> = tin.vertices.iter().map(|vertex| edges_of(*vertex)).collect();
    for triangle in &tin.triangles {
        let [a, b, c] = *triangle;
        let corners = [numbers.of(a, false), numbers.of(b, false), numbers.of(c, false)];
        indices.extend_from_slice(&corners);
        let [of_a, of_b, of_c] = triangle.map(|vertex| edges[usize::from(vertex)]);
        if (of_a & of_b) | (of_b & of_c) | (of_c & of_a) == 0 {
            continue;
        }
        for (k, next) in [(0, 1), (1, 2), (2, 0)] {
            let [from, to] = [triangle[k], triangle[next]];
            if edges[usize::from(from)] & edges[usize::from(to)] != 0 {
                let [a, b] = [corners[k], corners[next]];
                let [c, d] = [from, to].map(|vertex| numbers.of(vertex, true));
                indices.extend([a, c, d, a, d, b]);
            }
        }
    }
    let lattice = Lattice::new(tile);
    // glTF's y axis points up: x = east, y = up, z = -north.
    let y_up = |v: DVec3| [v.x as f32, v.z as f32, -v.y as f32];
    let Look { image, roughness } = look;
    let has_uvs = image.is_some() || form.has_normal_map;
    let mut map = form.has_normal_map.then(|| normal_map(&lattice)).transpose()?;
    let mut mesh =
        GlbMesh { base_color: [1.0; 4], image, roughness, quantized: form.is_quantized, indices, ..GlbMesh::default() };
    mesh.positions.reserve(numbers.vertices.len());
    mesh.normals.reserve(numbers.vertices.len());
    for (vertex, is_bottom) in numbers.vertices {
        let [i, j] = tin.vertices[usize::from(vertex)].map(i64::from);
        let place = lattice.at(i, j);
        mesh.positions.push(y_up(if is_bottom { place - skirt_m * lattice.up(i, j) } else { place }));
        match &mut map {
            Some(map) => {
                let [east, _, up] = lattice.frame(i, j);
                mesh.normals.push(y_up(up));
                let [x, y, z] = y_up(east);
                map.tangents.push([x, y, z, 1.0]);
            }
            None => mesh.normals.push(y_up(lattice.normal(i, j))),
        }
        // Without a texture nothing reads its coordinates.
        if has_uvs {
            mesh.uvs.push([i as f32 / CELLS as f32, 1.0 - j as f32 / CELLS as f32]);
        }
    }
    mesh.normal_map = map;
    if !tin.is_ordered {
        mesh.optimize_order();
    }
    Ok(mesh)
}

/// The texels along a side of a normal map: one for each sample.
const TEXELS: u32 = CELLS as u32 + 1;

/// Returns the map of normals of a tile, without tangents. On failure returns the reason.
///
/// The frame of the map is east, north and up, and the mesh has these directions as tangents and normals of its vertices. So it
/// is the same for all triangles, however steep, and for all ways in which readers derive tangents. Texels lie on samples:
/// neighbours have the same ones on a common edge.
///
/// PNG takes the fewest bytes: a map of the samples of Kilauea 4.3 kB, as WebP without loss 5.1 kB. JPEG would show its blocks.
fn normal_map(lattice: &Lattice) -> Result<GlbNormalMap, String> {
    let last = CELLS as i64;
    let mut texels = Vec::with_capacity(3 * (TEXELS * TEXELS) as usize);
    for (j, i) in (0..=last).rev().flat_map(|j| (0..=last).map(move |i| (j, i))) {
        let normal = lattice.normal(i, j);
        texels.extend(lattice.frame(i, j).map(|axis| ((0.5 + 0.5 * normal.dot(axis)) * 255.0).round() as u8));
    }
    let mut image = Vec::new();
    PngEncoder::new_with_quality(&mut image, CompressionType::Default, FilterType::Paeth)
        .write_image(&texels, TEXELS, TEXELS, ExtendedColorType::Rgb8)
        .map_err(|e| e.to_string())?;
    // The texture coordinates of a tile reach from the centres of the outermost texels to each other.
    let texel = 1.0 / TEXELS as f32;
    Ok(GlbNormalMap { image, tangents: Vec::new(), uv_scale: [1.0 - texel; 2], uv_offset: [0.5 * texel; 2] })
}
