//! Samples of a lattice inside a window.
//!
//! The lattice of depth `d` has every `2^d`-th vertex of the finest level along both axes. Its columns count from the western
//! edge of the set and its rows from the southern one, so that a column and row name the same place in every window.

/// A rectangle of columns and rows of a lattice, the first and the last included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    pub first: [i64; 2],
    pub last: [i64; 2],
}

impl Window {
    /// Returns the window of a square with a margin on each side, clamped to a lattice with `cells` cells along a side.
    pub fn around(first: [i64; 2], side: i64, margin: i64, cells: i64) -> Self {
        Self {
            first: first.map(|c| (c - margin).clamp(0, cells)),
            last: first.map(|c| (c + side + margin).clamp(0, cells)),
        }
    }

    pub fn width(&self) -> usize {
        (self.last[0] - self.first[0] + 1) as usize
    }

    pub fn height(&self) -> usize {
        (self.last[1] - self.first[1] + 1) as usize
    }

    /// Returns true if another window lies inside this one.
    pub fn contains(&self, other: &Self) -> bool {
        (0..2).all(|k| self.first[k] <= other.first[k] && other.last[k] <= self.last[k])
    }

    /// Returns the part of this window inside another one, if there is any.
    pub fn intersection(&self, other: &Self) -> Option<Self> {
        let both = Self {
            first: [0, 1].map(|k| self.first[k].max(other.first[k])),
            last: [0, 1].map(|k| self.last[k].min(other.last[k])),
        };
        (0..2).all(|k| both.first[k] <= both.last[k]).then_some(both)
    }
}

/// A height in metres at a column and row of the lattice of a depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HeightAt {
    pub depth: u32,
    pub at: [i64; 2],
    pub height_m: f32,
}

/// Heights in metres at the vertices of a window, rows from south to north, each from west to east. NaN marks vertices
/// without data.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Samples {
    pub window: Window,
    pub values: Vec<f32>,
}

impl Samples {
    /// Creates samples without data.
    pub fn unknown(window: Window) -> Self {
        Self { window, values: vec![f32::NAN; window.width() * window.height()] }
    }

    /// Returns the sample at a column and row. Outside of the window it is the nearest sample inside.
    pub fn at(&self, x: i64, y: i64) -> f32 {
        let [x, y] = self.nearest(x, y);
        self.values[y * self.window.width() + x]
    }

    /// Sets the sample at a column and row inside the window.
    pub fn set(&mut self, x: i64, y: i64, height_m: f32) {
        let [x, y] = self.nearest(x, y);
        self.values[y * self.window.width() + x] = height_m;
    }

    /// Returns the samples of a row from a column on, to the window's eastern edge.
    pub fn row_from(&self, x: i64, y: i64) -> &[f32] {
        let ([x, y], width) = (self.nearest(x, y), self.window.width());
        &self.values[y * width + x..(y + 1) * width]
    }

    fn nearest(&self, x: i64, y: i64) -> [usize; 2] {
        let Window { first, last } = self.window;
        [(x.clamp(first[0], last[0]) - first[0]) as usize, (y.clamp(first[1], last[1]) - first[1]) as usize]
    }

    pub fn has_unknown(&self) -> bool {
        self.values.iter().any(|h| h.is_nan())
    }

    /// Returns true if any sample in a window inside this one has data.
    pub fn has_data_in(&self, part: &Window) -> bool {
        let rows = part.first[1]..=part.last[1];
        rows.into_iter().any(|y| self.row_from(part.first[0], y)[..part.width()].iter().any(|h| !h.is_nan()))
    }

    /// Copies the samples that another window of the same lattice has in common with this one.
    pub fn copy_from(&mut self, other: &Self) {
        let Some(both) = self.window.intersection(&other.window) else { return };
        let (width, wide) = (self.window.width(), both.width());
        for y in both.first[1]..=both.last[1] {
            let [x, row] = self.nearest(both.first[0], y);
            let to = row * width + x;
            self.values[to..to + wide].copy_from_slice(&other.row_from(both.first[0], y)[..wide]);
        }
    }

    /// Returns every second sample: those of the next coarser lattice.
    pub fn every_second(&self) -> Self {
        let Window { first, last } = self.window;
        let window = Window { first: first.map(|c| (c + 1).div_euclid(2)), last: last.map(|c| c.div_euclid(2)) };
        let mut out = Self::unknown(window);
        let width = window.width();
        for (row, out) in out.values.chunks_mut(width).enumerate() {
            let from = self.row_from(2 * window.first[0], 2 * (window.first[1] + row as i64));
            out.iter_mut().zip(from.iter().step_by(2)).for_each(|(out, h)| *out = *h);
        }
        out
    }

