//! The drainage of a world: a lattice of places of which each drains into a lower one near it.
//!
//! Each cell of the lattice has a node, the lowest of some places in it. A node drains into the lowest of its neighbours. One
//! without a lower neighbour is a pit: its depression is a lake, whose outlet leads to a lower node some cells away. All this
//! depends on the surroundings of a cell only, so that each tile finds the same rivers.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::Arc;

use terrane::math::random::mix64;

use super::super::points::{Points, sin_cos, unit_vector};
use super::{Ground, Relief, Scratch, part_seed};

/// The cells from which a river can reach a place, and those to which the outlet of a lake can lead.
const REACH: i32 = 4;
const OUTLET: i32 = 3;
/// The number of links upstream that a river gathers its water from.
const GATHERED: u32 = 4;
/// The number of places of which the lowest is a cell's node.
const CANDIDATES: u64 = 3;
/// Nodes and rivers of cells that are kept from one tile to the next.
const MAX_NODES: usize = 1 << 16;
const MAX_WATERS: usize = 1 << 12;
/// Rows with fewer cells, next to the poles, have no rivers.
const MIN_COLUMNS: i64 = 64;

/// A cell of the lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Cell {
    row: i32,
    column: i32,
}

/// Hashes cells: two numbers need less than text from outside.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.write_i32(i32::from(*byte)));
    }

    fn write_i32(&mut self, number: i32) {
        self.0 = (self.0.rotate_left(32) ^ u64::from(number as u32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}

type Cells<T> = HashMap<Cell, T, BuildHasherDefault<CellHasher>>;

/// The lattice: rows of equal height, with cells that are about square.
#[derive(Clone, Debug)]
pub(crate) struct Drainage {
    spacing_m: f64,
    /// The radius of the body in metres.
    radius_m: f64,
    columns: Arc<[i64]>,
}

impl Drainage {
    /// Creates the lattice of a spacing in metres on a body with a radius in metres.
    pub fn new(spacing_m: f64, radius_m: f64) -> Self {
        use std::f64::consts::PI;
        let rows = (PI * radius_m / spacing_m).round().max(1.0);
        let columns = (0..rows as u32).map(|row| {
            let (sin, _) = sin_cos((f64::from(row) + 0.5) / rows * PI);
            (2.0 * rows * sin).round().max(1.0) as i64
        });
        Self { spacing_m, radius_m, columns: columns.collect() }
    }

    pub fn spacing_m(&self) -> f64 {
        self.spacing_m
    }

    /// Returns the cell of a place in radians.
    pub fn cell(&self, longitude: f64, latitude: f64) -> Cell {
        use std::f64::consts::PI;
        let rows = self.columns.len() as f64;
        let row = ((latitude / PI + 0.5) * rows).floor().clamp(0.0, rows - 1.0) as i32;
        let columns = self.columns[row as usize];
        let column = ((longitude / (2.0 * PI) + 0.5) * columns as f64).floor() as i64;
        Cell { row, column: column.rem_euclid(columns) as i32 }
    }

    /// Returns the longitude and latitude of a place in a cell, with coordinates within 0..1.
    fn place(&self, cell: Cell, [u, v]: [f64; 2]) -> [f64; 2] {
        use std::f64::consts::PI;
        let columns = self.columns[cell.row as usize] as f64;
        let longitude = ((f64::from(cell.column) + u) / columns - 0.5) * 2.0 * PI;
        [longitude, ((f64::from(cell.row) + v) / self.columns.len() as f64 - 0.5) * PI]
    }

    /// Returns the point in the middle of a cell.
    pub fn middle(&self, cell: Cell) -> [f64; 3] {
        let [longitude, latitude] = self.place(cell, [0.5; 2]);
        unit_vector(longitude, latitude)
    }

    /// Returns the cells within some rows and columns, the cell itself included.
    pub fn around(&self, cell: Cell, rows: i32, columns: i32) -> impl Iterator<Item = Cell> {
        let own = self.columns[cell.row as usize];
        let others = (-rows..=rows).filter_map(move |down| {
            let row = cell.row + down;
            let count = *self.columns.get(usize::try_from(row).ok()?)?;
            (count >= MIN_COLUMNS).then_some((row, count))
        });
        others.flat_map(move |(row, count)| {
            // The cell of the other row that is north or south of the middle of this one.
            let middle = (2 * i64::from(cell.column) + 1) * count / (2 * own);
            (-columns..=columns).map(move |k| Cell { row, column: (middle + i64::from(k)).rem_euclid(count) as i32 })
        })
    }
}

/// The lowest place in a cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub at: [f64; 3],
    /// Height of the water there in metres; below the sea in the sea.
    pub level_m: f32,
}

/// The way of a node's water.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Course {
    pub down: Option<Cell>,
    pub is_pit: bool,
}

