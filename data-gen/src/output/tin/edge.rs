//! The vertices on an edge of a tile.

use super::{ALLOWED_SHARE, MIN_ALLOWED_M};

/// Returns the positions of the vertices on an edge, both ends included, from its heights in metres (from west to east, or from
/// south to north). The result depends on the arguments alone, which two tiles at the edge have in common. `curvature_m` is the
/// height by which the earth falls below its tangent within one cell; `is_kept` says which samples must be vertices. Distances
/// are at most `limit_m`.
pub(crate) fn edge_vertices(
    heights_m: &[f32],
    curvature_m: f64,
    limit_m: f64,
    is_kept: impl Fn(usize) -> bool,
) -> Vec<u16> {
    let last = heights_m.len().saturating_sub(1);
    let middle = 0.5 * last as f64;
    let lowered = |(k, h): (usize, &f32)| f64::from(*h) - curvature_m * (k as f64 - middle).powi(2);
    let values_m: Vec<f64> = heights_m.iter().enumerate().map(lowered).collect();
    let mut halved_error_m = 0.0f64;
    if last.is_multiple_of(2) {
        for k in (1..last).step_by(2) {
            halved_error_m = halved_error_m.max((values_m[k] - 0.5 * (values_m[k - 1] + values_m[k + 1])).abs());
        }
    }
    let allowed_m = (ALLOWED_SHARE * halved_error_m).min(limit_m).max(MIN_ALLOWED_M);
    let mut vertices = vec![0];
    let mut from = 0;
    for to in (1..=last).filter(|k| *k == last || is_kept(*k)) {
        subdivide(&values_m, from, to, allowed_m, &mut vertices);
        vertices.push(to as u16);
        from = to;
    }
    vertices
}

/// Adds the vertices between two positions so that all samples lie within the allowed distance of the line through them (Douglas
/// and Peucker). Of equal distances the first is taken.
fn subdivide(values_m: &[f64], from: usize, to: usize, allowed_m: f64, vertices: &mut Vec<u16>) {
    let slope = (values_m[to] - values_m[from]) / (to - from) as f64;
    let (mut farthest, mut largest_m) = (from, allowed_m);
    for k in from + 1..to {
        let distance_m = (values_m[from] + slope * (k - from) as f64 - values_m[k]).abs();
        if distance_m > largest_m {
            (farthest, largest_m) = (k, distance_m);
        }
    }
    if farthest > from {
        subdivide(values_m, from, farthest, allowed_m, vertices);
        vertices.push(farthest as u16);
        subdivide(values_m, farthest, to, allowed_m, vertices);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_edges_have_two_vertices_and_kept_samples_are_vertices() {
        let slope: Vec<f32> = (0..65).map(|k| 0.5 * k as f32).collect();
        assert_eq!(edge_vertices(&slope, 0.0, f64::INFINITY, |_| false), [0, 64]);
        assert_eq!(edge_vertices(&slope, 0.0, f64::INFINITY, |k| k == 7 || k == 8), [0, 7, 8, 64]);
        let mut peak = slope;
        peak[20] += 100.0;
        assert_eq!(edge_vertices(&peak, 0.0, f64::INFINITY, |_| false), [0, 19, 20, 21, 64]);
        // A cliff does not hide a hill.
        let mut hill = [0.0f32; 65];
        (hill[10], hill[64]) = (5.0, 1000.0);
        assert_eq!(edge_vertices(&hill, 0.0, f64::INFINITY, |_| false), [0, 63, 64]);
        assert_eq!(edge_vertices(&hill, 0.0, 1.0, |_| false), [0, 9, 10, 11, 63, 64]);
    }

    #[test]
    fn round_edges_are_divided() {
        // On flat land the cells of half as many have the error of the curvature; a quarter of it needs all samples.
        let vertices = edge_vertices(&[0.0; 9], 4.0, f64::INFINITY, |_| false);
        assert_eq!(vertices, [0, 1, 2, 3, 4, 5, 6, 7, 8]);
    }
}
