//! Predicts the tiles, the bytes and the time of a run. Tiles are counted; bytes and time are those of a few tiles that are
//! made in a temporary folder.

use std::collections::HashSet;
use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rayon::prelude::*;
use serde::Serialize;

use crate::opened::Opened;
use crate::output::{Builder, CORNER_ERRORS_JSON_BYTES, Journal, TerrainSet, spread, tiles_and_bytes};
use crate::pyramid::{Grid, Layer, Plan, TileKey, tiles_with_data};
use crate::{ContentKind, GenArgs, GenError, Voids, WorldSet};

/// Levels of the subtrees that are made as a sample.
const SAMPLE_LEVELS: u32 = 3;
/// The number of places where a dry run makes a sample.
pub(crate) const PLACES: usize = 8;
/// The number of subtrees in which the tiles of the finest levels are counted.
const COUNTED: usize = 64;
/// The number of blocks of the finest layer whose sampling is timed.
const TIMED_BLOCKS: usize = 2;
/// The number of tiles of each level of a world that are made, each with its neighbour.
const WORLD_PLACES: u64 = 4;
/// More bytes than a tile has.
const MAX_TILE_BYTES: u64 = 400_000;

/// Describes the set that a run would make.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Prediction {
    /// The levels from the coarsest one on.
    pub levels: Vec<LevelPrediction>,
    /// The number of tiles of all levels.
    pub tiles: u64,
    /// The size of all files in bytes.
    pub bytes: u64,
    /// The time of the run in seconds.
    pub seconds: f64,
    /// The number of threads.
    pub threads: usize,
    /// The number of tiles that were made for the prediction.
    pub sampled_tiles: u64,
    /// The bytes that are free on the disk of OUT; `None` if the system does not tell.
    pub free_bytes: Option<u64>,
}

/// A level of a [`Prediction`].
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct LevelPrediction {
    /// The level.
    pub level: u32,
    /// The number of its tiles.
    pub tiles: u64,
    /// The size of their files in bytes.
    pub bytes: u64,
}

impl Display for Prediction {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let mb = |bytes: u64| bytes as f64 / 1e6;
        writeln!(f, "level        tiles           MB")?;
        for LevelPrediction { level, tiles, bytes } in &self.levels {
            writeln!(f, "{level:>5} {tiles:>12} {:>12.1}", mb(*bytes))?;
        }
        writeln!(f, "  all {:>12} {:>12.1}", self.tiles, mb(self.bytes))?;
        let seconds = Duration::from_secs_f64(self.seconds.clamp(0.0, 1e12)).as_secs();
        let [hours, minutes] = [seconds / 3600, seconds / 60 % 60];
        write!(f, "about {hours} h {minutes} min {} s with {} threads, ", seconds % 60, self.threads)?;
        match self.free_bytes {
            Some(free) => write!(f, "{:.1} MB are free", mb(free))?,
            None => write!(f, "free bytes unknown")?,
        }
        write!(f, "; {} tiles were made for this", self.sampled_tiles)
    }
}

/// The tiles that were made as a sample.
struct Sample {
    /// By level, the number of tiles that may have data, of those that have, and the bytes of their files.
    levels: Vec<[u64; 3]>,
    /// The time before the first tile, that of sampling a block of the finest layer, and that of writing all tiles.
    start: Duration,
    per_block: Duration,
    writing: Duration,
    /// The bytes of the JSON of a tile.
    json_bytes: u64,
}

/// Predicts a set of elevation files or of noise, from subtrees at a number of places.
pub(crate) fn predict(args: &GenArgs, opened: &Opened<'_>, out: &Path, places: usize) -> Result<Prediction, GenError> {
    let (grid, plan) = (opened.grid, &opened.plan);
    let (counts, roots) = count_tiles(grid, plan);
    let sample = sample(args, opened, &roots, places)?;
    let first = (grid.levels - SAMPLE_LEVELS.min(grid.levels)) as usize;
    let coarsest = sample.levels.iter().find(|[_, made, _]| *made > 0).copied().unwrap_or([1, 1, 0]);
    let mut levels = Vec::new();
    for (level, count) in counts.into_iter().enumerate().skip(plan.first_level() as usize) {
        let [may_have, made, bytes] = match sample.levels[level] {
            [_, 0, _] if level < first => coarsest,
            own => own,
        };
        let share = if level < first || may_have == 0 { 1.0 } else { made as f64 / may_have as f64 };
        let tiles = (count as f64 * share).round() as u64;
        let bytes = (bytes as f64 / made.max(1) as f64 + sample.json_bytes as f64) * tiles as f64;
        levels.push(LevelPrediction { level: level as u32, tiles, bytes: bytes as u64 });
    }
    let sampled_tiles = sample.levels.iter().map(|[_, made, _]| made).sum::<u64>();
    let per_tile = sample.writing.as_secs_f64() / sampled_tiles.max(1) as f64;
    let tiles: u64 = levels.iter().map(|level| level.tiles).sum();
    let work = sample.per_block.as_secs_f64() * roots.len() as f64 + per_tile * tiles as f64;
    Ok(Prediction {
        bytes: levels.iter().map(|level| level.bytes).sum(),
        seconds: sample.start.as_secs_f64() + work,
        levels,
        tiles,
        threads: rayon::current_num_threads(),
        sampled_tiles,
        free_bytes: free_bytes(out),
    })
}

