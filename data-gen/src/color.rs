//! Colour of a tile: natural by height, slope and noise with baked ambient shading, or from given imagery.
//!
//! Every texel depends on its place in the world alone, so the edges of neighbouring tiles agree. The sun's light is
//! the renderer's; baked is only how much sky a place sees.

use crate::imagery::Imagery;
use crate::noise::{fbm, gradient};
use crate::procedural::smooth;
use crate::pyramid::{Pyramid, TileKey};

/// Texels along a tile's side.
pub(crate) const TEXELS: u32 = 256;

/// What colours tiles.
pub(crate) struct Painter<'a> {
    pub pyramid: &'a Pyramid,
    pub imagery: Option<&'a Imagery>,
    /// Smoothed heights: level 0 the grid itself, each next half as fine, with their sides.
    smoothed: Vec<(usize, Vec<f32>)>,
    low_m: f64,
    high_m: f64,
}

impl<'a> Painter<'a> {
    pub fn new(pyramid: &'a Pyramid, imagery: Option<&'a Imagery>) -> Self {
        let mut smoothed = vec![(pyramid.grid.side, pyramid.grid.heights.clone())];
        while smoothed.len() < pyramid.levels as usize + 3 {
            let Some((side, fine)) = smoothed.last() else { break };
            if *side < 5 {
                break;
            }
            smoothed.push(halve(*side, fine));
        }
        let root = pyramid.facts(TileKey { level: 0, x: 0, y: 0 });
        let (low_m, high_m) = (f64::from(root.min_height_m), f64::from(root.max_height_m));
        Self { pyramid, imagery, smoothed, low_m, high_m }
    }

    /// RGB, north row first.
    pub fn paint(&self, key: TileKey) -> Vec<u8> {
        let e = self.pyramid.extent(key);
        let n = TEXELS as usize;
        let mut rgb = Vec::with_capacity(n * n * 3);
        // Two levels finer than the tile: one texel is one cell there.
        let depth = (self.pyramid.levels - 1 - key.level).saturating_sub(2) as usize;
        let tiles = f64::from(1u32 << key.level);
        let world = self.pyramid.grid.extent;
        let mean_lat = 0.5 * (world.south + world.north);
        let meters =
            [6_371_000.0 * mean_lat.cos() * (world.east - world.west), 6_371_000.0 * (world.north - world.south)];
        for row in 0..n {
            let v = (f64::from(key.y) + 1.0 - (row as f64 + 0.5) / n as f64) / tiles;
            let latitude = e.north - (e.north - e.south) * (row as f64 + 0.5) / n as f64;
            for column in 0..n {
                let u = (f64::from(key.x) + (column as f64 + 0.5) / n as f64) / tiles;
                let longitude = e.west + (e.east - e.west) * (column as f64 + 0.5) / n as f64;
                let picture = self.imagery.and_then(|i| i.at(longitude, latitude));
                let color = picture.unwrap_or_else(|| self.natural(u, v, depth, meters));
                rgb.extend(color.map(|c| c.clamp(0.0, 255.0).round() as u8));
            }
        }
        rgb
    }

    /// Height at (u, v) in 0..1 over the set, from the smoothed level `depth`.
    fn height(&self, u: f64, v: f64, depth: usize) -> f64 {
        let (side, heights) = &self.smoothed[depth.min(self.smoothed.len() - 1)];
        let last = (*side - 1) as f64;
        let (x, y) = ((u * last).clamp(0.0, last), (v * last).clamp(0.0, last));
        let (x0, y0) = ((x as usize).min(side - 2), (y as usize).min(side - 2));
        let (fx, fy) = (x - x0 as f64, y - y0 as f64);
        let at = |x: usize, y: usize| f64::from(heights[y * side + x]);
        let low = at(x0, y0) * (1.0 - fx) + at(x0 + 1, y0) * fx;
        let high = at(x0, y0 + 1) * (1.0 - fx) + at(x0 + 1, y0 + 1) * fx;
        low * (1.0 - fy) + high * fy
    }

