//! Writes the tiles of a pyramid and `tileset.json`.

use std::collections::{BTreeSet, HashMap};
use std::f64::consts::{PI, TAU};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DAffine3, DMat4};
use rayon::prelude::*;
use serde_json::{Value, json};
use terrane::formats::writers::{write_compressed_glb, write_glb, write_height_exr};

use super::encoding::Triangles;
use super::{mesh, tin};
use crate::args::{Color, ContentKind, GenArgs, Summary, Voids};
use crate::color::{Painter, TEXELS};
use crate::georeference::ROUNDING;
use crate::pyramid::{CELLS, Coverage, Pyramid, QUANTUM_M, TileKey};
use crate::{GenError, Progress};

/// Writes all tiles of a pyramid and the tileset into a folder, on the threads of the current rayon pool. The caller
/// fills in the duration and the final folder of the summary.
pub(crate) fn write_tiles(
    args: &GenArgs,
    pyramid: &Pyramid,
    painter: &Painter<'_>,
    folder: &Path,
) -> Result<Summary, GenError> {
    let levels = pyramid.levels;
    let keys: Vec<TileKey> = pyramid.keys().collect();
    let columns: BTreeSet<(u32, u32)> = keys.iter().map(|key| (key.level, key.x)).collect();
    for (level, x) in columns {
        let path = folder.join(level.to_string()).join(x.to_string());
        std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
    }
    let progress = Progress::new("writing", keys.len() as u64, "tiles");
    let bytes = AtomicU64::new(0);
    let level_errors_m = pyramid.level_errors_m();
    let written = keys.par_iter().map(|&key| {
        let Written { bytes: of_tile, distance_m } = write_tile(args, pyramid, painter, &level_errors_m, folder, key)?;
        bytes.fetch_add(of_tile, Ordering::Relaxed);
        progress.advance(1);
        Ok((key, distance_m))
    });
    let distances_m = written.collect::<Result<HashMap<TileKey, f64>, GenError>>()?;
    drop(progress);
    let root = TileKey { level: 0, x: 0, y: 0 };
    let facts = pyramid.facts(root);
    let diagonal_m = 2.0 * (facts.error_m + f64::from(facts.max_height_m - facts.min_height_m)) + 1.0;
    let [min_height_m, max_height_m] = pyramid.grid.range_m().map(f64::from);
    let (cut_samples, filled_samples) = match args.voids {
        Voids::Cut => (pyramid.grid.voids, 0),
        Voids::Fill | Voids::Sea => (0, pyramid.grid.voids),
    };
    let mut asset = json!({ "version": "1.1", "generator": "terrane" });
    if args.content == ContentKind::Height {
        asset["extras"] = json!({ "terrane": {
            "format": 1, "content": "height", "layout": "wgs84", "side": CELLS + 1, "border": 1,
            "quantum_m": QUANTUM_M, "level_errors_m": level_errors_m,
        } });
    }
    // `terrane info` prints it.
    let properties = json!({
        "minimumHeight": min_height_m, "maximumHeight": max_height_m, "finestError": level_errors_m.last(),
        "samplesLeftOut": cut_samples, "samplesFilled": filled_samples,
        "sourceVerticalDatum": args.vertical_datum.to_string(),
    });
    let tree = tile_json(args, pyramid, &level_errors_m, &distances_m, root, DAffine3::IDENTITY);
    let root_error_m = tree["geometricError"].as_f64().unwrap_or(facts.error_m);
    let mut tileset = json!({ "asset": asset, "geometricError": diagonal_m.max(2.0 * root_error_m), "root": tree });
    (tileset["schema"], tileset["metadata"]) = (schema(), json!({ "class": "terrain", "properties": properties }));
    tileset["root"]["refine"] = "REPLACE".into();
    let text = tileset.to_string();
    let path = folder.join("tileset.json");
    std::fs::write(&path, &text).map_err(GenError::file(&path))?;
    Ok(Summary {
        out: folder.to_path_buf(),
        tiles: keys.len() as u64,
        levels,
        bytes: bytes.into_inner() + text.len() as u64,
        min_height_m,
        max_height_m,
        filled_samples,
        cut_samples,
        notes: Vec::new(),
        level_errors_m,
        seconds: 0.0,
    })
}