fn may_have_data(grid: &Grid<'_>, key: TileKey) -> bool {
    grid.voids != Voids::Cut || grid.may_have_data_in_tile(key)
}

/// Returns the number of tiles of each level that may have data, and the roots of the finest layer's blocks. The levels of the
/// finest layer are counted in some of its blocks.
fn count_tiles(grid: &Grid<'_>, plan: &Plan) -> (Vec<u64>, Vec<TileKey>) {
    let has_data = |key: &TileKey| may_have_data(grid, *key);
    let children = |keys: &[TileKey]| -> Vec<TileKey> {
        keys.par_iter().flat_map_iter(|key| key.children()).filter(has_data).collect()
    };
    let mut counts = vec![0; grid.levels as usize];
    let (first, root) = (plan.first_level(), plan.finest().root);
    let mut roots = tiles_with_data(first, &|key| may_have_data(grid, key));
    counts[first as usize] = roots.len() as u64;
    for level in first + 1..=root {
        roots = children(&roots);
        counts[level as usize] = roots.len() as u64;
    }
    let mut some: Vec<TileKey> = spread(&roots, COUNTED);
    let scale = roots.len() as f64 / some.len().max(1) as f64;
    for level in root + 1..grid.levels {
        some = children(&some);
        counts[level as usize] = (scale * some.len() as f64).round() as u64;
    }
    (counts, roots)
}

/// Makes subtrees of the finest levels inside some blocks. A run samples whole blocks, whose margins and sources cost less for
/// each tile than those of small subtrees. So the sampling of blocks and the writing of tiles are timed each on its own.
fn sample(args: &GenArgs, opened: &Opened<'_>, blocks: &[TileKey], places: usize) -> Result<Sample, GenError> {
    let grid = opened.grid;
    let layer = Layer { root: grid.levels.saturating_sub(SAMPLE_LEVELS), finest: grid.levels - 1 };
    let folder = tempfile::tempdir().map_err(GenError::file(std::env::temp_dir()))?;
    let mut roots: Vec<TileKey> = Vec::new();
    // At most a quarter of the finest tiles are made, unless the set is smaller than a subtree.
    let places = places.min((1 << (2 * layer.root.min(8))) / 4).max(1);
    for k in 0..places.min(blocks.len() << (2 * layer.root.min(8))) {
        let mut root = blocks[(2 * k + 1) * blocks.len() / (2 * places)];
        while root.level < layer.root {
            let mut children = root.children();
            children.rotate_left((k + k / 4 + root.level as usize) % 4);
            let Some(child) = children.into_iter().find(|child| may_have_data(grid, *child)) else { break };
            root = child;
        }
        if root.level == layer.root && !roots.contains(&root) {
            roots.push(root);
        }
    }
    let begin = Instant::now();
    let mut builder = Builder::new(args, grid, opened.imagery, &opened.plan, folder.path())?;
    let start = begin.elapsed();
    let mut levels = vec![[0; 3]; grid.levels as usize];
    let timed = spread(blocks, TIMED_BLOCKS);
    let begin = Instant::now();
    timed.iter().try_for_each(|root| builder.sample_block(opened.plan.finest(), *root))?;
    let per_block = begin.elapsed() / timed.len().max(1) as u32;
    // The sources are read before the time counts.
    roots.iter().try_for_each(|root| builder.sample_block(layer, *root))?;
    let begin = Instant::now();
    roots.iter().try_for_each(|root| builder.sample_block(layer, *root))?;
    let sampling = begin.elapsed();
    let begin = Instant::now();
    builder.make_blocks(layer, &roots)?;
    let writing = begin.elapsed().saturating_sub(sampling);
    let mut json_bytes = 0;
    let journal = Journal::new(folder.path());
    for root in &roots {
        json_bytes += journal.load(*root)?.map_or(0, |record| record.tree.len() as u64);
        let mut keys = vec![*root];
        while let Some(key) = keys.pop() {
            levels[key.level as usize][0] += 1;
            if key.level < layer.finest {
                keys.extend(key.children().into_iter().filter(|child| may_have_data(grid, *child)));
            }
        }
    }
    for level in layer.root..=layer.finest {
        let [_, made, bytes] = &mut levels[level as usize];
        (*made, *bytes) = match args.output.is_packed() {
            true => tiles_and_bytes(folder.path(), level)?,
            false => files_of_level(&folder.path().join(level.to_string()))?,
        };
    }
    let made: u64 = levels.iter().map(|[_, made, _]| made).sum();
    let corners = if args.content == ContentKind::Height { CORNER_ERRORS_JSON_BYTES } else { 0 };
    Ok(Sample { levels, start, per_block, writing, json_bytes: json_bytes / made.max(1) + corners })
}

