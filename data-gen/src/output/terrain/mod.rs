//! Writes terrain for globes: quantized-mesh tiles in the geographic tiling of the Tile Map Service, with a layer.json.
//!
//! Each tile samples the source itself, because tiles of that tiling do not depend on the rectangle of the source. Levels are
//! made from the finest to the coarsest, so that the heights in a tile's header hold for the finer tiles inside, which clients
//! cull by.
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
use super::journal::{CompleteTile, Inputs, Journal, TileList};
use super::mesh::curvature_m;
use super::set_files::write_whole;
use super::tin::Tin;
use crate::pyramid::{CELLS, TileKey};
use crate::update::TerrainUpdate;
use crate::{ElevationSource, Extent, GenArgs, GenError, Progress, Shard, Summary, Voids};

/// The error in metres that CesiumJS assumes for level 0: a quarter of the distance of 65 samples at the equator. It is halved
/// from level to level.
const LEVEL_0_ERROR_M: f64 = 77_067.34;
/// The allowed distance of samples and triangles as a share of the level's error: half a pixel with the usual limit of 2.
const SHARE_OF_LEVEL: f64 = 0.25;

/// Levels of the subtrees that shards make; a merge makes the coarser tiles.
const SHARD_LEVELS: u32 = 5;
/// With `--tile-availability`, tiles of the levels that this number divides name the tiles of as many levels below.
pub(crate) const METADATA_LEVELS: u32 = 10;

/// The number of subtrees in which the tiles of the finest levels are counted.
const COUNTED: usize = 64;
/// More bytes than a tile takes in the lists of a run.
const LISTED_BYTES: u64 = 256;
/// More bytes than the averages and the coarse lattices take that voids are filled from.
const FILLED_BYTES: u64 = 28 << 20;

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

    /// Returns the number of tiles of each level. Those of the finest levels are estimated from some subtrees if there are many.
    pub fn count_tiles(&self, args: &GenArgs) -> Vec<u64> {
        self.with_heights(args, |heights| {
            let root = self.levels.saturating_sub(SHARD_LEVELS);
            let roots = heights.tiles(root);
            let some: Vec<TileKey> = spread(&roots, COUNTED);
            let scale = roots.len() as f64 / some.len().max(1) as f64;
            let count = |level: u32| match level {
                _ if level < root => heights.tiles(level).len() as u64,
                _ => {
                    let found: usize = some.iter().map(|root| heights.tiles_below(*root, level).len()).sum();
                    (scale * found as f64).round() as u64
                }
            };
            (0..self.levels).map(count).collect()
        })
    }

    /// Returns the bytes that a run takes beside those of each thread and of the blocks of sources.
    pub fn work_bytes(&self, args: &GenArgs) -> u64 {
        let per_tile = if args.run.update { 2 * LISTED_BYTES } else { LISTED_BYTES };
        FILLED_BYTES + per_tile * self.count_tiles(args).iter().sum::<u64>()
    }

    /// Makes the tiles of subtrees of some levels at a number of places, as a sample. Returns for each level from `root` on the
    /// number of tiles and their bytes.
    pub fn sample(&self, args: &GenArgs, root: u32, places: usize, folder: &Path) -> Result<Vec<[u64; 2]>, GenError> {
        self.with_heights(args, |heights| {
            let roots = spread(&heights.tiles(root), places);
            let below = |level| roots.iter().flat_map(|root| heights.tiles_below(*root, level)).collect();
            let by_level: Vec<Vec<TileKey>> = (0..self.levels).map(below).collect();
            let list = Journal::new(folder).tiles(None)?;
            let progress = Progress::new("sampling", by_level.iter().map(Vec::len).sum::<usize>() as u64, "tiles");
            let made = Run { args, heights, folder, list, update: None, progress }.make(&by_level)?;
            Ok((root as usize..by_level.len()).map(|k| [by_level[k].len() as u64, made.bytes[k]]).collect())
        })
    }

    /// Returns a checksum of the heights that wide gaps continue.
    pub fn gaps_checksum(&self, args: &GenArgs) -> Result<Option<u64>, GenError> {
        self.with_heights(args, |heights| heights.gaps_checksum())
    }

    /// Writes all tiles and layer.json into a folder, on the threads of the current rayon pool; of a shard only the tiles below
    /// its roots. Tiles that a killed run or a shard has completed are not made again, nor those that an update keeps. The
    /// caller fills in the duration and the final folder of the summary.
    pub fn write(
        &self,
        args: &GenArgs,
        folder: &Path,
        shard: Option<Shard>,
        update: Option<&TerrainUpdate<'_>>,
    ) -> Result<Written, GenError> {
        let roots = shard.map(|_| self.roots(args)).unwrap_or_default();
        let part = shard.map(|shard| shard.part_of(&roots));
        self.with_heights(args, |heights| self.write_part(args, heights, folder, shard.zip(part), update))
    }

    fn write_part(
        &self,
        args: &GenArgs,
        heights: &Heights<'_>,
        folder: &Path,
        shard: Option<(Shard, &[TileKey])>,
        update: Option<&TerrainUpdate<'_>>,
    ) -> Result<Written, GenError> {
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
        let run = Run { args, heights, folder, list, update, progress };
        let Made { bytes, voids, range_m, has_gaps } = run.make(&by_level)?;
        drop(run);
        let mut bytes: u64 = bytes.iter().sum();
        let mut notes = Vec::new();
        if voids > 0 && args.voids == Voids::Cut {
            notes.push(format!("{voids} samples without data are filled: quantized-mesh tiles have no holes"));
        }
        if shard.is_none() {
            if range_m[0] > range_m[1] {
                let reason = "no vertex of the finest level lies on the elevation; more --levels have some";
                return Err(GenError::invalid(args.dem.first().cloned().unwrap_or_default(), reason));
            }
            let layer = layer_json(args, &self.extent, &by_level, heights.has_water()?);
            bytes += write_whole(&folder.join("layer.json"), layer.as_bytes())?;
            journal.sort_tiles()?;
        }
        let [min_height_m, max_height_m] = if range_m[0] > range_m[1] { [0.0; 2] } else { range_m.map(f64::from) };
        let summary = Summary {
            out: folder.to_path_buf(),
            tiles: tiles as u64,
            levels,
            bytes,
            min_height_m,
            max_height_m,
            filled_samples: voids,
            notes,
            ..Summary::default()
        };
        let gaps = if has_gaps && shard.is_none() { heights.gaps_checksum()? } else { None };
        Ok(Written { summary, gaps })
    }
}

