//! [`Record`]: a block leaves it for the blocks above it and for the set's description. It holds facts, and samples
//! of the lattices of its parent.
//!
//! A record is a file of the run's journal. Integers and floats are little-endian; a checksum is at the end.

use terrane::math::random::fnv1a;

use super::dependencies::Dependencies;
use super::samples::{HeightAt, Samples, Window};
use super::tile::{Coverage, TileFacts};

const MAGIC: &[u8; 8] = b"terrblk2";
/// The largest number of samples in an array.
const MAX_SAMPLES: usize = 1 << 22;

/// The record of a block.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Record {
    /// The facts of the block's root tile.
    pub facts: TileFacts,
    /// The largest difference of the finest level and the source in the block, in metres.
    pub finest_error_m: f64,
    /// By level, the largest distance between the block's finest samples and the triangles of the tile that contains the block,
    /// for the levels above the root's.
    pub above_m: Vec<f64>,
    /// Heights of the vertices of the parent's lattice, NaN where there is no data.
    pub known: Samples,
    /// Heights of the same vertices with voids filled, if there are any and they shall be.
    pub filled: Option<Samples>,
    /// The smoothed heights that texels of the parent need; `None` without colour.
    pub texels: Option<Samples>,
    /// For each cell of the parent inside the block, row-major, whether it has data; `None` if all have.
    pub cells: Option<Vec<bool>>,
    pub totals: Totals,
    /// The region of the root tile: west, south, east, north in radians, lowest and highest height in metres.
    pub region: [f64; 6],
    /// The geometric error of the root tile in metres.
    pub geometric_error_m: f64,
    /// The JSON of the root tile with its descendants; empty without data.
    pub tree: String,
    pub dependencies: Dependencies,
}

/// Sums and extremes over the tiles of blocks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Totals {
    pub tiles: u64,
    pub bytes: u64,
    /// Vertices of the finest level without data.
    pub voids: u64,
    /// The lowest and the highest vertex of the finest level with data, in metres.
    pub range_m: [f32; 2],
    /// The largest error of the tiles of each level in metres, root first.
    pub level_errors_m: Vec<f64>,
}

impl Totals {
    /// Creates the totals of no tiles.
    pub fn new(levels: u32) -> Self {
        Self {
            tiles: 0,
            bytes: 0,
            voids: 0,
            range_m: [f32::INFINITY, f32::NEG_INFINITY],
            level_errors_m: vec![0.0; levels as usize],
        }
    }

    pub fn add(&mut self, other: &Self) {
        self.tiles += other.tiles;
        self.bytes += other.bytes;
        self.voids += other.voids;
        self.range_m = [self.range_m[0].min(other.range_m[0]), self.range_m[1].max(other.range_m[1])];
        self.level_errors_m.iter_mut().zip(&other.level_errors_m).for_each(|(a, b)| *a = a.max(*b));
    }
}

impl Record {
    /// Returns the bytes of the record's file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Writer(MAGIC.to_vec());
        out.f64(self.facts.error_m);
        out.f32s(&[self.facts.min_height_m, self.facts.max_height_m]);
        out.u64(match self.facts.coverage {
            Coverage::None => 0,
            Coverage::Part => 1,
            Coverage::Whole => 2,
        });
        out.f64(self.finest_error_m);
        out.f64s(&self.above_m);
        out.samples(&self.known);
        for samples in [&self.filled, &self.texels] {
            out.u64(samples.is_some().into());
            samples.iter().for_each(|samples| out.samples(samples));
        }
        out.u64(self.cells.is_some().into());
        if let Some(cells) = &self.cells {
            out.u64(cells.len() as u64);
            out.0.extend(cells.iter().map(|cell| u8::from(*cell)));
        }
        let totals = &self.totals;
        [totals.tiles, totals.bytes, totals.voids].into_iter().for_each(|count| out.u64(count));
        out.f32s(&totals.range_m);
        out.f64s(&totals.level_errors_m);
        out.f64s(&self.region);
        out.f64(self.geometric_error_m);
        out.u64(self.tree.len() as u64);
        out.0.extend(self.tree.as_bytes());
        out.u64(self.dependencies.reach as u64);
        out.heights(&self.dependencies.vertices);
        out.heights(&self.dependencies.gaps);
        let sum = fnv1a(&out.0);
        out.u64(sum);
        out.0
    }

    /// Reads a record; `None` if the bytes are not one.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (content, sum) = bytes.split_at_checked(bytes.len().checked_sub(8)?)?;
        let mut input = Reader(content.strip_prefix(MAGIC)?);
        if fnv1a(content) != u64::from_le_bytes(sum.try_into().ok()?) {
            return None;
        }
        let error_m = input.f64()?;
        let [min_height_m, max_height_m] = input.f32s()?.try_into().ok()?;
        let coverage = *[Coverage::None, Coverage::Part, Coverage::Whole].get(input.u64()? as usize)?;
        let facts = TileFacts { error_m, min_height_m, max_height_m, coverage };
        let (finest_error_m, above_m, known) = (input.f64()?, input.f64s()?, input.samples()?);
        let mut optional = || Some(if input.u64()? == 1 { Some(input.samples()?) } else { None });
        let (filled, texels) = (optional()?, optional()?);
        let cells = match input.u64()? {
            1 => {
                let count = input.count()?;
                Some(input.bytes(count)?.iter().map(|cell| *cell != 0).collect())
            }
            _ => None,
        };
        let (tiles, size_bytes, voids) = (input.u64()?, input.u64()?, input.u64()?);
        let range_m = input.f32s()?.try_into().ok()?;
        let totals = Totals { tiles, bytes: size_bytes, voids, range_m, level_errors_m: input.f64s()? };
        let region = input.f64s()?.try_into().ok()?;
        let geometric_error_m = input.f64()?;
        let length = usize::try_from(input.u64()?).ok()?;
        let tree = String::from_utf8(input.bytes(length)?.to_vec()).ok()?;
        let dependencies =
            Dependencies { reach: input.u64()? as i64, vertices: input.heights()?, gaps: input.heights()? };
        Some(Self {
            facts,
            finest_error_m,
            above_m,
            known,
            filled,
            texels,
            cells,
            totals,
            region,
            geometric_error_m,
            tree,
            dependencies,
        })
    }
}

