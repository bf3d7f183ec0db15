//! SPZ, Niantic's format of compressed Gaussian splats, versions 1 to 4 (<https://github.com/nianticlabs/spz>).
//!
//! ```text
//! header        magic "NGSP", version, number of splats: u32 each; degree of harmonics, fractional bits, flags, streams: u8 each
//! attributes
//!   positions   3 x 24-bit fixed point; version 1: 3 x f16
//!   opacities   u8
//!   colours     3 x u8: coefficients of the first harmonic, -3.33 to 3.33
//!   scales      3 x u8: 16 steps for a factor of e, from e^-10 on
//!   rotations   x, y, z as 3 x u8, with w from 0 on; from version 3 on: u32, its largest component left out
//!   harmonics   3 x u8 for each coefficient above degree 0: 128 for 0, and 128 steps for 1
//! ```
//! Up to version 3 all of it is compressed by gzip, with records of writers behind. A file of version 4 is
//! ```text
//! header, u32: where the table begins, 12 bytes 0
//! records       of writers, up to the table
//! table         2 x u64 for each attribute that is not empty: bytes compressed, bytes unpacked
//! streams       one zstd stream for each of these attributes
//! ```
//! Values are taken as they are, as CesiumJS does. The draft of the glTF extension demands half a turn around y (decision
//! 0069).

use std::io::Read;

use exr::prelude::f16;

use super::{Found, HARMONIC_0, SourceSplat};
use crate::fetch::{IoError, encoding};
use crate::scene::SplatHarmonics;

const MAGIC: &[u8; 4] = b"NGSP";
const HEADER_BYTES: usize = 16;
/// The bytes before the records of version 4.
const HEADER_4_BYTES: usize = 32;
const MAX_DEGREE: u8 = 4;
/// The bit of the header's flags for splats that were trained to be smoothed as small ones are.
const IS_ANTIALIASED: u8 = 1;
/// The bit of the header's flags for records of writers.
const HAS_RECORDS: u8 = 2;
/// Colours are stored with this share of the range of a byte for 1.
const COLOR_SCALE: f32 = 0.15;

/// The reason why an SPZ file cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum SpzError {
    #[error("SPZ: {0}")]
    Gzip(#[from] std::io::Error),
    #[error("SPZ: magic {0:02x?}, expected \"NGSP\"")]
    Magic([u8; 4]),
    #[error("SPZ: version {0}; versions 1 to 3 within gzip and version 4 without it are read")]
    Version(u32),
    #[error("SPZ: harmonics of degree {0}, expected 0 to 4")]
    Degree(u8),
    #[error("SPZ: {0} fractional bits, expected at most 24")]
    FractionalBits(u8),
    #[error("SPZ: stream {0} does not unpack to its {1} bytes")]
    Stream(usize, usize),
    #[error("SPZ: stream {0}: {1}")]
    Zstd(usize, String),
    #[error("SPZ: ends within the values of {0} splats")]
    Truncated(usize),
    /// The caller has no room for the splats.
    #[error(transparent)]
    Refused(IoError),
}

/// The number of attributes, each with its own stream in version 4.
const ATTRIBUTES: usize = 6;

#[derive(Clone, Copy, Debug)]
struct Header {
    version: u32,
    count: usize,
    degree: u8,
    fractional_bits: u8,
    flags: u8,
}

impl Header {
    fn new(bytes: &[u8; HEADER_BYTES]) -> Result<Self, SpzError> {
        let magic = [bytes[0], bytes[1], bytes[2], bytes[3]];
        let (version, [degree, fractional_bits, flags]) = (word(bytes, 4), [bytes[12], bytes[13], bytes[14]]);
        match () {
            _ if magic != *MAGIC => Err(SpzError::Magic(magic)),
            _ if degree > MAX_DEGREE => Err(SpzError::Degree(degree)),
            _ if fractional_bits > 24 => Err(SpzError::FractionalBits(fractional_bits)),
            _ => Ok(Self { version, count: word(bytes, 8) as usize, degree, fractional_bits, flags }),
        }
    }

    /// Returns the bytes of each attribute of a splat, in the order of the file.
    fn sizes(&self) -> [usize; ATTRIBUTES] {
        let (position, rotation) = (if self.version == 1 { 6 } else { 9 }, if self.version < 3 { 3 } else { 4 });
        [position, 1, 3, 3, rotation, 3 * SplatHarmonics::coefficients_of(self.degree)]
    }

