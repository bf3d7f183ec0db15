//! Writes the tiles of a pyramid and `tileset.json`.

use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DAffine3, DMat4};
use image::codecs::jpeg::JpegEncoder;
use rayon::prelude::*;
use serde_json::{Value, json};
use terrane::formats::writers::{write_glb, write_height_exr};

use super::mesh;
use crate::args::{Color, ContentKind, GenArgs, Summary, Voids};
use crate::color::{Painter, TEXELS};
use crate::georeference::ROUNDING;
use crate::pyramid::{CELLS, Coverage, Pyramid, QUANTUM_M, TileKey};
use crate::{GenError, Progress};

const JPEG_QUALITY: u8 = 85;

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
    keys.par_iter().try_for_each(|&key| {
        let written = write_tile(args, pyramid, painter, &level_errors_m, folder, key)?;
        bytes.fetch_add(written, Ordering::Relaxed);
        progress.advance(1);
        Ok::<_, GenError>(())
    })?;
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
    let tree = tile_json(args, pyramid, &level_errors_m, root, DAffine3::IDENTITY);
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

/// Returns the depth of a tile's skirt in metres. It covers the step to a neighbour one level coarser.
fn skirt_m(level_errors_m: &[f64], key: TileKey) -> f64 {
    let coarser = level_errors_m[key.level.saturating_sub(1) as usize];
    2.0 * coarser + 1.0
}

/// Writes the files of one tile and returns their size in bytes.
fn write_tile(
    args: &GenArgs,
    pyramid: &Pyramid,
    painter: &Painter<'_>,
    level_errors_m: &[f64],
    folder: &Path,
    key: TileKey,
) -> Result<u64, GenError> {
    let encode = || {
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY)
            .encode(&painter.paint(key)?, TEXELS, TEXELS, image::ExtendedColorType::Rgb8)
            .map_err(|e| GenError::Encode(format!("JPEG of tile {key:?}: {e}")))?;
        Ok(jpeg)
    };
    let jpeg = (args.color != Color::None).then(encode).transpose()?;
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
            let image_bytes = jpeg.map_or(Ok(0), |jpeg| write("jpg", &jpeg))?;
            Ok(write("exr", &exr)? + image_bytes)
        }
        ContentKind::Mesh => {
            let glb = write_glb(&mesh::build(pyramid, key, skirt_m(level_errors_m, key), jpeg, !args.float_vertices));
            write("glb", &glb)
        }
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
    key: TileKey,
    ecef_from_parent: DAffine3,
) -> Value {
    let e = pyramid.extent(key);
    let f = pyramid.facts(key);
    // Meshes lie below the ellipsoid between their vertices, by the height of the arc above its chord.
    let cell = (e.east - e.west).max(e.north - e.south) / CELLS as f64;
    let sagitta_m = 6_378_137.0 * cell * cell / 4.0;
    let low_m = f64::from(f.min_height_m) - skirt_m(level_errors_m, key) - sagitta_m;
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
    let mut tile = json!({
        "boundingVolume": { "region": region },
        "geometricError": f.error_m + if is_quantized { half_step_m } else { 0.0 },
    });
    let mut ecef_from_tile = DAffine3::IDENTITY;
    match form(args, pyramid, key) {
        ContentKind::Height => {
            tile["content"] = json!({ "uri": format!("{name}.exr") });
            if args.color != Color::None {
                tile["extras"] = json!({ "terrane": { "imagery": format!("{name}.jpg") } });
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
            .map(|child| tile_json(args, pyramid, level_errors_m, child, ecef_from_tile))
            .collect();
        tile["children"] = children.into();
    }
    tile
}
