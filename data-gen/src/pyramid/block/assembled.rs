//! Blocks above the finest layer, made of the records of the blocks below.

use rayon::prelude::*;

use super::{AMBIENT_MARGIN, Below, Block, coarser_triangles};
use crate::GenError;
use crate::pyramid::grid::Grid;
use crate::pyramid::plan::Layer;
use crate::pyramid::record::Record;
use crate::pyramid::samples::{Samples, Window};
use crate::pyramid::tile::{CELLS, Coverage, TileKey};

/// Loads the record of a block of the layer below by its root; `None` if it has no data.
pub(crate) type LoadRecord<'a> = &'a (dyn Fn(TileKey) -> Result<Option<Record>, GenError> + Sync);

impl<'a> Block<'a> {
    /// Makes a block above the finest layer from the records of the blocks below.
    pub fn assemble(
        grid: &'a Grid<'a>,
        layer: Layer,
        root: TileKey,
        paints: bool,
        load: LoadRecord<'_>,
    ) -> Result<Self, GenError> {
        let mut block = Self::new(grid, layer, root);
        let depth = block.finest_depth();
        let (first, side) = (block.first(depth), block.side(depth));
        let window = block.assembled_window(paints);
        let mut known = Samples::unknown(window);
        grid.flood(&mut known);
        let mut filled = None;
        let mut texels = paints.then(|| {
            let first = first.map(|c| 4 * c);
            let margin = 3i64 << (layer.levels() - 1);
            let mut texels = Samples::unknown(Window::around(first, 4 * side, margin, 4 * grid.cells(depth)));
            grid.flood(&mut texels);
            texels
        });
        // A block below has half as many cells of this lattice along a side as a tile.
        let half = CELLS as i64 / 2;
        let keys = Self::records_of(grid, layer, root, paints);
        let is_own = |key: &TileKey| {
            let up = key.level - root.level;
            (key.x >> up, key.y >> up) == (root.x, root.y)
        };
        let tiles = 1usize << (layer.finest + 1 - root.level);
        let cells = tiles * half as usize;
        let mut below = vec![None; tiles * tiles];
        let mut has_data: Option<Vec<bool>> = None;
        for keys in keys.chunks(256) {
            let records: Result<Vec<_>, GenError> = keys.par_iter().map(|key| Ok((*key, load(*key)?))).collect();
            for (key, record) in records? {
                let [x, y] = [(key.x, root.x), (key.y, root.y)]
                    .map(|(own, root)| (i64::from(own) - i64::from(root) * tiles as i64) as usize);
                let is_whole = record.as_ref().is_some_and(|record| record.cells.is_none());
                if is_own(&key) && !is_whole {
                    let has_data = has_data.get_or_insert_with(|| vec![true; cells * cells]);
                    for (k, cell) in (0..half * half).enumerate() {
                        let [column, row] = [cell % half, cell / half].map(|c| c as usize);
                        let own = record.as_ref().and_then(|record| record.cells.as_ref()?.get(k));
                        let at = (y * half as usize + row) * cells + x * half as usize + column;
                        has_data[at] = own.copied().unwrap_or(false);
                    }
                }
                let Some(record) = record else { continue };
                known.copy_from(&record.known);
                if let Some(own) = &record.filled {
                    filled.get_or_insert_with(|| known.clone()).copy_from(own);
                } else if let Some(filled) = &mut filled {
                    filled.copy_from(&record.known);
                }
                if let (Some(texels), Some(own)) = (&mut texels, &record.texels) {
                    texels.copy_from(own);
                }
                if is_own(&key) {
                    if record.facts.coverage != Coverage::None {
                        let Record { region, geometric_error_m, .. } = record;
                        block.below.push(Below { root: key, region, geometric_error_m });
                    }
                    below[y * tiles + x] = Some((record.facts, record.finest_error_m, record.above_m));
                }
            }
        }
        block.known.push(known);
        for depth in 1..layer.levels() as usize {
            let coarser = block.known[depth - 1].every_second();
            block.known.push(coarser);
        }
        block.fill_voids(filled)?;
        block.smooth(paints, texels);
        block.triangles = has_data.map(|cells| coarser_triangles(cells.iter().map(|has| [*has; 2]).collect(), layer));
        block.measure_from(&below);
        Ok(block)
    }

    /// Returns the window of a block above the finest layer on the lattice of its finest tiles.
    fn assembled_window(&self, paints: bool) -> Window {
        let depth = self.finest_depth();
        let ring = if paints { AMBIENT_MARGIN } else { 1 };
        Window::around(self.first(depth), self.side(depth), ring << (self.layer.levels() - 1), self.grid.cells(depth))
    }

    /// Returns the blocks of the layer below whose records [`Self::assemble`] loads, those of neighbours included.
    pub fn records_of(grid: &'a Grid<'a>, layer: Layer, root: TileKey, paints: bool) -> Vec<TileKey> {
        let window = Self::new(grid, layer, root).assembled_window(paints);
        // A block below has half as many cells of this lattice along a side as a tile.
        let half = CELLS as i64 / 2;
        let below = |c: i64| (c / half).min((1 << (layer.finest + 1)) - 1) as u32;
        (below(window.first[1])..=below(window.last[1]))
            .flat_map(|y| (below(window.first[0])..=below(window.last[0])).map(move |x| (x, y)))
            .map(|(x, y)| TileKey { level: layer.finest + 1, x, y })
            .collect()
    }
}
