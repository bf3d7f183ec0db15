//! From arguments to a folder of tiles.

use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use glam::{DAffine3, DMat4};
use image::codecs::jpeg::JpegEncoder;
use rayon::prelude::*;
use serde_json::{Value, json};
use terrane::formats::writers::{write_glb, write_height_exr};

use crate::args::{JOBS, MAX_LEVELS, SIZES_M};
use crate::color::{Painter, TEXELS};
use crate::grid::{Extent, Grid, QUANTUM_M};
use crate::imagery::Imagery;
use crate::mosaic::Mosaic;
use crate::output::Partial;
use crate::placement::ROUNDING;
use crate::pyramid::{CELLS, Pyramid, TileKey};
use crate::{ContentKind, ElevationSource, GenArgs, GenError, Procedural, Progress, Raster, Summary, mesh};

const JPEG_QUALITY: u8 = 85;
/// Place of procedural terrain, degrees.
const PROCEDURAL_PLACE: [f64; 2] = [8.0, 47.0];
/// Levels of procedural terrain where none are asked for.
const PROCEDURAL_LEVELS: u32 = 5;
/// The default set's folder changes with what it holds.
const DEFAULT_SET: &str = "default-set-2";

/// Makes the small set that `terrane fly` shows by default, once; returns its folder.
pub fn default_set(folder: &Path) -> Result<PathBuf, GenError> {
    let out = folder.join(DEFAULT_SET);
    if !out.join("tileset.json").is_file() {
        let args = GenArgs { overwrite: true, levels: Some(5), size: 40_000.0, ..GenArgs::new(&out) };
        run(&args)?;
    }
    Ok(out)
}

/// Makes a tile set. Files are written beside OUT first and moved there when all are complete.
pub fn run(args: &GenArgs) -> Result<Summary, GenError> {
    let start = Instant::now();
    let out = std::path::absolute(&args.out).map_err(GenError::file(&args.out))?;
    let occupied = match std::fs::read_dir(&out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => false,
        Err(e) => return Err(GenError::File { path: out, reason: e }),
    };
    if out.is_symlink() && !out.exists() {
        return Err(GenError::invalid(out, "a link to what is not there"));
    }
    if occupied && !args.overwrite {
        return Err(GenError::Exists(out));
    }
    let out = if out.exists() { out.canonicalize().map_err(GenError::file(&out))? } else { out };
    if occupied {
        may_be_replaced(&out, args)?;
    }
    // Checked here as well as by the command line, because programs call this function too.
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
    // 0: as many as there are cores.
    let threads = args.jobs.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| GenError::Argument(format!("--jobs {threads}: {e}")))?;
    let partial = Partial::beside(&out)?;
    let mut summary = pool.install(|| write_set(args, partial.path()))?;
    partial.put_in_place(&out)?;
    summary.out = out;
    summary.seconds = start.elapsed().as_secs_f64();
    Ok(summary)
}

/// Whether a folder with something in it is a tile set that none of the sources lies in.
fn may_be_replaced(out: &Path, args: &GenArgs) -> Result<(), GenError> {
    if !out.join("tileset.json").is_file() {
        let reason = format!("{} holds no tile set, which is all that --overwrite replaces", out.display());
        return Err(GenError::Argument(reason));
    }
    let is_inside = |path: &&PathBuf| path.canonicalize().is_ok_and(|path| path.starts_with(out));
    match args.dem.iter().chain(&args.imagery).find(is_inside) {
        Some(path) => Err(GenError::Argument(format!("--overwrite would remove {}", path.display()))),
        None => Ok(()),
    }
}

/// What is sampled, where, and how finely.
fn source(args: &GenArgs) -> Result<(Box<dyn ElevationSource>, Extent, u32), GenError> {
    if args.dem.is_empty() {
        let [lon, lat] = PROCEDURAL_PLACE.map(f64::to_radians);
        let half = 0.5 * args.size / 6_371_000.0;
        let half_lon = half / lat.cos();
        let extent = Extent { west: lon - half_lon, south: lat - half, east: lon + half_lon, north: lat + half };
        let source = Procedural { seed: args.seed, cos_latitude: lat.cos() };
        return Ok((Box::new(source), extent, args.levels.unwrap_or(PROCEDURAL_LEVELS)));
    }
    let rasters = args.dem.iter().map(|path| Raster::read_in(path, args.epsg)).collect::<Result<Vec<_>, _>>()?;
    let rasters = on_from_the_date_line(rasters);
    let mut e = Extent { west: f64::MAX, south: f64::MAX, east: f64::MIN, north: f64::MIN };
    // Smallest step between samples, east and north, radians.
    let mut step = [f64::INFINITY; 2];
    for r in &rasters {
        let [west, south, east, north] = r.bounds();
        e = Extent {
            west: e.west.min(west),
            south: e.south.min(south),
            east: e.east.max(east),
            north: e.north.max(north),
        };
        let [w, h] = r.size();
        let own = [(east - west) / (w.max(2) - 1) as f64, (north - south) / (h.max(2) - 1) as f64];
        step = [step[0].min(own[0]), step[1].min(own[1])];
    }
    const NOWHERE: &str = "the elevation lies nowhere on the earth";
    let is_there = e.south >= -0.5 * PI - ROUNDING && e.north <= 0.5 * PI + ROUNDING && e.west >= -PI - ROUNDING;
    let (wide, high) = (e.east - e.west, e.north - e.south);
    let problem = match e.east {
        _ if !(is_there && wide >= 1e-9 && high >= 1e-9) => Some(NOWHERE),
        east if east <= PI + ROUNDING || (e.west < PI && wide < PI) => None,
        _ if e.west < PI => Some("the elevation reaches across the date line and half around the earth"),
        _ => Some(NOWHERE),
    };
    if let Some(problem) = problem {
        return Err(GenError::invalid(args.dem.first().cloned().unwrap_or_default(), problem));
    }
    // Less what rounding adds, so that 513 samples are 512 cells.
    let cells = ((e.east - e.west) / step[0]).max((e.north - e.south) / step[1]) - 1e-6;
    let wanted = ((cells / CELLS as f64).log2().ceil().max(0.0) as u32 + 1).clamp(1, MAX_LEVELS);
    Ok((Box::new(Mosaic::new(rasters)), e, args.levels.unwrap_or(wanted)))
}

