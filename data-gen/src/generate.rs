//! Generates a tile set from its options: checks them, reads the sources, and writes the folder.

use std::f64::consts::PI;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::args::{JOBS, MAX_LEVELS, SIZES_M};
use crate::color::{Imagery, TEXELS};
use crate::elevation::{DEFAULT_CACHE_BYTES, Mosaic, SourceContext, expand, open_all, use_overviews};
use crate::fingerprint::fingerprint;
use crate::georeference::{DatumGrid, ROUNDING};
use crate::output::{
    Builder, Journal, PartialFolder, ROOTS, TerrainSet, blocks, finish, is_archive_at, level_errors_m, voids,
};
use crate::pyramid::{ALIGNED, CELLS, Grid, Layer, Plan, TileKey};
use crate::store::BlockCache;
use crate::update::{Manifest, keep_blocks};
use crate::web_tiles::TileContent;
use crate::world::{check_world, world_set, write_world};
use crate::{
    Color, ContentKind, ElevationSource, Extent, GenArgs, GenError, Prediction, PredictionFormat, Procedural, Raster,
    Sharding, Summary,
};
use crate::{prediction, shards};

/// Longitude and latitude of the middle of procedural terrain, in degrees.
const PROCEDURAL_CENTER: [f64; 2] = [8.0, 47.0];
/// The default number of levels of procedural terrain.
const PROCEDURAL_LEVELS: u32 = 5;
/// The folder of the default set. The number changes with the content of the set, so that old sets are not used.
const DEFAULT_SET: &str = "default-set-2";
/// The number of places where a run that may not fit on the disk makes a sample.
const SPACE_PLACES: usize = 2;

