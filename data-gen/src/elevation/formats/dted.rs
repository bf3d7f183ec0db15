//! DTED (MIL-PRF-89020B): profiles of heights along meridians, the westernmost first, each from south to north.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use super::{Opened, height_bits};
use crate::GenError;
use crate::georeference::{Crs, GeoTransform, Placement};
use crate::store::{BlockGrid, BlockReader, FileState, Rect};

/// The length of a label of a tape, and of the user header label.
const LABEL_BYTES: usize = 80;
/// The number of labels of a tape that may precede the user header label.
const MAX_LABELS: usize = 2;
/// The lengths of the user header label, the data set identification and the accuracy record.
const HEADER_BYTES: u64 = 80 + 648 + 2700;
/// The bytes of a profile before and after its heights.
const PROFILE_START: u64 = 8;
const PROFILE_END: u64 = 4;
/// The value of unknown heights.
const UNKNOWN: i16 = -32767;
/// Sign and magnitude below this do not occur: the file has two's complement, against its specification.
const LOWEST: i16 = -16000;
/// The number of profiles in a block.
const PROFILES: usize = 64;

/// The header of a file.
#[derive(Debug, PartialEq)]
struct Header {
    /// The number of profiles, and of heights in each.
    size: [usize; 2],
    /// Longitude and latitude of the first height, in degrees.
    corner: [f64; 2],
    /// The distances of profiles and of their heights, in degrees.
    step: [f64; 2],
    /// The position of the first profile in the file.
    start: u64,
}

impl Header {
    /// Reads the first bytes of a file. The error is the reason.
    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let mut labels = bytes.chunks_exact(LABEL_BYTES).take(MAX_LABELS + 1);
        let before = labels.clone().take_while(|label| !label.starts_with(b"UHL1")).count();
        let label = labels.nth(before).ok_or("no user header label")?;
        let text = |from: usize, count: usize| std::str::from_utf8(&label[from..from + count]).unwrap_or_default();
        let number = |from: usize, count: usize| text(from, count).trim().parse::<u32>().ok();
        let angle = |from: usize, hemispheres: [&str; 2], name: &str| {
            let parts = [number(from, 3), number(from + 3, 2), number(from + 5, 2)];
            let sign = match text(from + 7, 1) {
                h if h == hemispheres[0] => 1.0,
                h if h == hemispheres[1] => -1.0,
                _ => 0.0,
            };
            match parts {
                [Some(d), Some(m), Some(s)] if sign != 0.0 => {
                    Ok(sign * (f64::from(d) + f64::from(m) / 60.0 + f64::from(s) / 3600.0))
                }
                _ => Err(format!("its {name} is `{}`", text(from, 8).escape_debug())),
            }
        };
        let corner = [angle(4, ["E", "W"], "longitude")?, angle(12, ["N", "S"], "latitude")?];
        let positive = |from: usize, name: &str| {
            let found = number(from, 4).filter(|n| *n > 0);
            found.ok_or_else(|| format!("its {name} is `{}`", text(from, 4).escape_debug()))
        };
        // Tenths of a second.
        let step = [positive(20, "interval of longitude")?, positive(24, "interval of latitude")?];
        let size = [positive(47, "number of profiles")?, positive(51, "number of latitudes")?];
        let start = HEADER_BYTES + (before * LABEL_BYTES) as u64;
        Ok(Self { size: size.map(|n| n as usize), corner, step: step.map(|n| f64::from(n) / 36_000.0), start })
    }

    fn profile_bytes(&self) -> u64 {
        PROFILE_START + 2 * self.size[1] as u64 + PROFILE_END
    }

    /// Heights are points; pixels reach half a step around them.
    fn placement(&self) -> Placement {
        let [dx, dy] = self.step;
        let north = self.corner[1] + dy * (self.size[1] - 1) as f64;
        let origin = [self.corner[0] - 0.5 * dx, north + 0.5 * dy];
        Placement::new(GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] }, Crs::Geographic)
    }
}

/// A DTED file, read by seeking.
struct Dted {
    path: PathBuf,
    header: Header,
    state: FileState,
}

/// Opens a DTED file of any level.
pub(super) fn open(path: &Path) -> Result<Opened, GenError> {
    let bad = |reason: String| GenError::invalid(path, format!("DTED: {reason}"));
    let state = FileState::of(path)?;
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(GenError::file(path))?;
    file.take(((MAX_LABELS + 1) * LABEL_BYTES) as u64).read_to_end(&mut bytes).map_err(GenError::file(path))?;
    let header = Header::parse(&bytes).map_err(bad)?;
    let needed = header.start + header.size[0] as u64 * header.profile_bytes();
    if state.bytes() < needed {
        let [profiles, heights] = header.size;
        return Err(bad(format!("{} bytes for {profiles} profiles of {heights} heights", state.bytes())));
    }
    let grid = BlockGrid::new(header.size, [PROFILES, header.size[1]]);
    let placement = header.placement();
    Ok(Opened { grid, reader: Box::new(Dted { path: path.to_owned(), header, state }), placement })
}

/// Returns true for the first bytes of a DTED file.
pub(super) fn is_dted(magic: &[u8]) -> bool {
    [b"UHL1", b"VOL1", b"HDR1"].iter().any(|label| magic.starts_with(*label))
}

impl BlockReader for Dted {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        self.state.check(&self.path)?;
        let stride = self.header.profile_bytes();
        let read = || {
            let mut file = File::open(&self.path)?;
            file.seek(SeekFrom::Start(self.header.start + block.column as u64 * stride))?;
            let mut bytes = vec![0; block.width * stride as usize];
            file.read_exact(&mut bytes)?;
            Ok(bytes)
        };
        let bytes = read().map_err(GenError::file(&self.path))?;
        let mut heights = vec![f32::NAN; block.pixels()];
        for (column, profile) in bytes.chunks_exact(stride as usize).enumerate() {
            // A block has all heights of its profiles.
            let samples = &profile[PROFILE_START as usize..stride as usize - PROFILE_END as usize];
            for (k, sample) in samples.as_chunks().0.iter().enumerate() {
                heights[(block.height - 1 - k) * block.width + column] = height_m(*sample);
            }
        }
        Ok(height_bits(heights))
    }
}

/// Returns a height of sign and magnitude, NaN if it is unknown.
fn height_m(sample: [u8; 2]) -> f32 {
    let bits = i16::from_be_bytes(sample);
    let height = if bits < 0 { -(bits & i16::MAX) } else { bits };
    match height {
        UNKNOWN => f32::NAN,
        height if height < LOWEST => f32::from(bits),
        height => f32::from(height),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_have_a_sign_and_a_magnitude() {
        for (sample, expected) in [([0, 7], 7.0), ([0x80, 7], -7.0), ([0x81, 0], -256.0), ([0xff, 0xf6], -10.0)] {
            assert_eq!(height_m(sample), expected, "{sample:?}");
        }
        assert!(height_m([0xff, 0xff]).is_nan());
    }
}
