//! Craters of impacts.

#![allow(clippy::needless_range_loop, reason = "one number indexes positions, weights and outputs")]

use super::super::points::Points;
use super::super::preset::Relief;
use super::lattice::{LANES, for_blocks, lanes, part};
use super::{Ground, part_seed};

/// Adds craters to `out`: one for a share of the lattice points near the sphere. A radius is at most 0.36 cells. Heights
/// are `amplitude` for each cell of a crater's radius.
fn add_craters(points: &Points, frequency: f64, seed: u32, share: f32, amplitude: f32, out: &mut [f32]) {
    let n = out.len();
    let missing = (1.0 - share) * 1024.0 - 512.0;
    for_blocks(
        points,
        frequency,
        seed,
        n,
        #[inline(always)]
        move |range, block| {
            let up = [lanes(&points.x, range.start), lanes(&points.y, range.start), lanes(&points.z, range.start)];
            let mut sums = [0.0f32; LANES];
            for corner in 0..8 {
                let hashes = block.hashes(corner);
                let (mut squares, mut nears, mut radii) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
                // A crater and its ejecta end at 1.7 radii.
                let mut is_near = 0u32;
                for k in 0..LANES {
                    let h = hashes[k];
                    let d = block.offset(corner, k, h, 0.25);
                    let above = d[0] * up[0][k] as f32 + d[1] * up[1][k] as f32 + d[2] * up[2][k] as f32;
                    squares[k] = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - above * above).max(0.0);
                    // Sizes: many small craters, few large ones.
                    let other = h.wrapping_mul(0x9e37_79b1);
                    let size = ((other >> 12) & 0x3ff) as i32 as f32 / 1024.0;
                    radii[k] = 0.13 + 0.23 * size * size;
                    let is_there = if part(other, 22) > missing { 1.0f32 } else { 0.0 };
                    // Lattice points that are far above or below the ground have none.
                    nears[k] = (1.0 - ((above.abs() - 0.25) * 10.0).clamp(0.0, 1.0)) * is_there;
                    let reach = 1.7 * radii[k];
                    is_near |= u32::from(squares[k] < reach * reach) & u32::from(nears[k] > 0.0);
                }
                if is_near == 0 {
                    continue;
                }
                for k in 0..LANES {
                    let r = squares[k].sqrt() / radii[k];
                    // The bowl, the rim, and the blanket of ejecta around it.
                    let bowl = (r * r - 1.0) * 0.42 + 0.10;
                    let floor = (-0.24f32).max(bowl);
                    let t = ((1.7 - r) / 0.7).clamp(0.0, 1.0);
                    let outside = 0.10 * t * t * t;
                    let height = if r < 1.0 { floor } else { outside };
                    sums[k] += nears[k] * radii[k] * height;
                }
            }
            for (out, sum) in out[range].iter_mut().zip(sums) {
                *out += amplitude * sum;
            }
        },
    );
}

impl Relief {
    /// Adds craters of all sizes, small ones on top of large ones.
    pub(super) fn add_craters(&self, seed: u64, points: &Points, out: &mut Ground) {
        let craters = self.forms.craters;
        if craters <= 0.0 {
            return;
        }
        let (mut cell_m, mut share) = (900_000.0f64, 0.3f32);
        for octave in 0..14 {
            // Large craters are flatter.
            let flat = 1.0 / (1.0 + cell_m as f32 / 60_000.0);
            let depth = craters * cell_m as f32 * (0.03 + 0.55 * flat);
            add_craters(points, points.radius_m / cell_m, part_seed(seed, 60 + octave), share, depth, &mut out.bed_m);
            cell_m *= 0.5;
            share = 0.8;
        }
    }
}
