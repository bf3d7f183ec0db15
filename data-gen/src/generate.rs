//! Generates a tile set from its options: checks them, reads the sources, and writes the folder.

use std::f64::consts::PI;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::args::{JOBS, MAX_LEVELS, SIZES_M};
use crate::color::{Imagery, TEXELS};
use crate::elevation::{DEFAULT_CACHE_BYTES, Mosaic, SourceContext, expand, open_all};
use crate::fingerprint::fingerprint;
use crate::georeference::ROUNDING;
use crate::output::{
    Builder, Journal, PartialFolder, ROOTS, blocks, finish, is_archive_at, level_errors_m, voids, write_terrain,
};
use crate::pyramid::{CELLS, Grid, Layer, Plan, TileKey};
use crate::shards;
use crate::store::BlockCache;
use crate::world::{check_world, world_set, write_world};
use crate::{ContentKind, ElevationSource, Extent, GenArgs, GenError, Procedural, Raster, Summary};

/// Longitude and latitude of the middle of procedural terrain, in degrees.
const PROCEDURAL_CENTER: [f64; 2] = [8.0, 47.0];
/// The default number of levels of procedural terrain.
const PROCEDURAL_LEVELS: u32 = 5;
/// The folder of the default set. The number changes with the content of the set, so that old sets are not used.
const DEFAULT_SET: &str = "default-set-2";

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
}

impl Outcome {
    /// Writes the outcome to standard output. A closed pipe is not an error.
    pub fn print(&self) -> std::io::Result<()> {
        match self {
            Self::Set(summary) => summary.print(),
            Self::Plan(json) => match writeln!(std::io::stdout(), "{json}") {
                Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
                written => written,
            },
        }
    }
}

/// Does what the options ask for: makes a set or a shard, or plans shards.
pub fn execute(args: &GenArgs) -> Result<Outcome, GenError> {
    let Some(count) = args.sharding.plan else { return run(args).map(|summary| Outcome::Set(Box::new(summary))) };
    let args = &GenArgs { dem: expand(&args.dem)?, ..args.clone() };
    check(args)?;
    let fingerprint = fingerprint(args)?;
    with_grid(args, |grid, _, _| {
        let plan = Plan::new(grid.levels);
        let layer = plan.finest();
        let tiles = layer.tiles_per_block();
        Ok(Outcome::Plan(shards::plan(count, fingerprint, grid.levels, &blocks_below_root(grid, layer), tiles)))
    })
}

/// Generates a tile set, or a shard of one. Files are written to a temporary folder beside OUT, which is moved to OUT when all are
/// complete. If the run is killed, the same options continue it.
pub fn run(args: &GenArgs) -> Result<Summary, GenError> {
    let start = Instant::now();
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
    let args = &GenArgs { dem: expand(&args.dem)?, ..args.clone() };
    if occupied && !args.overwrite && !is_shard {
        return Err(GenError::Exists(out));
    }
    let out = if out.exists() { out.canonicalize().map_err(GenError::file(&out))? } else { out };
    if occupied && !is_shard {
        check_replaceable(&out, args, is_archive)?;
    }
    check(args)?;
    let fingerprint = fingerprint(args)?;
    // With 0 rayon starts one thread per core.
    let threads = args.jobs.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| GenError::Argument(format!("--jobs {threads}: {e}")))?;
    if occupied && is_shard {
        if !shards::is_made(&out, fingerprint) {
            return Err(GenError::Exists(out));
        }
        return Ok(Summary { out, notes: vec!["the shard was complete".to_owned()], ..Summary::default() });
    }
    let partial = PartialFolder::beside(&out, fingerprint)?;
    let made = pool.install(|| make(args, &out, fingerprint, partial.path()));
    let is_same = || self::fingerprint(args).is_ok_and(|now| now == fingerprint);
    let (mut summary, shards) = match made {
        Ok(_) if !is_same() => return Err(GenError::Changed(out)),
        Ok(made) => made,
        Err(reason @ (GenError::File { .. } | GenError::Shards { .. }))
            if Journal::new(partial.path()).has_blocks() && is_same() =>
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

/// Checks options. The command line checks some of them as well, but programs may call [`run`] directly.
fn check(args: &GenArgs) -> Result<(), GenError> {
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
    if let Some(set) = world_set(args, PROCEDURAL_LEVELS) {
        return Ok((write_world(&set, folder)?, Vec::new()));
    }
    if args.content == ContentKind::QuantizedMesh {
        let terrain = terrain(args, None, &Arc::new(BlockCache::new(DEFAULT_CACHE_BYTES)))?;
        let needed = levels_for([PI; 2], terrain.step, CELLS);
        let levels = args.levels.unwrap_or(needed.min(MAX_LEVELS));
        let mut summary =
            write_terrain(args, terrain.source.as_ref(), terrain.extent, (levels, levels >= needed), folder)?;
        if levels < needed {
            summary.notes.push(format!("the sources have detail for {needed} levels; {levels} are written"));
        }
        summary.notes.extend(terrain.context.iter().flat_map(|context| notes(context)));
        return Ok((summary, Vec::new()));
    }
    let shards = if args.sharding.merge { shards::gather(out, fingerprint, folder)? } else { Vec::new() };
    with_grid(args, |grid, imagery, notes| {
        let plan = Plan::new(grid.levels);
        let mut builder = Builder::new(args, grid, imagery, &plan, folder)?;
        let totals = match args.sharding.shard {
            Some(shard) => {
                let blocks = blocks_below_root(grid, plan.finest());
                let totals = builder.make_blocks(plan.finest(), shard.part_of(&blocks))?;
                shards::write_manifest(folder, shard, fingerprint)?;
                totals
            }
            None => {
                let totals = builder.make_set()?;
                Journal::new(folder).remove()?;
                totals
            }
        };
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
            notes: notes(),
        };
        Ok((summary, shards))
    })
}

