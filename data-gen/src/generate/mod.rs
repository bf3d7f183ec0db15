//! Generates a tile set from its options: checks them, reads the sources, and writes the folder.

#[cfg(feature = "object-store")]
mod bucket;

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::args::{JOBS, MAX_LEVELS, SIZES_M};
use crate::elevation::expand;
use crate::fingerprint::fingerprint;
use crate::opened::{OpenedTerrain, PROCEDURAL_LEVELS, with_grid, with_terrain};
use crate::output::{
    Builder, Journal, PartialFolder, ROOTS, Written, blocks, finish, is_archive_at, level_errors_m, voids,
};
use crate::pyramid::{Grid, Layer, TileKey};
use crate::update::{LocalSet, Manifest, OldSet, TerrainUpdate, keep_blocks};
use crate::web_tiles::TileContent;
use crate::world::{WorldArgs, WorldPreset, WorldSet, check_world, shard_roots, tiles_below, world_set, write_world};
use crate::{ContentKind, GenArgs, GenError, Prediction, PredictionFormat, Shard, Sharding, Summary};
use crate::{prediction, shards};

/// The folder of the default set. The number changes with the content of the set, so that old sets are not used.
const DEFAULT_SET: &str = "default-set-4";
/// The number of places where a run that may not fit on the disk makes a sample.
const SPACE_PLACES: usize = 2;

/// Returns the folder of the small set that `terrane fly` shows by default, mountains of a world. Generates the set in
/// `folder` unless it is there.
pub fn default_set(folder: &Path) -> Result<PathBuf, GenError> {
    let out = folder.join(DEFAULT_SET);
    if !out.join("tileset.json").is_file() {
        let world = WorldArgs { world: Some(WorldPreset::Alps), ..WorldArgs::default() };
        let args = GenArgs { overwrite: true, levels: Some(5), size: 40_000.0, world, ..GenArgs::new(&out) };
        match run(&args) {
            // Another program makes it now.
            Err(GenError::Busy(_)) => {
                std::thread::sleep(Duration::from_millis(100));
                return default_set(folder);
            }
            made => drop(made?),
        }
    }
    Ok(out)
}

/// The result of a command.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// A set, or a shard of it.
    Set(Box<Summary>),
    /// A plan of shards, as JSON.
    Plan(String),
    /// A prediction, and its form.
    Prediction(Box<Prediction>, PredictionFormat),
}

impl Outcome {
    /// Writes the outcome to standard output. A closed pipe is not an error.
    pub fn print(&self) -> std::io::Result<()> {
        let text = match self {
            Self::Set(summary) => return summary.print(),
            Self::Plan(json) => json.clone(),
            Self::Prediction(prediction, PredictionFormat::Table) => prediction.to_string(),
            Self::Prediction(prediction, PredictionFormat::Json) => serde_json::to_string_pretty(prediction)?,
        };
        match writeln!(std::io::stdout(), "{text}") {
            Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
            written => written,
        }
    }
}

/// Does what the options ask for: makes a set or a shard, plans shards, or predicts a run.
pub fn execute(args: &GenArgs) -> Result<Outcome, GenError> {
    if let Some(format) = args.run.dry_run {
        return predict(args).map(|prediction| Outcome::Prediction(Box::new(prediction), format));
    }
    let Some(count) = args.sharding.plan else { return run(args).map(|summary| Outcome::Set(Box::new(summary))) };
    let args = &expanded(args)?;
    check(args)?;
    let fingerprint = fingerprint(args)?;
    let complete = complete_shards(args, count, fingerprint)?;
    let print = |levels, roots: &[TileKey], tiles| shards::plan(count, fingerprint, levels, roots, tiles, &complete);
    if args.content == ContentKind::QuantizedMesh {
        return with_terrain(args, |OpenedTerrain { set, .. }| {
            Ok(Outcome::Plan(print(set.levels, &set.roots(args), set.tiles_per_root())))
        });
    }
    if let Some(set) = tiled_world(args) {
        let roots = shard_roots(&set);
        let tiles = roots.first().map_or(0, |root| tiles_below(&set, root.level));
        return Ok(Outcome::Plan(print(set.levels(), &roots, tiles)));
    }
    with_grid(args, |opened| {
        let layer = opened.plan.finest();
        let blocks = blocks_below_root(opened.grid, layer);
        Ok(Outcome::Plan(print(opened.grid.levels, &blocks, layer.tiles_per_block())))
    })
}

