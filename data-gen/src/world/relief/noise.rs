//! Noise in space from a hash, evaluated along rows of positions: gradient noise with and without its derivative, stripes
//! that follow a slope, waves, barchans and craters.
//!
//! The loops have no branches and no calls, so that the compiler can vectorise them. Neither fused multiply-add nor
//! functions of the C library are used, so that the bits are the same on every machine.

#![allow(clippy::needless_range_loop, reason = "one number indexes positions, weights and outputs")]

use super::super::points::{Points, ROUND};

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

/// Splits a coordinate below 2^31 into the number of its lattice cell and the position in it, 0..1.
#[inline(always)]
fn cell(x: f64) -> (u32, f32) {
    let rounded = (x - 0.5) + ROUND;
    (rounded.to_bits() as u32, (x - (rounded - ROUND)) as f32)
}

const HASH_X: u32 = 0x9e37_79b1;
const HASH_Y: u32 = 0x85eb_ca77;
const HASH_Z: u32 = 0xc2b2_ae3d;

/// Returns, for a point and each axis, the products of the coordinates of both lattice points around it for [`mix`], and the position
/// between them, 0..1.
#[inline(always)]
fn cell_at(point: [f64; 3], frequency: f64, seed: u32) -> ([[u32; 2]; 3], [f32; 3]) {
    let (ix, fx) = cell(point[0] * frequency);
    let (iy, fy) = cell(point[1] * frequency);
    let (iz, fz) = cell(point[2] * frequency);
    let x = [ix.wrapping_mul(HASH_X), ix.wrapping_mul(HASH_X).wrapping_add(HASH_X)];
    let y = [iy.wrapping_mul(HASH_Y), iy.wrapping_mul(HASH_Y).wrapping_add(HASH_Y)];
    let z = [iz.wrapping_mul(HASH_Z) ^ seed, iz.wrapping_mul(HASH_Z).wrapping_add(HASH_Z) ^ seed];
    ([x, y, z], [fx, fy, fz])
}

/// Mixes the products of a lattice point's coordinates.
#[inline(always)]
fn mix(x: u32, y: u32, z: u32) -> u32 {
    let h = x ^ y ^ z;
    let h = (h ^ (h >> 15)).wrapping_mul(0x7feb_352d);
    h ^ (h >> 15)
}

/// Ten bits of a hash as a number within -511.5..511.5.
#[inline(always)]
fn part(hash: u32, shift: u32) -> f32 {
    ((hash >> shift) & 0x3ff) as i32 as f32 - 511.5
}

/// Scales the dot products with gradients of [`part`] so that the noise lies within about -1..1.
const SCALE: f32 = 1.5 / 512.0;

/// Runs a loop with the widest registers that the processor has. The bits do not depend on them: nothing is fused.
#[inline(always)]
pub(crate) fn wide<R>(op: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(op)
}

/// Adds `amplitude` times gradient noise to `out`. `frequency` is the number of lattice cells per radius.
pub(crate) fn add_noise(points: &Points, frequency: f64, seed: u32, amplitude: f32, out: &mut [f32]) {
    let n = out.len();
    let (px, py, pz) = (&points.x[..n], &points.y[..n], &points.z[..n]);
    let amplitude = amplitude * SCALE;
    wide(
        #[inline(always)]
        move || {
            for k in 0..n {
                let ([x, y, z], [fx, fy, fz]) = cell_at([px[k], py[k], pz[k]], frequency, seed);
                let corner = |a: usize, b: usize, c: usize| {
                    let h = mix(x[a], y[b], z[c]);
                    part(h, 22) * (fx - a as f32) + part(h, 12) * (fy - b as f32) + part(h, 2) * (fz - c as f32)
                };
                let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
                let (u, v, w) = (fade(fx), fade(fy), fade(fz));
                let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
                let low = lerp(lerp(corner(0, 0, 0), corner(1, 0, 0), u), lerp(corner(0, 1, 0), corner(1, 1, 0), u), v);
                let high =
                    lerp(lerp(corner(0, 0, 1), corner(1, 0, 1), u), lerp(corner(0, 1, 1), corner(1, 1, 1), u), v);
                out[k] += amplitude * lerp(low, high, w);
            }
        },
    );
}