struct Writer(Vec<u8>);

impl Writer {
    fn u64(&mut self, value: u64) {
        self.0.extend(value.to_le_bytes());
    }

    fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }

    fn f64s(&mut self, values: &[f64]) {
        self.u64(values.len() as u64);
        values.iter().for_each(|value| self.f64(*value));
    }

    fn f32s(&mut self, values: &[f32]) {
        self.u64(values.len() as u64);
        values.iter().for_each(|value| self.0.extend(value.to_bits().to_le_bytes()));
    }

    fn heights(&mut self, heights: &[HeightAt]) {
        self.u64(heights.len() as u64);
        for HeightAt { depth, at: [x, y], height_m } in heights {
            for number in [u64::from(*depth), *x as u64, *y as u64, height_m.to_bits().into()] {
                self.u64(number);
            }
        }
    }

    fn samples(&mut self, samples: &Samples) {
        let Window { first, last } = samples.window;
        first.into_iter().chain(last).for_each(|c| self.u64(c as u64));
        self.f32s(&samples.values);
    }
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.bytes(8)?.try_into().ok()?))
    }

    fn f64(&mut self) -> Option<f64> {
        Some(f64::from_bits(self.u64()?))
    }

    fn count(&mut self) -> Option<usize> {
        usize::try_from(self.u64()?).ok().filter(|count| *count <= MAX_SAMPLES)
    }

    fn f64s(&mut self) -> Option<Vec<f64>> {
        let count = self.count()?;
        (0..count).map(|_| self.f64()).collect()
    }

    fn f32s(&mut self) -> Option<Vec<f32>> {
        let count = self.count()?;
        let (values, _) = self.bytes(4 * count)?.as_chunks::<4>();
        Some(values.iter().map(|bytes| f32::from_bits(u32::from_le_bytes(*bytes))).collect())
    }

    fn heights(&mut self) -> Option<Vec<HeightAt>> {
        let count = self.count()?;
        let mut height = || {
            let (depth, x, y) = (u32::try_from(self.u64()?).ok()?, self.u64()? as i64, self.u64()? as i64);
            Some(HeightAt { depth, at: [x, y], height_m: f32::from_bits(self.u64()? as u32) })
        };
        (0..count).map(|_| height()).collect()
    }

    fn samples(&mut self) -> Option<Samples> {
        let mut corner = || Some([self.u64()? as i64, self.u64()? as i64]);
        let window = Window { first: corner()?, last: corner()? };
        let is_valid = (0..2).all(|k| {
            let (first, last) = (window.first[k], window.last[k]);
            0 <= first && first <= last && last < 1 << 40 && last - first < MAX_SAMPLES as i64
        });
        let values = self.f32s()?;
        let is_whole = is_valid && window.width().checked_mul(window.height()) == Some(values.len());
        is_whole.then_some(Samples { window, values })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_read_back_and_damage_is_noticed() {
        let window = Window { first: [32, 64], last: [34, 65] };
        let samples = |h: f32| Samples { window, values: (0..6).map(|k| h + k as f32).collect() };
        let facts = TileFacts { error_m: 3.5, min_height_m: -2.0, max_height_m: 8.0, coverage: Coverage::Part };
        let totals = Totals { tiles: 5, bytes: 99, voids: 7, range_m: [-1.0, 8.0], level_errors_m: vec![9.0, 3.5] };
        let record = Record {
            facts,
            finest_error_m: 0.25,
            above_m: vec![9.0],
            known: samples(1.0),
            filled: None,
            texels: Some(samples(-4.0)),
            cells: Some(vec![true, false]),
            totals,
            region: [0.1, 0.2, 0.3, 0.4, -5.0, 9.0],
            geometric_error_m: 3.6,
            tree: "{}".to_owned(),
            dependencies: Dependencies {
                reach: 276,
                vertices: vec![HeightAt { depth: 3, at: [5, 6], height_m: 7.5 }],
                gaps: Vec::new(),
            },
        };
        let bytes = record.to_bytes();
        assert_eq!(Record::from_bytes(&bytes), Some(record));
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x10;
            assert_eq!(Record::from_bytes(&damaged), None, "{at}");
            assert_eq!(Record::from_bytes(&bytes[..at]), None, "{at}");
        }
    }
}