/// Returns the shards of a plan that are complete.
fn complete_shards(args: &GenArgs, count: u32, fingerprint: u64) -> Result<Vec<Shard>, GenError> {
    #[cfg(feature = "object-store")]
    if crate::store::is_remote(&args.out) {
        return bucket::complete_shards(args, fingerprint);
    }
    let out = std::path::absolute(&args.out).map_err(GenError::file(&args.out))?;
    Ok(shards::complete(&out, count, fingerprint))
}

/// Predicts a run: its tiles, bytes and time. Fails as the run would, as far as that is known before; writes nothing.
pub fn predict(args: &GenArgs) -> Result<Prediction, GenError> {
    #[cfg(feature = "object-store")]
    if crate::store::is_remote(&args.out) {
        return bucket::predict(args);
    }
    let args = &expanded(args)?;
    let (out, _) = target(args)?;
    check(args)?;
    prediction::check_writable(&out)?;
    let predicted = thread_pool(args)?.install(|| match tiled_world(args) {
        Some(set) => prediction::predict_world(&set, &out),
        None if args.content == ContentKind::QuantizedMesh => {
            with_terrain(args, |opened| prediction::predict_terrain(args, &opened.set, &out, prediction::PLACES))
        }
        None => with_grid(args, |opened| prediction::predict(args, opened, &out, prediction::PLACES)),
    })?;
    predicted.check_space(&out)?;
    Ok(predicted)
}

/// Returns the absolute path of OUT, or of the shard beside it, and whether there are files in it. Fails if they may not be
/// replaced.
fn target(args: &GenArgs) -> Result<(PathBuf, bool), GenError> {
    let out = std::path::absolute(&args.out).map_err(GenError::file(&args.out))?;
    let out = args.sharding.shard.map_or(out.clone(), |shard| shard.folder(&out));
    let is_shard = args.sharding.shard.is_some();
    let is_archive = args.output.archive.is_some() && !is_shard;
    let occupied = match std::fs::read_dir(&out) {
        _ if is_archive => is_archive_at(args, &out)?,
        Ok(mut entries) => entries.next().is_some(),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => false,
        Err(e) => return Err(GenError::File { path: out, reason: e }),
    };
    if out.is_symlink() && !out.exists() {
        return Err(GenError::invalid(out, "is a link whose target does not exist"));
    }
    if occupied && !args.overwrite && !args.run.update && !is_shard {
        return Err(GenError::Exists(out));
    }
    let out = if out.exists() { out.canonicalize().map_err(GenError::file(&out))? } else { out };
    if occupied && !is_shard {
        check_replaceable(&out, args, is_archive)?;
    }
    Ok((out, occupied))
}

fn thread_pool(args: &GenArgs) -> Result<rayon::ThreadPool, GenError> {
    // With 0 rayon starts one thread per core.
    let threads = args.jobs.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|e| GenError::Argument(format!("--jobs {threads}: {e}")))
}

/// Generates a tile set, or a shard of one. Files are written to a temporary folder beside OUT, which is moved to OUT when all
/// are complete; those of a bucket to one in the folder of temporary files, and are uploaded. If the run is killed, the same
/// options continue it.
pub fn run(args: &GenArgs) -> Result<Summary, GenError> {
    #[cfg(feature = "object-store")]
    if crate::store::is_remote(&args.out) {
        return bucket::run(args);
    }
    let out = std::path::absolute(&args.out).map_err(GenError::file(&args.out))?;
    run_with(args, &LocalSet(out))
}