/// Returns the schema of the set's metadata.
fn schema() -> Value {
    let number =
        |kind: &str, description: &str| json!({ "type": "SCALAR", "componentType": kind, "description": description });
    json!({ "id": "terrane", "classes": { "terrain": { "properties": {
        "minimumHeight": number("FLOAT64", "Lowest sample in metres above the ellipsoid"),
        "maximumHeight": number("FLOAT64", "Highest sample in metres above the ellipsoid"),
        "finestError": number("FLOAT64", "Largest difference of the finest level and the source in metres"),
        "samplesLeftOut": number("UINT64", "Samples of the finest level without data that were left out"),
        "samplesFilled": number("UINT64", "Samples of the finest level without data that were given heights"),
        "sourceVerticalDatum": { "type": "STRING", "description": "Surface that the source's heights are measured from" },
    } } } })
}

/// Returns the depth of a tile's skirt in metres. It covers the step to a neighbour one level coarser. Triangulated edges of that
/// neighbour deviate by at most a share of the error of the level above it, and those of the tile by less.
fn skirt_m(args: &GenArgs, level_errors_m: &[f64], key: TileKey) -> f64 {
    let above = |levels: u32| level_errors_m[key.level.saturating_sub(levels) as usize];
    let triangulation_m = match args.tiles.triangles {
        Triangles::Tin => 2.0 * tin::ALLOWED_SHARE * above(2),
        Triangles::Grid => 0.0,
    };
    2.0 * above(1) + triangulation_m + 1.0
}

/// The files of a tile that were written.
struct Written {
    /// The size of its files.
    bytes: u64,
    /// The largest distance of its triangles from those of the grid, in metres.
    distance_m: f64,
}

/// Writes the files of one tile.
fn write_tile(
    args: &GenArgs,
    pyramid: &Pyramid,
    painter: &Painter<'_>,
    level_errors_m: &[f64],
    folder: &Path,
    key: TileKey,
) -> Result<Written, GenError> {
    let format = args.tiles.texture;
    let encode = || {
        let encoded = format.encode(&painter.paint(key), TEXELS);
        encoded.map_err(|e| GenError::Encode(format!("texture of tile {key:?}: {e}")))
    };
    let image = (args.color != Color::None).then(encode).transpose()?;
    let stem = folder.join(format!("{}/{}/{}", key.level, key.x, key.y));
    let write = |extension: &str, bytes: &[u8]| -> Result<u64, GenError> {
        let path = stem.with_extension(extension);
        std::fs::write(&path, bytes).map_err(GenError::file(&path))?;
        Ok(bytes.len() as u64)
    };
    match form(args, pyramid, key) {
        ContentKind::Height => {
            let last = CELLS as i64 + 1;
            let mut heights = Vec::with_capacity((CELLS + 3) * (CELLS + 3));
            for j in (-1..=last).rev() {
                heights.extend((-1..=last).map(|i| pyramid.height_m(key, i, j)));
            }
            let uri = format!("{}/{}/{}.exr", key.level, key.x, key.y);
            let exr = write_height_exr(&uri, CELLS + 3, heights).map_err(|e| GenError::Encode(e.to_string()))?;
            let image_bytes = image.map_or(Ok(0), |image| write(format.extension(), &image))?;
            Ok(Written { bytes: write("exr", &exr)? + image_bytes, distance_m: 0.0 })
        }
        ContentKind::Mesh => {
            let tin = mesh::triangles(pyramid, key, triangles(args));
            let skirt_m = skirt_m(args, level_errors_m, key);
            let mesh = mesh::build(pyramid, key, &tin, skirt_m, image, !args.float_vertices);
            let is_compressed = !args.float_vertices && !args.tiles.no_meshopt;
            let glb = if is_compressed { write_compressed_glb(&mesh) } else { write_glb(&mesh) };
            Ok(Written { bytes: write("glb", &glb)?, distance_m: tin.distance_m })
        }
    }
}