    /// Blurs with the kernel `[1 2 1]` and keeps every second sample.
    pub fn halved(&self, cells: i64) -> Self {
        self.blurred(cells, 2)
    }

    /// Blurs with the kernel `[1 2 1]` and keeps every `step`-th sample. Samples without data do not contribute, and stay
    /// without data. The result is smaller by the samples whose neighbours lie outside of the window; beyond the edges of the
    /// set, which has `cells` cells along a side of this lattice, the outermost samples are repeated.
    pub fn blurred(&self, cells: i64, step: i64) -> Self {
        let Window { first, last } = self.window;
        let window = Window {
            first: first.map(|c| if c == 0 { 0 } else { (c + step).div_euclid(step) }),
            last: last.map(|c| if c == cells { c / step } else { (c - 1).div_euclid(step) }),
        };
        let width = window.width();
        let mut out = Self::unknown(window);
        let weights = [(-1, 1.0f32), (0, 2.0), (1, 1.0)];
        for (row, out) in out.values.chunks_mut(width).enumerate() {
            let y = step * (window.first[1] + row as i64);
            let rows = weights.map(|(dy, _)| self.row_from(first[0], (y + dy).clamp(0, cells)));
            for (k, out) in out.iter_mut().enumerate() {
                let x = step * (window.first[0] + k as i64);
                let columns = weights.map(|(dx, _)| ((x + dx).clamp(0, cells) - first[0]) as usize);
                if rows[1][columns[1]].is_nan() {
                    continue;
                }
                let mut sum = 0.0;
                for (row, (_, wy)) in rows.iter().zip(weights) {
                    for (column, (_, wx)) in columns.iter().zip(weights) {
                        sum += wx * wy * row[*column];
                    }
                }
                *out = if sum.is_nan() { known_mean(&rows, &columns) } else { sum / 16.0 };
            }
        }
        out
    }

    /// Interpolates at a column and row with fractions.
    pub fn bilinear(&self, x: f64, y: f64) -> f32 {
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = ((x - x0) as f32, (y - y0) as f32);
        let at = |dx: i64, dy: i64| self.at(x0 as i64 + dx, y0 as i64 + dy);
        let low = at(0, 0) + (at(1, 0) - at(0, 0)) * fx;
        let high = at(0, 1) + (at(1, 1) - at(0, 1)) * fx;
        low + (high - low) * fy
    }
}

/// Returns the mean of the samples with data, with the weights of [`Samples::halved`].
fn known_mean(rows: &[&[f32]; 3], columns: &[usize; 3]) -> f32 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for (row, wy) in rows.iter().zip([1.0, 2.0, 1.0]) {
        for (column, wx) in columns.iter().zip([1.0, 2.0, 1.0]) {
            let h = row[*column];
            if !h.is_nan() {
                sum += wx * wy * h;
                weights += wx * wy;
            }
        }
    }
    sum / weights
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(first: [i64; 2], last: [i64; 2]) -> Samples {
        let mut out = Samples::unknown(Window { first, last });
        for y in first[1]..=last[1] {
            for x in first[0]..=last[0] {
                let h = (x * x % 7 + y * y % 5) as f32 + 0.1 * (x - y) as f32;
                out.set(x, y, if (x + 2 * y) % 11 == 0 { f32::NAN } else { h });
            }
        }
        out
    }

    #[test]
    fn windows_of_one_lattice_agree_where_they_overlap() {
        let whole = samples([0, 0], [32, 32]);
        for (first, last) in [([0, 4], [13, 32]), ([5, 5], [24, 23]), ([16, 0], [32, 9])] {
            let part = samples(first, last);
            for (whole, part) in [(whole.halved(32), part.halved(32)), (whole.every_second(), part.every_second())] {
                let Window { first, last } = part.window;
                for y in first[1]..=last[1] {
                    for x in first[0]..=last[0] {
                        assert_eq!(part.at(x, y).to_bits(), whole.at(x, y).to_bits(), "{x} {y}");
                    }
                }
            }
        }
        let mut copy = Samples::unknown(whole.window);
        copy.copy_from(&samples([3, 4], [9, 30]));
        assert_eq!(copy.values.iter().filter(|h| !h.is_nan()).count(), {
            let part = samples([3, 4], [9, 30]);
            part.values.iter().filter(|h| !h.is_nan()).count()
        });
    }
}
