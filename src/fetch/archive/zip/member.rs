//! One file of a zip archive: the span to read, the content inside that span, and its decompression.

use super::directory::Member;
use crate::fetch::archive::span::{Span, le_uint};
use crate::fetch::{IoError, Limits, encoding};

const LOCAL_HEADER: u64 = 0x0403_4b50;
const LOCAL_HEADER_BYTES: u64 = 30;
/// The local extra field may be this many bytes longer than the one in the directory before a second read is needed.
const SLACK_BYTES: u64 = 256;
/// An upper bound for the bytes that are read with a content beyond its own size. Name and extra field of a local header have
/// at most 64 KiB each.
pub(in crate::fetch::archive) const MAX_HEADER_BYTES: u64 = (1 << 18) + SLACK_BYTES;

// Compression methods (APPNOTE 4.4.5).
pub(super) const STORED: u16 = 0;
const DEFLATED: u16 = 8;
const ZSTD: u16 = 93;

/// Returns the span of a member's local header and content, as far as the directory knows their length. The directory begins
/// at offset `directory`.
pub(in crate::fetch::archive) fn member_span(
    uri: &str,
    member: &Member,
    directory: u64,
    limits: &Limits,
) -> Result<Span, IoError> {
    check_member(uri, member, limits)?;
    let head = LOCAL_HEADER_BYTES + (member.name_bytes + member.extra_bytes) as u64 + SLACK_BYTES;
    // The parser of the directory has checked that the member begins before the directory.
    let size = (head + member.packed).min(directory - member.offset);
    Ok(Span { offset: member.offset, size })
}

/// Fails if the member is encrypted or larger than the limits.
pub(in crate::fetch::archive) fn check_member(uri: &str, member: &Member, limits: &Limits) -> Result<(), IoError> {
    if member.is_encrypted {
        return Err(IoError::unsupported(uri, "an encrypted file in an archive"));
    }
    let limit = limits.max_file_bytes;
    for got in [member.size, member.packed] {
        if got > limit {
            return Err(IoError::TooLarge { uri: uri.to_owned(), what: "file in an archive", got, limit });
        }
    }
    Ok(())
}

/// Returns the range of the content in `piece`, which begins with the member's local header. The range may reach beyond the
/// end of the piece.
pub(in crate::fetch::archive) fn content_range(
    uri: &str,
    member: &Member,
    piece: &[u8],
) -> Result<std::ops::Range<u64>, IoError> {
    let broken = || IoError::invalid(uri, "a broken header in the archive");
    let (Some(LOCAL_HEADER), Some(name), Some(extra)) =
        (le_uint::<4>(piece, 0), le_uint::<2>(piece, 26), le_uint::<2>(piece, 28))
    else {
        return Err(broken());
    };
    if name != member.name_bytes as u64 {
        return Err(broken());
    }
    let start = LOCAL_HEADER_BYTES + name + extra;
    Ok(start..start.checked_add(member.packed).ok_or_else(broken)?)
}

/// Decompresses a content and checks its size and checksum.
pub(in crate::fetch::archive) fn unpack(
    uri: &str,
    member: &Member,
    packed: Vec<u8>,
    limits: &Limits,
) -> Result<Vec<u8>, IoError> {
    let limit = member.size.min(limits.max_file_bytes);
    let bytes = match member.method {
        STORED => packed,
        DEFLATED => {
            encoding::read_limited(uri, "deflate", flate2::read::DeflateDecoder::new(packed.as_slice()), limit)?
        }
        ZSTD => encoding::unzstd(uri, &packed, limit)?,
        other => return Err(IoError::unsupported(uri, format!("compression method {other} in an archive"))),
    };
    if bytes.len() as u64 != member.size || crc32fast::hash(&bytes) != member.crc {
        return Err(IoError::invalid(uri, "size or checksum differs from the archive's directory"));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overflowing_lengths_are_errors() {
        let mut piece = LOCAL_HEADER.to_le_bytes()[..4].to_vec();
        piece.resize(LOCAL_HEADER_BYTES as usize, 0);
        let with = |packed| Member {
            offset: 0,
            packed,
            size: packed,
            crc: 0,
            method: STORED,
            is_encrypted: false,
            name_bytes: 0,
            extra_bytes: 0,
        };
        assert_eq!(content_range("a", &with(7), &piece), Ok(30..37));
        assert!(content_range("a", &with(u64::MAX), &piece).is_err());
    }
}