    /// Returns the bytes of all splats.
    fn bytes(&self) -> u64 {
        self.count as u64 * self.sizes().iter().sum::<usize>() as u64
    }

    /// Returns what is left out of the file.
    fn ignored(&self) -> Vec<&'static str> {
        let of_flag = |flag, what| (self.flags & flag != 0).then_some(what);
        let degree = (self.degree == MAX_DEGREE).then_some("glTF: harmonics of degree 4 of Gaussian splats");
        let flags = [
            of_flag(IS_ANTIALIASED, "glTF: antialiasing of Gaussian splats"),
            of_flag(HAS_RECORDS, "glTF: records of an SPZ file"),
        ];
        flags.into_iter().chain([degree]).flatten().collect()
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

fn word(bytes: &[u8; HEADER_BYTES], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

/// Reads an SPZ file. `reserve` is called with the number of splats and the bytes to unpack before they are, and may refuse
/// them.
pub(super) fn read(
    file: &[u8],
    is_linear: bool,
    reserve: impl FnOnce(usize, u64) -> Result<(), IoError>,
) -> Result<Found, SpzError> {
    if let Some(bytes) = file.first_chunk::<HEADER_BYTES>().filter(|bytes| bytes.starts_with(MAGIC)) {
        let header = Header::new(bytes)?;
        if header.version != 4 {
            return Err(SpzError::Version(header.version));
        }
        reserve(header.count, header.bytes()).map_err(SpzError::Refused)?;
        return Ok(splats(&header, &unpack_streams(&header, file)?, is_linear));
    }
    let mut plain = flate2::read::GzDecoder::new(file);
    let mut bytes = [0; HEADER_BYTES];
    plain.read_exact(&mut bytes)?;
    let header = Header::new(&bytes)?;
    if !(1..=3).contains(&header.version) {
        return Err(SpzError::Version(header.version));
    }
    reserve(header.count, header.bytes()).map_err(SpzError::Refused)?;
    let mut values = Vec::new();
    plain.by_ref().take(header.bytes()).read_to_end(&mut values)?;
    if values.len() as u64 != header.bytes() {
        return Err(SpzError::Truncated(header.count));
    }
    Ok(splats(&header, &values, is_linear))
}

/// Returns the attributes of a file of version 4, one after the other as in older versions.
fn unpack_streams(header: &Header, file: &[u8]) -> Result<Vec<u8>, SpzError> {
    let truncated = || SpzError::Truncated(header.count);
    let long = |at: usize| {
        let bytes = file.get(at..).and_then(|rest| rest.first_chunk()).ok_or_else(truncated)?;
        usize::try_from(u64::from_le_bytes(*bytes)).map_err(|_| truncated())
    };
    let stated = file.get(HEADER_BYTES..).and_then(|rest| rest.first_chunk()).ok_or_else(truncated)?;
    let mut entry = (u32::from_le_bytes(*stated) as usize).max(HEADER_4_BYTES);
    let sizes = header.sizes().map(|size| size * header.count);
    let streams = sizes.iter().filter(|size| **size > 0);
    let mut at = entry.saturating_add(16 * streams.clone().count());
    let mut values = Vec::new();
    for (number, size) in streams.enumerate() {
        let (compressed, unpacked) = (long(entry)?, long(entry + 8)?);
        let end = at.checked_add(compressed).ok_or_else(truncated)?;
        let stream = file.get(at..end).ok_or_else(truncated)?;
        if unpacked != *size {
            return Err(SpzError::Stream(number, *size));
        }
        let stream = encoding::unzstd("", stream, *size as u64);
        let stream = stream.map_err(|error| SpzError::Zstd(number, error.reason()))?;
        if stream.len() != *size {
            return Err(SpzError::Stream(number, *size));
        }
        values.extend(stream);
        (entry, at) = (entry + 16, end);
    }
    Ok(values)
}

/// Returns the splats of unpacked attributes, which have the bytes of the header.
fn splats(header: &Header, values: &[u8], is_linear: bool) -> Found {
    let Header { count, degree, .. } = *header;
    let [position_bytes, _, _, _, rotation_bytes, _] = header.sizes();
    let (positions, rest) = values.split_at(count * position_bytes);
    let (opacities, rest) = rest.split_at(count);
    let (colors, rest) = rest.split_at(count * 3);
    let (scales, rest) = rest.split_at(count * 3);
    let (rotations, harmonics) = rest.split_at(count * rotation_bytes);
    let mut found = Found::new(count, degree, is_linear);
    found.ignored = header.ignored();
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
    found
}
