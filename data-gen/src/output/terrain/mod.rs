//! Writes terrain for globes: quantized-mesh tiles in the geographic tiling of the Tile Map Service, with a layer.json.
//!
//! Each tile samples the source itself, because tiles of that tiling do not depend on the rectangle of the source. Levels are made from
//! the finest to the coarsest, so that the heights in a tile's header hold for the finer tiles inside, which clients cull by.
//!
//! | file | contents |
//! |---|---|
//! | `heights` | the heights of a tile's vertices |
//! | `turned` | a source across the date line on the longitudes of the tiling |
//! | `layer` | layer.json with the ranges of tiles |

mod heights;
mod layer;
mod turned;

use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;
use terrane::formats::writers::{TerrainMesh, write_quantized_mesh};
use terrane::math::{Geodetic, WGS84};

use self::heights::{Heights, TileHeights};
use self::layer::layer_json;
use super::encoding::Triangles;
use super::mesh::curvature_m;
use super::tile_set::write_whole;
use super::tin::Tin;
use crate::pyramid::{CELLS, TileKey};
use crate::{ElevationSource, Extent, GenArgs, GenError, Progress, Summary, Voids};

/// The error in metres that CesiumJS assumes for level 0: a quarter of the distance of 65 samples at the equator. It is halved from level
/// to level.
const LEVEL_0_ERROR_M: f64 = 77_067.34;
/// The allowed distance of samples and triangles as a share of the level's error: half a pixel with the usual limit of 2.
const SHARE_OF_LEVEL: f64 = 0.25;

/// Describes a tile that was written, or found complete.
struct Written {
    key: TileKey,
    /// The lowest and the highest height of the tile and of the finer tiles inside.
    range_m: [f32; 2],
    /// The same of the vertices with data alone.
    data_m: [f32; 2],
    /// Vertices inside of the source's rectangle without data.
    voids: u64,
    bytes: u64,
}

/// Writes all tiles and layer.json into a folder, on the threads of the current rayon pool. `extent` is the rectangle of the source;
/// level `levels - 1` of the tiling is the finest. `is_fine` is true if it is as fine as the source. The caller fills in the
/// duration and the final folder of the summary.
pub(crate) fn write_terrain(
    args: &GenArgs,
    source: &dyn ElevationSource,
    extent: Extent,
    (levels, is_fine): (u32, bool),
    folder: &Path,
) -> Result<Summary, GenError> {
    let turned = turned::Turned::new(source, extent);
    let heights = Heights::new(args.voids, &turned, source, extent, levels, is_fine);
    let by_level: Vec<Vec<TileKey>> = (0..levels).map(|level| heights.tiles(level)).collect();
    let tiles: usize = by_level.iter().map(Vec::len).sum();
    let progress = Progress::new("writing", tiles as u64, "tiles");
    let (mut bytes, mut voids, mut range_m) = (0, 0, [f32::INFINITY, f32::NEG_INFINITY]);
    let mut below: HashMap<TileKey, [f32; 2]> = HashMap::new();
    for (level, keys) in by_level.iter().enumerate().rev() {
        let mut columns: Vec<u32> = keys.iter().map(|key| key.x).collect();
        columns.sort_unstable();
        columns.dedup();
        for x in columns {
            let path = folder.join(format!("{level}/{x}"));
            std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
        }
        let write = |key: &TileKey| {
            let written = write_tile(args, &heights, *key, &below, folder);
            progress.advance(1);
            written
        };
        let written: Vec<Written> = keys.par_iter().map(write).collect::<Result<_, GenError>>()?;
        bytes += written.iter().map(|tile| tile.bytes).sum::<u64>();
        if level + 1 == levels as usize {
            voids = written.iter().map(|tile| tile.voids).sum();
            range_m = written.iter().fold(range_m, |range, tile| union(range, tile.data_m));
        }
        below = written.into_iter().map(|tile| (tile.key, tile.range_m)).collect();
    }
    if range_m[0] > range_m[1] {
        let reason = "no vertex of the finest level lies on the elevation; more --levels have some";
        return Err(GenError::invalid(args.dem.first().cloned().unwrap_or_default(), reason));
    }
    let layer = layer_json(args, &extent, &by_level);
    bytes += write_whole(&folder.join("layer.json"), layer.as_bytes())?;
    let mut notes = Vec::new();
    if voids > 0 && args.voids == Voids::Cut {
        notes.push(format!("{voids} samples without data are filled: quantized-mesh tiles have no holes"));
    }
    Ok(Summary {
        out: folder.to_path_buf(),
        tiles: tiles as u64,
        levels,
        bytes,
        min_height_m: range_m[0].into(),
        max_height_m: range_m[1].into(),
        filled_samples: voids,
        notes,
        ..Summary::default()
    })
}