/// Like [`run`], for a set in a folder. `--update` takes tiles of the set `old`.
pub(crate) fn run_with(args: &GenArgs, old: &dyn OldSet) -> Result<Summary, GenError> {
    let start = Instant::now();
    let args = &expanded(args)?;
    let (out, _) = target(args)?;
    let is_shard = args.sharding.shard.is_some();
    check(args)?;
    let fingerprint = fingerprint(args)?;
    let pool = thread_pool(args)?;
    let partial = PartialFolder::beside(&out, fingerprint)?;
    // Another run may have completed OUT before this one locked its folder.
    let (_, occupied) = target(args)?;
    if occupied && is_shard {
        if !shards::is_made(&out, fingerprint) {
            return Err(GenError::Exists(out));
        }
        let none = [f64::INFINITY, f64::NEG_INFINITY];
        let [min_height_m, max_height_m] = none;
        let notes = vec!["the shard was complete".to_owned()];
        return Ok(Summary { out, notes, min_height_m, max_height_m, ..Summary::default() });
    }
    let made = pool.install(|| make(args, &out, old, fingerprint, partial.path()));
    let is_same = || self::fingerprint(args).is_ok_and(|now| now == fingerprint);
    let (mut summary, shards) = match made {
        Ok(_) if !is_same() => return Err(GenError::Changed(out)),
        Ok(made) => made,
        Err(reason @ (GenError::File { .. } | GenError::Shards { .. }))
            if Journal::new(partial.path()).exists() && is_same() =>
        {
            return Err(GenError::Unfinished { reason: Box::new(reason), folder: partial.keep() });
        }
        Err(error) => return Err(error),
    };
    for shard in shards {
        // The set is complete, and has their files. If the run is killed before it is in place, a later merge continues it.
        std::fs::remove_dir_all(&shard).map_err(GenError::file(&shard))?;
    }
    summary.bytes = pool.install(|| finish(args, partial, &out, summary.bytes))?;
    summary.out = out;
    summary.seconds = start.elapsed().as_secs_f64();
    Ok(summary)
}

/// Returns the options with the files that folders, patterns and lists name.
pub(crate) fn expanded(args: &GenArgs) -> Result<GenArgs, GenError> {
    let dem = expand(&args.dem, TileContent::Heights)?;
    Ok(GenArgs { dem, imagery: expand(&args.imagery, TileContent::Colors)?, ..args.clone() })
}

/// Checks options. The command line checks some of them as well, but programs may call [`run`] directly.
pub(crate) fn check(args: &GenArgs) -> Result<(), GenError> {
    if !SIZES_M.contains(&args.size) {
        return Err(GenError::Argument(format!("--size {} m is not within 100 m and 2,000 km", args.size)));
    }
    args.check().map_err(GenError::Argument)?;
    check_world(args).map_err(GenError::Argument)?;
    if args.levels.is_some_and(|l| l == 0 || l > MAX_LEVELS) {
        return Err(GenError::Argument(format!("--levels must be 1 to {MAX_LEVELS}")));
    }
    if args.jobs.is_some_and(|jobs| !JOBS.contains(&jobs)) {
        return Err(GenError::Argument(format!("--jobs must be {} to {}", JOBS.start(), JOBS.end())));
    }
    Ok(())
}

