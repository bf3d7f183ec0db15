//! Positions in the lattice of a noise, in blocks of as many as the widest registers hold.
//!
//! The corners of a cell are hashed once for all positions of a block that lies in it, as blocks of long waves do. Neither
//! this nor the width of registers changes the bits: each position is computed alike, and neither fused multiply-add nor
//! functions of the C library are used.

#![allow(clippy::needless_range_loop, reason = "one number indexes positions, weights and outputs")]

use super::super::points::{Points, ROUND};

/// The number of positions in a block.
pub(crate) const LANES: usize = 16;

/// A number for each position of a block.
pub(super) type Lanes<T> = [T; LANES];

/// Runs a loop with the widest registers that the processor has.
#[inline(always)]
pub(crate) fn wide<R>(op: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(op)
}

/// Splits a coordinate below 2^31 into the number of its lattice cell and the position in it, 0..1.
#[inline(always)]
fn cell(x: f64) -> (u32, f32) {
    let rounded = (x - 0.5) + ROUND;
    (rounded.to_bits() as u32, (x - (rounded - ROUND)) as f32)
}

/// Odd numbers that the coordinates of lattice points are multiplied with.
const HASH: [u32; 3] = [0x9e37_79b1, 0x85eb_ca77, 0xc2b2_ae3d];

/// Returns ten bits of a hash as a number within -511.5..511.5.
#[inline(always)]
pub(crate) fn part(hash: u32, shift: u32) -> f32 {
    ((hash >> shift) & 0x3ff) as i32 as f32 - 511.5
}

/// Returns three parts of a hash.
#[inline(always)]
pub(super) fn parts(hash: u32) -> [f32; 3] {
    [part(hash, 22), part(hash, 12), part(hash, 2)]
}

/// Returns 1 for the upper lattice point along an axis of one of the eight corners of a cell, and 0 for the lower one.
#[inline(always)]
pub(super) fn bit(corner: usize, axis: usize) -> usize {
    corner >> axis & 1
}

/// Returns the numbers of a block of a row, the last one repeated behind the end of the row.
#[inline(always)]
pub(super) fn lanes<T: Copy>(row: &[T], start: usize) -> Lanes<T> {
    let rest = &row[start..];
    if let Some(all) = rest.first_chunk() {
        return *all;
    }
    let mut lanes = [rest[rest.len() - 1]; LANES];
    lanes[..rest.len()].copy_from_slice(rest);
    lanes
}

/// A block of positions.
pub(crate) struct Block {
    /// The coordinates of the lower corner of each position's cell, each multiplied for the hash.
    lower: [Lanes<u32>; 3],
    /// The position in the cell along each axis, 0..1.
    pub at: [Lanes<f32>; 3],
    seed: u32,
    /// True if all positions lie in one cell.
    pub is_one_cell: bool,
}

impl Block {
    #[inline(always)]
    fn new(points: [Lanes<f64>; 3], frequency: f64, seed: u32) -> Self {
        let mut block = Self { lower: [[0; LANES]; 3], at: [[0.0; LANES]; 3], seed, is_one_cell: false };
        for axis in 0..3 {
            for k in 0..LANES {
                let (number, place) = cell(points[axis][k] * frequency);
                block.lower[axis][k] = number.wrapping_mul(HASH[axis]);
                block.at[axis][k] = place;
            }
        }
        let mut differ = 0;
        for axis in 0..3 {
            for k in 0..LANES {
                differ |= block.lower[axis][k] ^ block.lower[axis][0];
            }
        }
        block.is_one_cell = differ == 0;
        block
    }

    /// Returns the hash of a corner of the cell of a position.
    #[inline(always)]
    pub fn hash(&self, corner: usize, lane: usize) -> u32 {
        let along =
            |axis: usize| self.lower[axis][lane].wrapping_add(HASH[axis].wrapping_mul(bit(corner, axis) as u32));
        let h = along(0) ^ along(1) ^ along(2) ^ self.seed;
        let h = (h ^ (h >> 15)).wrapping_mul(0x7feb_352d);
        h ^ (h >> 15)
    }

    /// Returns the hashes of a corner of the cells of all positions.
    #[inline(always)]
    pub fn hashes(&self, corner: usize) -> Lanes<u32> {
        let mut hashes = [0; LANES];
        if self.is_one_cell {
            return [self.hash(corner, 0); LANES];
        }
        for k in 0..LANES {
            hashes[k] = self.hash(corner, k);
        }
        hashes
    }

    /// Returns the offset of a position from a corner of its cell that its hash moves, by at most half of `share` along each
    /// axis.
    #[inline(always)]
    pub fn offset(&self, corner: usize, lane: usize, hash: u32, share: f32) -> [f32; 3] {
        let along = |axis: usize, shift: u32| {
            self.at[axis][lane] - bit(corner, axis) as f32 + part(hash, shift) * (share / 512.0)
        };
        [along(0, 22), along(1, 12), along(2, 2)]
    }

    /// Returns the parts of the hashes of the eight corners of the first position's cell.
    #[inline(always)]
    pub fn corners(&self) -> [[f32; 3]; 8] {
        let mut corners = [[0.0; 3]; 8];
        for corner in 0..8 {
            corners[corner] = parts(self.hash(corner, 0));
        }
        corners
    }
}

/// Calls `op` for each block of a row, with the range of the row that is in it. `frequency` is the number of lattice cells per
/// radius. Runs with the widest registers; `op` is inlined.
#[inline(always)]
pub(crate) fn for_blocks(
    points: &Points,
    frequency: f64,
    seed: u32,
    len: usize,
    mut op: impl FnMut(std::ops::Range<usize>, &Block),
) {
    let (x, y, z) = (&points.x[..len], &points.y[..len], &points.z[..len]);
    wide(
        #[inline(always)]
        move || {
            for start in (0..len).step_by(LANES) {
                let block = Block::new([lanes(x, start), lanes(y, start), lanes(z, start)], frequency, seed);
                op(start..(start + LANES).min(len), &block);
            }
        },
    );
}
