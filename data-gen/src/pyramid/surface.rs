//! The heights that the colours of one level's tiles are made of: smoothed to the distance of texels, and to three coarser
//! distances for ambient shading.

use std::borrow::Cow;

use super::grid::Grid;
use super::samples::Samples;

/// Heights on a lattice over the set.
pub(crate) struct Lattice<'a> {
    /// The number of cells along the set's side.
    pub cells: i64,
    /// Heights without voids. Beyond the window, which has a margin around the block, the nearest sample is repeated.
    pub samples: Cow<'a, Samples>,
}

/// The lattices of one level.
pub(crate) struct Surface<'a> {
    lattices: [Lattice<'a>; 4],
}

impl<'a> Surface<'a> {
    /// Makes the lattices from smoothed heights at the distance of texels, and from heights without voids on a lattice that is
    /// four times as coarse; each with its depth.
    pub fn new(grid: &Grid<'_>, (depth, texels): (u32, &'a Samples), (ambient, around): (u32, &Samples)) -> Self {
        let cells = |depth: u32| grid.cells(0) >> depth;
        let near = around.blurred(cells(ambient), 1);
        let twice = |fine: &Samples, depth: u32| fine.halved(cells(depth)).halved(cells(depth + 1));
        let middle = twice(&near, ambient);
        let far = twice(&middle, ambient + 2);
        let mut texels = Cow::Borrowed(texels);
        if texels.has_unknown() {
            let texels = texels.to_mut();
            let (window, width) = (texels.window, texels.window.width());
            let scale = 1.0 / (1i64 << (ambient - depth)) as f64;
            for (k, h) in texels.values.iter_mut().enumerate().filter(|(_, h)| h.is_nan()) {
                let at = [window.first[0] + (k % width) as i64, window.first[1] + (k / width) as i64];
                *h = around.bilinear(at[0] as f64 * scale, at[1] as f64 * scale);
            }
        }
        let of = |depth: u32, samples: Samples| Lattice { cells: cells(depth), samples: Cow::Owned(samples) };
        let fine = Lattice { cells: cells(depth), samples: texels };
        Self { lattices: [fine, of(ambient, near), of(ambient + 2, middle), of(ambient + 4, far)] }
    }

    /// Returns the lattice whose cells are texels, and three that are 4, 16 and 64 times as coarse.
    pub fn lattices(&self) -> &[Lattice<'a>; 4] {
        &self.lattices
    }
}