/// A river between two nodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Channel {
    pub from: [f64; 3],
    /// The upper end in metres from the middle of the cell that the channel was found for.
    pub from_m: [f32; 3],
    /// From the upper to the lower end in metres, and one over the square of its length.
    pub along_m: [f32; 3],
    pub per_length2: f32,
    /// Levels of the water at the ends.
    pub levels_m: [f32; 2],
    /// Half the widths at the ends.
    pub half_m: [f32; 2],
    /// The share of the length that lies in the lake at the upper end.
    pub in_lake: f32,
    /// The level of the lake at the lower end, or that of the sea.
    pub floor_m: f32,
    /// True if no river comes from above.
    pub is_source: bool,
    /// The place of stones on a glacier, within -1..1 across it.
    pub moraines: [f32; 2],
}

/// The lake of a pit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lake {
    pub at: [f64; 3],
    /// Its middle in metres from the middle of the cell that the lake was found for.
    pub at_m: [f32; 3],
    pub level_m: f32,
    pub radius_m: f32,
}

/// The rivers and lakes that reach a cell.
#[derive(Debug, Default)]
pub(crate) struct Waters {
    /// The middle of the cell.
    pub middle: [f64; 3],
    /// The radius of the body in metres.
    pub radius_m: f64,
    pub channels: Vec<Channel>,
    pub lakes: Vec<Lake>,
}

/// The terrain that the rivers of a world follow from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Basin<'a> {
    pub relief: &'a Relief,
    pub drainage: &'a Drainage,
    pub seed: u64,
}

impl Basin<'_> {
    fn bits(&self, cell: Cell, part: u32) -> u64 {
        let place = (cell.row as u64) << 32 | cell.column as u64;
        mix64(place ^ (u64::from(part_seed(self.seed, part)) << 32))
    }
}

/// The part of the drainage that was computed, and buffers. Each thread has its own.
#[derive(Clone, Debug, Default)]
pub(crate) struct Network {
    nodes: Cells<Node>,
    courses: Cells<Course>,
    counts: Cells<u32>,
    waters: Cells<Arc<Waters>>,
    points: Points,
    scratch: Scratch,
    ground: Ground,
}

impl Network {
    /// Forgets what was computed if it is much. Called between tiles, of the same world: what a tile has computed stays until it
    /// is complete.
    pub fn bound(&mut self) {
        if self.nodes.len() > MAX_NODES || self.waters.len() > MAX_WATERS {
            (self.nodes, self.courses, self.counts, self.waters) = Default::default();
        }
    }

    /// Computes the rivers that reach cells.
    pub fn prepare(&mut self, basin: Basin<'_>, cells: &[Cell]) {
        let new = cells.iter().filter(|cell| !self.waters.contains_key(cell));
        let around = new.flat_map(|cell| basin.drainage.around(*cell, REACH + 1, REACH + 2));
        let around: Vec<Cell> = around.collect();
        self.add_nodes(basin, around.into_iter());
        for cell in cells {
            if !self.waters.contains_key(cell) {
                let waters = self.waters_of(basin, *cell);
                self.waters.insert(*cell, Arc::new(waters));
            }
        }
    }

    /// Returns the rivers that reach a cell. [`Self::prepare`] has computed them.
    pub fn waters(&self, cell: Cell) -> Option<Arc<Waters>> {
        self.waters.get(&cell).cloned()
    }

    /// Computes the nodes of cells that are not known.
    fn add_nodes(&mut self, basin: Basin<'_>, cells: impl Iterator<Item = Cell>) {
        let mut missing = Vec::new();
        for cell in cells {
            self.nodes.entry(cell).or_insert_with(|| {
                missing.push(cell);
                Node { at: [0.0; 3], level_m: 0.0 }
            });
        }
        let count = CANDIDATES as usize;
        self.points.radius_m = basin.drainage.radius_m;
        for batch in missing.chunks(512) {
            self.points.clear();
            for cell in batch {
                let bits = basin.bits(*cell, 100);
                for candidate in 0..CANDIDATES {
                    let bits = mix64(bits ^ candidate);
                    let share = |shift: u32| 0.12 + 0.76 * ((bits >> shift) & 0xffff) as f64 / 65_536.0;
                    let [longitude, latitude] = basin.drainage.place(*cell, [share(0), share(16)]);
                    self.points.push(unit_vector(longitude, latitude));
                }
            }
            basin.relief.valley_row(basin.seed, &self.points, &mut self.scratch, &mut self.ground);
            for (cell, first) in batch.iter().zip((0..).step_by(count)) {
                let heights = &self.ground.bed_m[first..first + count];
                let lowest = (0..count).min_by(|a, b| heights[*a].total_cmp(&heights[*b])).unwrap_or_default();
                let node = Node { at: self.points.at(first + lowest), level_m: heights[lowest] };
                self.nodes.insert(*cell, node);
            }
        }
    }

