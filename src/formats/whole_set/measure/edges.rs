//! [`Edges`]: heights along the edges of tiles, compared with those of their neighbours of the same level. Plain values.

use std::collections::HashMap;
use std::sync::Arc;

use super::place::MapFrame;
use super::surface::{EAST, NORTH, SOUTH, Surface, WEST, wrapped};

/// The maximum number of points of edges that wait for their neighbour. Further edges are not compared.
const MAX_WAITING_POINTS: usize = 4_000_000;
/// Edges that overlap by a smaller share of their length are not neighbours.
const MIN_OVERLAP: f64 = 1e-2;

/// The edge of a tile.
struct Edge {
    uri: Arc<str>,
    /// Where it lies across its direction.
    across: f64,
    points: Vec<[f64; 2]>,
    /// The declared error of its tile, metres.
    error_m: f64,
    /// The depth of its skirt, metres; 0 without one.
    skirt_m: f64,
}

/// Two edges of neighbours that differ.
pub(super) struct Difference {
    pub largest_m: f64,
    pub error_m: f64,
    pub skirt_m: f64,
    pub neighbour: Arc<str>,
}

/// The edges that wait for their neighbours.
#[derive(Default)]
pub(super) struct Edges {
    /// By level, side and the place across, in steps of the level.
    waiting: HashMap<(u32, usize, i64), Vec<Edge>>,
    /// The step of each level: a small part of the size of its first tile.
    steps: HashMap<u32, f64>,
    points: usize,
    /// Number of edges that found no room.
    pub dropped: u64,
}

impl Edges {
    /// Compares the edges of a tile with those that wait, and lets the others wait. Returns the differences, one for each
    /// neighbour.
    pub fn add(&mut self, level: u32, uri: &Arc<str>, surface: &Surface, error_m: f64) -> Vec<Difference> {
        let [west, south, east, north] = surface.rectangle;
        let size = (east - west).max(north - south);
        let step = *self.steps.entry(level).or_insert(1e-3 * size);
        let mut found = Vec::new();
        if !(step > 0.0) {
            return found;
        }
        let skirt_m = surface.skirt_m.map_or(0.0, |[_, deepest]| deepest);
        for side in [WEST, SOUTH, EAST, NORTH] {
            let across = match (side, surface.frame) {
                // Both sides of the antimeridian are the same place.
                (WEST | EAST, MapFrame::Earth) => wrapped(surface.rectangle[side]),
                _ => surface.rectangle[side],
            };
            let points = &surface.profiles[side];
            if points.len() < 2 {
                continue;
            }
            let key = |across: f64| (across / step).round() as i64;
            let opposite = (side + 2) % 4;
            let mut covered = 0.0;
            for number in key(across) - 1..=key(across) + 1 {
                let Some(list) = self.waiting.get_mut(&(level, opposite, number)) else { continue };
                let points_before: usize = list.iter().map(|edge| edge.points.len()).sum();
                list.retain(|other| {
                    if (other.across - across).abs() > step {
                        return true;
                    }
                    let Some((largest_m, share)) = difference(points, &other.points) else { return true };
                    covered += share;
                    found.push(Difference {
                        largest_m,
                        error_m: error_m.max(other.error_m),
                        skirt_m: other.skirt_m.max(skirt_m),
                        neighbour: other.uri.clone(),
                    });
                    share < 0.99
                });
                self.points -= points_before - list.iter().map(|edge| edge.points.len()).sum::<usize>();
                if list.is_empty() {
                    self.waiting.remove(&(level, opposite, number));
                }
            }
            if covered > 0.99 {
                continue;
            }
            if self.points + points.len() > MAX_WAITING_POINTS {
                self.dropped += 1;
                continue;
            }
            self.points += points.len();
            let edge = Edge { uri: uri.clone(), across, points: points.clone(), error_m, skirt_m };
            self.waiting.entry((level, side, key(across))).or_default().push(edge);
        }
        found
    }
}

/// Returns the largest difference between the edges of a tile and those of a coarser one that contains it, where they lie on
/// each other, metres.
pub(super) fn difference_to_coarser_m(fine: &Surface, coarse: &Surface) -> Option<f64> {
    let mut largest: Option<f64> = None;
    let size = (fine.rectangle[2] - fine.rectangle[0]).max(fine.rectangle[3] - fine.rectangle[1]);
    for side in [WEST, SOUTH, EAST, NORTH] {
        let (a, b) = (fine.rectangle[side], coarse.rectangle[side]);
        let b = if side == WEST || side == EAST { fine.frame.near(b, a) } else { b };
        let shift = match side {
            SOUTH | NORTH => fine.frame.near(coarse.rectangle[WEST], fine.rectangle[WEST]) - coarse.rectangle[WEST],
            _ => 0.0,
        };
        if (a - b).abs() > 1e-3 * size {
            continue;
        }
        let shifted: Vec<[f64; 2]> =
            coarse.profiles[side].iter().map(|[at, height_m]| [at + shift, *height_m]).collect();
        if let Some((found, _)) = difference(&fine.profiles[side], &shifted) {
            largest = Some(largest.map_or(found, |known| known.max(found)));
        }
    }
    largest
}

/// Returns the largest difference of two lines of heights where both are known, and the share of the shorter one that this is;
/// `None` if they hardly overlap.
fn difference(a: &[[f64; 2]], b: &[[f64; 2]]) -> Option<(f64, f64)> {
    let ends = |line: &[[f64; 2]]| Some((line.first()?[0], line.last()?[0]));
    let ((a0, a1), (b0, b1)) = (ends(a)?, ends(b)?);
    let (from, to) = (a0.max(b0), a1.min(b1));
    let share = (to - from) / (a1 - a0).min(b1 - b0);
    if !(share >= MIN_OVERLAP) {
        return None;
    }
    let mut largest_m = 0.0f64;
    // Places of neighbours are rounded.
    let slack = 1e-4 * (a1 - a0).min(b1 - b0);
    for (line, other) in [(a, b), (b, a)] {
        let inside = line.iter().filter(|[at, _]| (from - slack..=to + slack).contains(at));
        for [at, height_m] in inside {
            largest_m = largest_m.max(distance_m(other, *at, *height_m, slack));
        }
    }
    Some((largest_m, share))
}

/// Returns the distance of a height from a line of heights at a place. Where the line has several heights, the nearest counts.
fn distance_m(line: &[[f64; 2]], at: f64, height_m: f64, slack: f64) -> f64 {
    let first = line.partition_point(|point| point[0] < at - slack);
    let mut nearest = f64::INFINITY;
    // Points at the place itself.
    for [_, other] in line[first..].iter().take_while(|point| point[0] <= at + slack) {
        nearest = nearest.min((other - height_m).abs());
    }
    if nearest.is_finite() {
        return nearest;
    }
    match (first.checked_sub(1).map(|before| line[before]), line.get(first)) {
        (Some([x0, h0]), Some([x1, h1])) => (h0 + (h1 - h0) * (at - x0) / (x1 - x0) - height_m).abs(),
        (Some([_, h]), None) => (h - height_m).abs(),
        (None, Some([_, h])) => (h - height_m).abs(),
        (None, None) => 0.0,
    }
}
