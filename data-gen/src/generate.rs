//! Generates a tile set from its options: checks them, reads the sources, and writes the folder.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use crate::args::{JOBS, MAX_LEVELS, SIZES_M};
use crate::color::{Imagery, Painter, TEXELS};
use crate::elevation::{DEFAULT_CACHE_BYTES, Mosaic, SourceContext, expand, open_all};
use crate::georeference::ROUNDING;
use crate::output::{PartialFolder, write_tiles};
use crate::pyramid::CELLS;
use crate::store::BlockCache;
use crate::{
    ElevationSource, Extent, GenArgs, GenError, Grid, Procedural, Progress, Pyramid, Raster, Sampling, Summary,
};

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
        run(&args)?;
    }
    Ok(out)
}

/// Generates a tile set. Files are written to a temporary folder beside OUT, which is moved to OUT when all are complete.
pub fn run(args: &GenArgs) -> Result<Summary, GenError> {
    let start = Instant::now();
    let out = std::path::absolute(&args.out).map_err(GenError::file(&args.out))?;
    let occupied = match std::fs::read_dir(&out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => false,
        Err(e) => return Err(GenError::File { path: out, reason: e }),
    };
    if out.is_symlink() && !out.exists() {
        return Err(GenError::invalid(out, "is a link whose target does not exist"));
    }
    if occupied && !args.overwrite {
        return Err(GenError::Exists(out));
    }
    let out = if out.exists() { out.canonicalize().map_err(GenError::file(&out))? } else { out };
    let args = &GenArgs { dem: expand(&args.dem)?, ..args.clone() };
    if occupied {
        check_replaceable(&out, args)?;
    }
    // The command line checks these as well, but programs may call this function directly.
    if !SIZES_M.contains(&args.size) {
        return Err(GenError::Argument(format!("--size {} m is not within 100 m and 2,000 km", args.size)));
    }
    args.check().map_err(GenError::Argument)?;
    if args.levels.is_some_and(|l| l == 0 || l > MAX_LEVELS) {
        return Err(GenError::Argument(format!("--levels must be 1 to {MAX_LEVELS}")));
    }
    if args.jobs.is_some_and(|jobs| !JOBS.contains(&jobs)) {
        return Err(GenError::Argument(format!("--jobs must be {} to {}", JOBS.start(), JOBS.end())));
    }
    // With 0 rayon starts one thread per core.
    let threads = args.jobs.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| GenError::Argument(format!("--jobs {threads}: {e}")))?;
    let partial = PartialFolder::beside(&out)?;
    let mut summary = pool.install(|| generate_into(args, partial.path()))?;
    partial.put_in_place(&out)?;
    summary.out = out;
    summary.seconds = start.elapsed().as_secs_f64();
    Ok(summary)
}

/// Refuses to replace a folder that is no tile set, or that contains one of the source files.
fn check_replaceable(out: &Path, args: &GenArgs) -> Result<(), GenError> {
    if !out.join("tileset.json").is_file() {
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
    levels: u32,
    /// True if the finest level is as fine as the source.
    is_fine: bool,
    /// Notes about the sources, each a sentence.
    notes: Vec<String>,
    /// What the files of the elevation share; `None` for procedural terrain.
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
        return Ok(Terrain {
            source: Box::new(source),
            extent,
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
    Ok(Terrain { source, extent: e, levels, is_fine: levels >= needed, notes, context: Some(context) })
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

/// Samples, measures and paints the terrain, and writes its tiles into `folder`.
fn generate_into(args: &GenArgs, folder: &Path) -> Result<Summary, GenError> {
    let cache = Arc::new(BlockCache::new(DEFAULT_CACHE_BYTES));
    let open = |path: &PathBuf| {
        // A folder of imagery is refused as any other file that is none.
        let files = if path.is_dir() { vec![path.clone()] } else { expand(std::slice::from_ref(path))? };
        Imagery::open(&files, args.epsg.as_ref(), &cache)
    };
    let imagery = args.imagery.as_ref().map(open).transpose()?;
    let Terrain { source, extent, levels, is_fine, mut notes, context } = terrain(args, imagery.as_ref(), &cache)?;
    if let (Some(image), Some(path)) = (&imagery, &args.imagery)
        && !image.covers(&extent)?
    {
        return Err(GenError::invalid(path, "does not overlap the elevation"));
    }
    let side = (CELLS << (levels - 1)) + 1;
    let sampling = Progress::new("sampling the elevation", side as u64, "rows");
    let row_done = || sampling.advance(1);
    let how = Sampling { voids: args.voids, keep_extrema: is_fine, row_done: &row_done };
    let grid = Grid::sample_rows(source.as_ref(), extent, side, &how)?;
    drop(sampling);
    let pyramid = Pyramid::new(grid, levels, source.as_ref())?;
    notes.extend(context.iter().flat_map(|context| self::notes(context)));
    // The memory of the source is free while tiles are written.
    drop((source, context));
    if pyramid.keys().next().is_none() {
        let reason = "no neighbouring samples have heights; --voids fill continues them";
        return Err(GenError::invalid(args.dem.first().cloned().unwrap_or_default(), reason));
    }
    let painter = Painter::new(&pyramid, imagery.as_ref());
    let summary = write_tiles(args, &pyramid, &painter, folder)?;
    Ok(Summary { notes, ..summary })
}
