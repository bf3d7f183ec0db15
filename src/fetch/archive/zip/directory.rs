//! The central directory of a zip file (PKWARE's APPNOTE, 4.3.12 to 4.3.16), with its 64-bit parts. Parses bytes, does no I/O.

use std::borrow::Cow;

use crate::fetch::archive::span::{Span, le_uint};
use crate::fetch::{IoError, Limits};

/// The number of bytes at the end of the file that are searched for the end record. They hold the longest comment, both end
/// records, and the whole directory of a small archive.
pub(in crate::fetch::archive) const TAIL_BYTES: u64 = 128 << 10;

/// The error text if a name is missing in a directory that must contain it.
pub(in crate::fetch::archive) const DAMAGED_NAMES: &str =
    "damaged archive: names in its directory are not those of its files";

const END: u32 = 0x0605_4b50;
const END_64: u32 = 0x0606_4b50;
const LOCATOR_64: u32 = 0x0706_4b50;
const HEADER: u32 = 0x0201_4b50;
const END_BYTES: usize = 22;
const HEADER_BYTES: usize = 46;

/// The content of an end record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::fetch::archive) enum DirectoryEnd {
    /// The span of the directory, and its number of files.
    Directory(Span, u64),
    /// The span of the 64-bit end record of a large archive, which must be read next.
    Record(Span),
}

fn signature(bytes: &[u8], at: usize) -> Option<u32> {
    le_uint::<4>(bytes, at).map(|n| n as u32)
}

impl DirectoryEnd {
    /// Finds the end record in the last bytes of a file, which begin at offset `start`.
    pub fn find(uri: &str, tail: &[u8], start: u64) -> Result<Self, IoError> {
        let none = || IoError::invalid(uri, "no zip archive: its directory's end is missing");
        // The last signature whose comment reaches exactly to the end of the file.
        let at = (0..=tail.len().checked_sub(END_BYTES).ok_or_else(none)?)
            .rev()
            .find(|at| {
                signature(tail, *at) == Some(END)
                    && le_uint::<2>(tail, at + 20)
                        .is_some_and(|comment| at + END_BYTES + comment as usize == tail.len())
            })
            .ok_or_else(none)?;
        let (count, size, offset) =
            (le_uint::<2>(tail, at + 10), le_uint::<4>(tail, at + 12), le_uint::<4>(tail, at + 16));
        let (Some(count), Some(size), Some(offset)) = (count, size, offset) else { return Err(none()) };
        if count == 0xffff || size == 0xffff_ffff || offset == 0xffff_ffff {
            let locator = at.checked_sub(20).filter(|at| signature(tail, *at) == Some(LOCATOR_64));
            if let Some(offset) = locator.and_then(|at| le_uint::<8>(tail, at + 8)) {
                return Ok(Self::Record(Span { offset, size: 56 }));
            }
        }
        let directory = Span { offset, size };
        Self::inside(uri, directory, count, start + at as u64)
    }

    /// Parses the 64-bit end record of a large archive, which begins at `offset`.
    pub fn of_record(uri: &str, record: &[u8], offset: u64) -> Result<Self, IoError> {
        let numbers = (le_uint::<8>(record, 32), le_uint::<8>(record, 40), le_uint::<8>(record, 48));
        match (signature(record, 0), numbers) {
            (Some(END_64), (Some(count), Some(size), Some(at))) => {
                Self::inside(uri, Span { offset: at, size }, count, offset)
            }
            _ => Err(IoError::invalid(uri, "zip archive: its directory's end is broken")),
        }
    }

    fn inside(uri: &str, directory: Span, count: u64, end: u64) -> Result<Self, IoError> {
        match directory.end() {
            Some(e) if e <= end => Ok(Self::Directory(directory, count)),
            _ => Err(IoError::invalid(uri, "zip archive: its directory lies outside of it")),
        }
    }
}

/// The header of one file in an archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::fetch::archive) struct Member {
    /// Offset of its local header.
    pub offset: u64,
    /// Compressed size in bytes.
    pub packed: u64,
    /// Uncompressed size in bytes.
    pub size: u64,
    /// CRC-32 of the uncompressed content.
    pub crc: u32,
    /// Compression method (APPNOTE 4.4.5).
    pub method: u16,
    pub is_encrypted: bool,
    /// Lengths in bytes of the name and of the extra field.
    pub name_bytes: usize,
    pub extra_bytes: usize,
}

/// The central directory: its bytes as read, and the offsets of its headers sorted by name.
#[derive(Debug)]
pub(in crate::fetch::archive) struct ZipDirectory {
    bytes: Vec<u8>,
    headers: Vec<u32>,
    /// Offsets of the headers whose names need normalization, sorted by normalized name.
    renamed: Vec<u32>,
}

/// Normalizes a name. Some programs write backslashes (as .NET did on Windows) or a leading slash.
fn normalized(name: &[u8]) -> Cow<'_, [u8]> {
    if !name.contains(&b'\\') && !name.starts_with(b"/") {
        return Cow::Borrowed(name);
    }
    let slashes = name.iter().map(|byte| if *byte == b'\\' { b'/' } else { *byte });
    Cow::Owned(slashes.skip_while(|byte| *byte == b'/').collect())
}

