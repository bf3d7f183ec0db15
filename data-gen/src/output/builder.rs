//! Makes the blocks of a set, layer by layer.

use std::path::Path;

use rayon::prelude::*;

use super::corner_errors::{BlockErrors, TileErrors, is_round};
use super::implicit::{self, Subtrees};
use super::journal::Journal;
use super::options::Tiling;
use super::set_files::write_whole;
use super::tile_set::{Written, write_tiles};
use super::tree::{Tree, external_name, external_tileset, trunk_tileset};
use crate::args::{Color, ContentKind, GenArgs};
use crate::color::{Imagery, Painter};
use crate::pyramid::{Below, Block, Coverage, Grid, Layer, Plan, Record, TileKey, Totals, tiles_with_data};
use crate::{GenError, Progress, Voids};

/// Makes the blocks of a set in a folder. One block is in memory at a time; the threads of the current rayon pool share its work.
pub(crate) struct Builder<'a> {
    args: &'a GenArgs,
    grid: &'a Grid<'a>,
    imagery: Option<&'a Imagery>,
    plan: &'a Plan,
    folder: &'a Path,
    journal: Journal,
    /// About the lowest and the highest height of the set in metres, for colours.
    range_m: [f32; 2],
    progress: Progress,
}

impl<'a> Builder<'a> {
    pub fn new(
        args: &'a GenArgs,
        grid: &'a Grid<'a>,
        imagery: Option<&'a Imagery>,
        plan: &'a Plan,
        folder: &'a Path,
    ) -> Result<Self, GenError> {
        let range_m = if args.color == Color::None { [0.0; 2] } else { grid.coarse_range_m()? };
        let progress = Progress::new("writing", 0, "tiles");
        Ok(Self { args, grid, imagery, plan, folder, journal: Journal::new(folder), range_m, progress })
    }

    /// Makes the whole set and its `tileset.json`. Returns the totals.
    pub fn make_set(&mut self) -> Result<Totals, GenError> {
        let blocks: Vec<Vec<TileKey>> = self.plan.layers.iter().map(|layer| blocks(self.grid, *layer)).collect();
        let tiles =
            self.plan.layers.iter().zip(&blocks).map(|(layer, keys)| layer.tiles_per_block() * keys.len() as u64);
        self.progress.set_total(tiles.sum());
        let mut totals = Totals::new(self.grid.levels);
        for (layer, keys) in self.plan.layers.iter().zip(&blocks) {
            for key in keys.iter().filter(|key| key.level > 0 || self.grid.is_aligned()) {
                totals.add(&self.make(*layer, *key)?.totals);
            }
        }
        if self.grid.is_aligned() {
            return self.make_trunk(totals, &blocks);
        }
        // Blocks that were not made have no data at any vertex.
        let made: u64 = blocks.first().into_iter().flatten().map(|key| vertices_of(self.grid, *key)).sum();
        totals.voids += vertices_of(self.grid, TileKey::ROOT) - made;
        let Some(layer) = self.plan.layers.last() else { return Ok(totals) };
        self.make_root(*layer, totals, &blocks)
    }

    /// Makes some blocks of a layer below the root's. Returns their totals.
    pub fn make_blocks(&mut self, layer: Layer, roots: &[TileKey]) -> Result<Totals, GenError> {
        self.progress.set_total(layer.tiles_per_block() * roots.len() as u64);
        let mut totals = Totals::new(self.grid.levels);
        for root in roots {
            totals.add(&self.make(layer, *root)?.totals);
        }
        Ok(totals)
    }

    /// Samples and measures a block of the finest layer, and writes nothing. For measurements of time.
    pub fn sample_block(&self, layer: Layer, root: TileKey) -> Result<(), GenError> {
        self.block(layer, root).map(drop)
    }

    /// Makes a block that is not the root's, unless the journal has it, and returns its record.
    fn make(&self, layer: Layer, root: TileKey) -> Result<Record, GenError> {
        if let Some(record) = self.journal.load(root)? {
            self.progress.advance(record.totals.tiles);
            return Ok(record);
        }
        let block = self.block(layer, root)?;
        let (bytes, tree) = self.write(&block)?;
        let (mut geometric_error_m, mut json) = (0.0, String::new());
        if block.facts(root).coverage != Coverage::None {
            geometric_error_m = tree.geometric_error_m(root);
            json = match self.is_implicit() {
                true => implicit::list(&tree.entries()),
                false => tree.external_root(),
            };
        }
        let record = block.record(bytes, tree.root_region(), geometric_error_m, json);
        self.journal.save(root, &record)?;
        Ok(record)
    }

    /// Makes the block of the root and all tilesets. `totals` are those of all other blocks, `blocks` their roots.
    fn make_root(&self, layer: Layer, mut totals: Totals, blocks: &[Vec<TileKey>]) -> Result<Totals, GenError> {
        let block = self.block(layer, TileKey::ROOT)?;
        if block.facts(TileKey::ROOT).coverage == Coverage::None {
            return Err(self.without_data());
        }
        let (bytes, tree) = self.write(&block)?;
        totals.add(&block.totals(bytes));
        let mut root = tree.root();
        let below = match self.is_implicit() {
            true => {
                let shape = (self.grid.levels, tree.contents().len());
                let is_round = self.has_heights().then(|| is_round(&self.grid.extent));
                let (plan, folder) = (self.plan, self.folder);
                Subtrees::new(plan, &self.journal, folder, shape, is_round, tree.entries()).write(TileKey::ROOT)?
            }
            false => {
                let errors = BlockErrors::new(self.plan, &self.journal, Some(&root));
                let errors = self.tile_errors(&errors);
                if self.has_heights() {
                    errors.describe(&mut root)?;
                }
                self.write_external(&totals, blocks.iter().flatten().filter(|key| key.level > 0), &errors)?
            }
        };
        let text = tree.tileset(&totals, root);
        totals.bytes += below + write_whole(&self.folder.join("tileset.json"), text.as_bytes())?;
        Ok(totals)
    }