/// Where files lie on both sides of the date line, or one across it, and not all around the earth the other way: the
/// western longitudes go on from 180 degrees, so that all are one piece.
fn on_from_the_date_line(mut rasters: Vec<Raster>) -> Vec<Raster> {
    let mut longitudes: Vec<[f64; 2]> = rasters.iter().map(Raster::bounds).map(|[w, _, e, _]| [w, e]).collect();
    let is_across = |[west, east]: &[f64; 2]| *west < -PI - ROUNDING || *east > PI + ROUNDING;
    if longitudes.iter().any(is_across) || widest_gap(&mut longitudes) > PI {
        rasters.iter_mut().filter(|r| r.bounds()[0] < 0.0).for_each(Raster::turn_east);
    }
    rasters
}

/// The widest stretch between intervals of longitude where none is.
fn widest_gap(intervals: &mut [[f64; 2]]) -> f64 {
    intervals.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let (mut gap, mut end) = (0.0f64, f64::INFINITY);
    for [west, east] in intervals {
        gap = gap.max(*west - end);
        end = if end.is_finite() { end.max(*east) } else { *east };
    }
    gap
}

fn write_set(args: &GenArgs, folder: &Path) -> Result<Summary, GenError> {
    let (source, extent, levels) = source(args)?;
    let imagery = args.imagery.as_deref().map(|path| Imagery::read(path, args.epsg)).transpose()?;
    if let (Some(picture), Some(path)) = (&imagery, &args.imagery)
        && !picture.covers(&extent)
    {
        return Err(GenError::invalid(path, "covers none of the elevation"));
    }
    let side = (CELLS << (levels - 1)) + 1;
    let sampling = Progress::new("sampling the elevation", side as u64, "rows");
    let grid = Grid::sample_rows(source.as_ref(), extent, side, &|| sampling.advance(1));
    drop(sampling);
    let filled_samples = grid.filled;
    let pyramid = Pyramid::new(grid, levels);
    let painter = Painter::new(&pyramid, imagery.as_ref());
    let keys: Vec<TileKey> = pyramid.keys().collect();
    for level in 0..levels {
        for x in 0..1u32 << level {
            let path = folder.join(level.to_string()).join(x.to_string());
            std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
        }
    }
    let progress = Progress::new("writing", keys.len() as u64, "tiles");
    let bytes = AtomicU64::new(0);
    let level_errors_m = pyramid.level_errors_m();
    keys.par_iter().try_for_each(|&key| {
        let written = write_tile(args, &pyramid, &painter, &level_errors_m, folder, key)?;
        bytes.fetch_add(written, Ordering::Relaxed);
        progress.advance(1);
        Ok::<_, GenError>(())
    })?;
    drop(progress);
    let root = TileKey { level: 0, x: 0, y: 0 };
    let facts = pyramid.facts(root);
    let diagonal_m = 2.0 * (facts.error_m + f64::from(facts.max_height_m - facts.min_height_m)) + 1.0;
    let mut asset = json!({ "version": "1.1", "generator": "terrane" });
    if args.content == ContentKind::Height {
        asset["extras"] = json!({ "terrane": {
            "format": 1, "content": "height", "layout": "wgs84", "side": CELLS + 1, "border": 1,
            "quantum_m": QUANTUM_M, "level_errors_m": level_errors_m,
        } });
    }
    let tree = tile_json(args, &pyramid, &level_errors_m, root, DAffine3::IDENTITY);
    let mut tileset = json!({ "asset": asset, "geometricError": diagonal_m.max(2.0 * facts.error_m), "root": tree });
    tileset["root"]["refine"] = "REPLACE".into();
    let text = tileset.to_string();
    let path = folder.join("tileset.json");
    std::fs::write(&path, &text).map_err(GenError::file(&path))?;
    Ok(Summary {
        out: folder.to_path_buf(),
        tiles: keys.len() as u64,
        levels,
        bytes: bytes.into_inner() + text.len() as u64,
        min_height_m: facts.min_height_m.into(),
        max_height_m: facts.max_height_m.into(),
        filled_samples,
        level_errors_m,
        seconds: 0.0,
    })
}