/// Returns the folder of the small set that `terrane fly` shows by default. Generates the set in `folder` unless it is
/// there.
pub fn default_set(folder: &Path) -> Result<PathBuf, GenError> {
    let out = folder.join(DEFAULT_SET);
    if !out.join("tileset.json").is_file() {
        let args = GenArgs { overwrite: true, levels: Some(5), size: 40_000.0, ..GenArgs::new(&out) };
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
    let out = std::path::absolute(&args.out).map_err(GenError::file(&args.out))?;
    let print = |levels, roots: &[TileKey], tiles| shards::plan(count, fingerprint, levels, roots, tiles, &out);
    if args.content == ContentKind::QuantizedMesh {
        let mut plan = String::new();
        with_terrain(args, |set| {
            plan = print(set.levels, &set.roots(args), set.tiles_per_root());
            Ok(Summary::default())
        })?;
        return Ok(Outcome::Plan(plan));
    }
    with_grid(args, |opened| {
        let layer = opened.plan.finest();
        let blocks = blocks_below_root(opened.grid, layer);
        Ok(Outcome::Plan(print(opened.grid.levels, &blocks, layer.tiles_per_block())))
    })
}

/// Predicts a run: its tiles, bytes and time. Fails as the run would, as far as that is known before; writes nothing.
pub fn predict(args: &GenArgs) -> Result<Prediction, GenError> {
    #[cfg(feature = "object-store")]
    if crate::store::is_remote(&args.out) {
        return crate::bucket::predict(args);
    }
    let args = &expanded(args)?;
    let (out, _) = target(args)?;
    check(args)?;
    prediction::check_writable(&out)?;
    let predicted = thread_pool(args)?.install(|| match world_set(args, PROCEDURAL_LEVELS) {
        Some(set) => prediction::predict_world(&set, &out),
        None => with_grid(args, |opened| prediction::predict(args, opened, &out, prediction::PLACES)),
    })?;
    predicted.check_space(&out)?;
    Ok(predicted)
}

/// Returns the absolute path of OUT, or of the shard beside it, and whether there are files in it. Fails if they may not be replaced.
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

/// Generates a tile set, or a shard of one. Files are written to a temporary folder beside OUT, which is moved to OUT when all are
/// complete; those of a bucket to one in the folder of temporary files, and are uploaded. If the run is killed, the same options
/// continue it.
pub fn run(args: &GenArgs) -> Result<Summary, GenError> {
    #[cfg(feature = "object-store")]
    if crate::store::is_remote(&args.out) {
        return crate::bucket::run(args);
    }
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
        return Ok(Summary { out, notes: vec!["the shard was complete".to_owned()], ..Summary::default() });
    }
    let made = pool.install(|| make(args, &out, fingerprint, partial.path()));
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
    summary.bytes = pool.install(|| finish(args, partial, &out, summary.bytes))?;
    for shard in shards {
        // The set is complete; a later merge would find the shards empty.
        std::fs::remove_dir_all(&shard).map_err(GenError::file(&shard))?;
    }
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
fn make(args: &GenArgs, out: &Path, fingerprint: u64, folder: &Path) -> Result<(Summary, Vec<PathBuf>), GenError> {
    let is_fresh = !Journal::new(folder).exists();
    if let Some(set) = world_set(args, PROCEDURAL_LEVELS) {
        if is_fresh {
            let tiles = (0..set.levels()).map(|level| 1u64 << (2 * level)).sum();
            prediction::check_space(out, tiles, || prediction::predict_world(&set, out))?;
        }
        return Ok((write_world(&set, args.output.tiling, folder)?, Vec::new()));
    }
    let shards = if args.sharding.merge { shards::gather(out, fingerprint, folder)? } else { Vec::new() };
    if args.content == ContentKind::QuantizedMesh {
        let summary = with_terrain(args, |set| {
            let summary = set.write(args, folder, args.sharding.shard)?;
            args.sharding.shard.map_or(Ok(()), |shard| shards::write_manifest(folder, shard, fingerprint))?;
            Ok(summary)
        })?;
        return Ok((summary, shards));
    }
    with_grid(args, |opened| {
        let (grid, plan) = (opened.grid, &opened.plan);
        let mut notes = Vec::new();
        if args.run.update && out.join("tileset.json").is_file() {
            notes.push(keep_blocks(args, opened, out, folder)?);
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

/// Opens the sources of terrain for globes and calls with them. Their notes are added to the summary.
fn with_terrain(
    args: &GenArgs,
    call: impl FnOnce(&TerrainSet<'_>) -> Result<Summary, GenError>,
) -> Result<Summary, GenError> {
    let datum_grid = open_datum_grid(args)?;
    let cache = Arc::new(BlockCache::new(DEFAULT_CACHE_BYTES).allowing(&args.run.allow_host));
    let terrain = terrain(args, None, datum_grid.as_ref(), &cache)?;
    check_use(datum_grid.as_deref())?;
    let needed = levels_for([PI; 2], terrain.step, CELLS);
    let levels = args.levels.unwrap_or(needed.min(MAX_LEVELS));
    let (source, is_fine) = (terrain.source.as_ref(), levels >= needed);
    let mut summary = call(&TerrainSet { source, extent: terrain.extent, levels, is_fine })?;
    summary.notes.extend(terrain.notes);
    summary.notes.extend(terrain.context.iter().flat_map(|context| notes(context)));
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

/// The elevation to sample, with its rectangle and the number of levels.
struct Terrain {
    source: Box<dyn ElevationSource>,
    extent: Extent,
    /// The smallest step between samples, east and north, in radians.
    step: [f64; 2],
    levels: u32,
    /// True if the finest level is as fine as the source.
    is_fine: bool,
    /// The bounds of each elevation file: west, south, east and north in radians.
    places: Vec<[f64; 4]>,
    /// The largest pixel of the elevation files, east and north, in radians.
    pixel: [f64; 2],
    /// Notes about the sources, each a sentence.
    notes: Vec<String>,
    /// The context that the elevation files share; `None` for procedural terrain.
    context: Option<Arc<SourceContext>>,
}

/// Reads the elevation files, or creates procedural terrain if there are none. By default there are enough levels for all
/// detail of the elevation and of the imagery.
fn terrain(
    args: &GenArgs,
    imagery: Option<&Imagery>,
    datum_grid: Option<&Arc<DatumGrid>>,
    cache: &Arc<BlockCache>,
) -> Result<Terrain, GenError> {
    if args.dem.is_empty() {
        let [lon, lat] = PROCEDURAL_CENTER.map(f64::to_radians);
        let half = 0.5 * args.size / 6_371_000.0;
        let half_lon = half / lat.cos();
        let extent = Extent { west: lon - half_lon, south: lat - half, east: lon + half_lon, north: lat + half };
        let source = Procedural { seed: args.seed, cos_latitude: lat.cos() };
        let levels = args.levels.unwrap_or(PROCEDURAL_LEVELS);
        let cells = (CELLS << (PROCEDURAL_LEVELS - 1)) as f64;
        let step = [2.0 * half_lon / cells, 2.0 * half / cells];
        return Ok(Terrain {
            source: Box::new(source),
            extent,
            step,
            levels,
            is_fine: false,
            places: Vec::new(),
            pixel: [0.0; 2],
            notes: Vec::new(),
            context: None,
        });
    }
    let options = args.raster_options();
    let context = SourceContext::new(Arc::clone(cache), args.vertical_datum.geoid()?, datum_grid.cloned());
    let mut rasters = unwrap_at_date_line(open_all(&args.dem, &options, &context)?);
    let mut e = Extent { west: f64::MAX, south: f64::MAX, east: f64::MIN, north: f64::MIN };
    // The smallest step between samples, east and north, in radians.
    let mut step = [f64::INFINITY; 2];
    for r in &rasters {
        let [west, south, east, north] = r.bounds();
        e = Extent {
            west: e.west.min(west),
            south: e.south.min(south),
            east: e.east.max(east),
            north: e.north.max(north),
        };
        let own = r.sample_distance();
        step = [step[0].min(own[0]), step[1].min(own[1])];
    }
    const OUT_OF_RANGE: &str = "the elevation lies outside of the earth's coordinates or has no extent";
    let is_on_earth = e.south >= -0.5 * PI - ROUNDING && e.north <= 0.5 * PI + ROUNDING && e.west >= -PI - ROUNDING;
    let (wide, high) = (e.east - e.west, e.north - e.south);
    let problem = match e.east {
        _ if !(is_on_earth && wide >= 1e-9 && high >= 1e-9) => Some(OUT_OF_RANGE),
        east if east <= PI + ROUNDING || (e.west < PI && wide < PI) => None,
        _ if e.west < PI => Some("the elevation reaches across the date line and half around the earth"),
        _ => Some(OUT_OF_RANGE),
    };
    if let Some(problem) = problem {
        return Err(GenError::invalid(args.dem.first().cloned().unwrap_or_default(), problem));
    }
    if args.run.aligned && wide >= 2.0 * PI - ROUNDING {
        return Err(GenError::Argument("--aligned has no effect for elevation around the whole earth".to_owned()));
    }
    let grid = if args.run.aligned { ALIGNED } else { e };
    let sides = match args.content {
        // The tiles of the top level are half as wide as the earth.
        ContentKind::QuantizedMesh => [PI; 2],
        _ => [grid.east - grid.west, grid.north - grid.south],
    };
    let needed = levels_for(sides, step, CELLS);
    let mut wanted = needed;
    if let Some(imagery) = imagery {
        wanted = wanted.max(levels_for(sides, imagery.pixel_size(), TEXELS as usize));
    }
    let levels = args.levels.unwrap_or(wanted.min(MAX_LEVELS));
    let mut notes = Vec::new();
    if levels < wanted {
        notes.push(format!("the sources have detail for {wanted} levels; {levels} are written"));
    }
    if levels < needed {
        let cells = (CELLS as f64) * f64::from(levels - 1).exp2();
        let replaced = use_overviews(&mut rasters, sides.map(|side| side / cells), &options, &context)?;
        if replaced > 0 {
            notes.push(format!(
                "{replaced} of {} elevation files are read by their overviews, as the finest level is coarser; errors are \
                 measured against these",
                rasters.len()
            ));
        }
    }
    let places = rasters.iter().map(Raster::bounds).collect();
    let distances = rasters.iter().map(Raster::sample_distance);
    let pixel = distances.fold([0.0f64; 2], |widest, own| [widest[0].max(own[0]), widest[1].max(own[1])]);
    let source = Box::new(Mosaic::new(rasters, args.blend));
    let is_fine = levels >= needed;
    Ok(Terrain { source, extent: e, step, levels, is_fine, places, pixel, notes, context: Some(context) })
}

/// Returns the number of levels whose finest one has steps of at most a size, for a rectangle with these sides. A tile has
/// `per_tile` steps along a side.
fn levels_for(sides: [f64; 2], step: [f64; 2], per_tile: usize) -> u32 {
    // The tolerance makes 513 samples 512 cells in spite of rounding.
    let steps = (sides[0] / step[0]).max(sides[1] / step[1]) - 1e-6;
    let levels = (steps / per_tile as f64).log2().ceil().max(0.0) + 1.0;
    if levels.is_finite() { levels as u32 } else { 1 }
}

/// Heights of the earth in metres, with some room.
const EARTH_M: [f32; 2] = [-12_000.0, 9_000.0];

/// Returns notes about heights that were read and that the earth does not have.
fn notes(context: &SourceContext) -> Vec<String> {
    let [low, high] = context.seen.range_m().unwrap_or(EARTH_M);
    let unusual = [(low < EARTH_M[0]).then_some(low), (high > EARTH_M[1]).then_some(high)];
    let note =
        |height_m| format!("a height of {height_m} m is not the earth's; the unit or the scale of a file may be wrong");
    unusual.into_iter().flatten().map(note).collect()
}

/// Adds a turn to western longitudes if files lie on both sides of the date line or across it, so that all are one piece.
/// Files that are connected through longitude 0 are not changed.
fn unwrap_at_date_line(mut rasters: Vec<Raster>) -> Vec<Raster> {
    let mut longitudes: Vec<[f64; 2]> = rasters.iter().map(Raster::bounds).map(|[w, _, e, _]| [w, e]).collect();
    let is_across = |[west, east]: &[f64; 2]| *west < -PI - ROUNDING || *east > PI + ROUNDING;
    if longitudes.iter().any(is_across) || widest_gap(&mut longitudes) > PI {
        rasters.iter_mut().filter(|r| r.bounds()[0] < 0.0).for_each(Raster::turn_east);
    }
    rasters
}

/// Returns the widest gap between intervals of longitude.
fn widest_gap(intervals: &mut [[f64; 2]]) -> f64 {
    intervals.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let (mut gap, mut end) = (0.0f64, f64::INFINITY);
    for [west, east] in intervals {
        gap = gap.max(*west - end);
        end = if end.is_finite() { end.max(*east) } else { *east };
    }
    gap
}

/// The opened sources of a run.
pub(crate) struct Opened<'a> {
    pub grid: &'a Grid<'a>,
    pub imagery: Option<&'a Imagery>,
    pub plan: Plan,
    /// [`Terrain::is_fine`], [`Terrain::places`] and [`Terrain::pixel`].
    pub is_fine: bool,
    pub places: Vec<[f64; 4]>,
    pub pixel: [f64; 2],
    /// Returns notes about the sources; what was read since is among them.
    pub notes: &'a (dyn Fn() -> Vec<String> + Sync),
}

fn open_datum_grid(args: &GenArgs) -> Result<Option<Arc<DatumGrid>>, GenError> {
    Ok(args.datum_grid.as_deref().map(DatumGrid::read).transpose()?.map(Arc::new))
}

/// Fails if no source has the datum of a grid.
fn check_use(datum_grid: Option<&DatumGrid>) -> Result<(), GenError> {
    match datum_grid.is_some_and(|grid| !grid.is_used()) {
        true => Err(GenError::Argument("--datum-grid has no effect: the datum of all sources is WGS84".to_owned())),
        false => Ok(()),
    }
}

/// Opens the sources and calls with them.
pub(crate) fn with_grid<T>(
    args: &GenArgs,
    call: impl FnOnce(&Opened<'_>) -> Result<T, GenError>,
) -> Result<T, GenError> {
    let cache = BlockCache::new(args.run.memory.map_or(DEFAULT_CACHE_BYTES, |_| MIN_CACHE_BYTES));
    let cache = Arc::new(cache.allowing(&args.run.allow_host));
    let datum_grid = open_datum_grid(args)?;
    let imagery = match args.imagery.is_empty() {
        true => None,
        false => Some(Imagery::open(&args.imagery, args.epsg.as_ref(), datum_grid.as_deref(), &cache)?),
    };
    let Terrain { source, extent, levels, is_fine, places, pixel, notes, context, .. } =
        terrain(args, imagery.as_ref(), datum_grid.as_ref(), &cache)?;
    check_use(datum_grid.as_deref())?;
    if let (Some(image), Some(path)) = (&imagery, args.imagery.first())
        && !image.covers(&extent)?
    {
        return Err(GenError::invalid(path, "does not overlap the elevation"));
    }
    let all_notes = || notes.iter().cloned().chain(context.iter().flat_map(|context| self::notes(context))).collect();
    let (grid, plan) = if args.run.aligned {
        (Grid::aligned(source.as_ref(), levels, is_fine), Plan::aligned(levels, &extent))
    } else {
        (Grid::new(source.as_ref(), extent, levels, args.voids, is_fine), Plan::new(levels))
    };
    let grid = grid.with_step(args.tiles.step_m());
    if let Some(memory) = args.run.memory {
        cache.set_budget(cache_bytes(memory, &plan, args)?);
    }
    call(&Opened { grid: &grid, imagery: imagery.as_ref(), plan, is_fine, places, pixel, notes: &all_notes })
}

/// The bytes of blocks of sources that a run needs at least.
const MIN_CACHE_BYTES: usize = 16 << 20;
/// The bytes that a thread takes for a tile.
const TILE_BYTES: u64 = 2 << 20;

/// Returns the part of the memory that is left for blocks of sources.
fn cache_bytes(memory: u64, plan: &Plan, args: &GenArgs) -> Result<usize, GenError> {
    let work = plan.work_bytes(args.color != Color::None) + TILE_BYTES * rayon::current_num_threads() as u64;
    match memory.checked_sub(work) {
        Some(rest) if rest >= MIN_CACHE_BYTES as u64 => Ok(usize::try_from(rest).unwrap_or(usize::MAX)),
        _ => {
            let least = (work + MIN_CACHE_BYTES as u64).div_ceil(1 << 20);
            Err(GenError::Argument(format!("--memory is too small for this set, which needs at least {least}M")))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elevation::SourceContext;
    use crate::pyramid::Window;

    #[test]
    fn memory_is_shared_by_sources_and_tiles() {
        let args = GenArgs::new("set");
        for levels in [3, 6, 12, 20] {
            let plan = Plan::new(levels);
            let work = plan.work_bytes(true);
            let rest = cache_bytes(1 << 30, &plan, &args).unwrap();
            assert!(rest >= MIN_CACHE_BYTES && rest as u64 + work <= 1 << 30, "{levels}: {rest} {work}");
            assert!(cache_bytes(work, &plan, &args).unwrap_err().to_string().contains("at least"));
        }
    }

    /// The file has 26 MB, and 52 MB as heights.
    #[test]
    fn larger_source_stays_within_the_bytes_of_the_cache() {
        const BUDGET_BYTES: usize = 3 << 20;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("N46E007.hgt");
        let heights: Vec<u8> =
            (0..3601u32 * 3601).flat_map(|k| ((k % 3601 + k / 3601) as i16 / 4).to_be_bytes()).collect();
        std::fs::write(&path, heights).unwrap();
        let cache = Arc::new(BlockCache::new(1 << 20));
        cache.set_budget(BUDGET_BYTES);
        let context = SourceContext::new(Arc::clone(&cache), None, None);
        let rasters = open_all(&[path], &GenArgs::new("set").raster_options(), &context).unwrap();
        let [west, south, east, north] = rasters[0].bounds();
        let mosaic = Mosaic::new(rasters, 0.0);
        let grid = Grid::new(&mosaic, Extent { west, south, east, north }, 6, crate::Voids::Cut, false);
        for column in [0, 256, 0] {
            let window = Window { first: [column, 0], last: [column + 40, 512] };
            assert!(!grid.sample(2, window).unwrap().has_unknown());
        }
        assert!((1 << 20..=BUDGET_BYTES).contains(&cache.peak_bytes()), "{}", cache.peak_bytes());
    }
}
