//! [`Edges`]: heights along the edges of tiles, compared with those of their neighbours of the same level. Plain values.

use std::collections::HashMap;
use std::sync::Arc;

use super::place::MapFrame;
use super::surface::{EAST, NORTH, Profile, SOUTH, Surface, WEST, wrapped};

/// The maximum number of points of edges that wait for their neighbour. Further edges are not compared.
const MAX_WAITING_POINTS: usize = 4_000_000;
/// Edges that overlap by a smaller share of their length are not neighbours.
const MIN_OVERLAP: f64 = 1e-2;

/// The edge of a tile.
struct Edge {
    uri: Arc<str>,
    /// Its position across its direction.
    across: f64,
    profile: Profile,
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
        if step.is_nan() || step <= 0.0 {
            return found;
        }
        let skirt_m = surface.skirt_m.map_or(0.0, |[_, deepest]| deepest);
        for side in [WEST, SOUTH, EAST, NORTH] {
            let across = match (side, surface.frame) {
                // Both sides of the antimeridian are the same place.
                (WEST | EAST, MapFrame::Globe(_)) => wrapped(surface.rectangle[side]),
                _ => surface.rectangle[side],
            };
            let profile = &surface.profiles[side];
            if profile.points.len() < 2 {
                continue;
            }
            let key = |across: f64| (across / step).round() as i64;
            let opposite = (side + 2) % 4;
            let mut covered = 0.0;
            for number in key(across) - 1..=key(across) + 1 {
                let Some(list) = self.waiting.get_mut(&(level, opposite, number)) else { continue };
                let points_before: usize = list.iter().map(|edge| edge.profile.points.len()).sum();
                list.retain(|other| {
                    if (other.across - across).abs() > step {
                        return true;
                    }
                    let Some((largest_m, share)) = difference(profile, &other.profile) else { return true };
                    covered += share;
                    found.push(Difference {
                        largest_m,
                        error_m: error_m.max(other.error_m),
                        skirt_m: other.skirt_m.max(skirt_m),
                        neighbour: other.uri.clone(),
                    });
                    share < 0.99
                });
                self.points -= points_before - list.iter().map(|edge| edge.profile.points.len()).sum::<usize>();
                if list.is_empty() {
                    self.waiting.remove(&(level, opposite, number));
                }
            }
            if covered > 0.99 {
                continue;
            }
            if self.points + profile.points.len() > MAX_WAITING_POINTS {
                self.dropped += 1;
                continue;
            }
            self.points += profile.points.len();
            let edge = Edge { uri: uri.clone(), across, profile: profile.clone(), error_m, skirt_m };
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
        let moved = |list: &[[f64; 2]], is_place: bool| -> Vec<[f64; 2]> {
            list.iter().map(|[a, b]| [a + shift, if is_place { b + shift } else { *b }]).collect()
        };
        let Profile { points, covered } = &coarse.profiles[side];
        let shifted = Profile { points: moved(points, false), covered: moved(covered, true) };
        if let Some((found, _)) = difference(&fine.profiles[side], &shifted) {
            largest = Some(largest.map_or(found, |known| known.max(found)));
        }
    }
    largest
}

/// Returns the largest difference of two edges where both have triangles, and the share of the shorter one that they have in
/// common; `None` if that is hardly anything.
fn difference(a: &Profile, b: &Profile) -> Option<(f64, f64)> {
    let ends = |profile: &Profile| Some((profile.points.first()?[0], profile.points.last()?[0]));
    let ((a0, a1), (b0, b1)) = (ends(a)?, ends(b)?);
    let (from, to) = (a0.max(b0), a1.min(b1));
    let length = (a1 - a0).min(b1 - b0);
    let share = (to - from) / length;
    if share.is_nan() || share < MIN_OVERLAP {
        return None;
    }
    // Places of neighbours are rounded.
    let slack = 1e-4 * length;
    let mut largest_m: Option<f64> = None;
    for (one, other) in [(a, b), (b, a)] {
        for [at, height_m] in &one.points {
            if let Some(distance_m) = distance_m(other, *at, *height_m, slack) {
                largest_m = Some(largest_m.map_or(distance_m, |known| known.max(distance_m)));
            }
        }
    }
    Some((largest_m?, share))
}

/// Returns the distance of a height from an edge at a place; `None` if the edge has no triangle there. Where it has several
/// heights, the nearest counts.
fn distance_m(profile: &Profile, at: f64, height_m: f64, slack: f64) -> Option<f64> {
    let line = &profile.points;
    let first = line.partition_point(|point| point[0] < at - slack);
    let there = line[first..].iter().take_while(|point| point[0] <= at + slack);
    if let Some(nearest) = there.map(|[_, other]| (other - height_m).abs()).min_by(f64::total_cmp) {
        return Some(nearest);
    }
    let is_covered = profile.covered.iter().any(|[from, to]| (*from..=*to).contains(&at));
    let ([x0, h0], [x1, h1]) = (line[first.checked_sub(1)?], line.get(first)?);
    is_covered.then(|| (h0 + (h1 - h0) * (at - x0) / (x1 - x0) - height_m).abs())
}