/// How far the skirt of a tile reaches down: over the step to a neighbour one level coarser.
fn skirt_m(level_errors_m: &[f64], key: TileKey) -> f64 {
    let coarser = level_errors_m[key.level.saturating_sub(1) as usize];
    2.0 * coarser + 1.0
}

fn write_tile(
    args: &GenArgs,
    pyramid: &Pyramid,
    painter: &Painter<'_>,
    level_errors_m: &[f64],
    folder: &Path,
    key: TileKey,
) -> Result<u64, GenError> {
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY)
        .encode(&painter.paint(key), TEXELS, TEXELS, image::ExtendedColorType::Rgb8)
        .map_err(|e| GenError::Encode(format!("JPEG of tile {key:?}: {e}")))?;
    let stem = folder.join(format!("{}/{}/{}", key.level, key.x, key.y));
    let write = |extension: &str, bytes: &[u8]| -> Result<u64, GenError> {
        let path = stem.with_extension(extension);
        std::fs::write(&path, bytes).map_err(GenError::file(&path))?;
        Ok(bytes.len() as u64)
    };
    match args.content {
        ContentKind::Height => {
            let last = CELLS as i64 + 1;
            let mut heights = Vec::with_capacity((CELLS + 3) * (CELLS + 3));
            for j in (-1..=last).rev() {
                heights.extend((-1..=last).map(|i| pyramid.height_m(key, i, j)));
            }
            let uri = format!("{}/{}/{}.exr", key.level, key.x, key.y);
            let exr = write_height_exr(&uri, CELLS + 3, heights).map_err(|e| GenError::Encode(e.to_string()))?;
            Ok(write("exr", &exr)? + write("jpg", &jpeg)?)
        }
        ContentKind::Mesh => {
            let glb = write_glb(&mesh::build(pyramid, key, skirt_m(level_errors_m, key), jpeg, !args.float_vertices));
            write("glb", &glb)
        }
    }
}

fn tile_json(
    args: &GenArgs,
    pyramid: &Pyramid,
    level_errors_m: &[f64],
    key: TileKey,
    ecef_from_parent: DAffine3,
) -> Value {
    let e = pyramid.extent(key);
    let f = pyramid.facts(key);
    // The height of the chord's middle below the arc: meshes cut through the ellipsoid between their vertices.
    let cell = (e.east - e.west).max(e.north - e.south) / CELLS as f64;
    let sagitta_m = 6_378_137.0 * cell * cell / 4.0;
    let low_m = f64::from(f.min_height_m) - skirt_m(level_errors_m, key) - sagitta_m;
    let high_m = f64::from(f.max_height_m);
    // Half a step of quantized vertices besides.
    let slack_m = 0.1 + (6_378_137.0 * cell * CELLS as f64 + high_m - low_m) / 131_070.0;
    // Of what lies across the date line, 3D Tiles has the west east of the east.
    let [west, east] = [e.west, e.east].map(|l| if l > PI + ROUNDING { l - TAU } else { l });
    let region = [west, e.south, east, e.north, low_m - slack_m, high_m + slack_m];
    let name = format!("{}/{}/{}", key.level, key.x, key.y);
    let leaf = key.level + 1 == pyramid.levels;
    let mut tile = json!({
        "boundingVolume": { "region": region },
        "geometricError": if leaf { 0.0 } else { f.error_m },
    });
    let mut ecef_from_tile = ecef_from_parent;
    match args.content {
        ContentKind::Height => {
            tile["content"] = json!({ "uri": format!("{name}.exr") });
            tile["extras"] = json!({ "terrane": { "imagery": format!("{name}.jpg") } });
        }
        ContentKind::Mesh => {
            tile["content"] = json!({ "uri": format!("{name}.glb") });
            ecef_from_tile = mesh::ecef_from_tile(pyramid, key);
            let parent_from_tile = ecef_from_parent.inverse() * ecef_from_tile;
            tile["transform"] = json!(DMat4::from(parent_from_tile).to_cols_array());
        }
    }
    if !leaf {
        let children: Vec<Value> = [(0, 0), (1, 0), (0, 1), (1, 1)]
            .into_iter()
            .map(|(dx, dy)| {
                let child = TileKey { level: key.level + 1, x: 2 * key.x + dx, y: 2 * key.y + dy };
                tile_json(args, pyramid, level_errors_m, child, ecef_from_tile)
            })
            .collect();
        tile["children"] = children.into();
    }
    tile
}