/// Writes gradient noise to `out` and its gradient, per lattice cell, to `gradient`.
pub(crate) fn noise_gradient(points: &Points, frequency: f64, seed: u32, out: &mut [f32], gradient: &mut Vectors) {
    let n = out.len();
    let (px, py, pz) = (&points.x[..n], &points.y[..n], &points.z[..n]);
    let (gx, gy, gz) = (&mut gradient.x[..n], &mut gradient.y[..n], &mut gradient.z[..n]);
    wide(
        #[inline(always)]
        move || {
            for k in 0..n {
                let ([x, y, z], [fx, fy, fz]) = cell_at([px[k], py[k], pz[k]], frequency, seed);
                let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
                let slope = |t: f32| 30.0 * t * t * (t * (t - 2.0) + 1.0);
                let (u, v, w) = ([1.0 - fade(fx), fade(fx)], [1.0 - fade(fy), fade(fy)], [1.0 - fade(fz), fade(fz)]);
                let (du, dv, dw) = (slope(fx), slope(fy), slope(fz));
                let (mut value, mut dx, mut dy, mut dz) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
                for c in 0..2 {
                    for b in 0..2 {
                        for a in 0..2 {
                            let h = mix(x[a], y[b], z[c]);
                            let g = [part(h, 22), part(h, 12), part(h, 2)];
                            let dot = g[0] * (fx - a as f32) + g[1] * (fy - b as f32) + g[2] * (fz - c as f32);
                            let sign = [-1.0f32, 1.0];
                            let weight = u[a] * v[b] * w[c];
                            value += weight * dot;
                            dx += weight * g[0] + sign[a] * du * v[b] * w[c] * dot;
                            dy += weight * g[1] + sign[b] * dv * u[a] * w[c] * dot;
                            dz += weight * g[2] + sign[c] * dw * u[a] * v[b] * dot;
                        }
                    }
                }
                out[k] = value * SCALE;
                gx[k] = dx * SCALE;
                gy[k] = dy * SCALE;
                gz[k] = dz * SCALE;
            }
        },
    );
}

/// Writes stripes within -1..1 that run along the slope: their phase advances by `across`, in turns per lattice cell, which
/// is perpendicular to the slope. Also writes their derivative along `across`, per turn. Each lattice point has stripes
/// with a phase of its own, which are blended; they branch where blended ones meet, as gullies do.
pub(crate) fn stripes(
    points: &Points,
    frequency: f64,
    seed: u32,
    across: &Vectors,
    out: &mut [f32],
    derivative: &mut [f32],
) {
    let n = out.len();
    let (px, py, pz) = (&points.x[..n], &points.y[..n], &points.z[..n]);
    let (qx, qy, qz) = (&across.x[..n], &across.y[..n], &across.z[..n]);
    let derivative = &mut derivative[..n];
    wide(
        #[inline(always)]
        move || {
            for k in 0..n {
                let ([x, y, z], [fx, fy, fz]) = cell_at([px[k], py[k], pz[k]], frequency, seed);
                let (u, v, w) = (weights(fx), weights(fy), weights(fz));
                let (mut value, mut slope) = (0.0f32, 0.0f32);
                for c in 0..2 {
                    for b in 0..2 {
                        for a in 0..2 {
                            let h = mix(x[a], y[b], z[c]);
                            let offset = [fx - a as f32, fy - b as f32, fz - c as f32];
                            let phase = phase_of(h, offset, [qx[k], qy[k], qz[k]]);
                            // A cosine of polynomials: 1 at whole turns, -1 between them.
                            let turn = phase - ((phase + 12_582_912.0) - 12_582_912.0);
                            let t = 2.0 * turn.abs();
                            let weight = u[a] * v[b] * w[c];
                            value += weight * (1.0 - 2.0 * t * t * (3.0 - 2.0 * t));
                            slope += weight * (-24.0 * t * (1.0 - t)) * turn.signum();
                        }
                    }
                }
                out[k] = value;
                derivative[k] = slope;
            }
        },
    );
}

