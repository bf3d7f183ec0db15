//! The central directory of a zip file (PKWARE's APPNOTE, 4.3.12 to 4.3.16), with its 64-bit parts.

use std::borrow::Cow;

use crate::io::{IoError, Limits};

/// The end of the file in which the directory's end is looked for: the longest comment and both end records, and room
/// for the whole directory of a small archive.
pub(crate) const TAIL_BYTES: u64 = 128 << 10;

/// What is said where a file's name is not in a directory that should have it.
pub(crate) const DAMAGED: &str = "damaged archive: names in its directory are not those of its files";

const END: u32 = 0x0605_4b50;
const END_64: u32 = 0x0606_4b50;
const LOCATOR_64: u32 = 0x0706_4b50;
const HEADER: u32 = 0x0201_4b50;
const END_BYTES: usize = 22;
const HEADER_BYTES: usize = 46;

/// A part of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Span {
    pub offset: u64,
    pub size: u64,
}

impl Span {
    fn end(&self) -> Option<u64> {
        self.offset.checked_add(self.size)
    }
}

/// What the end of an archive says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// Where the directory is, and of how many files it is.
    Directory(Span, u64),
    /// Where to read on: the end record of a large archive.
    Record(Span),
}

impl Span {
    /// This part of what was read from `start`, where it is all there.
    pub fn of(self, bytes: &[u8], start: u64) -> Option<&[u8]> {
        let from = usize::try_from(self.offset.checked_sub(start)?).ok()?;
        bytes.get(from..from.checked_add(usize::try_from(self.size).ok()?)?)
    }
}

/// A little-endian number.
pub(super) fn number<const N: usize>(bytes: &[u8], at: usize) -> Option<u64> {
    let digits: [u8; N] = bytes.get(at..at.checked_add(N)?)?.try_into().ok()?;
    Some(digits.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b)))
}

fn signature(bytes: &[u8], at: usize) -> Option<u32> {
    number::<4>(bytes, at).map(|n| n as u32)
}

impl End {
    /// Looks through the last bytes of a file, which begin at `start`.
    pub fn find(uri: &str, tail: &[u8], start: u64) -> Result<Self, IoError> {
        let none = || IoError::invalid(uri, "no zip archive: its directory's end is missing");
        // The last place whose comment reaches just to the end of the file.
        let at = (0..=tail.len().checked_sub(END_BYTES).ok_or_else(none)?)
            .rev()
            .find(|at| {
                signature(tail, *at) == Some(END)
                    && number::<2>(tail, at + 20).is_some_and(|comment| at + END_BYTES + comment as usize == tail.len())
            })
            .ok_or_else(none)?;
        let (count, size, offset) =
            (number::<2>(tail, at + 10), number::<4>(tail, at + 12), number::<4>(tail, at + 16));
        let (Some(count), Some(size), Some(offset)) = (count, size, offset) else { return Err(none()) };
        if count == 0xffff || size == 0xffff_ffff || offset == 0xffff_ffff {
            let locator = at.checked_sub(20).filter(|at| signature(tail, *at) == Some(LOCATOR_64));
            if let Some(offset) = locator.and_then(|at| number::<8>(tail, at + 8)) {
                return Ok(Self::Record(Span { offset, size: 56 }));
            }
        }
        let directory = Span { offset, size };
        Self::inside(uri, directory, count, start + at as u64)
    }

    /// From the end record of a large archive, which is at `offset`.
    pub fn of_record(uri: &str, record: &[u8], offset: u64) -> Result<Self, IoError> {
        let numbers = (number::<8>(record, 32), number::<8>(record, 40), number::<8>(record, 48));
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

/// What an archive holds of one file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Member {
    /// Where its own header is.
    pub offset: u64,
    /// Bytes in the archive.
    pub packed: u64,
    /// Bytes of the file.
    pub size: u64,
    pub crc: u32,
    pub method: u16,
    pub is_encrypted: bool,
    /// Bytes of its name and of what else the directory says.
    pub name_bytes: usize,
    pub extra_bytes: usize,
}

/// The directory: its bytes as they came, and where each header is, sorted by name.
#[derive(Debug)]
pub(crate) struct Directory {
    bytes: Vec<u8>,
    headers: Vec<u32>,
    /// Those whose names are not written as they should be, sorted by what is meant.
    odd: Vec<u32>,
}

/// What a name means: some programs write backslashes (as .NET's on Windows did), or names from the root.
fn meant(name: &[u8]) -> Cow<'_, [u8]> {
    if !name.contains(&b'\\') && !name.starts_with(b"/") {
        return Cow::Borrowed(name);
    }
    let slashes = name.iter().map(|byte| if *byte == b'\\' { b'/' } else { *byte });
    Cow::Owned(slashes.skip_while(|byte| *byte == b'/').collect())
}

