//! Finds the rasters of a mosaic near a position without asking each of them.

/// The largest number of cells along a side.
const MAX_CELLS: usize = 512;

/// Rectangles of longitude and latitude, found by the cells of a grid over all of them.
pub(super) struct Nearby {
    /// West, south, east and north of each rectangle in radians.
    bounds: Vec<[f64; 4]>,
    /// West, south, east and north of all of them.
    all: [f64; 4],
    /// The number of cells along a side.
    cells: usize,
    /// For each cell, row-major from the south-west, the indices of the rectangles that touch it, in their order.
    found: Vec<Vec<u32>>,
}

impl Nearby {
    pub fn new(bounds: Vec<[f64; 4]>) -> Self {
        let all = bounds.iter().fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |a, b| {
            [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
        });
        // About four cells for each rectangle.
        let cells = (2.0 * (bounds.len() as f64).sqrt()) as usize;
        let cells = cells.clamp(1, MAX_CELLS);
        let mut nearby = Self { bounds, all, cells, found: vec![Vec::new(); cells * cells] };
        for k in 0..nearby.bounds.len() {
            let [west, south, east, north] = nearby.bounds[k];
            let ([x0, y0], [x1, y1]) = (nearby.cell(west, south), nearby.cell(east, north));
            for cell in (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| y * cells + x)) {
                nearby.found[cell].push(k as u32);
            }
        }
        nearby
    }

    /// Returns the column and row of the cell of a position, or of the nearest cell.
    fn cell(&self, longitude: f64, latitude: f64) -> [usize; 2] {
        let [west, south, east, north] = self.all;
        // Casts of numbers clamp them, and make 0 of NaN.
        let at = |t: f64| ((t * self.cells as f64) as usize).min(self.cells - 1);
        [at((longitude - west) / (east - west)), at((latitude - south) / (north - south))]
    }

    /// Returns the indices of the rectangles that contain a position, in their order.
    pub fn at(&self, longitude: f64, latitude: f64) -> impl Iterator<Item = usize> + Clone {
        let [x, y] = self.cell(longitude, latitude);
        let contains = move |k: &usize| {
            let [west, south, east, north] = self.bounds[*k];
            (west..=east).contains(&longitude) && (south..=north).contains(&latitude)
        };
        self.found[y * self.cells + x].iter().map(|k| *k as usize).filter(contains)
    }

    /// Returns the indices of the rectangles that touch a rectangle, in their order.
    pub fn within(&self, [west, south, east, north]: [f64; 4]) -> Vec<usize> {
        let ([x0, y0], [x1, y1]) = (self.cell(west, south), self.cell(east, north));
        let cells = (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| y * self.cells + x));
        let touches = |k: &usize| {
            let b = self.bounds[*k];
            b[0] <= east && b[2] >= west && b[1] <= north && b[3] >= south
        };
        let mut found: Vec<usize> =
            cells.flat_map(|cell| &self.found[cell]).map(|k| *k as usize).filter(touches).collect();
        found.sort_unstable();
        found.dedup();
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_are_those_of_a_linear_search() {
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / (1u64 << 24) as f64
        };
        let bounds: Vec<[f64; 4]> = (0..500)
            .map(|k| {
                let size = if k == 100 { 3.0 } else { 0.2 * random() };
                let (west, south) = (6.0 * random() - 3.0, 3.0 * random() - 1.5);
                [west, south, west + size, south + size * random()]
            })
            .collect();
        let nearby = Nearby::new(bounds.clone());
        let mut hits = 0;
        for k in 0..2000 {
            let b = bounds[k % bounds.len()];
            // Corners of rectangles, and positions anywhere.
            let (x, y) = if k < 500 { (b[2], b[1]) } else { (7.0 * random() - 3.5, 4.0 * random() - 2.0) };
            let expected: Vec<usize> = (0..bounds.len())
                .filter(|k| {
                    let b = bounds[*k];
                    b[0] <= x && x <= b[2] && b[1] <= y && y <= b[3]
                })
                .collect();
            hits += expected.len();
            assert_eq!(nearby.at(x, y).collect::<Vec<_>>(), expected);
            assert_eq!(nearby.within([x, y, x, y]), expected);
        }
        assert!(hits > 500);
        assert_eq!(nearby.within([-9.0, -9.0, 9.0, 9.0]).len(), 500);
        assert!(Nearby::new(Vec::new()).at(0.0, 0.0).next().is_none());
    }
}
