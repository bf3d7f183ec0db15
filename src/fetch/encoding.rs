//! Decompression with an upper limit on the result: the `Content-Encoding`s of HTTP, gzip by magic, and zstd for archives.
//! CPU only; any thread.

use std::io::Read;

use super::error::IoError;
use super::limits::Limits;
use super::memory::gated;

/// The `Accept-Encoding` of requests.
#[cfg(feature = "http")]
pub(crate) const ACCEPT: &str = "zstd, br, gzip";
/// The first bytes of gzip.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// The maximum number of encodings applied to one body.
#[cfg(feature = "http")]
const MAX_ENCODINGS: usize = 4;

/// Returns true if [`decode`] makes other bytes of a body.
#[cfg(feature = "http")]
pub(crate) fn is_encoded(bytes: &[u8], encodings: &str) -> bool {
    !encodings.is_empty() || bytes.starts_with(&GZIP_MAGIC)
}

/// Decodes a body by its `Content-Encoding`, last encoding first, and then gzip that the header does not list.
#[cfg(feature = "http")]
pub(crate) fn decode(uri: &str, mut bytes: Vec<u8>, encodings: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
    let names: Vec<String> = encodings.split(',').map(|e| e.trim().to_ascii_lowercase()).collect();
    if names.len() > MAX_ENCODINGS {
        return Err(IoError::invalid(uri, "more than four content encodings"));
    }
    for name in names.iter().rev() {
        bytes = match name.as_str() {
            "" | "identity" => bytes,
            "gzip" | "x-gzip" => gunzip(uri, bytes, limits)?,
            "br" => {
                let reader = brotli_decompressor::Decompressor::new(bytes.as_slice(), 4096);
                read_limited(uri, "br", reader, limits.max_file_bytes)?
            }
            "zstd" => unzstd(uri, &bytes, limits.max_file_bytes)?,
            "deflate" => inflate(uri, bytes, limits)?,
            "compress" | "x-compress" | "exi" | "pack200-gzip" | "dcb" | "dcz" => {
                return Err(IoError::unsupported(uri, format!("content encoding {name:?}")));
            }
            // No encoding, but stored with the object by mistake, such as `utf-8` and `aws-chunked`. Browsers do the same.
            _ => bytes,
        };
    }
    gunzip(uri, bytes, limits)
}

/// Decodes any bytes with any list of encodings and checks the limit. Entry point of the fuzz tests.
#[cfg(all(feature = "http", feature = "testing"))]
pub fn fuzz_encoding(encodings: &str, bytes: &[u8], limits: &Limits) {
    match decode("fuzz", bytes.to_vec(), encodings, limits) {
        Ok(plain) => assert!(plain.len() as u64 <= limits.max_file_bytes.max(bytes.len() as u64)),
        Err(error) => assert!(!error.uri().is_empty() && !error.reason().is_empty()),
    }
}

/// Decodes all frames of a zstd stream.
pub(crate) fn unzstd(uri: &str, mut bytes: &[u8], limit: u64) -> Result<Vec<u8>, IoError> {
    use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
    let bad = |e: String| IoError::invalid(uri, format!("zstd: {e}"));
    let mut out = Vec::new();
    while !bytes.is_empty() {
        match ruzstd::decoding::StreamingDecoder::new(&mut bytes) {
            Ok(mut decoder) => {
                let left = limit - out.len() as u64;
                gated(&mut decoder).take(left + 1).read_to_end(&mut out).map_err(|e| bad(e.to_string()))?;
                if out.len() as u64 > limit {
                    return Err(IoError::TooLarge { uri: uri.to_owned(), what: "file", got: limit + 1, limit });
                }
                let decoder = decoder.into_frame_decoder();
                let (stored, computed) = (decoder.get_checksum_from_data(), decoder.get_calculated_checksum());
                if stored.is_some() && stored != computed {
                    return Err(bad("wrong checksum".to_owned()));
                }
            }
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                bytes = bytes.get(length as usize..).ok_or_else(|| bad("ends early".to_owned()))?;
            }
            Err(e) => return Err(bad(e.to_string())),
        }
    }
    Ok(out)
}