    fn node(&mut self, basin: Basin<'_>, cell: Cell) -> Node {
        if !self.nodes.contains_key(&cell) {
            self.add_nodes(basin, std::iter::once(cell));
        }
        self.nodes[&cell]
    }

    /// Returns the lowest neighbour of a node that is lower than it. Two such links do not cross.
    fn lowest_neighbor(&mut self, basin: Basin<'_>, cell: Cell) -> Option<Cell> {
        let level_m = self.node(basin, cell).level_m;
        if basin.relief.has_sea && level_m < 0.0 {
            return None;
        }
        self.add_nodes(basin, basin.drainage.around(cell, 1, 1));
        let mut lowest = (level_m, None);
        for near in basin.drainage.around(cell, 1, 1) {
            let other_m = self.nodes[&near].level_m;
            if other_m < lowest.0 {
                lowest = (other_m, Some(near));
            }
        }
        lowest.1
    }

    /// Returns where a node drains to.
    pub fn course(&mut self, basin: Basin<'_>, cell: Cell) -> Course {
        if let Some(course) = self.courses.get(&cell) {
            return *course;
        }
        let down = self.lowest_neighbor(basin, cell);
        let is_in_sea = basin.relief.has_sea && self.node(basin, cell).level_m < 0.0;
        let course = match down {
            None if !is_in_sea => Course { down: self.outlet(basin, cell), is_pit: true },
            _ => Course { down, is_pit: false },
        };
        self.courses.insert(cell, course);
        course
    }

    /// Returns the nearest lower node that the lake of a pit can drain into without crossing a river.
    fn outlet(&mut self, basin: Basin<'_>, pit: Cell) -> Option<Cell> {
        let (from, radius_m) = (self.node(basin, pit), basin.drainage.radius_m);
        let cells: Vec<Cell> = basin.drainage.around(pit, OUTLET, OUTLET + 1).filter(|cell| *cell != pit).collect();
        self.add_nodes(basin, cells.iter().copied());
        let mut links = Vec::new();
        let mut lower = Vec::new();
        for &cell in &cells {
            let node = self.nodes[&cell];
            let way_m = distance_m(radius_m, from.at, node.at);
            if node.level_m < from.level_m && way_m < OUTLET as f32 * basin.drainage.spacing_m as f32 {
                lower.push((way_m, cell));
            }
        }
        if lower.is_empty() {
            return None;
        }
        for &cell in &cells {
            if let Some(down) = self.lowest_neighbor(basin, cell) {
                links.push([(cell, self.node(basin, cell).at), (down, self.node(basin, down).at)]);
            }
        }
        lower.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let to = |at| difference_m(radius_m, from.at, at);
        let is_free = |&(_, target): &(f32, Cell)| {
            let end = to(self.nodes[&target].at);
            links.iter().all(|[(upper, a), (down, b)]| {
                *upper == target || *down == target || *down == pit || !crosses(from.at, end, to(*a), to(*b))
            })
        };
        lower.iter().find(|target| is_free(target)).map(|(_, cell)| *cell)
    }

    /// Returns the number of nodes that drain into a node within some links, itself included.
    fn gathered(&mut self, basin: Basin<'_>, cell: Cell, links: u32) -> u32 {
        if links == GATHERED
            && let Some(count) = self.counts.get(&cell)
        {
            return *count;
        }
        let mut sum = 1;
        if links > 0 {
            for near in basin.drainage.around(cell, 1, 2).filter(|near| *near != cell) {
                let course = self.course(basin, near);
                if course.down == Some(cell) && !course.is_pit {
                    sum += self.gathered(basin, near, links - 1);
                }
            }
        }
        if links == GATHERED {
            self.counts.insert(cell, sum);
        }
        sum
    }

    /// Returns the lake of a node that is a pit. The lake lies below all neighbours, so that rivers fall into it.
    pub fn lake(&mut self, basin: Basin<'_>, cell: Cell) -> Option<Lake> {
        if !self.course(basin, cell).is_pit || basin.relief.rivers.lakes <= 0.0 {
            return None;
        }
        let node = self.node(basin, cell);
        let around = basin.drainage.around(cell, 1, 1).filter(|near| *near != cell);
        let spill_m = around.map(|near| self.nodes[&near].level_m).fold(f32::MAX, f32::min);
        let depth_m = (0.8 * (spill_m - node.level_m)).clamp(0.0, 60.0);
        let share = (basin.bits(cell, 101) & 0xffff) as f32 / 65_536.0;
        let radius_m = basin.relief.rivers.lakes * basin.drainage.spacing_m as f32 * (0.35 + 0.5 * share);
        Some(Lake { at: node.at, at_m: [0.0; 3], level_m: node.level_m + depth_m, radius_m })
    }

