//! Layers of rock of different thickness and hardness: a flat bench, talus at a gentle slope, and a cliff of hard rock above it.

use super::super::points::Points;
use super::super::preset::Relief;
use super::{Scratch, add_octaves, part_seed, reset, smooth};

/// A layer at a height.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layer {
    /// The lower boundary and the thickness, in mean thicknesses.
    low: f32,
    thickness: f32,
    /// The place within the layer, 0..1.
    place: f32,
    /// 0 for soft rock, 1 for rock that makes cliffs.
    pub hardness: f32,
    /// A number within -1..1 for the layer's colour.
    pub tone: f32,
}

/// Returns random bits of a number of a boundary.
#[inline(always)]
fn bits(number: f32) -> u32 {
    let h = (number as i32 as u32).wrapping_mul(0x9e37_79b1);
    let h = (h ^ (h >> 15)).wrapping_mul(0x85eb_ca77);
    h ^ (h >> 13)
}

/// Returns eight bits of a number within -1..1.
#[inline(always)]
fn signed(bits: u32, shift: u32) -> f32 {
    ((bits >> shift) & 0xff) as i32 as f32 / 127.5 - 1.0
}

impl Layer {
    /// Returns the layer at a height in mean thicknesses.
    #[inline(always)]
    pub fn at(height: f32) -> Self {
        let whole = (height - 0.5 + 12_582_912.0) - 12_582_912.0;
        let boundary = |number: f32| number + 0.36 * signed(bits(number), 0);
        // Boundaries are moved by less than half of the mean thickness.
        let (here, next) = (boundary(whole), boundary(whole + 1.0));
        let number = if height < here {
            whole - 1.0
        } else if height < next {
            whole
        } else {
            whole + 1.0
        };
        let (low, high) = (boundary(number), boundary(number + 1.0));
        let bits = bits(number);
        Self {
            low,
            thickness: high - low,
            place: ((height - low) / (high - low)).clamp(0.0, 1.0),
            hardness: 0.5 + 0.5 * signed(bits, 8),
            tone: signed(bits, 16),
        }
    }

    /// Returns the height to which erosion brings a uniform slope, for rock of a hardness.
    #[inline(always)]
    pub fn eroded(self, hardness: f32) -> f32 {
        // The shares of the layer that are bench and talus, and the share of its height that is a cliff.
        const BENCH: f32 = 0.3;
        const CLIFF: f32 = 0.7;
        let cliff = 0.3 + 0.48 * hardness;
        let below = (1.0 - cliff) / CLIFF;
        let t = self.place;
        let bench = 0.55 * t.min(BENCH);
        let talus = (CLIFF - 0.55 * BENCH) / (CLIFF - BENCH) * (t.min(CLIFF) - BENCH).max(0.0);
        let face = cliff / (1.0 - CLIFF) * (t - CLIFF).max(0.0);
        self.low + self.thickness * (below * (bench + talus) + face)
    }
}

/// Returns a height stepped by layers. `dip_m` is the height by which the layers lie lower here than elsewhere.
#[inline(always)]
pub(super) fn stepped(height_m: f32, layer_m: f32, dip_m: f32, harder: f32) -> f32 {
    let layer = Layer::at((height_m + dip_m) / layer_m);
    let hardness = (layer.hardness + harder).clamp(0.0, 1.0);
    layer.eroded(hardness) * layer_m - dip_m
}

/// The thickness of layers in worlds without steps, for colours.
const PLAIN_LAYER_M: f32 = 110.0;

impl Relief {
    /// Returns the mean thickness of layers.
    pub fn strata_m(&self) -> f32 {
        if self.layer_m > 0.0 { self.layer_m } else { PLAIN_LAYER_M }
    }

    /// Computes how layers lie in `scratch.dip`, and how hard they are in `scratch.hard`.
    pub(super) fn set_strata(&self, seed: u64, points: &Points, s: &mut Scratch) {
        let n = points.len();
        for buffer in [&mut s.dip, &mut s.hard] {
            reset(buffer, n);
        }
        let layer_m = self.strata_m();
        add_octaves(points, 60_000.0, 3, 0.4, 1.6 * layer_m, part_seed(seed, 30), &mut s.dip);
        if self.layer_m > 0.0 {
            add_octaves(points, 9_000.0, 2, 0.5, 0.7, part_seed(seed, 33), &mut s.hard);
        }
    }

    /// Steps a height by layers of rock.
    pub(super) fn stepped(&self, height_m: f32, s: &Scratch, k: usize) -> f32 {
        if self.layer_m <= 0.0 {
            return height_m;
        }
        stepped(height_m, self.layer_m, s.dip[k], s.hard[k])
    }

    /// Turns some bands of the slopes of mountains in `scratch.detail` into cliffs above talus.
    pub(super) fn add_cliffs(&self, seed: u64, points: &Points, s: &mut Scratch) {
        let (n, cliff_m) = (points.len(), self.forms.cliff_m);
        if cliff_m <= 0.0 {
            return;
        }
        reset(&mut s.noise, n);
        add_octaves(points, 0.9 * self.massif_m, 3, 0.5, 1.0, part_seed(seed, 34), &mut s.noise);
        reset(&mut s.slope, n);
        add_octaves(points, 0.3 * self.massif_m, 3, 0.45, 0.8 * cliff_m, part_seed(seed, 37), &mut s.slope);
        for k in 0..n {
            // Not on the floors of valleys, and not everywhere.
            let share = smooth(-0.1, 0.35, s.noise[k]) * smooth(0.06, 0.2, s.detail[k]);
            if share > 0.0 {
                let height_m = self.mountain_m * s.detail[k];
                let cut_m = stepped(height_m, cliff_m, s.slope[k], 0.8 * s.noise[k]);
                s.detail[k] += share * (cut_m - height_m) / self.mountain_m;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_differ_in_thickness_and_join() {
        let heights: Vec<f32> = (0..60_000).map(|k| -20.0 + 0.001 * k as f32).collect();
        let mut thickness: Vec<f32> = heights.iter().map(|h| Layer::at(*h).thickness).collect();
        for (hardness, steepest) in [(0.0, 1.4), (1.0, 2.7)] {
            let cut: Vec<f32> = heights.iter().map(|h| Layer::at(*h).eroded(hardness)).collect();
            let slopes: Vec<f32> = cut.windows(2).map(|pair| (pair[1] - pair[0]) / 0.001).collect();
            assert!(slopes.iter().all(|slope| (0.0..steepest).contains(slope)), "heights rise without jumps");
            assert!(cut.iter().zip(&heights).all(|(cut, height)| (cut - height).abs() < 0.9));
        }
        thickness.sort_by(f32::total_cmp);
        thickness.dedup_by(|a, b| (*a - *b).abs() < 0.01);
        assert!(thickness.len() > 15 && thickness[0] > 0.25, "{thickness:?}");
        assert!(thickness[thickness.len() - 1] > 1.8 * thickness[0]);
    }
}