/// Returns the triangles of meshes. Beside height tiles they have all vertices of a common edge.
fn triangles(args: &GenArgs) -> Triangles {
    match args.content {
        ContentKind::Mesh => args.tiles.triangles,
        ContentKind::Height => Triangles::Grid,
    }
}

/// Returns the form of a tile's content. Heights cannot leave out a part of a tile, so that tiles on the border of the data
/// are meshes.
fn form(args: &GenArgs, pyramid: &Pyramid, key: TileKey) -> ContentKind {
    match pyramid.facts(key).coverage {
        Coverage::Part => ContentKind::Mesh,
        Coverage::Whole | Coverage::None => args.content,
    }
}

/// Returns the tile and its descendants with data as 3D Tiles JSON. `ecef_from_parent` is the parent's frame.
fn tile_json(
    args: &GenArgs,
    pyramid: &Pyramid,
    level_errors_m: &[f64],
    distances_m: &HashMap<TileKey, f64>,
    key: TileKey,
    ecef_from_parent: DAffine3,
) -> Value {
    let e = pyramid.extent(key);
    let f = pyramid.facts(key);
    // Meshes lie below the ellipsoid between their vertices, by the height of the arc above its chord.
    let cell = (e.east - e.west).max(e.north - e.south) / CELLS as f64;
    let sagitta_m = 6_378_137.0 * cell * cell / 4.0;
    let distance_m = distances_m.get(&key).copied().unwrap_or(0.0);
    let low_m = f64::from(f.min_height_m) - skirt_m(args, level_errors_m, key) - sagitta_m - distance_m;
    let high_m = f64::from(f.max_height_m);
    // Quantized vertices are off by at most half a step, which is added to the volume and to the error.
    let half_step_m = (6_378_137.0 * cell * CELLS as f64 + high_m - low_m) / 131_070.0;
    let slack_m = 0.1 + half_step_m;
    let is_quantized = form(args, pyramid, key) == ContentKind::Mesh && !args.float_vertices;
    // A region across the date line has its west edge east of its east edge in 3D Tiles.
    let [west, east] = [e.west, e.east].map(|l| if l > PI + ROUNDING { l - TAU } else { l });
    let region = [west, e.south, east, e.north, low_m - slack_m, high_m + slack_m];
    let name = format!("{}/{}/{}", key.level, key.x, key.y);
    let leaf = key.level + 1 == pyramid.levels;
    let mut error_m = f.error_m + distance_m + if is_quantized { half_step_m } else { 0.0 };
    let mut tile = json!({ "boundingVolume": { "region": region } });
    let mut ecef_from_tile = DAffine3::IDENTITY;
    match form(args, pyramid, key) {
        ContentKind::Height => {
            tile["content"] = json!({ "uri": format!("{name}.exr") });
            if args.color != Color::None {
                tile["extras"] =
                    json!({ "terrane": { "imagery": format!("{name}.{}", args.tiles.texture.extension()) } });
            }
        }
        ContentKind::Mesh => {
            tile["content"] = json!({ "uri": format!("{name}.glb") });
            ecef_from_tile = mesh::ecef_from_tile(pyramid, key);
        }
    }
    // Height tiles are placed by their region: their frame is the earth's, also below meshes.
    if ecef_from_tile != ecef_from_parent {
        let parent_from_tile = ecef_from_parent.inverse() * ecef_from_tile;
        tile["transform"] = json!(DMat4::from(parent_from_tile).to_cols_array());
    }
    if !leaf {
        let children: Vec<Value> = [(0, 0), (1, 0), (0, 1), (1, 1)]
            .into_iter()
            .map(|(dx, dy)| TileKey { level: key.level + 1, x: 2 * key.x + dx, y: 2 * key.y + dy })
            .filter(|child| pyramid.facts(*child).coverage != Coverage::None)
            .map(|child| tile_json(args, pyramid, level_errors_m, distances_m, child, ecef_from_tile))
            .collect();
        error_m = children.iter().filter_map(|child| child["geometricError"].as_f64()).fold(error_m, f64::max);
        tile["children"] = children.into();
    }
    tile["geometricError"] = error_m.into();
    tile
}
