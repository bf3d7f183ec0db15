//! One file of an archive: which piece of the archive holds it, and undoing its compression.

use super::directory::{Member, Span, number};
use crate::io::{IoError, Limits, encoding};

const LOCAL_HEADER: u64 = 0x0403_4b50;
const LOCAL_HEADER_BYTES: u64 = 30;
/// The extra field before the content may be so much longer than the one in the directory without a second read.
pub(crate) const SLACK_BYTES: u64 = 256;

pub(super) const STORED: u16 = 0;
const DEFLATED: u16 = 8;
const ZSTD: u16 = 93;

/// The piece to read: header and content, as far as the directory knows their length. It begins at `start`.
pub(crate) fn piece_of(uri: &str, member: &Member, start: u64, limits: &Limits) -> Result<Span, IoError> {
    check(uri, member, limits)?;
    let head = LOCAL_HEADER_BYTES + (member.name_bytes + member.extra_bytes) as u64 + SLACK_BYTES;
    // The directory made sure that the offset is before its own.
    let size = (head + member.packed).min(start - member.offset);
    Ok(Span { offset: member.offset, size })
}

/// The file may be read.
pub(crate) fn check(uri: &str, member: &Member, limits: &Limits) -> Result<(), IoError> {
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

/// Where in a piece the content is: one that begins with the member's own header.
pub(crate) fn data_of(uri: &str, member: &Member, piece: &[u8]) -> Result<std::ops::Range<u64>, IoError> {
    let broken = || IoError::invalid(uri, "a broken header in the archive");
    let (Some(LOCAL_HEADER), Some(name), Some(extra)) =
        (number::<4>(piece, 0), number::<2>(piece, 26), number::<2>(piece, 28))
    else {
        return Err(broken());
    };
    if name != member.name_bytes as u64 {
        return Err(broken());
    }
    let start = LOCAL_HEADER_BYTES + name + extra;
    Ok(start..start.checked_add(member.packed).ok_or_else(broken)?)
}

/// Undoes the compression of a content.
pub(crate) fn unpack(uri: &str, member: &Member, packed: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, IoError> {
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
        return Err(IoError::invalid(uri, "not as its archive says: size or checksum is another"));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_beyond_any_file_are_broken() {
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
        assert_eq!(data_of("a", &with(7), &piece), Ok(30..37));
        assert!(data_of("a", &with(u64::MAX), &piece).is_err());
    }
}