/// Returns the roots of the finest layer's blocks. The only block of a small set is left out: it is made when shards are merged.
fn blocks_below_root(grid: &Grid<'_>, layer: Layer) -> Vec<TileKey> {
    if layer.root == 0 { Vec::new() } else { blocks(grid, layer) }
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
    /// Notes about the sources, each a sentence.
    notes: Vec<String>,
    /// The context that the elevation files share; `None` for procedural terrain.
    context: Option<Arc<SourceContext>>,
}

/// Reads the elevation files, or creates procedural terrain if there are none. By default there are enough levels for all
/// detail of the elevation and of the imagery.
fn terrain(args: &GenArgs, imagery: Option<&Imagery>, cache: &Arc<BlockCache>) -> Result<Terrain, GenError> {
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
            notes: Vec::new(),
            context: None,
        });
    }
    let options = args.raster_options();
    let context = SourceContext::new(Arc::clone(cache), args.vertical_datum.geoid()?);
    let rasters = unwrap_at_date_line(open_all(&args.dem, &options, &context)?);
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
    let needed = levels_for([e.east - e.west, e.north - e.south], step, CELLS);
    let mut wanted = needed;
    if let Some(imagery) = imagery {
        wanted = wanted.max(levels_for([e.east - e.west, e.north - e.south], imagery.pixel_size(), TEXELS as usize));
    }
    let levels = args.levels.unwrap_or(wanted.min(MAX_LEVELS));
    let mut notes = Vec::new();
    if levels < wanted {
        notes.push(format!("the sources have detail for {wanted} levels; {levels} are written"));
    }
    let source = Box::new(Mosaic::new(rasters));
    Ok(Terrain { source, extent: e, step, levels, is_fine: levels >= needed, notes, context: Some(context) })
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

/// Opens the sources and calls with the grid, the imagery, and a function that returns notes about the sources: what was read
/// since is among them.
fn with_grid<T>(
    args: &GenArgs,
    call: impl FnOnce(&Grid<'_>, Option<&Imagery>, &dyn Fn() -> Vec<String>) -> Result<T, GenError>,
) -> Result<T, GenError> {
    let cache = Arc::new(BlockCache::new(DEFAULT_CACHE_BYTES));
    let open = |path: &PathBuf| {
        // A folder of imagery is refused as any other file that is none.
        let files = if path.is_dir() { vec![path.clone()] } else { expand(std::slice::from_ref(path))? };
        Imagery::open(&files, args.epsg.as_ref(), &cache)
    };
    let imagery = args.imagery.as_ref().map(open).transpose()?;
    let Terrain { source, extent, levels, is_fine, notes, context, .. } = terrain(args, imagery.as_ref(), &cache)?;
    if let (Some(image), Some(path)) = (&imagery, &args.imagery)
        && !image.covers(&extent)?
    {
        return Err(GenError::invalid(path, "does not overlap the elevation"));
    }
    let all_notes = || notes.iter().cloned().chain(context.iter().flat_map(|context| self::notes(context))).collect();
    call(&Grid::new(source.as_ref(), extent, levels, args.voids, is_fine), imagery.as_ref(), &all_notes)
}
