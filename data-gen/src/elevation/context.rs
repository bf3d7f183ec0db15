//! Holds what all rasters of a run share: the cache of decoded blocks, the open files, the geoid, and the heights that were seen.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use netcdf_reader::NcFile;

use crate::georeference::geotiff::Tiff;
use crate::georeference::{DatumGrid, Geoid};
use crate::store::{BlockCache, Pool};

/// The default number of bytes for decoded blocks.
pub const DEFAULT_CACHE_BYTES: usize = 256 << 20;

/// Is shared by all rasters of a run.
pub(crate) struct SourceContext {
    pub cache: Arc<BlockCache>,
    pub tiffs: Pool<Tiff>,
    pub netcdfs: Pool<NcFile>,
    /// The surface that heights are measured from; `None` for the ellipsoid.
    pub geoid: Option<Geoid>,
    /// The grid that shifts datums to WGS84.
    pub datum_grid: Option<Arc<DatumGrid>>,
    /// The heights of all blocks that were decoded.
    pub seen: HeightRange,
}

impl SourceContext {
    /// Creates the context of a run that keeps decoded blocks in a cache.
    pub fn new(cache: Arc<BlockCache>, geoid: Option<Geoid>, datum_grid: Option<Arc<DatumGrid>>) -> Arc<Self> {
        Arc::new(Self {
            cache,
            tiffs: Pool::new(),
            netcdfs: Pool::new(),
            geoid,
            datum_grid,
            seen: HeightRange::default(),
        })
    }
}

/// The lowest and the highest of heights that several threads add.
pub(crate) struct HeightRange {
    /// The bits of the lowest and of the highest height, ordered by [`ordered`].
    low: AtomicU32,
    high: AtomicU32,
}

impl Default for HeightRange {
    fn default() -> Self {
        Self { low: AtomicU32::new(u32::MAX), high: AtomicU32::new(0) }
    }
}

impl HeightRange {
    /// Adds the lowest and the highest of some heights in metres.
    pub fn add(&self, [low_m, high_m]: [f32; 2]) {
        if low_m <= high_m {
            self.low.fetch_min(ordered(low_m), Ordering::Relaxed);
            self.high.fetch_max(ordered(high_m), Ordering::Relaxed);
        }
    }

    /// Returns the lowest and the highest height in metres; `None` if none was added.
    pub fn range_m(&self) -> Option<[f32; 2]> {
        let [low, high] = [&self.low, &self.high].map(|bound| bound.load(Ordering::Relaxed));
        (low <= high).then(|| [low, high].map(from_ordered))
    }
}

/// Maps a number to an integer of the same order.
fn ordered(number: f32) -> u32 {
    let bits = number.to_bits();
    if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }
}

/// The inverse of [`ordered`].
fn from_ordered(integer: u32) -> f32 {
    f32::from_bits(if integer >> 31 == 1 { integer & !(1 << 31) } else { !integer })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_those_of_all_heights() {
        let range = HeightRange::default();
        assert_eq!(range.range_m(), None);
        range.add([f32::INFINITY, f32::NEG_INFINITY]);
        assert_eq!(range.range_m(), None);
        range.add([-3.5, -1.0]);
        assert_eq!(range.range_m(), Some([-3.5, -1.0]));
        range.add([-2.0, 8000.25]);
        range.add([-11_000.0, -10_000.0]);
        assert_eq!(range.range_m(), Some([-11_000.0, 8000.25]));
    }
}
