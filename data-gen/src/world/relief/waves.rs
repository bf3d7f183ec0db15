//! Stripes that follow a slope, and waves: each lattice point has some with a phase of its own, and those of neighbours are
//! blended.

#![allow(clippy::needless_range_loop, reason = "one number indexes positions, weights and outputs")]

use super::super::points::Points;
use super::lattice::{Block, LANES, Lanes, bit, for_blocks, lanes, parts};
use super::noise::{Vectors, weights};

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

/// Returns the phase of the stripes of a corner of a position's cell, in turns. The stripes pass through a random point,
/// `jitter`, within half a cell around the corner.
#[inline(always)]
fn phase_of(corner: usize, place: [f32; 3], jitter: [f32; 3], turns_per_cell: [f32; 3]) -> f32 {
    const HALF: f32 = 0.5 / 512.0;
    let off = |axis: usize| place[axis] - bit(corner, axis) as f32 + jitter[axis] * HALF;
    off(0) * turns_per_cell[0] + off(1) * turns_per_cell[1] + off(2) * turns_per_cell[2]
}

/// Returns the stripes at the positions of a block, and their derivative.
#[inline(always)]
fn stripes_of(block: &Block, across: &[Lanes<f32>; 3], jitter: impl Fn(usize, usize) -> [f32; 3]) -> [Lanes<f32>; 2] {
    let mut all = [[0.0; LANES]; 2];
    for k in 0..LANES {
        let (mut value, mut slope) = (0.0f32, 0.0f32);
        let place = [block.at[0][k], block.at[1][k], block.at[2][k]];
        let turns_per_cell = [across[0][k], across[1][k], across[2][k]];
        let (u, v, w) = (weights(place[0]), weights(place[1]), weights(place[2]));
        for corner in 0..8 {
            let phase = phase_of(corner, place, jitter(corner, k), turns_per_cell);
            let weight = u[bit(corner, 0)] * v[bit(corner, 1)] * w[bit(corner, 2)];
            // A cosine of polynomials: 1 at whole turns, -1 between them.
            let turn = from_whole(phase);
            let t = 2.0 * turn.abs();
            value += weight * (1.0 - 2.0 * t * t * (3.0 - 2.0 * t));
            slope += weight * (-24.0 * t * (1.0 - t)) * if turn < 0.0 { -1.0 } else { 1.0 };
        }
        all[0][k] = value;
        all[1][k] = slope;
    }
    all
}

/// Writes stripes within -1..1 that run along the slope: their phase advances by `across`, in turns per lattice cell, which
/// is perpendicular to the slope. Also writes their derivative along `across`, per turn. Stripes branch where blended ones
/// meet, as gullies do.
pub(crate) fn stripes(
    points: &Points,
    frequency: f64,
    seed: u32,
    across: &Vectors,
    out: &mut [f32],
    derivative: &mut [f32],
) {
    let n = out.len();
    let (qx, qy, qz) = (&across.x[..n], &across.y[..n], &across.z[..n]);
    let derivative = &mut derivative[..n];
    for_blocks(
        points,
        frequency,
        seed,
        n,
        #[inline(always)]
        move |range, block| {
            let across = [lanes(qx, range.start), lanes(qy, range.start), lanes(qz, range.start)];
            let [value, slope] = if block.is_one_cell {
                let corners = block.corners();
                stripes_of(
                    block,
                    &across,
                    #[inline(always)]
                    |corner, _| corners[corner],
                )
            } else {
                stripes_of(
                    block,
                    &across,
                    #[inline(always)]
                    |corner, k| parts(block.hash(corner, k)),
                )
            };
            let len = range.len();
            out[range.clone()].copy_from_slice(&value[..len]);
            derivative[range].copy_from_slice(&slope[..len]);
        },
    );
}

/// Writes the phase of waves in turns, -0.5..0.5, which advances by `along` turns per lattice cell, and their strength, 0..1.
/// Where the waves of neighbouring lattice points cancel each other, crests end or branch, and the strength is 0. (Phasor
/// noise: Tricard and others, 2019.)
pub(crate) fn waves(
    points: &Points,
    frequency: f64,
    seed: u32,
    along: &Vectors,
    turns: &mut [f32],
    strength: &mut [f32],
) {
    let n = turns.len();
    let (qx, qy, qz) = (&along.x[..n], &along.y[..n], &along.z[..n]);
    let strength = &mut strength[..n];
    for_blocks(
        points,
        frequency,
        seed,
        n,
        #[inline(always)]
        move |range, block| {
            let along = [lanes(qx, range.start), lanes(qy, range.start), lanes(qz, range.start)];
            let mut hashes = [[0u32; LANES]; 8];
            for corner in 0..8 {
                hashes[corner] = block.hashes(corner);
            }
            let (mut angles, mut lengths) = ([0.0; LANES], [0.0; LANES]);
            for k in 0..LANES {
                let (mut re, mut im) = (0.0f32, 0.0f32);
                let place = [block.at[0][k], block.at[1][k], block.at[2][k]];
                let turns_per_cell = [along[0][k], along[1][k], along[2][k]];
                let (u, v, w) = (weights(place[0]), weights(place[1]), weights(place[2]));
                for corner in 0..8 {
                    let phase = phase_of(corner, place, parts(hashes[corner][k]), turns_per_cell);
                    let weight = u[bit(corner, 0)] * v[bit(corner, 1)] * w[bit(corner, 2)];
                    re += weight * sine(from_whole(phase + 0.25));
                    im += weight * sine(from_whole(phase));
                }
                // The angle of (re, im) from that within an eighth of a turn, to 0.001 turns.
                let (large, small) = (re.abs().max(im.abs()), re.abs().min(im.abs()));
                let q = small / (large + 1e-9);
                let eighth = q * (0.125 + 0.0433 * (1.0 - q));
                let quarter = if im.abs() > re.abs() { 0.25 - eighth } else { eighth };
                let half = if re < 0.0 { 0.5 - quarter } else { quarter };
                angles[k] = if im < 0.0 { -half } else { half };
                lengths[k] = (re * re + im * im).sqrt();
            }
            let len = range.len();
            turns[range.clone()].copy_from_slice(&angles[..len]);
            strength[range].copy_from_slice(&lengths[..len]);
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
