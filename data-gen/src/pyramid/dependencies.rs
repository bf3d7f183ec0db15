//! Records the inputs of a block beside the samples of its own part: `--update` keeps a block if none of them has changed.

use super::grid::Grid;
use super::samples::HeightAt;
use crate::GenError;

/// Lists the inputs of a block beyond its rectangle.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Dependencies {
    /// How far from the block the source was read, in cells of the finest lattice.
    pub reach: i64,
    /// Heights of vertices of coarser tiles that contain the block.
    pub vertices: Vec<HeightAt>,
    /// Heights that stand for boxes of vertices without data; `at` is the column and row of a box.
    pub gaps: Vec<HeightAt>,
}

impl Dependencies {
    /// Returns true if a grid still has the heights of gaps that the block's tiles were made of.
    pub fn has_same_gaps(&self, grid: &Grid<'_>) -> Result<bool, GenError> {
        are_same(&self.gaps, |gap| grid.gap_height_m(gap.depth, gap.at))
    }

    /// Returns true if a grid still has the vertices that errors of the tiles above were measured with.
    pub fn has_same_vertices(&self, grid: &Grid<'_>) -> Result<bool, GenError> {
        are_same(&self.vertices, |vertex| grid.vertex(vertex.depth, vertex.at))
    }

    /// Adds heights, each once.
    pub fn add_gaps(&mut self, gaps: Vec<HeightAt>) {
        self.gaps.extend(gaps);
        self.gaps.sort_by_key(|gap| (gap.depth, gap.at));
        self.gaps.dedup_by_key(|gap| (gap.depth, gap.at));
    }
}

fn are_same(heights: &[HeightAt], now: impl Fn(&HeightAt) -> Result<f32, GenError>) -> Result<bool, GenError> {
    for height in heights {
        if now(height)?.to_bits() != height.height_m.to_bits() {
            return Ok(false);
        }
    }
    Ok(true)
}