/// Adds craters to `out`: one for a share of the lattice points near the sphere. A radius is at most 0.36 cells. Heights
/// are `amplitude` for each cell of a crater's radius.
pub(crate) fn add_craters(points: &Points, frequency: f64, seed: u32, share: f32, amplitude: f32, out: &mut [f32]) {
    let n = out.len();
    let (px, py, pz) = (&points.x[..n], &points.y[..n], &points.z[..n]);
    let missing = (1.0 - share) * 1024.0 - 512.0;
    wide(
        #[inline(always)]
        move || {
            for k in 0..n {
                let (nx, ny, nz) = (px[k] as f32, py[k] as f32, pz[k] as f32);
                let ([x, y, z], [fx, fy, fz]) = cell_at([px[k], py[k], pz[k]], frequency, seed);
                let mut sum = 0.0f32;
                for c in 0..2 {
                    for b in 0..2 {
                        for a in 0..2 {
                            let h = mix(x[a], y[b], z[c]);
                            let jitter = |shift: u32| part(h, shift) * (0.25 / 512.0);
                            let d = [fx - a as f32 + jitter(22), fy - b as f32 + jitter(12), fz - c as f32 + jitter(2)];
                            let above = d[0] * nx + d[1] * ny + d[2] * nz;
                            let squared = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - above * above).max(0.0);
                            // Sizes: many small craters, few large ones.
                            let other = h.wrapping_mul(0x9e37_79b1);
                            let size = ((other >> 12) & 0x3ff) as i32 as f32 / 1024.0;
                            let radius = 0.13 + 0.23 * size * size;
                            let is_there = if part(other, 22) > missing { 1.0f32 } else { 0.0 };
                            // Lattice points that are far above or below the ground have none.
                            let near = (1.0 - ((above.abs() - 0.25) * 10.0).clamp(0.0, 1.0)) * is_there;
                            let r = squared.sqrt() / radius;
                            // The bowl, the rim, and the blanket of ejecta around it, which ends at 1.7 radii.
                            let bowl = (r * r - 1.0) * 0.42 + 0.10;
                            let floor = (-0.24f32).max(bowl);
                            let t = ((1.7 - r) / 0.7).clamp(0.0, 1.0);
                            let outside = 0.10 * t * t * t;
                            let height = if r < 1.0 { floor } else { outside };
                            sum += near * radius * height;
                        }
                    }
                }
                out[k] += amplitude * sum;
            }
        },
    );
}

/// Returns the distance of a number from the nearest whole one.
#[inline(always)]
pub(crate) fn from_whole(x: f32) -> f32 {
    x - ((x + 12_582_912.0) - 12_582_912.0)
}

/// Returns the sine of a number of turns within -0.5..0.5, to 0.001.
#[inline(always)]
fn sine(turn: f32) -> f32 {
    let arc = 8.0 * turn * (1.0 - 2.0 * turn.abs());
    arc * (0.775 + 0.225 * arc.abs())
}

/// Returns the weights of the two lattice points around a place between them, 0..1.
#[inline(always)]
fn weights(place: f32) -> [f32; 2] {
    let fade = place * place * place * (place * (place * 6.0 - 15.0) + 10.0);
    [1.0 - fade, fade]
}

/// Returns the phase of a lattice point's stripes at an offset from it, in turns. The stripes pass through a random point
/// within half a cell around the lattice point.
#[inline(always)]
fn phase_of(hash: u32, offset: [f32; 3], turns_per_cell: [f32; 3]) -> f32 {
    let jitter = |shift: u32| part(hash, shift) * (0.5 / 512.0);
    (offset[0] + jitter(22)) * turns_per_cell[0]
        + (offset[1] + jitter(12)) * turns_per_cell[1]
        + (offset[2] + jitter(2)) * turns_per_cell[2]
}

/// Writes the phase of waves in turns, -0.5..0.5, which advances by `along` turns per lattice cell, and their strength, 0..1.
/// Each lattice point has waves with a phase of its own; where those of neighbours cancel each other, crests end or branch,
/// and the strength is 0. (Phasor noise: Tricard and others, 2019.)
pub(crate) fn waves(
    points: &Points,
    frequency: f64,
    seed: u32,
    along: &Vectors,
    turns: &mut [f32],
    strength: &mut [f32],
) {
    let n = turns.len();
    let (px, py, pz) = (&points.x[..n], &points.y[..n], &points.z[..n]);
    let (qx, qy, qz) = (&along.x[..n], &along.y[..n], &along.z[..n]);
    let strength = &mut strength[..n];
    wide(
        #[inline(always)]
        move || {
            for k in 0..n {
                let ([x, y, z], [fx, fy, fz]) = cell_at([px[k], py[k], pz[k]], frequency, seed);
                let (u, v, w) = (weights(fx), weights(fy), weights(fz));
                let (mut re, mut im) = (0.0f32, 0.0f32);
                for c in 0..2 {
                    for b in 0..2 {
                        for a in 0..2 {
                            let h = mix(x[a], y[b], z[c]);
                            let offset = [fx - a as f32, fy - b as f32, fz - c as f32];
                            let phase = phase_of(h, offset, [qx[k], qy[k], qz[k]]);
                            let weight = u[a] * v[b] * w[c];
                            re += weight * sine(from_whole(phase + 0.25));
                            im += weight * sine(from_whole(phase));
                        }
                    }
                }
                // The angle of (re, im) from that within an eighth of a turn, to 0.001 turns.
                let (large, small) = (re.abs().max(im.abs()), re.abs().min(im.abs()));
                let q = small / (large + 1e-9);
                let eighth = q * (0.125 + 0.0433 * (1.0 - q));
                let quarter = if im.abs() > re.abs() { 0.25 - eighth } else { eighth };
                let half = if re < 0.0 { 0.5 - quarter } else { quarter };
                turns[k] = if im < 0.0 { -half } else { half };
                strength[k] = (re * re + im * im).sqrt();
            }
        },
    );
}