fn union(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Writes a tile, unless its file is there: it has its name only when it is complete.
fn write_tile(
    args: &GenArgs,
    heights: &Heights<'_>,
    key: TileKey,
    below: &HashMap<TileKey, [f32; 2]>,
    folder: &Path,
) -> Result<Written, GenError> {
    let tile = heights.of(key)?;
    let finer = key.children().iter().filter_map(|child| below.get(child).copied()).collect::<Vec<_>>();
    let range_m = finer.into_iter().fold(tile.range_m(), union);
    let path = folder.join(format!("{}/{}/{}.terrain", key.level, key.x, key.y));
    let bytes = match path.metadata() {
        Ok(file) => file.len(),
        Err(_) => {
            let mesh = mesh_of(&tile, key.level, range_m, args.tiles.triangles);
            let bytes = write_quantized_mesh(&mesh);
            let bytes = bytes.ok_or_else(|| GenError::Encode(format!("the triangles of tile {key:?} are invalid")))?;
            write_whole(&path, &bytes)?
        }
    };
    Ok(Written { key, range_m, data_m: tile.data_m, voids: tile.voids, bytes })
}

/// Returns the mesh of a tile. Normals are those of the tile's samples, also where there are fewer vertices.
fn mesh_of(tile: &TileHeights, level: u32, range_m: [f32; 2], triangles: Triangles) -> TerrainMesh {
    let set = heights::SQUARE;
    let curvature_m = |row: i64| curvature_m(&set, tile.cells, tile.first[1] + row);
    let tin = match triangles {
        Triangles::Grid => Tin::grid(|_, _| [true; 2]),
        Triangles::Tin => {
            let limit_m = SHARE_OF_LEVEL * LEVEL_0_ERROR_M / f64::from(level).exp2();
            Tin::of_samples(&|i, j| tile.height_m(i, j), &curvature_m, None, limit_m)
        }
    };
    let e = tile.extent;
    let position = |i: i64, j: i64| -> DVec3 {
        let share = |c: i64| c as f64 / CELLS as f64;
        WGS84.ecef(&Geodetic {
            longitude: e.west + (e.east - e.west) * share(i),
            latitude: e.south + (e.north - e.south) * share(j),
            height_m: tile.height_m(i, j).into(),
        })
    };
    let mut mesh = TerrainMesh {
        rectangle: [e.west, e.south, e.east, e.north],
        heights_m: range_m,
        triangles: tin.triangles.as_flattened().iter().copied().map(u32::from).collect(),
        ..TerrainMesh::default()
    };
    for [i, j] in tin.vertices.iter().map(|vertex| vertex.map(i64::from)) {
        let [u, v] = [i, j].map(|c| c as f64 / CELLS as f64);
        mesh.vertices.push([u, v, tile.height_m(i, j).into()]);
        // Beyond a pole and at the date line there is no further vertex.
        let [west, east] = tile.neighbors(i, 0);
        let [south, north] = tile.neighbors(j, 1);
        let normal = (position(east, j) - position(west, j)).cross(position(i, north) - position(i, south));
        mesh.normals.push(normal.normalize_or(position(i, j).normalize()));
    }
    mesh
}