/// Returns true if a name in an archive means the wanted file.
pub(super) fn is_name_of(name: &[u8], wanted: &str) -> bool {
    name == wanted.as_bytes() || normalized(name) == wanted.as_bytes()
}

impl ZipDirectory {
    /// Parses a directory that begins at offset `start` of the archive.
    pub fn read(uri: &str, bytes: Vec<u8>, start: u64, limits: &Limits) -> Result<Self, IoError> {
        let broken = |what: &str| IoError::invalid(uri, format!("zip archive: {what} in its directory"));
        let mut headers = Vec::new();
        let mut at = 0;
        while at < bytes.len() {
            let (member, end) = header(&bytes, at).ok_or_else(|| broken("a broken header"))?;
            // All later reads of members then stay inside the archive.
            if member.offset.checked_add(member.packed).is_none_or(|end| end > start) {
                return Err(broken("a member outside of it"));
            }
            headers.push(u32::try_from(at).map_err(|_| broken("more than 4 GiB"))?);
            if headers.len() > limits.max_elements {
                let (got, limit) = (headers.len() as u64, limits.max_elements as u64);
                return Err(IoError::TooLarge { uri: uri.to_owned(), what: "files in an archive", got, limit });
            }
            at = end;
        }
        let name = |at: &u32| name(&bytes, *at as usize).unwrap_or_default();
        // The sort is stable: of two headers with one name the later one stays last.
        headers.sort_by(|a, b| name(a).cmp(name(b)));
        let is_renamed = |at: &&u32| matches!(normalized(name(at)), Cow::Owned(_));
        let mut renamed: Vec<u32> = headers.iter().filter(is_renamed).copied().collect();
        renamed.sort_by_cached_key(|at| (normalized(name(at)).into_owned(), *at));
        Ok(Self { bytes, headers, renamed })
    }

    /// Returns true if the directory was parsed from these bytes.
    #[cfg(feature = "http")]
    pub fn was_parsed_from(&self, bytes: &[u8]) -> bool {
        self.bytes == bytes
    }

    /// Returns the memory that it takes, in bytes.
    pub fn bytes(&self) -> usize {
        self.bytes.len() + size_of_val(self.headers.as_slice()) + size_of_val(self.renamed.as_slice())
    }

    /// Returns the file of that name. If several have it, returns the last one.
    pub fn find(&self, wanted: &str) -> Option<Member> {
        let (of, wanted) = (|at: &u32| name(&self.bytes, *at as usize).unwrap_or_default(), wanted.as_bytes());
        let last = |sorted: &[u32], is_before: &dyn Fn(&u32) -> bool| {
            sorted.get(sorted.partition_point(is_before).checked_sub(1)?).copied()
        };
        let plain = last(&self.headers, &|at| of(at) <= wanted).filter(|at| of(at) == wanted);
        let renamed =
            || last(&self.renamed, &|at| *normalized(of(at)) <= *wanted).filter(|at| *normalized(of(at)) == *wanted);
        header(&self.bytes, plain.or_else(renamed)? as usize).map(|(member, _)| member)
    }
}

/// Returns the name in the central header at an offset.
pub(super) fn name(bytes: &[u8], at: usize) -> Option<&[u8]> {
    let length = le_uint::<2>(bytes, at + 28)? as usize;
    bytes.get(at + HEADER_BYTES..at + HEADER_BYTES + length)
}

/// Parses the central header at an offset. Returns it with the offset of the next header.
pub(super) fn header(bytes: &[u8], at: usize) -> Option<(Member, usize)> {
    (signature(bytes, at)? == HEADER).then_some(())?;
    let name_bytes = le_uint::<2>(bytes, at + 28)? as usize;
    let extra_bytes = le_uint::<2>(bytes, at + 30)? as usize;
    let comment_bytes = le_uint::<2>(bytes, at + 32)? as usize;
    let extra_at = at + HEADER_BYTES + name_bytes;
    let end = extra_at + extra_bytes + comment_bytes;
    (end <= bytes.len()).then_some(())?;
    let mut member = Member {
        offset: le_uint::<4>(bytes, at + 42)?,
        packed: le_uint::<4>(bytes, at + 20)?,
        size: le_uint::<4>(bytes, at + 24)?,
        crc: le_uint::<4>(bytes, at + 16)? as u32,
        method: le_uint::<2>(bytes, at + 10)? as u16,
        is_encrypted: le_uint::<2>(bytes, at + 8)? & 1 == 1,
        name_bytes,
        extra_bytes,
    };
    // Values beyond 32 bits are in the 64-bit extra field, in this order.
    let mut wide = zip64_field(bytes.get(extra_at..extra_at + extra_bytes)?);
    for value in [&mut member.size, &mut member.packed, &mut member.offset] {
        if *value == 0xffff_ffff {
            *value = le_uint::<8>(wide, 0)?;
            wide = wide.get(8..)?;
        }
    }
    Some((member, end))
}

/// Returns the content of the 64-bit extra field, or an empty slice without one.
pub(super) fn zip64_field(mut extra: &[u8]) -> &[u8] {
    while let (Some(id), Some(length)) = (le_uint::<2>(extra, 0), le_uint::<2>(extra, 2)) {
        let Some((field, rest)) = extra.get(4..).and_then(|e| e.split_at_checked(length as usize)) else { break };
        if id == 1 {
            return field;
        }
        extra = rest;
    }
    &[]
}