/// Adds barchans to `out`, at most one for each lattice point near the sphere: heaps with a gentle side towards the wind, a lee
/// with the slope `repose`, and horns downwind. Heights are `amplitude` for each cell.
pub(crate) fn add_barchans(
    points: &Points,
    frequency: f64,
    seed: u32,
    wind: &Vectors,
    repose: f32,
    amplitude: f32,
    out: &mut [f32],
) {
    let n = out.len();
    let (px, py, pz) = (&points.x[..n], &points.y[..n], &points.z[..n]);
    let (wx, wy, wz) = (&wind.x[..n], &wind.y[..n], &wind.z[..n]);
    wide(
        #[inline(always)]
        move || {
            for k in 0..n {
                let (nx, ny, nz) = (px[k] as f32, py[k] as f32, pz[k] as f32);
                let (lx, ly, lz) = (ny * wz[k] - nz * wy[k], nz * wx[k] - nx * wz[k], nx * wy[k] - ny * wx[k]);
                let ([x, y, z], [fx, fy, fz]) = cell_at([px[k], py[k], pz[k]], frequency, seed);
                let mut highest = 0.0f32;
                for c in 0..2 {
                    for b in 0..2 {
                        for a in 0..2 {
                            let h = mix(x[a], y[b], z[c]);
                            let jitter = |shift: u32| part(h, shift) * (0.25 / 512.0);
                            let d = [fx - a as f32 + jitter(22), fy - b as f32 + jitter(12), fz - c as f32 + jitter(2)];
                            let above = d[0] * nx + d[1] * ny + d[2] * nz;
                            let other = h.wrapping_mul(0x9e37_79b1);
                            let size = ((other >> 12) & 0x3ff) as i32 as f32 / 1024.0;
                            // Half the width; the height is a tenth of the width.
                            let half = 0.07 + 0.17 * size * size;
                            let across = (d[0] * lx + d[1] * ly + d[2] * lz) / half;
                            let inside = (1.0 - across * across).max(0.0);
                            let crest_height = 0.24 * half * inside * (0.4 + 0.6 * inside);
                            // Downwind of the crest, which is bent.
                            let behind =
                                d[0] * wx[k] + d[1] * wy[k] + d[2] * wz[k] - half * (1.25 * across * across - 0.3);
                            let length = half * (0.25 + 1.55 * inside);
                            let up = (1.0 + behind / length).clamp(0.0, 1.0);
                            let windward = crest_height * up * (0.4 + up * (1.2 - 0.6 * up));
                            let lee = (crest_height - repose * behind.max(0.0)).max(0.0);
                            // Lattice points that are far above or below the ground have none.
                            let near = 1.0 - ((above.abs() - 0.3) * 20.0).clamp(0.0, 1.0);
                            highest = highest.max(near * windward.min(lee));
                        }
                    }
                }
                out[k] += amplitude * highest;
            }
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

    /// Phases advance as they are told to, and strengths vanish where they do not.
    #[test]
    fn waves_advance_along_their_direction() {
        let points = row(0.1, 2e-6, 0.6);
        let mut along = Vectors::default();
        along.reset(64);
        along.y.fill(3.0);
        let (mut turns, mut strength) = (vec![0.0; 64], vec![0.0; 64]);
        waves(&points, 2_000.0, 9, &along, &mut turns, &mut strength);
        assert!(
            turns.iter().all(|t| (-0.501..=0.501).contains(t)) && strength.iter().all(|s| (0.0..=1.01).contains(s))
        );
        let mut advanced = 0.0;
        for k in 0..63 {
            let step = from_whole(turns[k + 1] - turns[k]);
            assert!(step.abs() < 0.08, "{k}: {step}");
            advanced += step;
        }
        let expected = (points.y[63] - points.y[0]) as f32 * 2_000.0 * 3.0;
        assert!((advanced - expected).abs() < 0.4, "{advanced} turns, {expected} expected");
    }
}