    fn has_heights(&self) -> bool {
        self.args.content == ContentKind::Height
    }

    /// Returns the errors of all tiles of the set.
    fn tile_errors<'b>(
        &self,
        blocks: &'b BlockErrors<'_>,
    ) -> TileErrors<impl Fn(TileKey) -> Result<f64, GenError> + Sync + use<'b>> {
        let (first_level, is_round) = (self.plan.first_level(), is_round(&self.grid.extent));
        TileErrors { error_m: |key| blocks.error_m(key), first_level, is_round }
    }

    fn is_implicit(&self) -> bool {
        self.args.output.tiling == Tiling::Implicit
    }

    /// Makes the tilesets of an aligned set, whose coarsest tiles are the roots of blocks.
    fn make_trunk(&self, mut totals: Totals, blocks: &[Vec<TileKey>]) -> Result<Totals, GenError> {
        let mut below = Vec::new();
        for key in blocks.last().into_iter().flatten() {
            let record = self.journal.load(*key)?.filter(|record| record.facts.coverage != Coverage::None);
            below.extend(record.map(|record| Below {
                root: *key,
                region: record.region,
                geometric_error_m: record.geometric_error_m,
            }));
        }
        if below.is_empty() {
            return Err(self.without_data());
        }
        let text = trunk_tileset(self.args, &self.grid.ellipsoid, &totals, &below);
        let errors = BlockErrors::new(self.plan, &self.journal, None);
        let bytes = self.write_external(&totals, blocks.iter().flatten(), &self.tile_errors(&errors))?;
        totals.bytes += bytes + write_whole(&self.folder.join("tileset.json"), text.as_bytes())?;
        Ok(totals)
    }

    fn without_data(&self) -> GenError {
        let reason = "no neighbouring samples of the finest level have heights; more --levels make it finer, --voids fill continues them";
        GenError::invalid(self.args.dem.first().cloned().unwrap_or_default(), reason)
    }

    /// Writes the external tilesets of blocks, and returns their bytes.
    fn write_external<'k>(
        &self,
        totals: &Totals,
        blocks: impl Iterator<Item = &'k TileKey>,
        errors: &TileErrors<impl Fn(TileKey) -> Result<f64, GenError> + Sync>,
    ) -> Result<u64, GenError> {
        let external = blocks.collect::<Vec<_>>().into_par_iter().map(|key| {
            let record = self.journal.load(*key)?.filter(|record| record.facts.coverage != Coverage::None);
            let Some(record) = record else { return Ok(0) };
            let (mut tree, mut above) = (record.tree, None);
            if self.has_heights() {
                let damaged = |_| GenError::invalid(self.folder, format!("the journal of block {key:?} is damaged"));
                let mut tile = serde_json::from_str(&tree).map_err(damaged)?;
                errors.describe(&mut tile)?;
                (tree, above) = (tile.to_string(), Some(errors.above(*key)?));
            }
            let text = external_tileset(self.args, totals, *key, record.geometric_error_m, &tree, above.as_deref());
            let path = self.folder.join(external_name(*key));
            if let Some(folder) = path.parent() {
                // The tiles of packed sets lie in other folders.
                std::fs::create_dir_all(folder).map_err(GenError::file(folder))?;
            }
            write_whole(&path, text.as_bytes())
        });
        Ok(external.collect::<Result<Vec<u64>, GenError>>()?.iter().sum())
    }

    fn block(&self, layer: Layer, root: TileKey) -> Result<Block<'a>, GenError> {
        let paints = self.args.color != Color::None;
        if layer.finest + 1 == self.grid.levels {
            return Block::sample(self.grid, layer, root, paints);
        }
        Block::assemble(self.grid, layer, root, paints, &|key| self.journal.load(key))
    }

    /// Writes the files of a block's tiles, and returns their bytes and the description of the tiles.
    fn write<'b>(&'b self, block: &'b Block<'b>) -> Result<(u64, Tree<'b>), GenError> {
        let has_data = block.facts(block.root).coverage != Coverage::None;
        let paints = has_data && self.args.color != Color::None;
        let painter = paints.then(|| Painter::new(block, &self.grid.extent, self.imagery, self.range_m));
        let Written { bytes, distances_m, packed } =
            write_tiles(self.args, block, painter.as_ref(), self.folder, &self.progress)?;
        let tree = Tree::new(self.args, block, distances_m);
        if let Some(file) = packed {
            file.finish(|key| {
                let facts = block.facts(key);
                (tree.geometric_error_m(key), [facts.min_height_m, facts.max_height_m])
            })?;
        }
        Ok((bytes, tree))
    }
}

/// Returns the roots of a layer's blocks in Morton order, without those that have no data.
pub(crate) fn blocks(grid: &Grid<'_>, layer: Layer) -> Vec<TileKey> {
    tiles_with_data(layer.root, &|key| grid.voids != Voids::Cut || grid.may_have_data_in_tile(key))
}

/// Returns the number of vertices of the finest level in a tile. Those on its eastern and northern edges belong to its
/// neighbours, except at the edges of the set.
fn vertices_of(grid: &Grid<'_>, key: TileKey) -> u64 {
    let side = grid.cells(0) as u64 >> key.level;
    let along = |c: u32| side + u64::from(c + 1 == 1 << key.level);
    along(key.x) * along(key.y)
}
