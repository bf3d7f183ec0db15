//! Barchans: single dunes with horns downwind.

#![allow(clippy::needless_range_loop, reason = "one number indexes positions, weights and outputs")]

use super::super::points::Points;
use super::lattice::{LANES, for_blocks, lanes};
use super::noise::Vectors;

/// Adds barchans to `out`, at most one for each lattice point near the sphere: heaps with a gentle side towards the wind, a lee
/// with the slope `repose`, and horns downwind. Heights are `amplitude` for each cell.
pub(super) fn add_barchans(
    points: &Points,
    frequency: f64,
    seed: u32,
    wind: &Vectors,
    repose: f32,
    amplitude: f32,
    out: &mut [f32],
) {
    let n = out.len();
    let (wx, wy, wz) = (&wind.x[..n], &wind.y[..n], &wind.z[..n]);
    for_blocks(
        points,
        frequency,
        seed,
        n,
        #[inline(always)]
        move |range, block| {
            let start = range.start;
            let up = [lanes(&points.x, start), lanes(&points.y, start), lanes(&points.z, start)];
            let wind = [lanes(wx, start), lanes(wy, start), lanes(wz, start)];
            let mut highest = [0.0f32; LANES];
            for corner in 0..8 {
                let hashes = block.hashes(corner);
                let mut offs = [[0.0f32; LANES]; 3];
                let (mut nears, mut is_near) = ([0.0f32; LANES], 0u32);
                for k in 0..LANES {
                    let h = hashes[k];
                    let d = block.offset(corner, k, h, 0.25);
                    let above = d[0] * up[0][k] as f32 + d[1] * up[1][k] as f32 + d[2] * up[2][k] as f32;
                    // Lattice points that are far above or below the ground have none.
                    nears[k] = 1.0 - ((above.abs() - 0.3) * 20.0).clamp(0.0, 1.0);
                    is_near |= u32::from(nears[k] > 0.0);
                    (offs[0][k], offs[1][k], offs[2][k]) = (d[0], d[1], d[2]);
                }
                if is_near == 0 {
                    continue;
                }
                for k in 0..LANES {
                    let (nx, ny, nz) = (up[0][k] as f32, up[1][k] as f32, up[2][k] as f32);
                    let (wx, wy, wz) = (wind[0][k], wind[1][k], wind[2][k]);
                    let (lx, ly, lz) = (ny * wz - nz * wy, nz * wx - nx * wz, nx * wy - ny * wx);
                    let d = [offs[0][k], offs[1][k], offs[2][k]];
                    let other = hashes[k].wrapping_mul(0x9e37_79b1);
                    let size = ((other >> 12) & 0x3ff) as i32 as f32 / 1024.0;
                    // Half the width; the height is a tenth of the width.
                    let half = 0.07 + 0.17 * size * size;
                    let across = (d[0] * lx + d[1] * ly + d[2] * lz) / half;
                    let inside = (1.0 - across * across).max(0.0);
                    let crest_height = 0.24 * half * inside * (0.4 + 0.6 * inside);
                    // Downwind of the crest, which is bent.
                    let behind = d[0] * wx + d[1] * wy + d[2] * wz - half * (1.25 * across * across - 0.3);
                    let length = half * (0.25 + 1.55 * inside);
                    let up = (1.0 + behind / length).clamp(0.0, 1.0);
                    let windward = crest_height * up * (0.4 + up * (1.2 - 0.6 * up));
                    let lee = (crest_height - repose * behind.max(0.0)).max(0.0);
                    highest[k] = highest[k].max(nears[k] * windward.min(lee));
                }
            }
            for (out, highest) in out[range].iter_mut().zip(highest) {
                *out += amplitude * highest;
            }
        },
    );
}
