//! Gradient noise in 2D from a hash: Perlin's improved noise (2002) with eight gradients.
//!
//! Each position is computed independently of others. The bits are the same on every machine, because neither fused
//! multiply-add nor transcendental functions are used.

use terrane::math::random::{SplitMix64, mix64};

/// Hashes a lattice point and a seed.
fn hash(x: i64, y: i64, seed: u64) -> u64 {
    let x = (x as u64).wrapping_mul(SplitMix64::GOLDEN_GAMMA);
    mix64(seed ^ x ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f))
}

const DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;
const GRADIENTS: [[f64; 2]; 8] = [
    [1.0, 0.0],
    [DIAGONAL, DIAGONAL],
    [0.0, 1.0],
    [-DIAGONAL, DIAGONAL],
    [-1.0, 0.0],
    [-DIAGONAL, -DIAGONAL],
    [0.0, -1.0],
    [DIAGONAL, -DIAGONAL],
];

/// Rounds down. Without SSE4.1 `f64::floor` is a function call; this is not.
fn floor(x: f64) -> i64 {
    let towards_zero = x as i64;
    towards_zero - i64::from(x < towards_zero as f64)
}

/// Returns noise of about -1..1 that is zero at lattice points. The lattice spacing is 1.
pub(crate) fn gradient(x: f64, y: f64, seed: u64) -> f64 {
    let (ix, iy) = (floor(x), floor(y));
    let (fx, fy) = (x - ix as f64, y - iy as f64);
    let corner = |dx: i64, dy: i64| {
        let [gx, gy] = GRADIENTS[(hash(ix + dx, iy + dy, seed) >> 61) as usize];
        gx * (fx - dx as f64) + gy * (fy - dy as f64)
    };
    let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (u, v) = (fade(fx), fade(fy));
    let bottom = corner(0, 0) + u * (corner(1, 0) - corner(0, 0));
    let top = corner(0, 1) + u * (corner(1, 1) - corner(0, 1));
    1.5 * (bottom + v * (top - bottom))
}

/// Adds `amplitude` times gradient noise to `out`, along a row of positions `x + k * step` with `step` above 0. The
/// corners of a lattice cell are hashed once for all positions in it, and the inner loop can be vectorised.
pub(crate) fn add_gradient_row(out: &mut [f32], amplitude: f64, x: f64, step: f64, y: f64, seed: u64) {
    let iy = floor(y);
    let fy = y - iy as f64;
    let v = fy * fy * fy * (fy * (fy * 6.0 - 15.0) + 10.0);
    // The two corners of a lattice column blended over y: a linear function of x, as offset and slope.
    let column = |ix: i64| {
        let [ax, ay] = GRADIENTS[(hash(ix, iy, seed) >> 61) as usize];
        let [bx, by] = GRADIENTS[(hash(ix, iy + 1, seed) >> 61) as usize];
        let (bottom, top) = (ay * fy, by * (fy - 1.0));
        [bottom + v * (top - bottom), ax + v * (bx - ax)].map(|c| (1.5 * amplitude * c) as f32)
    };
    let (mut done, mut cell, mut right) = (0, i64::MIN, [0.0; 2]);
    while done < out.len() {
        let at = x + step * done as f64;
        let ix = floor(at);
        let left = if cell.checked_add(1) == Some(ix) { right } else { column(ix) };
        right = column(ix + 1);
        cell = ix;
        let fx = at - ix as f64;
        // At the boundary of two cells both give the same value, so one position too many is harmless.
        let inside = (((1.0 - fx) / step) as usize + 1).min(out.len() - done);
        let (fx, step) = (fx as f32, step as f32);
        for (k, value) in out[done..done + inside].iter_mut().enumerate() {
            let t = fx + step * k as i32 as f32;
            let fade = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
            let (l, r) = (left[0] + left[1] * t, right[0] + right[1] * (t - 1.0));
            *value += l + fade * (r - l);
        }
        done += inside;
    }
}

/// Computes [`fbm`] along a row. Octaves finer than two steps are left out, because they would alias.
pub(crate) fn fbm_row(out: &mut [f32], x: f64, step: f64, y: f64, octaves: u32, seed: u64) {
    out.fill(0.0);
    let (mut amplitude, mut frequency) = (0.5, 1.0);
    for octave in 0..octaves {
        if step * frequency > 0.5 {
            return;
        }
        let seed = seed.wrapping_add(u64::from(octave));
        add_gradient_row(out, amplitude, x * frequency, step * frequency, y * frequency, seed);
        amplitude *= 0.5;
        frequency *= 2.03;
    }
}

/// Returns fractal noise of about -1..1: a sum of octaves, each at twice the frequency and half the amplitude.
pub(crate) fn fbm(x: f64, y: f64, octaves: u32, seed: u64) -> f64 {
    let (mut sum, mut amplitude, mut frequency) = (0.0, 0.5, 1.0);
    for octave in 0..octaves {
        sum += amplitude * gradient(x * frequency, y * frequency, seed.wrapping_add(u64::from(octave)));
        amplitude *= 0.5;
        frequency *= 2.03;
    }
    sum
}

/// Returns ridged multifractal noise, 0..1 (Musgrave, Texturing and Modeling): ridges are detailed, valleys smooth.
pub(crate) fn ridged(x: f64, y: f64, octaves: u32, seed: u64) -> f64 {
    let (mut sum, mut amplitude, mut frequency, mut weight, mut total) = (0.0, 1.0, 1.0, 1.0, 0.0);
    for octave in 0..octaves {
        let n = 1.0 - gradient(x * frequency, y * frequency, seed.wrapping_add(u64::from(octave))).abs();
        let signal = n * n * weight;
        sum += signal * amplitude;
        total += amplitude;
        weight = (signal * 1.9).clamp(0.0, 1.0);
        amplitude *= 0.48;
        frequency *= 2.07;
    }
    sum / total
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn row_equals_single_points() {
        for (x, step, y) in [(-3.7, 0.031, 2.3), (812.4, 0.37, -55.9), (0.0, 1.9, 0.0), (9.0, 0.25, 4.0)] {
            let mut row = [1.0f32; 300];
            add_gradient_row(&mut row, 0.7, x, step, y, 42);
            for (k, value) in row.iter().enumerate() {
                let point = 1.0 + 0.7 * gradient(x + step * k as f64, y, 42);
                assert!((f64::from(*value) - point).abs() < 1e-5, "{k}: {value}, not {point}");
            }
        }
    }

    #[test]
    fn row_leaves_out_octaves_that_would_alias() {
        let (x, y) = (17.3, 5.9);
        let mut row = [9.0f32; 64];
        fbm_row(&mut row, x, 0.01, y, 6, 7);
        for (k, value) in row.iter().enumerate() {
            assert!((f64::from(*value) - fbm(x + 0.01 * k as f64, y, 6, 7)).abs() < 1e-5);
        }
        // 0.2, 0.406 and 0.82 cells per step: only the first two octaves are used.
        fbm_row(&mut row, x, 0.2, y, 6, 7);
        for (k, value) in row.iter().enumerate() {
            assert!((f64::from(*value) - fbm(x + 0.2 * k as f64, y, 2, 7)).abs() < 1e-5);
        }
    }
}
