//! Writes the files of a block's tiles.

use std::cell::RefCell;
use std::collections::HashMap;
use std::path::Path;

use rayon::prelude::*;
use terrane::formats::writers::{write_height_exr, write_packed_heights};

use zstd::bulk::Compressor;

use super::encoding::Triangles;
use super::mesh::{Look, MeshForm, MeshTile};
use super::packed::{BlockFile, Kind};
use super::set_files::write_whole;
use super::tin::Tin;
use crate::args::{Color, ContentKind, GenArgs};
use crate::color::{Painter, TEXELS};
use crate::pyramid::{Block, CELLS, Coverage, TileKey};
use crate::{GenError, Progress};

/// Tiles of a packed set that are in memory at a time.
const MAX_PACKED_TILES: usize = 64;

/// The files of a block's tiles that were written.
pub(super) struct Written {
    /// The size of all files in bytes.
    pub bytes: u64,
    /// The largest distance of a mesh's triangles from those of the whole grid, in metres, for tiles that have fewer.
    pub distances_m: HashMap<TileKey, f64>,
    /// The file of all tiles in a packed set. The caller completes it.
    pub packed: Option<BlockFile>,
}

/// Writes the tiles of a block into a folder, on the threads of the current rayon pool, and returns what it wrote. Tiles
/// whose files are there are not made again: a file has its name only when it is complete. Without a painter tiles have no
/// colour.
pub(crate) fn write_tiles(
    args: &GenArgs,
    block: &Block<'_>,
    painter: Option<&Painter<'_>>,
    folder: &Path,
    progress: &Progress,
) -> Result<Written, GenError> {
    let mut keys: Vec<TileKey> = block.keys().collect();
    let maker = TileMaker { args, form: MeshForm::new(args), block, painter };
    if args.output.is_packed() {
        keys.sort_by_key(|key| (key.level, key.morton()));
        return write_packed_tiles(&maker, &keys, folder, progress);
    }
    let mut columns: Vec<(u32, u32)> = keys.iter().map(|key| (key.level, key.x)).collect();
    columns.sort_unstable();
    columns.dedup();
    for (level, x) in columns {
        let path = folder.join(level.to_string()).join(x.to_string());
        std::fs::create_dir_all(&path).map_err(GenError::file(&path))?;
    }
    let written = keys.par_iter().map(|&key| {
        let (bytes, distance_m) = maker.write(folder, key)?;
        progress.advance(1);
        Ok::<_, GenError>((key, bytes, distance_m))
    });
    let tiles: Vec<(TileKey, u64, f64)> = written.collect::<Result<_, _>>()?;
    let bytes = tiles.iter().map(|(_, bytes, _)| bytes).sum();
    let distances_m = tiles.iter().filter(|(.., far_m)| *far_m > 0.0).map(|(key, _, far_m)| (*key, *far_m)).collect();
    Ok(Written { bytes, distances_m, packed: None })
}

/// Writes the tiles of a block into one file, in the order of its keys.
fn write_packed_tiles(
    maker: &TileMaker<'_>,
    keys: &[TileKey],
    folder: &Path,
    progress: &Progress,
) -> Result<Written, GenError> {
    let mut file = BlockFile::create(folder, maker.block.root)?;
    let (mut bytes, mut distances_m) = (0, HashMap::new());
    for keys in keys.chunks(MAX_PACKED_TILES) {
        let tiles: Vec<TileFiles> = keys.par_iter().map(|key| maker.make(*key)).collect::<Result<_, _>>()?;
        for (key, TileFiles { mut files, distance_m }) in keys.iter().zip(tiles) {
            // Heights come before their image, and all files of a tile in the order of their kinds.
            files.reverse();
            for (extension, content) in files {
                let no_kind = || GenError::Encode(format!("a packed set has no files of the kind {extension}"));
                file.add(*key, Kind::of_extension(extension).ok_or_else(no_kind)?, &content)?;
                bytes += content.len() as u64;
            }
            if distance_m > 0.0 {
                distances_m.insert(*key, distance_m);
            }
        }
        progress.advance(keys.len() as u64);
    }
    Ok(Written { bytes, distances_m, packed: Some(file) })
}

/// Returns the depth of a tile's skirt in metres. It covers the step to a neighbour two levels coarser, and to any finer one.
/// The edges of triangulations deviate from those of grids by a share of the same steps.
pub(super) fn skirt_m(args: &GenArgs, block: &Block<'_>, key: TileKey) -> f64 {
    let steps = if MeshForm::new(args).triangles == Triangles::Tin { 3.0 } else { 2.0 };
    1.0 + block.facts(key).error_m + steps * block.edge_step_m(key)
}