/// Returns the number of tiles in the folder of a level, and the bytes of their files.
fn files_of_level(folder: &Path) -> Result<(u64, u64), GenError> {
    let (mut stems, mut bytes) = (HashSet::new(), 0);
    let entries = |folder: &Path| -> Result<Vec<PathBuf>, GenError> {
        let entries = match std::fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(e) => return Err(GenError::file(folder)(e)),
        };
        entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>().map_err(GenError::file(folder))
    };
    for column in entries(folder)? {
        for file in entries(&column)? {
            bytes += file.metadata().map_err(GenError::file(&file))?.len();
            stems.insert(file.with_extension(""));
        }
    }
    Ok((stems.len() as u64, bytes))
}

/// Predicts terrain for globes, from subtrees at a number of places.
pub(crate) fn predict_terrain(
    args: &GenArgs,
    set: &TerrainSet<'_>,
    out: &Path,
    places: usize,
) -> Result<Prediction, GenError> {
    let begin = Instant::now();
    let counts = set.count_tiles(args);
    let start = begin.elapsed();
    let root = set.levels.saturating_sub(SAMPLE_LEVELS);
    let folder = tempfile::tempdir().map_err(GenError::file(std::env::temp_dir()))?;
    let begin = Instant::now();
    let sample = set.sample(args, root, places, folder.path())?;
    let work = begin.elapsed();
    let level = |(level, tiles): (usize, u64)| {
        // Coarser tiles are like the coarsest ones of the sample.
        let [made, bytes] = sample[level.saturating_sub(root as usize)];
        LevelPrediction { level: level as u32, tiles, bytes: (bytes as f64 / made.max(1) as f64 * tiles as f64) as u64 }
    };
    let levels: Vec<LevelPrediction> = counts.into_iter().enumerate().map(level).collect();
    let sampled_tiles: u64 = sample.iter().map(|[made, _]| made).sum();
    let tiles: u64 = levels.iter().map(|level| level.tiles).sum();
    Ok(Prediction {
        bytes: levels.iter().map(|level| level.bytes).sum(),
        seconds: start.as_secs_f64() + work.as_secs_f64() / sampled_tiles.max(1) as f64 * tiles as f64,
        levels,
        tiles,
        threads: rayon::current_num_threads(),
        sampled_tiles,
        free_bytes: free_bytes(out),
    })
}