/// Decodes gzip if the bytes begin with its magic; returns other bytes unchanged. Servers and disks often hold gzip files
/// without declaring it.
pub(crate) fn gunzip(uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, IoError> {
    if !bytes.starts_with(&GZIP_MAGIC) {
        return Ok(bytes);
    }
    let max_bytes = limits.max_file_bytes.saturating_add(1);
    let mut plain = Vec::with_capacity(max_bytes.min(bytes.len() as u64 * 3) as usize);
    gated(flate2::read::MultiGzDecoder::new(bytes.as_slice()))
        .take(max_bytes)
        .read_to_end(&mut plain)
        .map_err(|e| IoError::invalid(uri, format!("gzip: {e}")))?;
    limits.check_file_bytes(uri, plain.len() as u64)?;
    Ok(plain)
}

/// Decodes `deflate`: zlib, or the bare stream that some servers send under this name.
#[cfg(feature = "http")]
fn inflate(uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, IoError> {
    // The header of zlib: method 8, and a multiple of 31.
    let is_zlib = matches!(bytes[..], [first, second, ..]
        if first & 15 == 8 && u16::from_be_bytes([first, second]).is_multiple_of(31));
    match is_zlib {
        true => {
            let reader = gated(flate2::read::ZlibDecoder::new(bytes.as_slice()));
            read_limited(uri, "deflate", reader, limits.max_file_bytes)
        }
        false => {
            let reader = gated(flate2::read::DeflateDecoder::new(bytes.as_slice()));
            read_limited(uri, "deflate", reader, limits.max_file_bytes)
        }
    }
}

/// Reads a decoder to its end. Fails with [`IoError::TooLarge`] beyond `limit` bytes; `what` names the format in errors.
pub(crate) fn read_limited(uri: &str, what: &str, reader: impl Read, limit: u64) -> Result<Vec<u8>, IoError> {
    let mut out = Vec::new();
    reader.take(limit + 1).read_to_end(&mut out).map_err(|e| IoError::invalid(uri, format!("{what}: {e}")))?;
    if out.len() as u64 > limit {
        return Err(IoError::TooLarge { uri: uri.to_owned(), what: "file", got: limit + 1, limit });
    }
    Ok(out)
}

#[cfg(all(test, feature = "http"))]
mod tests {
    use std::io::Write as _;

    use super::*;

    const LIMITS: Limits = Limits {
        max_file_bytes: 100_000,
        max_image_side_px: 1,
        max_image_bytes: 1,
        max_elements: 1,
        max_depth: 1,
        max_external_depth: 1,
        max_json_bytes: 0,
        max_content_bytes: 0,
        file_timeout: std::time::Duration::MAX,
        follow_links: false,
        allow_outside: false,
    };

    fn text() -> Vec<u8> {
        b"heights and imagery ".repeat(400)
    }

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(bytes).expect("memory takes it");
        encoder.finish().expect("memory takes it")
    }

    fn zlib(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(bytes).expect("memory takes it");
        encoder.finish().expect("memory takes it")
    }

    fn zstd(bytes: &[u8]) -> Vec<u8> {
        ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest)
    }

    /// A brotli stream of uncompressed blocks (RFC 7932, 9.2).
    fn brotli(bytes: &[u8]) -> Vec<u8> {
        // WBITS 16 is one zero bit. Each block then has ISLAST 0, MNIBBLES 4, MLEN - 1, ISUNCOMPRESSED, padding.
        let mut out = Vec::new();
        for (i, block) in bytes.chunks(0x1_0000).enumerate() {
            let head = ((block.len() as u32 - 1) << 3) | (1 << 19);
            let bits = if i == 0 { head << 1 } else { head };
            // 21 or 20 bits, padded to a whole byte.
            out.extend_from_slice(&bits.to_le_bytes()[..3]);
            out.extend_from_slice(block);
        }
        out.push(3);
        out
    }

    #[test]
    fn all_content_encodings_are_decoded() {
        let plain = text();
        for (encodings, bytes) in [
            ("", plain.clone()),
            ("identity", plain.clone()),
            ("gzip", gzip(&plain)),
            ("", gzip(&plain)),
            ("X-GZIP", gzip(&plain)),
            ("zstd", zstd(&plain)),
            ("zstd", [zstd(&plain[..10]), vec![0x50, 0x2a, 0x4d, 0x18, 1, 0, 0, 0, 9], zstd(&plain[10..])].concat()),
            ("br", brotli(&plain)),
            ("br, gzip", gzip(&brotli(&plain))),
            ("zstd", zstd(&gzip(&plain))),
            ("deflate", zlib(&plain)),
            ("deflate", zlib(&plain)[2..].to_vec()),
            ("utf-8", plain.clone()),
            ("aws-chunked,gzip", gzip(&plain)),
        ] {
            assert!(decode("u", bytes, encodings, &LIMITS).unwrap() == plain, "{encodings}");
        }
    }

    #[test]
    fn oversized_and_broken_bodies_are_refused() {
        let bomb = vec![0u8; 100_001];
        for (encodings, bytes) in
            [("gzip", gzip(&bomb)), ("zstd", zstd(&bomb)), ("br", brotli(&bomb)), ("deflate", zlib(&bomb))]
        {
            let error = decode("u", bytes, encodings, &LIMITS).unwrap_err();
            assert!(matches!(error, IoError::TooLarge { .. }), "{encodings}: {error}");
        }
        let plain = text();
        for (encodings, bytes) in [("gzip", gzip(&plain)), ("zstd", zstd(&plain)), ("br", brotli(&plain))] {
            let cut = bytes[..bytes.len() / 2].to_vec();
            let error = decode("u", cut, encodings, &LIMITS).unwrap_err();
            assert!(matches!(error, IoError::Invalid { .. }), "{encodings}: {error}");
        }
        let mut changed = zstd(&plain);
        let at = changed.len() - 1;
        changed[at] ^= 1;
        assert!(decode("u", changed, "zstd", &LIMITS).is_err(), "the checksum is wrong");
        assert!(matches!(decode("u", plain.clone(), "compress", &LIMITS), Err(IoError::Unsupported { .. })));
        assert!(decode("u", plain, "gzip,gzip,gzip,gzip,gzip", &LIMITS).is_err());
    }
}