/// The files of a tile.
struct TileFiles {
    /// The extension of each file and its content. An image comes before the heights, which make a tile complete.
    files: Vec<(&'static str, Vec<u8>)>,
    /// The largest distance of the tile's triangles from those of the grid, in metres.
    distance_m: f64,
}

/// Makes the files of a block's tiles. Threads share it.
struct TileMaker<'a> {
    args: &'a GenArgs,
    /// The form of tiles that are meshes.
    form: MeshForm,
    block: &'a Block<'a>,
    painter: Option<&'a Painter<'a>>,
}

impl TileMaker<'_> {
    /// Writes the files of a tile into a folder, unless they are there. Returns their bytes and [`TileFiles::distance_m`].
    fn write(&self, folder: &Path, key: TileKey) -> Result<(u64, f64), GenError> {
        let stem = folder.join(format!("{}/{}/{}", key.level, key.x, key.y));
        let image = self.args.tiles.texture.extension();
        let extensions = match form(self.args, self.block, key) {
            ContentKind::Height if self.args.color != Color::None => &[image, "exr"][..],
            ContentKind::Height => &["exr"],
            ContentKind::Mesh | ContentKind::QuantizedMesh => &["glb"],
        };
        let sizes = extensions.iter().map(|extension| Some(stem.with_extension(extension).metadata().ok()?.len()));
        if let Some(bytes) = sizes.sum() {
            return Ok((bytes, self.mesh(key).map_or(0.0, |(_, tin)| tin.distance_m)));
        }
        let TileFiles { files, distance_m } = self.make(key)?;
        let written = files.iter().map(|(extension, bytes)| write_whole(&stem.with_extension(extension), bytes));
        Ok((written.sum::<Result<u64, GenError>>()?, distance_m))
    }

    /// Makes the files of a tile.
    fn make(&self, key: TileKey) -> Result<TileFiles, GenError> {
        let format = self.args.tiles.texture;
        let encode = |painter: &Painter<'_>| {
            let encoded = format.encode(&painter.paint(key)?, TEXELS);
            encoded.map_err(|e| GenError::Encode(format!("texture of tile {key:?}: {e}")))
        };
        let image = self.painter.map(encode).transpose()?;
        let Some((tile, tin)) = self.mesh(key) else {
            let mut files: Vec<_> = image.into_iter().map(|image| (format.extension(), image)).collect();
            files.push((self.args.output.heights(), self.heights(key)?));
            return Ok(TileFiles { files, distance_m: 0.0 });
        };
        let look = Look { image, ..Look::default() };
        let glb = tile.glb(&self.form, &tin, skirt_m(self.args, self.block, key), look)?;
        Ok(TileFiles { files: vec![("glb", glb)], distance_m: tin.distance_m })
    }

    /// Returns the file of a tile's heights, with those of the vertices next to the tile.
    fn heights(&self, key: TileKey) -> Result<Vec<u8>, GenError> {
        let side = CELLS + 3;
        let uri = format!("{}/{}/{}.{}", key.level, key.x, key.y, self.args.output.heights());
        let mut heights = Vec::with_capacity(side * side);
        let last = CELLS as i64 + 1;
        let file = if self.args.output.is_packed() {
            (-1..=last).for_each(|j| self.block.add_heights(key, -1..=last, j, &mut heights));
            write_packed_heights(&uri, side, self.block.step_m(), &heights, compress)
        } else {
            (-1..=last).rev().for_each(|j| self.block.add_heights(key, -1..=last, j, &mut heights));
            write_height_exr(&uri, side, heights)
        };
        file.map_err(|e| GenError::Encode(e.to_string()))
    }

    /// Returns the samples and the triangles of a tile that is a mesh.
    fn mesh(&self, key: TileKey) -> Option<(MeshTile<'_>, Tin)> {
        let is_mesh = form(self.args, self.block, key) == ContentKind::Mesh;
        let tile = is_mesh.then(|| MeshTile::of_block(self.block, key))?;
        let tin = tile.triangles(self.form.triangles, &[], f64::INFINITY);
        Some((tile, tin))
    }
}

thread_local! {
    /// Its buffers are used again for each tile.
    static COMPRESSOR: RefCell<Option<Compressor<'static>>> = const { RefCell::new(None) };
}

/// Returns bytes as a zstd frame. Higher levels take longer, and save 2 % of the bytes.
pub(crate) fn compress(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    COMPRESSOR.with_borrow_mut(|kept| {
        let compressor = match kept {
            Some(compressor) => compressor,
            None => kept.insert(Compressor::new(1)?),
        };
        compressor.compress(bytes)
    })
}

/// Returns the form of a tile's content. Heights cannot leave out a part of a tile, so that tiles on the border of the data
/// are meshes.
pub(super) fn form(args: &GenArgs, block: &Block<'_>, key: TileKey) -> ContentKind {
    match block.facts(key).coverage {
        Coverage::Part => ContentKind::Mesh,
        Coverage::Whole | Coverage::None => args.content,
    }
}