    /// Returns the river from a node to the one that it drains into.
    pub fn channel(&mut self, basin: Basin<'_>, cell: Cell) -> Option<Channel> {
        let course = self.course(basin, cell);
        let down = course.down?;
        let (node, end) = (self.node(basin, cell), self.node(basin, down));
        let along_m = difference_m(basin.drainage.radius_m, node.at, end.at);
        let length2 = dot(along_m, along_m).max(1.0);
        let (above, below) = (self.lake(basin, cell), self.lake(basin, down));
        let counts = [cell, down].map(|cell| self.gathered(basin, cell, GATHERED));
        // A lake's outlet is a river.
        let first = if course.is_pit { counts[0].max(5) } else { counts[0] };
        let [start, finish] =
            [first, counts[1]].map(|count| basin.relief.rivers.half_m * (0.35 + (count as f32 - 1.0).sqrt()));
        let sea_m = if basin.relief.has_sea { 0.0 } else { f32::MIN };
        Some(Channel {
            from: node.at,
            from_m: [0.0; 3],
            along_m,
            per_length2: 1.0 / length2,
            levels_m: [above.map_or(node.level_m, |lake| lake.level_m), end.level_m],
            half_m: [start, start.max(0.8 * finish)],
            in_lake: above.map_or(0.0, |lake| (lake.radius_m / length2.sqrt()).min(0.8)),
            floor_m: below.map_or(sea_m, |lake| lake.level_m.max(sea_m)),
            is_source: first == 1,
            moraines: [0, 16].map(|shift| ((basin.bits(cell, 102) >> shift) & 0xffff) as f32 / 40_960.0 - 0.8),
        })
    }

    fn waters_of(&mut self, basin: Basin<'_>, cell: Cell) -> Waters {
        let own = basin.drainage.middle(cell);
        let radius_m = basin.drainage.radius_m;
        let mut waters = Waters { middle: own, radius_m, ..Waters::default() };
        let spacing_m = basin.drainage.spacing_m as f32;
        // Half a diagonal of the cell, the width of valleys, and the bends.
        let reach_m = (0.71 + 0.75 + 0.2) * spacing_m;
        for near in basin.drainage.around(cell, REACH, REACH + 1) {
            // Some are too far away, whatever way they take.
            let node = self.node(basin, near);
            let far_m = distance_m(radius_m, own, node.at) - reach_m;
            if far_m > OUTLET as f32 * spacing_m {
                continue;
            }
            let course = self.course(basin, near);
            if course.is_pit && far_m < 0.0 {
                let lake = self.lake(basin, near);
                waters.lakes.extend(lake.map(|lake| Lake { at_m: difference_m(radius_m, own, lake.at), ..lake }));
            }
            if !course.is_pit && far_m > 2.5 * spacing_m {
                continue;
            }
            let Some(down) = course.down else { continue };
            let end = self.node(basin, down);
            let (along, to) = (difference_m(radius_m, node.at, end.at), difference_m(radius_m, node.at, own));
            let t = (dot(to, along) / dot(along, along).max(1.0)).clamp(0.0, 1.0);
            let off = [0, 1, 2].map(|k| to[k] - t * along[k]);
            if dot(off, off) < reach_m * reach_m {
                let channel = self.channel(basin, near);
                let placed =
                    |channel: Channel| Channel { from_m: difference_m(radius_m, own, channel.from), ..channel };
                waters.channels.extend(channel.map(placed));
            }
        }
        waters
    }
}

/// Returns the vector between two positions on a body in metres.
#[inline(always)]
pub(super) fn difference_m(radius_m: f64, from: [f64; 3], to: [f64; 3]) -> [f32; 3] {
    let along = |k: usize| ((to[k] - from[k]) * radius_m) as f32;
    // Not `map`, which the compiler does not always inline here: a quarter of the time of a tile was spent in it.
    [along(0), along(1), along(2)]
}

#[inline(always)]
pub(super) fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(super) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns true if the way from a place to `end` crosses the way from `a` to `b`, which are relative to it, seen from above.
fn crosses(at: [f64; 3], end: [f32; 3], a: [f32; 3], b: [f32; 3]) -> bool {
    let up = at.map(|c| c as f32);
    let side = |p: [f32; 3], q: [f32; 3]| {
        dot(up, [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]])
    };
    let ends_differ = side(end, a) * side(end, b) < 0.0;
    ends_differ && side(minus(b, a), minus([0.0; 3], a)) * side(minus(b, a), minus(end, a)) < 0.0
}

fn distance_m(radius_m: f64, from: [f64; 3], to: [f64; 3]) -> f32 {
    let way = difference_m(radius_m, from, to);
    dot(way, way).sqrt()
}