    /// sRGB 0..255 of terrain in a temperate climate.
    fn natural(&self, u: f64, v: f64, depth: usize, meters: [f64; 2]) -> [f64; 3] {
        let (side, _) = self.smoothed[depth.min(self.smoothed.len() - 1)];
        let step = 1.0 / (side - 1) as f64;
        let h = self.height(u, v, depth);
        let dx = (self.height(u + step, v, depth) - self.height(u - step, v, depth)) / (2.0 * step * meters[0]);
        let dy = (self.height(u, v + step, depth) - self.height(u, v - step, depth)) / (2.0 * step * meters[1]);
        let slope = dx.hypot(dy);
        let (x, y) = (u * meters[0], v * meters[1]);
        let patch = fbm(x / 1700.0, y / 1700.0, 6, 901);
        let grain = gradient(x / 70.0, y / 70.0, 902);
        // Heights relative to the set, so that any mountains have meadows below and snow above.
        let span = (self.high_m - self.low_m).max(1.0);
        // Snow lies by height above the sea, not by height in the set.
        let snow_line = smooth(2300.0, 2900.0, h + 260.0 * patch + 60.0 * grain);
        let tall = smooth(300.0, 1800.0, span);
        let t = (h - self.low_m) / span + 0.05 * patch;
        let mix = |a: [f64; 3], b: [f64; 3], t: f64| [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * t.clamp(0.0, 1.0));
        let meadow = mix([104.0, 122.0, 62.0], [134.0, 138.0, 82.0], 0.5 + 0.9 * patch);
        let forest = mix([58.0, 82.0, 46.0], [76.0, 98.0, 54.0], 0.5 + 0.5 * grain);
        let alpine = mix([122.0, 122.0, 84.0], [104.0, 104.0, 76.0], 0.5 + patch);
        let rock = mix([112.0, 106.0, 98.0], [140.0, 132.0, 120.0], 0.5 + 0.5 * grain + 0.3 * patch);
        let scree = [148.0, 142.0, 132.0];
        let snow = [240.0, 244.0, 250.0];
        let mut color = mix(meadow, forest, smooth(-0.10, 0.42, patch + 0.30 * smooth(0.1, 0.4, slope) + 0.06 * grain));
        color = mix(color, alpine, smooth(0.42, 0.58, t));
        color = mix(color, scree, 0.7 * tall * smooth(0.60, 0.74, t));
        color = mix(color, rock, smooth(0.45, 0.85, slope + 0.08 * grain));
        color = mix(color, snow, snow_line * (1.0 - smooth(0.75, 1.25, slope)));
        // Ambient: how far the place lies below its surroundings at three scales.
        let mut open = 0.0;
        for k in 1..=3 {
            let around = self.height(u, v, depth + 2 * k);
            let scale_m = step * meters[1] * (1 << (2 * k)) as f64;
            open += (h - around) / scale_m;
        }
        let ambient = 1.0 + 0.55 * (open / (0.25 + open.abs())).clamp(-0.62, 0.35);
        let shade = ambient * (1.0 + 0.05 * grain);
        color.map(|c| c * shade)
    }
}

/// Every second sample of a `[1 2 1]` blur.
fn halve(side: usize, fine: &[f32]) -> (usize, Vec<f32>) {
    let half = (side - 1) / 2 + 1;
    let at = |x: i64, y: i64| {
        let c = |v: i64| v.clamp(0, side as i64 - 1) as usize;
        fine[c(y) * side + c(x)]
    };
    let mut out = Vec::with_capacity(half * half);
    for j in 0..half as i64 {
        for i in 0..half as i64 {
            let mut sum = 0.0;
            for (dy, wy) in [(-1, 1.0), (0, 2.0), (1, 1.0)] {
                for (dx, wx) in [(-1, 1.0), (0, 2.0), (1, 1.0)] {
                    sum += wx * wy * at(2 * i + dx, 2 * j + dy);
                }
            }
            out.push(sum / 16.0);
        }
    }
    (half, out)
}
