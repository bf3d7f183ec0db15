//! Gradient noise in space from a hash, evaluated along rows of positions, with and without its derivative.

#![allow(clippy::needless_range_loop, reason = "one number indexes positions, weights and outputs")]

use super::super::points::Points;
use super::lattice::{Block, LANES, Lanes, bit, for_blocks, parts};

/// A vector for each position of a row, as three arrays.
#[derive(Clone, Debug, Default)]
pub(crate) struct Vectors {
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub z: Vec<f32>,
}

impl Vectors {
    pub fn at(&self, k: usize) -> [f32; 3] {
        [self.x[k], self.y[k], self.z[k]]
    }

    pub fn reset(&mut self, len: usize) {
        for v in [&mut self.x, &mut self.y, &mut self.z] {
            v.clear();
            v.resize(len, 0.0);
        }
    }
}

/// Scales the dot products with gradients, the parts of hashes, so that the noise lies within about -1..1.
const SCALE: f32 = 1.5 / 512.0;

#[inline(always)]
fn fade(t: f32) -> f32 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

/// Returns the weights of the two lattice points around a place between them, 0..1.
#[inline(always)]
pub(super) fn weights(place: f32) -> [f32; 2] {
    let upper = fade(place);
    [1.0 - upper, upper]
}

/// Returns noise at the positions of a block. `gradient` returns that of a corner of a position's cell.
#[inline(always)]
fn values(block: &Block, gradient: impl Fn(usize, usize) -> [f32; 3]) -> Lanes<f32> {
    let mut values = [0.0; LANES];
    for k in 0..LANES {
        let (fx, fy, fz) = (block.at[0][k], block.at[1][k], block.at[2][k]);
        let mut dots = [0.0; 8];
        for corner in 0..8 {
            let g = gradient(corner, k);
            let off = |axis: usize, place: f32| place - bit(corner, axis) as f32;
            dots[corner] = g[0] * off(0, fx) + g[1] * off(1, fy) + g[2] * off(2, fz);
        }
        let (u, v, w) = (fade(fx), fade(fy), fade(fz));
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let low = lerp(lerp(dots[0], dots[1], u), lerp(dots[2], dots[3], u), v);
        let high = lerp(lerp(dots[4], dots[5], u), lerp(dots[6], dots[7], u), v);
        values[k] = lerp(low, high, w);
    }
    values
}

/// Adds `amplitude` times gradient noise to `out`. `frequency` is the number of lattice cells per radius.
pub(crate) fn add_noise(points: &Points, frequency: f64, seed: u32, amplitude: f32, out: &mut [f32]) {
    let (n, amplitude) = (out.len(), amplitude * SCALE);
    for_blocks(
        points,
        frequency,
        seed,
        n,
        #[inline(always)]
        move |range, block| {
            let values = if block.is_one_cell {
                let corners = block.corners();
                values(
                    block,
                    #[inline(always)]
                    |corner, _| corners[corner],
                )
            } else {
                values(
                    block,
                    #[inline(always)]
                    |corner, k| parts(block.hash(corner, k)),
                )
            };
            for (out, value) in out[range].iter_mut().zip(values) {
                *out += amplitude * value;
            }
        },
    );
}

/// Returns noise and its gradient, per lattice cell, at the positions of a block.
#[inline(always)]
fn derivatives(block: &Block, gradient: impl Fn(usize, usize) -> [f32; 3]) -> [Lanes<f32>; 4] {
    let mut all = [[0.0; LANES]; 4];
    for k in 0..LANES {
        let (fx, fy, fz) = (block.at[0][k], block.at[1][k], block.at[2][k]);
        let slope = |t: f32| 30.0 * t * t * (t * (t - 2.0) + 1.0);
        let (u, v, w) = (weights(fx), weights(fy), weights(fz));
        let (du, dv, dw) = (slope(fx), slope(fy), slope(fz));
        let (mut value, mut dx, mut dy, mut dz) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for corner in 0..8 {
            let g = gradient(corner, k);
            let [a, b, c] = [bit(corner, 0), bit(corner, 1), bit(corner, 2)];
            let dot = g[0] * (fx - a as f32) + g[1] * (fy - b as f32) + g[2] * (fz - c as f32);
            let sign = [-1.0f32, 1.0];
            let weight = u[a] * v[b] * w[c];
            value += weight * dot;
            dx += weight * g[0] + sign[a] * du * v[b] * w[c] * dot;
            dy += weight * g[1] + sign[b] * dv * u[a] * w[c] * dot;
            dz += weight * g[2] + sign[c] * dw * u[a] * v[b] * dot;
        }
        all[0][k] = value * SCALE;
        all[1][k] = dx * SCALE;
        all[2][k] = dy * SCALE;
        all[3][k] = dz * SCALE;
    }
    all
}

