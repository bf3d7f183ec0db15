//! Opens the sources of a run: the elevation with its rectangle and levels, the imagery, and the grid of vertices.

use std::f64::consts::PI;
use std::sync::Arc;

use terrane::math::{Ellipsoid, WGS84};

use crate::args::MAX_LEVELS;
use crate::body::is_same;
use crate::color::{Imagery, TEXELS};
use crate::elevation::{DEFAULT_CACHE_BYTES, Mosaic, SourceContext, open_all, use_overviews};
use crate::georeference::{DatumGrid, ROUNDING};
use crate::output::TerrainSet;
use crate::pyramid::{ALIGNED, CELLS, Grid, Plan};
use crate::store::BlockCache;
use crate::world::{WorldSource, world_set};
use crate::{Color, ContentKind, ElevationSource, Extent, GenArgs, GenError, Procedural, Raster, VerticalDatum};

/// Longitude and latitude of the middle of procedural terrain, in degrees.
const PROCEDURAL_CENTER: [f64; 2] = [8.0, 47.0];
/// The default number of levels of procedural terrain.
pub(crate) const PROCEDURAL_LEVELS: u32 = 5;
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

/// The elevation to sample, with its rectangle and the number of levels.
struct Terrain {
    source: Box<dyn ElevationSource>,
    extent: Extent,
    /// The ellipsoid of the body that the elevation is of.
    ellipsoid: Ellipsoid,
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

impl Terrain {
    /// Returns terrain that has no files.
    fn of_formula(source: Box<dyn ElevationSource>, extent: Extent, step: [f64; 2], levels: u32) -> Self {
        let (places, notes, ellipsoid) = (Vec::new(), Vec::new(), WGS84);
        Self { source, extent, ellipsoid, step, levels, is_fine: false, places, pixel: [0.0; 2], notes, context: None }
    }
}

/// Reads the elevation files, or creates procedural terrain if there are none. By default there are enough levels for all
/// detail of the elevation and of the imagery.
fn terrain(
    args: &GenArgs,
    imagery: Option<&Imagery>,
    datum_grid: Option<&Arc<DatumGrid>>,
    cache: &Arc<BlockCache>,
) -> Result<Terrain, GenError> {
    if let Some(set) = world_set(args, PROCEDURAL_LEVELS) {
        let source = WorldSource::new(set);
        let (extent, step) = (source.extent(), source.step());
        let levels = args.levels.unwrap_or(PROCEDURAL_LEVELS);
        return Ok(Terrain::of_formula(Box::new(source), extent, step, levels));
    }
    if args.dem.is_empty() {
        let [lon, lat] = PROCEDURAL_CENTER.map(f64::to_radians);
        let half = 0.5 * args.size / 6_371_000.0;
        let half_lon = half / lat.cos();
        let extent = Extent { west: lon - half_lon, south: lat - half, east: lon + half_lon, north: lat + half };
        let source = Procedural { seed: args.seed, cos_latitude: lat.cos() };
        let levels = args.levels.unwrap_or(PROCEDURAL_LEVELS);
        let cells = (CELLS << (PROCEDURAL_LEVELS - 1)) as f64;
        let step = [2.0 * half_lon / cells, 2.0 * half / cells];
        return Ok(Terrain::of_formula(Box::new(source), extent, step, levels));
    }
    let options = args.raster_options();
    let context = SourceContext::new(Arc::clone(cache), args.vertical_datum.geoid()?, datum_grid.cloned());
    let mut rasters = unwrap_at_date_line(open_all(&args.dem, &options, &context)?);
    let ellipsoid = ellipsoid_of(args, &rasters)?;
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
    let mut notes: Vec<String> = rasters.iter().filter_map(Raster::note).collect();
    notes.extend(imagery.into_iter().flat_map(Imagery::notes));
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
    // Blends know the size of the earth.
    let blend = args.blend * (WGS84.semi_major_m / ellipsoid.semi_major_m);
    let source = Box::new(Mosaic::new(rasters, blend));
    let is_fine = levels >= needed;
    Ok(Terrain { source, extent: e, ellipsoid, step, levels, is_fine, places, pixel, notes, context: Some(context) })
}

/// Returns the ellipsoid of the body that elevation is of: that of `--body`, or of the reference systems of the files. Files of
/// different bodies are an error.
fn ellipsoid_of(args: &GenArgs, rasters: &[Raster]) -> Result<Ellipsoid, GenError> {
    let mut found = args.output.body.map(|body| (body.0, "--body".to_owned()));
    for raster in rasters {
        let own = match raster.ellipsoid() {
            // Degrees that name no body are those of the one that is given.
            None if args.output.body.is_some() => continue,
            own => own.unwrap_or(WGS84),
        };
        let Some((ellipsoid, of)) = &found else {
            found = Some((own, raster.path().display().to_string()));
            continue;
        };
        if !is_same(&own, ellipsoid) {
            let radii = |e: &Ellipsoid| format!("{} and {} m", e.semi_major_m, e.semi_minor_m);
            let reason = format!(
                "the ellipsoid of its reference system has radii of {}, and that of {of} {}",
                radii(&own),
                radii(ellipsoid)
            );
            return Err(GenError::invalid(raster.path(), reason));
        }
    }
    let (ellipsoid, of) = found.unwrap_or((WGS84, String::new()));
    match is_same(&ellipsoid, &WGS84) {
        true => Ok(WGS84),
        false if args.vertical_datum != VerticalDatum::Ellipsoid || args.datum_grid.is_some() => {
            Err(GenError::Argument(format!("--vertical-datum and --datum-grid are about the earth, {of} is not")))
        }
        false if args.content == ContentKind::QuantizedMesh => Err(GenError::Argument(format!(
            "--content quantized-mesh is terrain of the earth, {of} is not: layer.json names no body"
        ))),
        false => Ok(ellipsoid),
    }
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

/// Returns notes about heights that were read and that the earth does not have. There are none about other bodies.
fn notes(context: &SourceContext, ellipsoid: &Ellipsoid) -> Vec<String> {
    if *ellipsoid != WGS84 {
        return Vec::new();
    }
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

/// The opened sources of terrain for globes.
pub(crate) struct OpenedTerrain<'a> {
    pub set: TerrainSet<'a>,
    /// [`Opened::places`] and [`Opened::pixel`].
    pub places: Vec<[f64; 4]>,
    pub pixel: [f64; 2],
    /// [`Opened::notes`].
    pub notes: &'a (dyn Fn() -> Vec<String> + Sync),
}

/// Opens the sources of terrain for globes and calls with them.
pub(crate) fn with_terrain<T>(
    args: &GenArgs,
    call: impl FnOnce(&OpenedTerrain<'_>) -> Result<T, GenError>,
) -> Result<T, GenError> {
    let datum_grid = open_datum_grid(args)?;
    let cache = new_cache(args);
    let terrain = terrain(args, None, datum_grid.as_ref(), &cache)?;
    check_use(datum_grid.as_deref())?;
    let needed = levels_for([PI; 2], terrain.step, CELLS);
    let levels = args.levels.unwrap_or(needed.min(MAX_LEVELS));
    let Terrain { source, extent, ellipsoid, places, pixel, notes, context, .. } = terrain;
    let all_notes =
        || notes.iter().cloned().chain(context.iter().flat_map(|context| self::notes(context, &ellipsoid))).collect();
    let set = TerrainSet { source: source.as_ref(), extent, levels, is_fine: levels >= needed };
    if let Some(memory) = args.run.memory {
        cache.set_budget(cache_bytes(memory, set.work_bytes(args))?);
    }
    call(&OpenedTerrain { set, places, pixel, notes: &all_notes })
}

/// Creates the cache for blocks of sources. With a limit for memory it grows when the work is known.
fn new_cache(args: &GenArgs) -> Arc<BlockCache> {
    let cache = BlockCache::new(args.run.memory.map_or(DEFAULT_CACHE_BYTES, |_| MIN_CACHE_BYTES));
    Arc::new(cache.allowing(&args.run.allow_host))
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
    let cache = new_cache(args);
    let datum_grid = open_datum_grid(args)?;
    let imagery = match args.imagery.is_empty() {
        true => None,
        false => Some(Imagery::open(&args.imagery, args.epsg.as_ref(), datum_grid.as_deref(), &cache)?),
    };
    let Terrain { source, extent, ellipsoid, levels, is_fine, places, pixel, notes, context, .. } =
        terrain(args, imagery.as_ref(), datum_grid.as_ref(), &cache)?;
    check_use(datum_grid.as_deref())?;
    if let (Some(image), Some(path)) = (&imagery, args.imagery.first())
        && !image.covers(&extent)?
    {
        let notes: Vec<String> = image.notes().collect();
        let reason = if notes.is_empty() {
            "does not overlap the elevation"
        } else {
            "has no georeference; a world file places it"
        };
        return Err(GenError::invalid(path, reason));
    }
    if let Some(image) = &imagery
        && image.ellipsoids().any(|own| !is_same(&own, &ellipsoid))
    {
        let path = args.imagery.first().cloned().unwrap_or_default();
        return Err(GenError::invalid(path, "is on another body than the elevation"));
    }
    let all_notes =
        || notes.iter().cloned().chain(context.iter().flat_map(|context| self::notes(context, &ellipsoid))).collect();
    let (grid, plan) = if args.run.aligned {
        (Grid::aligned(source.as_ref(), levels, is_fine), Plan::aligned(levels, &extent))
    } else {
        (Grid::new(source.as_ref(), extent, levels, args.voids, is_fine), Plan::new(levels))
    };
    let grid = grid.with_step(args.tiles.step_m()).on(ellipsoid);
    if let Some(memory) = args.run.memory {
        cache.set_budget(cache_bytes(memory, plan.work_bytes(args.color != Color::None))?);
    }
    call(&Opened { grid: &grid, imagery: imagery.as_ref(), plan, is_fine, places, pixel, notes: &all_notes })
}

/// The bytes of blocks of sources that a run needs at least.
const MIN_CACHE_BYTES: usize = 16 << 20;
/// The bytes that a thread takes for a tile.
const TILE_BYTES: u64 = 2 << 20;

/// Returns the part of the memory that is left for blocks of sources, beside `work` bytes and those of each thread.
fn cache_bytes(memory: u64, work: u64) -> Result<usize, GenError> {
    let work = work + TILE_BYTES * rayon::current_num_threads() as u64;
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
        for levels in [3, 6, 12, 20] {
            let plan = Plan::new(levels);
            let work = plan.work_bytes(true);
            let rest = cache_bytes(1 << 30, work).unwrap();
            assert!(rest >= MIN_CACHE_BYTES && rest as u64 + work <= 1 << 30, "{levels}: {rest} {work}");
            assert!(cache_bytes(work, work).unwrap_err().to_string().contains("at least"));
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
