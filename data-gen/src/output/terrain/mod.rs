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

use self::heights::{Heights, NO_HEIGHTS_M, TileHeights};
use self::layer::{layer_json, metadata_json};
use super::encoding::Triangles;
use super::journal::{CompleteTile, Journal};
use super::mesh::curvature_m;
use super::tile_set::write_whole;
use super::tin::Tin;
use crate::pyramid::{CELLS, TileKey};
use crate::{ElevationSource, Extent, GenArgs, GenError, Progress, Shard, Summary, Voids};

/// The error in metres that CesiumJS assumes for level 0: a quarter of the distance of 65 samples at the equator. It is halved from level
/// to level.
const LEVEL_0_ERROR_M: f64 = 77_067.34;
/// The allowed distance of samples and triangles as a share of the level's error: half a pixel with the usual limit of 2.
const SHARE_OF_LEVEL: f64 = 0.25;

/// Levels of the subtrees that shards make; a merge makes the coarser tiles.
const SHARD_LEVELS: u32 = 5;
/// With `--tile-availability`, tiles of the levels that this number divides name the tiles of as many levels below.
const METADATA_LEVELS: u32 = 10;

/// Terrain to be written: the heights of a source, and the number of levels.
pub(crate) struct TerrainSet<'a> {
    pub source: &'a dyn ElevationSource,
    /// The rectangle of the source.
    pub extent: Extent,
    pub levels: u32,
    /// True if the finest level is as fine as the source.
    pub is_fine: bool,
}

impl TerrainSet<'_> {
    /// Calls with the heights of the set.
    fn with_heights<T>(&self, args: &GenArgs, call: impl FnOnce(&Heights<'_>) -> T) -> T {
        let turned = turned::Turned::new(self.source, self.extent);
        call(&Heights::new(args.voids, &turned, self.source, self.extent, self.levels, self.is_fine))
    }

    /// Returns the roots of the subtrees that shards make, in order.
    pub fn roots(&self, args: &GenArgs) -> Vec<TileKey> {
        self.with_heights(args, |heights| heights.tiles(self.levels.saturating_sub(SHARD_LEVELS)))
    }

    /// Returns the largest number of tiles of such a subtree.
    pub fn tiles_per_root(&self) -> u64 {
        (0..self.levels.min(SHARD_LEVELS)).map(|level| 1u64 << (2 * level)).sum()
    }

    /// Writes all tiles and layer.json into a folder, on the threads of the current rayon pool; of a shard only the tiles below its
    /// roots. Tiles that a killed run or a shard has completed are not made again. The caller fills in the duration and the final folder
    /// of the summary.
    pub fn write(&self, args: &GenArgs, folder: &Path, shard: Option<Shard>) -> Result<Summary, GenError> {
        let roots = shard.map(|_| self.roots(args)).unwrap_or_default();
        let part = shard.map(|shard| shard.part_of(&roots));
        self.with_heights(args, |heights| self.write_part(args, heights, folder, shard.zip(part)))
    }

    fn write_part(
        &self,
        args: &GenArgs,
        heights: &Heights<'_>,
        folder: &Path,
        shard: Option<(Shard, &[TileKey])>,
    ) -> Result<Summary, GenError> {
        let levels = self.levels;
        let by_level: Vec<Vec<TileKey>> = match shard {
            None => (0..levels).map(|level| heights.tiles(level)).collect(),
            Some((_, roots)) => (0..levels)
                .map(|level| roots.iter().flat_map(|root| heights.tiles_below(*root, level)).collect())
                .collect(),
        };
        let tiles: usize = by_level.iter().map(Vec::len).sum();
        let progress = Progress::new("writing", tiles as u64, "tiles");
        let journal = Journal::new(folder);
        let list = journal.tiles(shard.map(|(shard, _)| shard))?;
        let (mut bytes, mut voids, mut range_m) = (0, 0, NO_HEIGHTS_M);
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
                let written = match list.get(*key) {
                    Some(complete) => complete,
                    None => {
                        let complete = write_tile(args, heights, *key, &below, folder)?;
                        list.add(*key, &complete)?;
                        complete
                    }
                };
                progress.advance(1);
                Ok((*key, written))
            };
            let written: Vec<(TileKey, CompleteTile)> = keys.par_iter().map(write).collect::<Result<_, GenError>>()?;
            bytes += written.iter().map(|(_, tile)| tile.bytes).sum::<u64>();
            if level + 1 == levels as usize {
                voids = written.iter().map(|(_, tile)| tile.voids).sum();
                range_m = written.iter().fold(range_m, |range, (_, tile)| union(range, tile.data_m));
            }
            below = written.into_iter().map(|(key, tile)| (key, tile.range_m)).collect();
        }
        let mut notes = Vec::new();
        if voids > 0 && args.voids == Voids::Cut {
            notes.push(format!("{voids} samples without data are filled: quantized-mesh tiles have no holes"));
        }
        if shard.is_none() {
            if range_m[0] > range_m[1] {
                let reason = "no vertex of the finest level lies on the elevation; more --levels have some";
                return Err(GenError::invalid(args.dem.first().cloned().unwrap_or_default(), reason));
            }
            let layer = layer_json(args, &self.extent, &by_level);
            bytes += write_whole(&folder.join("layer.json"), layer.as_bytes())?;
            drop(list);
            journal.remove()?;
        }
        let [min_height_m, max_height_m] = if range_m[0] > range_m[1] { [0.0; 2] } else { range_m.map(f64::from) };
        Ok(Summary {
            out: folder.to_path_buf(),
            tiles: tiles as u64,
            levels,
            bytes,
            min_height_m,
            max_height_m,
            filled_samples: voids,
            notes,
            ..Summary::default()
        })
    }
}

fn union(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Writes a tile.
fn write_tile(
    args: &GenArgs,
    heights: &Heights<'_>,
    key: TileKey,
    below: &HashMap<TileKey, [f32; 2]>,
    folder: &Path,
) -> Result<CompleteTile, GenError> {
    let tile = heights.of(key)?;
    let finer = key.children().iter().filter_map(|child| below.get(child).copied()).collect::<Vec<_>>();
    let range_m = finer.into_iter().fold(tile.range_m(), union);
    let path = folder.join(format!("{}/{}/{}.terrain", key.level, key.x, key.y));
    let mut mesh = mesh_of(&tile, key.level, range_m, args.tiles.triangles);
    if args.output.tile_availability && key.level.is_multiple_of(METADATA_LEVELS) {
        let levels = key.level + 1..(key.level + 1 + METADATA_LEVELS).min(heights.levels());
        let below: Vec<Vec<TileKey>> = levels.map(|level| heights.tiles_below(key, level)).collect();
        mesh.metadata = metadata_json(&below);
    }
    let bytes = write_quantized_mesh(&mesh);
    let bytes = bytes.ok_or_else(|| GenError::Encode(format!("the triangles of tile {key:?} are invalid")))?;
    let bytes = write_whole(&path, &bytes)?;
    Ok(CompleteTile { bytes, range_m, data_m: tile.data_m, voids: tile.voids })
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