/// Writes gradient noise to `out` and its gradient, per lattice cell, to `gradient`.
pub(crate) fn noise_gradient(points: &Points, frequency: f64, seed: u32, out: &mut [f32], gradient: &mut Vectors) {
    let n = out.len();
    let (gx, gy, gz) = (&mut gradient.x[..n], &mut gradient.y[..n], &mut gradient.z[..n]);
    for_blocks(
        points,
        frequency,
        seed,
        n,
        #[inline(always)]
        move |range, block| {
            let [values, x, y, z] = if block.is_one_cell {
                let corners = block.corners();
                derivatives(
                    block,
                    #[inline(always)]
                    |corner, _| corners[corner],
                )
            } else {
                derivatives(
                    block,
                    #[inline(always)]
                    |corner, k| parts(block.hash(corner, k)),
                )
            };
            let len = range.len();
            out[range.clone()].copy_from_slice(&values[..len]);
            gx[range.clone()].copy_from_slice(&x[..len]);
            gy[range.clone()].copy_from_slice(&y[..len]);
            gz[range].copy_from_slice(&z[..len]);
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(longitude: f64, step: f64, latitude: f64) -> Points {
        let mut points = Points::default();
        let longitudes = (0..64).map(|k| longitude + step * f64::from(k));
        let meridians = super::super::super::points::meridians(longitudes);
        points.set_row(&meridians, latitude);
        points
    }

    #[test]
    fn gradient_is_the_derivative() {
        let points = row(0.3, 0.01, 0.7);
        let mut values = vec![0.0; 64];
        let mut gradient = Vectors::default();
        gradient.reset(64);
        noise_gradient(&points, 7.0, 5, &mut values, &mut gradient);
        let mut plain = vec![0.0; 64];
        add_noise(&points, 7.0, 5, 1.0, &mut plain);
        for k in 0..63 {
            assert!((values[k] - plain[k]).abs() < 1e-5);
            let d = |p: &[f64]| ((p[k + 1] - p[k]) * 7.0) as f32;
            let mid = |g: &[f32]| 0.5 * (g[k] + g[k + 1]);
            let expected =
                d(&points.x) * mid(&gradient.x) + d(&points.y) * mid(&gradient.y) + d(&points.z) * mid(&gradient.z);
            assert!(
                (values[k + 1] - values[k] - expected).abs() < 2e-3,
                "{k}: {} {expected}",
                values[k + 1] - values[k]
            );
        }
    }

    #[test]
    fn noise_is_continuous_and_differs_between_seeds() {
        let points = row(-0.2, 1e-4, -0.4);
        for frequency in [3.0, 900.0, 2e4] {
            let of = |seed| {
                let mut out = vec![0.0; 64];
                add_noise(&points, frequency, seed, 1.0, &mut out);
                out
            };
            let (a, b) = (of(1), of(2));
            assert!(a.iter().zip(&b).any(|(a, b)| (a - b).abs() > 0.01), "{frequency}");
            if frequency < 1000.0 {
                assert!(a.windows(2).all(|w| (w[0] - w[1]).abs() < 1e-4 * frequency as f32 * 4.0), "{frequency}");
            }
        }
    }

    /// Blocks in one cell and partial blocks at the ends of rows are computed alike.
    #[test]
    fn bits_do_not_depend_on_the_other_positions_of_a_block() {
        let points = row(0.7, 1e-5, 0.2);
        let at = |k: usize| {
            let mut one = Points::default();
            one.push(points.at(k));
            one
        };
        for frequency in [3.0, 4_000.0, 30_000.0] {
            let of = |points: &Points| {
                let (mut sum, mut value) = (vec![0.0; points.len()], vec![0.0; points.len()]);
                let mut gradient = Vectors::default();
                gradient.reset(points.len());
                add_noise(points, frequency, 4, 2.0, &mut sum);
                noise_gradient(points, frequency, 4, &mut value, &mut gradient);
                (sum, value, gradient)
            };
            let (sums, values, gradient) = of(&points);
            for k in [0, 1, 15, 16, 31, 47, 63] {
                let (sum, value, single) = of(&at(k));
                assert_eq!((sum[0], value[0], single.at(0)), (sums[k], values[k], gradient.at(k)), "{frequency} {k}");
            }
        }
    }
}
