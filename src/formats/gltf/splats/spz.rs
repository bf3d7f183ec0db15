//! SPZ, Niantic's format of compressed Gaussian splats, versions 1 to 3 (<https://github.com/nianticlabs/spz>).
//!
//! ```text
//! gzip of
//!   header      magic "NGSP", version, number of splats: u32 each; degree of harmonics, fractional bits, flags, 0: u8 each
//!   positions   3 x 24-bit fixed point; version 1: 3 x f16
//!   opacities   u8
//!   colours     3 x u8: coefficients of the first harmonic, -3.33 to 3.33
//!   scales      3 x u8: 16 steps for a factor of e, from e^-10 on
//!   rotations   x, y, z as 3 x u8, with w from 0 on; version 3: u32, its largest component left out
//!   harmonics   3 x u8 for each coefficient above degree 0: 128 for 0, and 128 steps for 1
//! ```
//! Values are taken as they are, as CesiumJS does. The draft of the glTF extension demands half a turn around y (decision
//! 0069).

use std::io::Read;

use exr::prelude::f16;

use super::{Found, HARMONIC_0, SourceSplat};
use crate::fetch::IoError;
use crate::scene::SplatHarmonics;

const MAGIC: &[u8; 4] = b"NGSP";
const HEADER_BYTES: usize = 16;
/// The bit of the header's flags for records after it, whose sizes only their writer knows.
const HAS_EXTENSIONS: u8 = 2;
/// Colours are stored with this share of the range of a byte for 1.
const COLOR_SCALE: f32 = 0.15;

/// The reason why an SPZ file cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum SpzError {
    #[error("SPZ: {0}")]
    Gzip(#[from] std::io::Error),
    #[error("SPZ: magic {0:02x?}, expected \"NGSP\"")]
    Magic([u8; 4]),
    #[error("SPZ: version {0}; versions 1 to 3 are read")]
    Version(u32),
    #[error("SPZ: harmonics of degree {0}, expected 0 to 3")]
    Degree(u8),
    #[error("SPZ: {0} fractional bits, expected at most 24")]
    FractionalBits(u8),
    #[error("SPZ: records after the header, which are not read")]
    Extensions,
    #[error("SPZ: ends within the values of {0} splats")]
    Truncated(usize),
    /// The caller has no room for the splats.
    #[error(transparent)]
    Refused(IoError),
}

#[derive(Clone, Copy, Debug)]
struct Header {
    version: u32,
    count: usize,
    degree: u8,
    fractional_bits: u8,
}

impl Header {
    fn new(bytes: &[u8; HEADER_BYTES]) -> Result<Self, SpzError> {
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let magic = [bytes[0], bytes[1], bytes[2], bytes[3]];
        let (version, [degree, fractional_bits, flags]) = (word(4), [bytes[12], bytes[13], bytes[14]]);
        match () {
            _ if magic != *MAGIC => Err(SpzError::Magic(magic)),
            _ if !(1..=3).contains(&version) => Err(SpzError::Version(version)),
            _ if degree > 3 => Err(SpzError::Degree(degree)),
            _ if fractional_bits > 24 => Err(SpzError::FractionalBits(fractional_bits)),
            _ if flags & HAS_EXTENSIONS != 0 => Err(SpzError::Extensions),
            _ => Ok(Self { version, count: word(8) as usize, degree, fractional_bits }),
        }
    }

    /// Returns the bytes of a position, and of a rotation.
    fn sizes(&self) -> [usize; 2] {
        [if self.version == 1 { 6 } else { 9 }, if self.version < 3 { 3 } else { 4 }]
    }

    /// Returns the bytes of a splat.
    fn splat_bytes(&self) -> usize {
        let [position, rotation] = self.sizes();
        position + 1 + 3 + 3 + rotation + 3 * SplatHarmonics::coefficients_of(self.degree)
    }

