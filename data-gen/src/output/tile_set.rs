//! Writes the files of a block's tiles.

use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use rayon::prelude::*;
use terrane::formats::writers::{write_glb, write_height_exr};

use super::mesh;
use crate::args::{Color, ContentKind, GenArgs};
use crate::color::{Painter, TEXELS};
use crate::pyramid::{Block, CELLS, Coverage, TileKey};
use crate::{GenError, Progress};

const JPEG_QUALITY: u8 = 85;

/// Writes the tiles of a block into a folder, on the threads of the current rayon pool, and returns their size in bytes. Tiles
/// whose files are there are not made again: a file has its name only when it is complete. Without a painter tiles have no colour.
pub(crate) fn write_tiles(
    args: &GenArgs,
    block: &Block<'_>,
    painter: Option<&Painter<'_>>,
    folder: &Path,
    progress: &Progress,
) -> Result<u64, GenError> {
    let keys: Vec<TileKey> = block.keys().collect();
    let mut columns: Vec<(u32, u32)> = keys.iter().map(|key| (key.level, key.x)).collect();
    columns.sort_unstable();
    columns.dedup();
    for (level, x) in columns {
        let path = folder.join(level.to_string()).join(x.to_string());
        std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
    }
    let written: Result<Vec<u64>, GenError> = keys
        .par_iter()
        .map(|&key| {
            let bytes = write_tile(args, block, painter, folder, key)?;
            progress.advance(1);
            Ok(bytes)
        })
        .collect();
    Ok(written?.iter().sum())
}

/// Returns the depth of a tile's skirt in metres. It covers the step to a neighbour two levels coarser, and to any finer one.
pub(super) fn skirt_m(block: &Block<'_>, key: TileKey) -> f64 {
    1.0 + block.facts(key).error_m + 2.0 * block.edge_step_m(key)
}

/// Writes the files of one tile and returns their size in bytes.
fn write_tile(
    args: &GenArgs,
    block: &Block<'_>,
    painter: Option<&Painter<'_>>,
    folder: &Path,
    key: TileKey,
) -> Result<u64, GenError> {
    let stem = folder.join(format!("{}/{}/{}", key.level, key.x, key.y));
    let form = form(args, block, key);
    let extensions = match form {
        ContentKind::Height if args.color != Color::None => &["jpg", "exr"][..],
        ContentKind::Height => &["exr"],
        ContentKind::Mesh => &["glb"],
    };
    let sizes = extensions.iter().map(|extension| Some(stem.with_extension(extension).metadata().ok()?.len()));
    if let Some(bytes) = sizes.sum() {
        return Ok(bytes);
    }
    let encode = |painter: &Painter<'_>| {
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY)
            .encode(&painter.paint(key), TEXELS, TEXELS, image::ExtendedColorType::Rgb8)
            .map_err(|e| GenError::Encode(format!("JPEG of tile {key:?}: {e}")))?;
        Ok(jpeg)
    };
    let jpeg = painter.map(encode).transpose()?;
    let write = |extension: &str, bytes: &[u8]| write_whole(&stem.with_extension(extension), bytes);
    match form {
        ContentKind::Height => {
            let last = CELLS as i64 + 1;
            let mut heights = Vec::with_capacity((CELLS + 3) * (CELLS + 3));
            for j in (-1..=last).rev() {
                heights.extend((-1..=last).map(|i| block.height_m(key, i, j)));
            }
            let uri = format!("{}/{}/{}.exr", key.level, key.x, key.y);
            let exr = write_height_exr(&uri, CELLS + 3, heights).map_err(|e| GenError::Encode(e.to_string()))?;
            let image_bytes = jpeg.map_or(Ok(0), |jpeg| write("jpg", &jpeg))?;
            Ok(write("exr", &exr)? + image_bytes)
        }
        ContentKind::Mesh => {
            let glb = write_glb(&mesh::build(block, key, skirt_m(block, key), jpeg, !args.float_vertices));
            write("glb", &glb)
        }
    }
}

/// Writes a file under another name and renames it, so that a killed run leaves no part of a file under its name. Returns the
/// number of bytes.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<u64, GenError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let unfinished = path.with_file_name(format!(".{name}.unfinished"));
    std::fs::write(&unfinished, bytes).map_err(GenError::file(path))?;
    std::fs::rename(&unfinished, path).map_err(GenError::file(path))?;
    Ok(bytes.len() as u64)
}

/// Returns the form of a tile's content. Heights cannot leave out a part of a tile, so that tiles on the border of the data
/// are meshes.
pub(super) fn form(args: &GenArgs, block: &Block<'_>, key: TileKey) -> ContentKind {
    match block.facts(key).coverage {
        Coverage::Part => ContentKind::Mesh,
        Coverage::Whole | Coverage::None => args.content,
    }
}
