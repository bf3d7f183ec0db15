//! [`Surface`]: the samples of a tile as a surface whose triangles are flat.

use super::rows::MAX_CELLS;

/// The samples from one row to the next.
pub(super) const STRIDE: usize = MAX_CELLS as usize + 1;

/// The samples of a tile. Triangles between them are flat in space, but the earth is round. Heights are lowered by the
/// bulge of the earth above a plane, so that a flat triangle is linear in column and row. The vertical distance of two surfaces
/// is then the difference of their values.
pub(crate) struct Surface {
    side: usize,
    /// Lowered heights in metres, southern row first, each row from west to east and filled up to [`STRIDE`] samples.
    values_m: Vec<f64>,
    /// The triangles of each cell that have data, south-eastern and north-western, of the tile and of one cell around it; empty
    /// if all have.
    data: Vec<[bool; 2]>,
}

impl Surface {
    /// Creates the surface of `side * side` samples, `side` at least 2 and at most [`STRIDE`]. `curvature_m` returns for a row
    /// the height in metres by which the earth falls below its tangent plane within one cell eastwards and one northwards.
    /// `has_data` returns which triangles of a cell have data; cells outside of the tile, from -1 to `side - 1`, belong to its
    /// neighbours.
    pub fn new(
        side: usize,
        height_m: impl Fn(i64, i64) -> f32,
        curvature_m: impl Fn(i64) -> [f64; 2],
        has_data: Option<&dyn Fn(i64, i64) -> [bool; 2]>,
    ) -> Self {
        let middle = 0.5 * (side - 1) as f64;
        let mut values_m = Vec::with_capacity(side * STRIDE);
        for j in 0..side {
            let [east_m, north_m] = curvature_m(j as i64);
            let row_m = north_m * (j as f64 - middle).powi(2);
            values_m.extend((0..side).map(|i| {
                let bulge_m = east_m * (i as f64 - middle).powi(2) + row_m;
                f64::from(height_m(i as i64, j as i64)) - bulge_m
            }));
            values_m.resize((j + 1) * STRIDE, 0.0);
        }
        let cells = -1..side as i64;
        let data = has_data.map_or_else(Vec::new, |has_data| {
            cells.clone().flat_map(|j| cells.clone().map(move |i| has_data(i, j))).collect::<Vec<_>>()
        });
        let is_whole = data.iter().all(|triangles| *triangles == [true; 2]);
        Self { side, values_m, data: if is_whole { Vec::new() } else { data } }
    }

    /// Returns the number of samples along a side.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Returns true if all triangles have data.
    pub fn is_whole(&self) -> bool {
        self.data.is_empty()
    }

    /// Returns the lowered height of a sample in metres.
    #[inline(always)]
    pub fn at(&self, sample: [i32; 2]) -> f64 {
        self.values_m[Self::index(sample)]
    }

    /// Returns the index of a sample among [`Self::values_m`].
    #[inline(always)]
    pub fn index([i, j]: [i32; 2]) -> usize {
        j as usize * STRIDE + i as usize
    }

    /// Returns all lowered heights in metres, in rows of [`STRIDE`].
    #[inline(always)]
    pub fn values_m(&self) -> &[f64] {
        &self.values_m
    }

    /// Returns the lowered heights of a part of a row.
    pub fn row(&self, j: i32, from: i32, to: i32) -> &[f64] {
        let first = j as usize * STRIDE;
        &self.values_m[first + from as usize..=first + to as usize]
    }

    /// Returns how much the surface bends at samples of a row, from one column to the one before `end`, in metres. A sample
    /// bends by its distance from the middle of the western and eastern neighbours, or of the southern and northern ones,
    /// whichever is larger.
    #[inline(always)]
    pub fn bends_m(&self, j: i32, from: i32, end: i32) -> impl Iterator<Item = f64> {
        let [south, own, north] = [j - 1, j, j + 1].map(|j| self.row(j, from - 1, end));
        own.windows(3).zip(south[1..].iter().zip(&north[1..])).map(|(along, (south, north))| {
            let (across, along) = (along[1] - 0.5 * (south + north), along[1] - 0.5 * (along[0] + along[2]));
            across.abs().max(along.abs())
        })
    }

    /// Returns which triangles of a cell have data: the south-eastern and the north-western one. Cells from -1 to `side - 1`.
    pub fn data(&self, [i, j]: [i32; 2]) -> [bool; 2] {
        if self.is_whole() {
            return [true; 2];
        }
        self.data[(j + 1) as usize * (self.side + 1) + (i + 1) as usize]
    }

    /// Returns the six triangles around a sample: true for those with data.
    fn around(&self, [i, j]: [i32; 2]) -> [bool; 6] {
        let [se_ne, nw_ne] = self.data([i, j]);
        let [se_sw, nw_sw] = self.data([i - 1, j - 1]);
        [se_ne, nw_ne, se_sw, nw_sw, self.data([i - 1, j])[0], self.data([i, j - 1])[1]]
    }

    /// Returns true if a triangle at the sample has data.
    pub fn is_used(&self, sample: [i32; 2]) -> bool {
        self.is_whole() || self.around(sample).contains(&true)
    }

    /// Returns true for samples on the border between triangles with data and those without.
    pub fn is_border(&self, sample: [i32; 2]) -> bool {
        !self.is_whole() && {
            let around = self.around(sample);
            around.contains(&true) && around.contains(&false)
        }
    }

    /// Returns the largest distance between the samples and a grid of half as many cells, in metres; 0 for a side with an odd
    /// number of cells.
    pub fn halved_error_m(&self) -> f64 {
        let last = (self.side - 1) as i32;
        if last % 2 == 1 {
            return 0.0;
        }
        let mut largest = 0.0f64;
        for j in 0..=last {
            // The rows between whose samples the coarser grid interpolates, on its diagonal inside of its cells.
            let dj = j % 2;
            let [own, south, north] = [j, j - dj, j + dj].map(|j| self.row(j, 0, last));
            let mut add = |i: usize, di: usize| {
                let distance_m = (own[i] - 0.5 * (south[i - di] + north[i + di])).abs();
                if distance_m > largest && self.is_used([i as i32, j]) {
                    largest = distance_m;
                }
            };
            (1..last as usize).step_by(2).for_each(|i| add(i, 1));
            if dj == 1 {
                (0..=last as usize).step_by(2).for_each(|i| add(i, 0));
            }
        }
        largest
    }
}