/// Terrain that was written.
pub(crate) struct Written {
    pub summary: Summary,
    /// The checksum of the heights that wide gaps continue; `None` if no tile has such a gap.
    pub gaps: Option<u64>,
}

/// Makes the tiles of levels. Threads share it.
struct Run<'a> {
    args: &'a GenArgs,
    heights: &'a Heights<'a>,
    folder: &'a Path,
    list: TileList,
    update: Option<&'a TerrainUpdate<'a>>,
    progress: Progress,
}

/// The tiles that a [`Run`] has made.
struct Made {
    /// The bytes of the tiles of each level.
    bytes: Vec<u64>,
    /// Vertices of the finest level without data.
    voids: u64,
    /// The lowest and the highest vertex of the finest level with data, in metres.
    range_m: [f32; 2],
    has_gaps: bool,
}

impl Run<'_> {
    /// Makes the tiles of all levels, the finest first.
    fn make(&self, by_level: &[Vec<TileKey>]) -> Result<Made, GenError> {
        let mut made = Made { bytes: vec![0; by_level.len()], voids: 0, range_m: NO_HEIGHTS_M, has_gaps: false };
        let mut below: HashMap<TileKey, [f32; 2]> = HashMap::new();
        for (level, keys) in by_level.iter().enumerate().rev() {
            let mut columns: Vec<u32> = keys.iter().map(|key| key.x).collect();
            columns.sort_unstable();
            columns.dedup();
            for x in columns {
                let path = self.folder.join(format!("{level}/{x}"));
                std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
            }
            let make = |key: &TileKey| {
                let tile = self.tile(*key, &below)?;
                self.progress.advance(1);
                Ok((*key, tile))
            };
            let tiles: Vec<(TileKey, CompleteTile)> = keys.par_iter().map(make).collect::<Result<_, GenError>>()?;
            made.bytes[level] = tiles.iter().map(|(_, tile)| tile.bytes).sum::<u64>();
            made.has_gaps |= tiles.iter().any(|(_, tile)| tile.inputs == Inputs::Gaps);
            if level + 1 == by_level.len() {
                made.voids = tiles.iter().map(|(_, tile)| tile.voids).sum();
                made.range_m = tiles.iter().fold(NO_HEIGHTS_M, |range, (_, tile)| union(range, tile.data_m));
            }
            below = tiles.into_iter().map(|(key, tile)| (key, tile.range_m)).collect();
        }
        Ok(made)
    }

    /// Makes a tile unless it is complete. `below` are the heights of the tiles of the next finer level.
    fn tile(&self, key: TileKey, below: &HashMap<TileKey, [f32; 2]>) -> Result<CompleteTile, GenError> {
        if let Some(complete) = self.list.get(key) {
            self.update.map_or(Ok(()), |update| update.keep_again(key))?;
            return Ok(complete);
        }
        let finer_m = key.children().iter().filter_map(|child| below.get(child).copied()).fold(NO_HEIGHTS_M, union);
        let kept = match self.update {
            Some(update) => update.keep(key, |inputs| self.heights.near(key, inputs), finer_m)?,
            None => None,
        };
        let complete = match kept {
            Some(kept) => kept,
            None => write_tile(self.args, self.heights, key, finer_m, self.folder)?,
        };
        self.list.add(key, &complete)?;
        Ok(complete)
    }
}