/// Predicts a set of a world. Some tiles are made for their bytes, and then the neighbour of each for the time: a run makes
/// neighbours one after the other too, which have rivers in common.
pub(crate) fn predict_world(set: &WorldSet, out: &Path) -> Result<Prediction, GenError> {
    let begin = Instant::now();
    set.level_errors_m();
    let start = begin.elapsed();
    let keys = |level: u32| -> Vec<TileKey> {
        let (side, tiles) = (1u64 << level, 1u64 << (2 * level));
        let count = WORLD_PLACES.min(tiles);
        let key = |k: u64| {
            let n = (2 * k + 1) * tiles / (2 * count);
            TileKey { level, x: ((n + n / side) % side) as u32, y: (n / side) as u32 }
        };
        (0..count).map(key).collect()
    };
    let all: Vec<TileKey> = (0..set.levels()).flat_map(keys).collect();
    let made: Result<Vec<(u64, f64)>, GenError> = all
        .par_iter()
        .map(|key| {
            let tile = set.tile(*key)?;
            let begin = Instant::now();
            set.tile(TileKey { y: if key.level > 0 { key.y ^ 1 } else { 0 }, ..*key })?;
            let seconds = begin.elapsed().as_secs_f64();
            let bytes = tile.files.iter().map(|(_, content)| content.len()).sum::<usize>();
            let corners = if set.has_meshes() { 0 } else { CORNER_ERRORS_JSON_BYTES };
            Ok(((bytes + set.tileset(*key).map_or(0, |json| json.len())) as u64 + corners, seconds))
        })
        .collect();
    let made = made?;
    let mut work = 0.0;
    let levels: Vec<LevelPrediction> = (0..set.levels())
        .map(|level| {
            let own: Vec<_> =
                all.iter().zip(&made).filter(|(key, _)| key.level == level).map(|(_, own)| *own).collect();
            let (bytes, seconds) = own.iter().fold((0, 0.0), |sum, (bytes, seconds)| (sum.0 + bytes, sum.1 + seconds));
            let tiles = 1u64 << (2 * level);
            let scale = tiles as f64 / own.len().max(1) as f64;
            work += seconds * scale;
            LevelPrediction { level, tiles, bytes: (bytes as f64 * scale) as u64 }
        })
        .collect();
    let tiles: u64 = levels.iter().map(|level| level.tiles).sum();
    let threads = rayon::current_num_threads();
    Ok(Prediction {
        bytes: levels.iter().map(|level| level.bytes).sum(),
        seconds: start.as_secs_f64() + work / threads as f64,
        levels,
        tiles,
        threads,
        sampled_tiles: 2 * all.len() as u64,
        free_bytes: free_bytes(out),
    })
}

/// Refuses a run whose files do not fit on the disk. `predict` is called only if it may be so.
pub(crate) fn check_space(
    out: &Path,
    max_tiles: u64,
    predict: impl FnOnce() -> Result<Prediction, GenError>,
) -> Result<(), GenError> {
    match free_bytes(out) {
        Some(free) if free < max_tiles.saturating_mul(MAX_TILE_BYTES) => predict()?.check_space(out),
        _ => Ok(()),
    }
}

/// Returns the number of tiles that a set of a grid has at most.
pub(crate) fn max_tiles(grid: &Grid<'_>, plan: &Plan) -> u64 {
    count_tiles(grid, plan).0.iter().sum()
}

impl Prediction {
    /// Returns an error if the files do not fit on the disk of OUT.
    pub(crate) fn check_space(&self, out: &Path) -> Result<(), GenError> {
        match self.free_bytes {
            Some(free) if free < self.bytes => {
                Err(GenError::Space { out: out.to_path_buf(), needed: self.bytes, free })
            }
            _ => Ok(()),
        }
    }
}

/// Returns the nearest folder above a path that exists.
pub(crate) fn folder_above(out: &Path) -> &Path {
    out.ancestors().skip(1).find(|path| path.is_dir()).unwrap_or(Path::new("."))
}

/// Returns an error if nothing can be written beside a path.
pub(crate) fn check_writable(out: &Path) -> Result<(), GenError> {
    let folder = folder_above(out);
    let made = tempfile::Builder::new().prefix(".terrane-gen-").tempdir_in(folder);
    made.map(drop).map_err(GenError::file(folder))
}

/// Returns the bytes that are free for files beside a path.
#[cfg(unix)]
fn free_bytes(out: &Path) -> Option<u64> {
    let found = rustix::fs::statvfs(folder_above(out)).ok()?;
    found.f_bavail.checked_mul(found.f_frsize)
}

#[cfg(not(unix))]
fn free_bytes(_: &Path) -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_that_does_not_fit_is_refused() {
        let out = Path::new("/target/set");
        let of = |bytes: u64, free_bytes: Option<u64>| Prediction {
            levels: Vec::new(),
            tiles: 1,
            bytes,
            seconds: 0.0,
            threads: 1,
            sampled_tiles: 1,
            free_bytes,
        };
        let error = of(5_000_000_000, Some(2_500_000_000)).check_space(out).unwrap_err().to_string();
        assert_eq!(error, "/target/set: the set needs about 5000.0 MB, and 2500.0 MB are free; nothing was written");
        assert!(of(5, Some(5)).check_space(out).is_ok() && of(5, None).check_space(out).is_ok());
    }
}
