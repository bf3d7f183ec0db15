//! The details that are seen from near the ground: stones, tufts and crowns of trees as round lumps, and ripples in sand.
//!
//! Lumps have sizes of their own, whatever the level is, so that those of a level are also on the next finer one. Each size is
//! drawn by the levels on which a lump has several texels and fewer than a hundred.

use super::super::points::Points;
use super::super::relief::{LANES, add_noise, for_blocks, part, part_seed, smooth};

/// The distances between lumps in metres: crowns, bushes and boulders, tufts and stones, pebbles.
const LUMPS_M: [f64; 4] = [9.8, 2.45, 0.61, 0.15];
/// The lengths of ripples in metres.
const RIPPLES_M: [f64; 2] = [1.1, 0.14];
/// The direction across ripples.
const ACROSS: [f64; 3] = [0.36, -0.48, 0.8];

/// The details at each texel of a row, each within about -1..1, and 0 where texels are too large.
#[derive(Clone, Debug, Default)]
pub(crate) struct Details {
    /// The height of lumps: 1 on top, -1 in the gaps between them.
    pub dome: Vec<f32>,
    /// A random number for each lump.
    pub tone: Vec<f32>,
    /// The height of ripples.
    pub ripple: Vec<f32>,
    noise: Vec<f32>,
}

/// Returns the share of a pattern of a size that texels show.
fn seen(size_m: f64, texel_m: f64) -> f32 {
    let texels = (size_m / texel_m) as f32;
    smooth(3.5, 7.0, texels) * smooth(96.0, 32.0, texels)
}

impl Details {
    /// Computes the details of a row of texels.
    pub fn set_row(&mut self, seed: u64, points: &Points, texel_m: f64) {
        for buffer in [&mut self.dome, &mut self.tone, &mut self.ripple] {
            buffer.clear();
            buffer.resize(points.len(), 0.0);
        }
        let shares = LUMPS_M.map(|size_m| seen(size_m, texel_m));
        let all = shares.iter().sum::<f32>().max(1.0);
        for (k, (size_m, share)) in (0..).zip(LUMPS_M.into_iter().zip(shares)) {
            if share > 0.0 {
                let seed = part_seed(seed, 92 + k);
                add_lumps(points, points.radius_m / size_m, seed, share / all, &mut self.dome, &mut self.tone);
            }
        }
        for (k, length_m) in (0..).zip(RIPPLES_M) {
            let share = seen(length_m, texel_m);
            if share > 0.0 {
                self.add_ripples(part_seed(seed, 97 + k), points, length_m, share);
            }
        }
    }

    /// Adds ripples, which bend and end.
    fn add_ripples(&mut self, seed: u32, points: &Points, length_m: f64, share: f32) {
        self.noise.clear();
        self.noise.resize(points.len(), 0.0);
        add_noise(points, points.radius_m / (9.0 * length_m), seed, 1.4, &mut self.noise);
        let per_m = points.radius_m / length_m;
        for (k, ripple) in self.ripple.iter_mut().enumerate() {
            let [x, y, z] = points.at(k);
            let turns = (x * ACROSS[0] + y * ACROSS[1] + z * ACROSS[2]) * per_m + f64::from(self.noise[k]);
            let turn = (turns - turns.floor()) as f32;
            // A gentle side and a steep one.
            let height = (turn / 0.7).min((1.0 - turn) / 0.3);
            *ripple += share * (2.0 * smooth(0.0, 1.0, height) - 1.0);
        }
    }
}

/// Adds lumps of a size, `amplitude` high, and their random numbers. A lump has the positions that are nearest to one lattice
/// point, which is moved by random; only the corners of a position's cell count.
fn add_lumps(points: &Points, frequency: f64, seed: u32, amplitude: f32, dome: &mut [f32], tone: &mut [f32]) {
    let n = dome.len();
    for_blocks(
        points,
        frequency,
        seed,
        n,
        #[inline(always)]
        move |range, block| {
            let (mut nearest, mut second, mut tones) = ([9.0f32; LANES], [9.0f32; LANES], [0.0f32; LANES]);
            for corner in 0..8 {
                let hashes = block.hashes(corner);
                for k in 0..LANES {
                    let h = hashes[k];
                    let d = block.offset(corner, k, h, 0.45);
                    let other = h.wrapping_mul(0x9e37_79b1);
                    // Some are larger than others.
                    let squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - part(other, 22) * (0.12 / 512.0);
                    let is_nearest = squared < nearest[k];
                    second[k] = if is_nearest { nearest[k] } else { second[k].min(squared) };
                    nearest[k] = if is_nearest { squared } else { nearest[k] };
                    tones[k] = if is_nearest { part(other, 12) * (1.0 / 512.0) } else { tones[k] };
                }
            }
            let (dome, tone) = (&mut dome[range.clone()], &mut tone[range]);
            for (k, (dome, tone)) in dome.iter_mut().zip(tone).enumerate() {
                // Narrow gaps between lumps.
                let inside = (2.6 * (second[k] - nearest[k])).min(1.0);
                *dome += amplitude * (2.0 * inside * (2.0 - inside) - 1.0);
                // Lumps of neighbours join in the gap.
                *tone += amplitude * tones[k] * inside;
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::super::super::points::{RADIUS_M, meridians};
    use super::*;

    fn row(step_m: f64) -> Points {
        let mut points = Points::default();
        points.set_row(&meridians((0..256).map(|k| 0.3 + step_m / RADIUS_M * f64::from(k))), 0.5);
        points
    }

    #[test]
    fn fine_texels_show_lumps_and_coarse_ones_do_not() {
        let of = |texel_m: f64| {
            let mut details = Details::default();
            details.set_row(3, &row(texel_m), texel_m);
            details
        };
        let far = of(5.0);
        assert!(far.dome.iter().chain(&far.tone).chain(&far.ripple).all(|x| *x == 0.0));
        for texel_m in [1.0, 0.2, 0.03] {
            let near = of(texel_m);
            let deviation = |field: &[f32]| {
                let mean = field.iter().sum::<f32>() / 256.0;
                (field.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / 256.0).sqrt()
            };
            assert!(deviation(&near.dome) > 0.2 && deviation(&near.tone) > 0.1, "{texel_m}");
            assert!(near.dome.iter().chain(&near.tone).all(|x| x.abs() <= 1.01), "{texel_m}");
            assert!(near.dome.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 1.5), "{texel_m}: no noise");
        }
        assert!(of(0.03).ripple.iter().any(|x| *x > 0.5));
    }

    /// Texels of tiles that meet at an edge, and those of a tile alone, are computed alike.
    #[test]
    fn details_depend_on_the_place_alone() {
        let (points, mut all, mut one) = (row(0.1), Details::default(), Details::default());
        all.set_row(3, &points, 0.1);
        for k in [0, 15, 16, 100, 255] {
            let mut single = Points::default();
            single.push(points.at(k));
            one.set_row(3, &single, 0.1);
            assert_eq!((one.dome[0], one.tone[0], one.ripple[0]), (all.dome[k], all.tone[k], all.ripple[k]), "{k}");
        }
    }
}