/// Returns some of a list of tiles, with equal distances.
pub(crate) fn spread(keys: &[TileKey], count: usize) -> Vec<TileKey> {
    let count = count.min(keys.len());
    (0..count).map(|k| keys[(2 * k + 1) * keys.len() / (2 * count)]).collect()
}

fn union(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Writes a tile. `finer_m` are the heights of the finer tiles inside.
fn write_tile(
    args: &GenArgs,
    heights: &Heights<'_>,
    key: TileKey,
    finer_m: [f32; 2],
    folder: &Path,
) -> Result<CompleteTile, GenError> {
    let tile = heights.of(key)?;
    let own_m = tile.range_m();
    let range_m = union(own_m, finer_m);
    let path = folder.join(format!("{}/{}/{}.terrain", key.level, key.x, key.y));
    let mut mesh = mesh_of(&tile, key.level, range_m, args.tiles.triangles);
    mesh.water = heights.water_depths_m(key)?.map_or_else(Vec::new, |depths_m| water_mask(&depths_m));
    if args.output.tile_availability && key.level.is_multiple_of(METADATA_LEVELS) {
        let levels = key.level + 1..(key.level + 1 + METADATA_LEVELS).min(heights.levels());
        let below: Vec<Vec<TileKey>> = levels.map(|level| heights.tiles_below(key, level)).collect();
        mesh.metadata = metadata_json(&below);
    }
    let bytes = write_quantized_mesh(&mesh);
    let bytes = bytes.ok_or_else(|| GenError::Encode(format!("the triangles of tile {key:?} are invalid")))?;
    let bytes = write_whole(&path, &bytes)?;
    Ok(CompleteTile { bytes, range_m, data_m: tile.data_m, own_m, voids: tile.voids, inputs: tile.inputs })
}

/// The cells of a mask of water along a cell of samples.
const MASK_CELLS: usize = 256 / CELLS;
/// The depths in metres, below 0 on land, between which cells are partly water.
const SHORE_M: std::ops::Range<f32> = -0.15..0.15;

/// Returns the water of a tile from depths at its vertices, southern row first: 0 is land, 255 is water. A number for each of
/// 256 x 256 cells, northern row first, or one if all are the same.
fn water_mask(depths_m: &[f32]) -> Vec<u8> {
    let share = |c: usize| ((c % MASK_CELLS) as f32 + 0.5) / MASK_CELLS as f32;
    let cell = |row: usize, column: usize| {
        let at =
            |right: usize, up: usize| depths_m[(row / MASK_CELLS + up) * (CELLS + 1) + column / MASK_CELLS + right];
        let (u, v) = (share(column), share(row));
        let along = |up: usize| at(0, up) + u * (at(1, up) - at(0, up));
        let depth_m = along(0) + v * (along(1) - along(0));
        let water = (depth_m - SHORE_M.start) / (SHORE_M.end - SHORE_M.start);
        (255.0 * water.clamp(0.0, 1.0)).round() as u8
    };
    let side = MASK_CELLS * CELLS;
    let mask: Vec<u8> =
        (0..side).rev().flat_map(|row| (0..side).map(move |column| (row, column))).map(|(r, c)| cell(r, c)).collect();
    if mask.iter().all(|water| *water == mask[0]) { vec![mask[0]] } else { mask }
}

/// Returns the mesh of a tile. Normals are those of the tile's samples, also where there are fewer vertices.
fn mesh_of(tile: &TileHeights, level: u32, range_m: [f32; 2], triangles: Triangles) -> TerrainMesh {
    let set = heights::SQUARE;
    let curvature_m = |row: i64| curvature_m(&WGS84, &set, tile.cells, tile.first[1] + row);
    let tin = match triangles {
        Triangles::Grid => Tin::grid(|_, _| [true; 2]),
        Triangles::Tin => {
            let limit_m = SHARE_OF_LEVEL * LEVEL_0_ERROR_M / f64::from(level).exp2();
            Tin::of_samples(&|i, j| tile.height_m(i, j), &curvature_m, None, &[limit_m], f64::INFINITY)
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