    fn position(&self, bytes: &[u8]) -> [f32; 3] {
        if self.version == 1 {
            return std::array::from_fn(|k| f16::from_le_bytes([bytes[2 * k], bytes[2 * k + 1]]).to_f32());
        }
        let scale = 1.0 / (1u32 << self.fractional_bits) as f32;
        std::array::from_fn(|k| {
            let fixed = i32::from_le_bytes([0, bytes[3 * k], bytes[3 * k + 1], bytes[3 * k + 2]]) >> 8;
            fixed as f32 * scale
        })
    }

    fn rotation(&self, bytes: &[u8]) -> [f32; 4] {
        match bytes {
            [a, b, c, d] => smallest_three(u32::from_le_bytes([*a, *b, *c, *d])),
            _ => {
                let [x, y, z] = [0, 1, 2].map(|k| f32::from(bytes[k]) / 127.5 - 1.0);
                [x, y, z, (1.0 - x * x - y * y - z * z).max(0.0).sqrt()]
            }
        }
    }
}

/// Returns a unit quaternion from three of its components, of ten bits each, and the index of the largest one in the two
/// highest bits.
fn smallest_three(mut bits: u32) -> [f32; 4] {
    let largest = (bits >> 30) as usize;
    let mut rotation = [0.0f32; 4];
    for k in (0..4).rev().filter(|k| *k != largest) {
        let size = (bits & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        rotation[k] = if bits >> 9 & 1 == 1 { -size } else { size };
        bits >>= 10;
    }
    let sum: f32 = rotation.iter().map(|q| q * q).sum();
    rotation[largest] = (1.0 - sum).max(0.0).sqrt();
    rotation
}

/// Reads an SPZ file. `reserve` is called with the number of splats and the bytes to unpack before they are, and may refuse
/// them.
pub(super) fn read(
    file: &[u8],
    is_linear: bool,
    reserve: impl FnOnce(usize, u64) -> Result<(), IoError>,
) -> Result<Found, SpzError> {
    // Version 4 begins with the magic: it compresses the parts, not the file.
    if let Some(header) = file.first_chunk::<HEADER_BYTES>().filter(|header| header.starts_with(MAGIC)) {
        return Err(SpzError::Version(u32::from_le_bytes([header[4], header[5], header[6], header[7]])));
    }
    let mut plain = flate2::read::GzDecoder::new(file);
    let mut header = [0; HEADER_BYTES];
    plain.read_exact(&mut header)?;
    let header = Header::new(&header)?;
    let Header { count, degree, .. } = header;
    let bytes = count as u64 * header.splat_bytes() as u64;
    reserve(count, bytes).map_err(SpzError::Refused)?;
    let mut values = Vec::new();
    plain.by_ref().take(bytes).read_to_end(&mut values)?;
    if values.len() as u64 != bytes {
        return Err(SpzError::Truncated(count));
    }
    let [position_bytes, rotation_bytes] = header.sizes();
    let (positions, rest) = values.split_at(count * position_bytes);
    let (opacities, rest) = rest.split_at(count);
    let (colors, rest) = rest.split_at(count * 3);
    let (scales, rest) = rest.split_at(count * 3);
    let (rotations, harmonics) = rest.split_at(count * rotation_bytes);
    let mut found = Found::new(count, degree, is_linear);
    let mut coefficients = vec![[0.0; 3]; SplatHarmonics::coefficients_of(degree)];
    for i in 0..count {
        let bytes = harmonics[3 * coefficients.len() * i..].iter();
        for (value, byte) in coefficients.as_flattened_mut().iter_mut().zip(bytes) {
            *value = (f32::from(*byte) - 128.0) / 128.0;
        }
        let splat = SourceSplat {
            position: header.position(&positions[position_bytes * i..][..position_bytes]),
            scale: [0, 1, 2].map(|k| (f32::from(scales[3 * i + k]) / 16.0 - 10.0).exp()),
            rotation: header.rotation(&rotations[rotation_bytes * i..][..rotation_bytes]),
            color: [0, 1, 2].map(|k| {
                let coefficient = (f32::from(colors[3 * i + k]) / 255.0 - 0.5) / COLOR_SCALE;
                0.5 + HARMONIC_0 * coefficient
            }),
            opacity: f32::from(opacities[i]) / 255.0,
        };
        found.add(&splat, &coefficients);
    }
    Ok(found)
}
