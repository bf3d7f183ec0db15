//! TIFFs with 16-bit floats. The decoder does not read them; it is shown the samples as 16-bit integers of the same bits.

use std::sync::Arc;

use tiff_reader::source::TiffSource;
use tiff_reader::{ByteOrder, Ifd, TiffError, TiffFile};

const SAMPLE_FORMAT: u16 = 339;
const UNSIGNED: u16 = 1;
const FLOAT: u16 = 3;
/// The largest number of channels whose format is replaced.
const MAX_CHANNELS: u64 = 64;

/// Returns true for an image of 16-bit floats.
fn is_half(ifd: &Ifd) -> bool {
    let all = |values: Result<Vec<u16>, TiffError>, value: u16| {
        values.is_ok_and(|values| !values.is_empty() && values.iter().all(|v| *v == value))
    };
    all(ifd.bits_per_sample(), 16) && all(ifd.sample_format(), FLOAT)
}

/// A file in which some bytes are replaced.
struct Replaced {
    file: Arc<dyn TiffSource>,
    /// Offsets and the bytes there.
    bytes: Vec<(u64, u8)>,
}

impl TiffSource for Replaced {
    fn len(&self) -> u64 {
        self.file.len()
    }

    fn read_exact_at(&self, offset: u64, len: usize) -> Result<Vec<u8>, TiffError> {
        let mut read = self.file.read_exact_at(offset, len)?;
        for (at, byte) in &self.bytes {
            let at = at.checked_sub(offset).and_then(|at| usize::try_from(at).ok());
            if let Some(place) = at.and_then(|at| read.get_mut(at)) {
                *place = *byte;
            }
        }
        Ok(read)
    }
}

/// Returns a file in which 16-bit floats are called integers; `None` if the first image has other samples.
pub(super) fn as_integers(
    file: &TiffFile,
    source: &Arc<dyn TiffSource>,
) -> Result<Option<Arc<dyn TiffSource>>, TiffError> {
    if !file.ifds().first().is_some_and(is_half) {
        return Ok(None);
    }
    let mut bytes = Vec::new();
    for ifd in file.ifds().iter().filter(|ifd| is_half(ifd)) {
        bytes.extend(replacements(file, source.as_ref(), ifd.offset())?);
    }
    Ok(Some(Arc::new(Replaced { file: Arc::clone(source), bytes })))
}

/// Returns the bytes of the values of SampleFormat in the directory at an offset, for unsigned integers.
fn replacements(file: &TiffFile, source: &dyn TiffSource, directory: u64) -> Result<Vec<(u64, u8)>, TiffError> {
    let is_little = file.byte_order() == ByteOrder::LittleEndian;
    let number = |offset: u64, bytes: usize| {
        let mut read = source.read_exact_at(offset, bytes)?;
        if !is_little {
            read.reverse();
        }
        Ok::<u64, TiffError>(read.iter().rev().fold(0, |n, byte| n << 8 | u64::from(*byte)))
    };
    // The sizes of the count of entries, of an entry, and of its count and value.
    let (counted, entry, wide) = if file.is_bigtiff() { (8, 20, 8) } else { (2, 12, 4) };
    let mut found = Vec::new();
    for k in 0..number(directory, counted)?.min(u64::from(u16::MAX)) {
        let at = directory + counted as u64 + k * entry;
        if number(at, 2)? != u64::from(SAMPLE_FORMAT) {
            continue;
        }
        let count = number(at + 4, wide)?.min(MAX_CHANNELS);
        let value = at + 4 + wide as u64;
        let first = if 2 * count <= wide as u64 { value } else { number(value, wide)? };
        let unsigned = if is_little { UNSIGNED.to_le_bytes() } else { UNSIGNED.to_be_bytes() };
        let places = (0..count).flat_map(|k| [(first + 2 * k, unsigned[0]), (first + 2 * k + 1, unsigned[1])]);
        found.extend(places);
    }
    Ok(found)
}
