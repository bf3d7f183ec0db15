//! The shares of a texel that rivers and glaciers cover, and the shape of a glacier.

use super::drainage::{Channel, Waters, difference_m, dot};
use super::smooth;

/// The distance between crevasses in metres.
const CREVASSES_M: f32 = 70.0;

/// The shares of a texel, 0..1.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Covers {
    pub water: f32,
    /// Stones on the ice.
    pub moraine: f32,
    pub crevasse: f32,
}

impl Waters {
    /// Returns the shares of a texel that rivers cover. Narrow ones are drawn a little wider, so that they are not dotted.
    pub fn river_covers(&self, at: [f64; 3], texel_m: f32) -> Covers {
        let at_m = difference_m(self.radius_m, self.middle, at);
        let mut water = 0.0f32;
        for channel in &self.channels {
            if channel.is_farther(at_m, 1.1 * texel_m) {
                continue;
            }
            let [bank_m, half_m] = channel.bank_m(at_m);
            let wider_m = (0.6 * texel_m - half_m).max(0.0);
            let share = ((wider_m - bank_m) / texel_m + 0.5).clamp(0.0, 1.0);
            water = water.max(share * (3.0 * half_m / texel_m).min(1.0).sqrt());
        }
        Covers { water, ..Covers::default() }
    }

    /// Returns the shares of a texel of glaciers. Glaciers carry stones at their sides, and where two have met.
    pub fn glacier_covers(&self, at: [f64; 3], texel_m: f32) -> Covers {
        let at_m = difference_m(self.radius_m, self.middle, at);
        let mut covers = Covers::default();
        let mut nearest_m = f32::MAX;
        for channel in &self.channels {
            let (t, distance_m, off) = channel.nearest(at_m);
            let half_m = channel.half_width_m(t);
            if distance_m - half_m > nearest_m || half_m < 1.0 {
                continue;
            }
            nearest_m = distance_m - half_m;
            // The place across the ice: -1 and 1 are its sides.
            let up = at.map(|c| c as f32);
            let a = channel.along_m;
            let left = [up[1] * a[2] - up[2] * a[1], up[2] * a[0] - up[0] * a[2], up[0] * a[1] - up[1] * a[0]];
            let across = distance_m / half_m * if dot(left, off) < 0.0 { -1.0 } else { 1.0 };
            let line = |middle: f32, width_m: f32| {
                let width = width_m.max(0.7 * texel_m) / half_m;
                (1.0 - smooth(0.4, 1.0, (across - middle).abs() / width)) * (width_m / texel_m).min(1.0)
            };
            let sides = line(-1.02, 45.0).max(line(1.02, 45.0));
            let middles = channel.moraines.map(|middle| line(middle, 26.0));
            let met = if channel.is_source { 0.0 } else { middles[0].max(middles[1]) };
            covers.moraine = sides.max(0.85 * met);
            let open = channel.open_crevasses(t, distance_m, half_m);
            // Crevasses narrower than a texel only tint it.
            let seen = smooth(0.5 * CREVASSES_M, 0.15 * CREVASSES_M, texel_m);
            let tint = 0.35 * channel.steepness(t);
            covers.crevasse = (tint + (open - tint) * seen) * smooth(0.0, -40.0, nearest_m);
        }
        covers
    }
}

impl Channel {
    /// Returns how far ice is torn, 0..1: where it descends steeply.
    fn steepness(&self, t: f32) -> f32 {
        let fall = (self.levels_m[0] - self.levels_m[1]) * self.per_length2.sqrt();
        smooth(0.03, 0.16, fall) * smooth(0.0, 0.15, t)
    }

    /// Returns the share of crevasses: arcs across the ice.
    fn open_crevasses(&self, t: f32, distance_m: f32, half_m: f32) -> f32 {
        let along_m = t / self.per_length2.sqrt();
        let place = (along_m - 0.4 * distance_m * distance_m / half_m) / CREVASSES_M;
        let from_middle = (place - place.floor() - 0.5).abs();
        smooth(0.16, 0.06, from_middle) * self.steepness(t)
    }

    /// Returns the height of a glacier's surface, or of the moraine beside it, above the level of its middle.
    pub(super) fn ice_m(&self, t: f32, distance_m: f32, half_m: f32) -> f32 {
        let bank_m = distance_m - half_m;
        if bank_m < 0.0 {
            let across = distance_m / half_m;
            let bulge_m = 0.035 * half_m * (1.0 - across * across);
            return bulge_m - 9.0 * self.open_crevasses(t, distance_m, half_m) * smooth(0.0, -40.0, bank_m);
        }
        // A ridge of stones along the ice.
        14.0 * (smooth(0.0, 30.0, bank_m) - smooth(30.0, 80.0, bank_m))
    }
}