/// A name in an archive is that of the wanted file.
pub(super) fn is_name_of(name: &[u8], wanted: &str) -> bool {
    name == wanted.as_bytes() || meant(name) == wanted.as_bytes()
}

impl Directory {
    /// Takes the bytes of a directory that begins at `start`.
    pub fn read(uri: &str, bytes: Vec<u8>, start: u64, limits: &Limits) -> Result<Self, IoError> {
        let broken = |what: &str| IoError::invalid(uri, format!("zip archive: {what} in its directory"));
        let mut headers = Vec::new();
        let mut at = 0;
        while at < bytes.len() {
            let (member, end) = header(&bytes, at).ok_or_else(|| broken("a broken header"))?;
            // What is read later stays inside the archive.
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
        // Stable: of two with one name the later is last.
        headers.sort_by(|a, b| name(a).cmp(name(b)));
        let mut odd: Vec<u32> = headers.iter().filter(|at| matches!(meant(name(at)), Cow::Owned(_))).copied().collect();
        odd.sort_by_cached_key(|at| (meant(name(at)).into_owned(), *at));
        Ok(Self { bytes, headers, odd })
    }

    /// These bytes are those of this one.
    #[cfg(feature = "http")]
    pub fn is_of(&self, bytes: &[u8]) -> bool {
        self.bytes == bytes
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        self.bytes.len() + size_of_val(self.headers.as_slice()) + size_of_val(self.odd.as_slice())
    }

    /// The file of that name; of several, the last.
    pub fn find(&self, wanted: &str) -> Option<Member> {
        let (of, wanted) = (|at: &u32| name(&self.bytes, *at as usize).unwrap_or_default(), wanted.as_bytes());
        let last = |sorted: &[u32], is_before: &dyn Fn(&u32) -> bool| {
            sorted.get(sorted.partition_point(is_before).checked_sub(1)?).copied()
        };
        let plain = last(&self.headers, &|at| of(at) <= wanted).filter(|at| of(at) == wanted);
        let odd = || last(&self.odd, &|at| *meant(of(at)) <= *wanted).filter(|at| *meant(of(at)) == *wanted);
        header(&self.bytes, plain.or_else(odd)? as usize).map(|(member, _)| member)
    }
}

pub(super) fn name(bytes: &[u8], at: usize) -> Option<&[u8]> {
    let length = number::<2>(bytes, at + 28)? as usize;
    bytes.get(at + HEADER_BYTES..at + HEADER_BYTES + length)
}

/// The header at a place, and where the next one is.
pub(super) fn header(bytes: &[u8], at: usize) -> Option<(Member, usize)> {
    (signature(bytes, at)? == HEADER).then_some(())?;
    let name_bytes = number::<2>(bytes, at + 28)? as usize;
    let extra_bytes = number::<2>(bytes, at + 30)? as usize;
    let comment_bytes = number::<2>(bytes, at + 32)? as usize;
    let extra_at = at + HEADER_BYTES + name_bytes;
    let end = extra_at + extra_bytes + comment_bytes;
    (end <= bytes.len()).then_some(())?;
    let mut member = Member {
        offset: number::<4>(bytes, at + 42)?,
        packed: number::<4>(bytes, at + 20)?,
        size: number::<4>(bytes, at + 24)?,
        crc: number::<4>(bytes, at + 16)? as u32,
        method: number::<2>(bytes, at + 10)? as u16,
        is_encrypted: number::<2>(bytes, at + 8)? & 1 == 1,
        name_bytes,
        extra_bytes,
    };
    // What does not fit into 32 bits is in an extra field, in this order.
    let mut wide = wide_field(bytes.get(extra_at..extra_at + extra_bytes)?);
    for value in [&mut member.size, &mut member.packed, &mut member.offset] {
        if *value == 0xffff_ffff {
            *value = number::<8>(wide, 0)?;
            wide = wide.get(8..)?;
        }
    }
    Some((member, end))
}

/// The content of the 64-bit extra field; empty without one.
pub(super) fn wide_field(mut extra: &[u8]) -> &[u8] {
    while let (Some(id), Some(length)) = (number::<2>(extra, 0), number::<2>(extra, 2)) {
        let Some((field, rest)) = extra.get(4..).and_then(|e| e.split_at_checked(length as usize)) else { break };
        if id == 1 {
            return field;
        }
        extra = rest;
    }
    &[]
}