/// Makes a set or a shard in a folder. Returns the folders of the shards that were merged as well.
fn make(
    args: &GenArgs,
    out: &Path,
    old: &dyn OldSet,
    fingerprint: u64,
    folder: &Path,
) -> Result<(Summary, Vec<PathBuf>), GenError> {
    let is_fresh = !Journal::new(folder).exists();
    let is_complete = ROOTS.iter().any(|root| folder.join(root).is_file());
    let shards = match args.sharding.merge {
        // A merge was killed when the set was complete, and perhaps has removed some shards.
        true if is_complete => shards::left_over(out, fingerprint)?,
        true => shards::gather(out, fingerprint, folder)?,
        false => Vec::new(),
    };
    let finish_shard =
        || args.sharding.shard.map_or(Ok(()), |shard| shards::write_manifest(folder, shard, fingerprint));
    if let Some(set) = tiled_world(args) {
        if is_fresh && args.sharding == Sharding::default() {
            let tiles = tiles_below(&set, 0);
            prediction::check_space(out, tiles, || prediction::predict_world(&set, out))?;
        }
        let summary = write_world(&set, args.output.tiling, folder, args.sharding.shard)?;
        finish_shard()?;
        return Ok((summary, shards));
    }
    if args.content == ContentKind::QuantizedMesh {
        let summary = with_terrain(args, |opened| make_terrain(args, opened, out, old, folder))?;
        finish_shard()?;
        return Ok((summary, shards));
    }
    with_grid(args, |opened| {
        let (grid, plan) = (opened.grid, &opened.plan);
        let mut notes = Vec::new();
        if args.run.update && old.exists() {
            notes.push(keep_blocks(args, opened, old, folder)?);
        } else if is_fresh && args.sharding == Sharding::default() {
            let predict = || prediction::predict(args, opened, out, SPACE_PLACES);
            prediction::check_space(out, prediction::max_tiles(grid, plan), predict)?;
        }
        let mut builder = Builder::new(args, grid, opened.imagery, plan, folder)?;
        let totals = match args.sharding.shard {
            Some(shard) => {
                let blocks = blocks_below_root(grid, plan.finest());
                let totals = builder.make_blocks(plan.finest(), shard.part_of(&blocks))?;
                shards::write_manifest(folder, shard, fingerprint)?;
                totals
            }
            None => {
                let totals = builder.make_set()?;
                if !args.dem.is_empty() {
                    Manifest::new(args, opened)?.save(folder)?;
                }
                totals
            }
        };
        notes.extend((opened.notes)());
        let [min_height_m, max_height_m] = totals.range_m.map(f64::from);
        let [cut_samples, filled_samples] = voids(args, &totals);
        let summary = Summary {
            out: folder.to_path_buf(),
            tiles: totals.tiles,
            levels: grid.levels,
            bytes: totals.bytes,
            min_height_m,
            max_height_m,
            filled_samples,
            cut_samples,
            level_errors_m: level_errors_m(&totals),
            seconds: 0.0,
            notes,
        };
        Ok((summary, shards))
    })
}

/// Returns the set of a world with a tiling of its own; `None` for terrain for globes, whose tiles sample a world as other
/// sources.
fn tiled_world(args: &GenArgs) -> Option<WorldSet> {
    world_set(args, PROCEDURAL_LEVELS).filter(|_| args.content != ContentKind::QuantizedMesh)
}

/// Makes terrain for globes, or a shard of it, in a folder.
fn make_terrain(
    args: &GenArgs,
    opened: &OpenedTerrain<'_>,
    out: &Path,
    old: &dyn OldSet,
    folder: &Path,
) -> Result<Summary, GenError> {
    let set = &opened.set;
    let is_update = args.run.update && old.exists();
    if !is_update && args.sharding == Sharding::default() && !Journal::new(folder).exists() {
        let predict = || prediction::predict_terrain(args, set, out, SPACE_PLACES);
        prediction::check_space(out, set.count_tiles(args).iter().sum(), predict)?;
    }
    let manifest = Manifest::of_terrain(args, opened)?;
    let update = if is_update { Some(TerrainUpdate::new(args, opened, &manifest, old, folder)?) } else { None };
    let Written { mut summary, gaps } = set.write(args, folder, args.sharding.shard, update.as_ref())?;
    if let Some(update) = &update {
        summary.notes.insert(0, update.note(summary.tiles));
    }
    if args.sharding.shard.is_none() && !args.dem.is_empty() {
        manifest.with_gaps(gaps).save(folder)?;
    }
    summary.notes.extend((opened.notes)());
    Ok(summary)
}

/// Returns the roots of the finest layer's blocks. The only block of a small set is left out: it is made when shards are merged.
fn blocks_below_root(grid: &Grid<'_>, layer: Layer) -> Vec<TileKey> {
    if layer.root == 0 && !grid.is_aligned() { Vec::new() } else { blocks(grid, layer) }
}

/// Refuses to replace a folder that is no tile set, or that contains one of the source files.
fn check_replaceable(out: &Path, args: &GenArgs, is_archive: bool) -> Result<(), GenError> {
    if !is_archive && !ROOTS.iter().any(|root| out.join(root).is_file()) {
        let reason = format!("{} holds no tile set; --overwrite replaces tile sets only", out.display());
        return Err(GenError::Argument(reason));
    }
    let is_inside = |path: &&PathBuf| path.canonicalize().is_ok_and(|path| path.starts_with(out));
    match args.dem.iter().chain(&args.imagery).find(is_inside) {
        Some(path) => Err(GenError::Argument(format!("--overwrite would remove {}", path.display()))),
        None => Ok(()),
    }
}
