//! Writes the tiles of a pyramid and `tileset.json`.

use std::f64::consts::{PI, TAU};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DAffine3, DMat4};
use image::codecs::jpeg::JpegEncoder;
use rayon::prelude::*;
use serde_json::{Value, json};
use terrane::formats::writers::{write_glb, write_height_exr};

use super::mesh;
use crate::args::{ContentKind, GenArgs, Summary};
use crate::color::{Painter, TEXELS};
use crate::georeference::ROUNDING;
use crate::pyramid::{CELLS, Pyramid, QUANTUM_M, TileKey};
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
        let written = write_tile(args, pyramid, painter, &level_errors_m, folder, key)?;
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
    let tree = tile_json(args, pyramid, &level_errors_m, root, DAffine3::IDENTITY);
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
        filled_samples: pyramid.grid.filled,
        level_errors_m,
        seconds: 0.0,
    })
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

/// Returns the tile and its descendants as 3D Tiles JSON.
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
    // Quantized vertices are off by at most half a step, which is added to the volume.
    let slack_m = 0.1 + (6_378_137.0 * cell * CELLS as f64 + high_m - low_m) / 131_070.0;
    // A region across the date line has its west edge east of its east edge in 3D Tiles.
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
