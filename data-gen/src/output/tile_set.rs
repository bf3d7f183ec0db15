//! Writes the files of a block's tiles.

use std::collections::HashMap;
use std::path::Path;

use rayon::prelude::*;
use terrane::formats::writers::{write_compressed_glb, write_glb, write_height_exr};

use super::encoding::Triangles;
use super::mesh;
use super::options::Tiling;
use crate::args::{Color, ContentKind, GenArgs};
use crate::color::{Painter, TEXELS};
use crate::pyramid::{Block, CELLS, Coverage, TileKey};
use crate::{GenError, Progress};

/// The files of a block's tiles that were written.
pub(super) struct Written {
    /// The size of all files in bytes.
    pub bytes: u64,
    /// The largest distance of a mesh's triangles from those of the whole grid, in metres, for tiles that have fewer.
    pub distances_m: HashMap<TileKey, f64>,
}

/// Writes the tiles of a block into a folder, on the threads of the current rayon pool, and returns what it wrote. Tiles
/// whose files are there are not made again: a file has its name only when it is complete. Without a painter tiles have no colour.
pub(crate) fn write_tiles(
    args: &GenArgs,
    block: &Block<'_>,
    painter: Option<&Painter<'_>>,
    folder: &Path,
    progress: &Progress,
) -> Result<Written, GenError> {
    let keys: Vec<TileKey> = block.keys().collect();
    let mut columns: Vec<(u32, u32)> = keys.iter().map(|key| (key.level, key.x)).collect();
    columns.sort_unstable();
    columns.dedup();
    for (level, x) in columns {
        let path = folder.join(level.to_string()).join(x.to_string());
        std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
    }
    let written = keys.par_iter().map(|&key| {
        let of_tile = write_tile(args, block, painter, folder, key)?;
        progress.advance(1);
        Ok::<_, GenError>((key, of_tile))
    });
    let tiles: Vec<(TileKey, TileFiles)> = written.collect::<Result<_, _>>()?;
    let bytes = tiles.iter().map(|(_, files)| files.bytes).sum();
    let distances_m =
        tiles.iter().filter(|(_, files)| files.distance_m > 0.0).map(|(key, files)| (*key, files.distance_m));
    Ok(Written { bytes, distances_m: distances_m.collect() })
}

/// Returns the depth of a tile's skirt in metres. It covers the step to a neighbour two levels coarser, and to any finer one.
/// The edges of triangulations deviate from those of grids by a share of the same steps.
pub(super) fn skirt_m(args: &GenArgs, block: &Block<'_>, key: TileKey) -> f64 {
    let steps = if triangles(args) == Triangles::Tin { 3.0 } else { 2.0 };
    1.0 + block.facts(key).error_m + steps * block.edge_step_m(key)
}

/// The files of a tile.
struct TileFiles {
    /// Their size.
    bytes: u64,
    /// The largest distance of its triangles from those of the grid, in metres.
    distance_m: f64,
}

/// Writes the files of one tile, unless they are there.
fn write_tile(
    args: &GenArgs,
    block: &Block<'_>,
    painter: Option<&Painter<'_>>,
    folder: &Path,
    key: TileKey,
) -> Result<TileFiles, GenError> {
    let stem = folder.join(format!("{}/{}/{}", key.level, key.x, key.y));
    let format = args.tiles.texture;
    let form = form(args, block, key);
    let extensions = match form {
        ContentKind::Height if args.color != Color::None => &[format.extension(), "exr"][..],
        ContentKind::Height => &["exr"],
        ContentKind::Mesh | ContentKind::QuantizedMesh => &["glb"],
    };
    let tin = (form == ContentKind::Mesh).then(|| mesh::triangles(block, key, triangles(args)));
    let distance_m = tin.as_ref().map_or(0.0, |tin| tin.distance_m);
    let sizes = extensions.iter().map(|extension| Some(stem.with_extension(extension).metadata().ok()?.len()));
    if let Some(bytes) = sizes.sum() {
        return Ok(TileFiles { bytes, distance_m });
    }
    let encode = |painter: &Painter<'_>| {
        let encoded = format.encode(&painter.paint(key)?, TEXELS);
        encoded.map_err(|e| GenError::Encode(format!("texture of tile {key:?}: {e}")))
    };
    let image = painter.map(encode).transpose()?;
    let write = |extension: &str, bytes: &[u8]| write_whole(&stem.with_extension(extension), bytes);
    let bytes = match tin {
        None => {
            let last = CELLS as i64 + 1;
            let mut heights = Vec::with_capacity((CELLS + 3) * (CELLS + 3));
            for j in (-1..=last).rev() {
                heights.extend((-1..=last).map(|i| block.height_m(key, i, j)));
            }
            let uri = format!("{}/{}/{}.exr", key.level, key.x, key.y);
            let exr = write_height_exr(&uri, CELLS + 3, heights).map_err(|e| GenError::Encode(e.to_string()))?;
            image.map_or(Ok(0), |image| write(format.extension(), &image))? + write("exr", &exr)?
        }
        Some(tin) => {
            let mut mesh = mesh::build(block, key, &tin, skirt_m(args, block, key), image, !args.float_vertices);
            // Tiles of implicit tilings have no transform.
            mesh.file_from_mesh = (args.output.tiling == Tiling::Implicit).then(|| mesh::file_from_tile(block, key));
            let is_compressed = !args.float_vertices && !args.tiles.no_meshopt;
            write("glb", &if is_compressed { write_compressed_glb(&mesh) } else { write_glb(&mesh) })?
        }
    };
    Ok(TileFiles { bytes, distance_m })
}

/// Returns the triangles of meshes. Beside height tiles they have all vertices of a common edge.
fn triangles(args: &GenArgs) -> Triangles {
    match args.content {
        ContentKind::Mesh | ContentKind::QuantizedMesh => args.tiles.triangles,
        ContentKind::Height => Triangles::Grid,
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
