//! The header of a packed set and the table of the pages of its index. Parses bytes, does no I/O.

use super::page::{ENTRY_BYTES, IndexPage, PackedEntry};
use crate::fetch::archive::span::{Span, le_uint};
use crate::fetch::{IoError, Limits};

/// The number of bytes that are read first. They hold the header, and the whole index of small sets.
pub(in crate::fetch::archive) const HEAD_BYTES: u64 = 16 << 10;
const MAGIC: &[u8] = b"TERRPACK";
const HEADER_BYTES: u64 = 64;
/// The bytes of a page's row in the table.
const ROW_BYTES: u64 = 16;
/// The maximum number of entries of a page: 1.3 MB.
const MAX_PAGE_ENTRIES: u64 = 1 << 15;

/// The parsed header.
#[derive(Clone, Copy, Debug)]
pub(in crate::fetch::archive) struct PackedHeader {
    page_entries: u64,
    entries: u64,
    /// The span of the table of pages.
    pub table: Span,
    index: Span,
    table_checksum: u32,
}

impl PackedHeader {
    /// Parses the first bytes of a set whose file has `file_bytes` bytes.
    pub fn read(uri: &str, head: &[u8], file_bytes: u64, limits: &Limits) -> Result<Self, IoError> {
        let broken = |what: &str| IoError::invalid(uri, format!("packed set: {what}"));
        if !head.starts_with(MAGIC) {
            return Err(broken("its magic is missing"));
        }
        match le_uint::<4>(head, 8) {
            Some(1) => {}
            Some(other) => return Err(IoError::unsupported(uri, format!("a packed set of version {other}"))),
            None => return Err(broken("it ends early")),
        }
        let Some(header) = head.get(..HEADER_BYTES as usize) else { return Err(broken("it ends early")) };
        let (content, checksum) = header.split_at(HEADER_BYTES as usize - 4);
        if le_uint::<4>(checksum, 0) != Some(crc32fast::hash(content).into()) {
            return Err(broken("the checksum of its header is wrong"));
        }
        let field = |at| le_uint::<8>(header, at).unwrap_or(0);
        let page_entries = le_uint::<4>(header, 12).unwrap_or(0);
        let (entries, table, index) = (field(16), field(24), field(32));
        let table_checksum = le_uint::<4>(header, 40).unwrap_or(0) as u32;
        if !(1..=MAX_PAGE_ENTRIES).contains(&page_entries) {
            return Err(broken("a page of its index has no entries, or too many"));
        }
        let size = |count: u64, bytes: u64| count.checked_mul(bytes);
        let pages = entries.div_ceil(page_entries);
        let (Some(table_bytes), Some(index_bytes)) = (size(pages, ROW_BYTES), size(entries, ENTRY_BYTES)) else {
            return Err(broken("it has too many files"));
        };
        let (table, index) = (Span { offset: table, size: table_bytes }, Span { offset: index, size: index_bytes });
        let is_inside = |span: Span| span.offset >= HEADER_BYTES && span.end().is_some_and(|end| end <= file_bytes);
        if !is_inside(table) || !is_inside(index) {
            return Err(broken("its index reaches beyond its end"));
        }
        limits.check_file_bytes(uri, table.size)?;
        Ok(Self { page_entries, entries, table, index, table_checksum })
    }
}

/// The header, and the first key and the checksum of each page of the index.
#[derive(Debug)]
pub(in crate::fetch::archive) struct PackedDirectory {
    header: PackedHeader,
    /// First keys and checksums.
    pages: Vec<(u64, u32)>,
    /// Files lie before this offset.
    file_bytes: u64,
}

impl PackedDirectory {
    /// Parses the table of pages.
    pub fn read(uri: &str, header: PackedHeader, table: &[u8], file_bytes: u64) -> Result<Self, IoError> {
        let broken = |what: &str| IoError::invalid(uri, format!("packed set: {what}"));
        if table.len() as u64 != header.table.size {
            return Err(broken("it ends early"));
        }
        if crc32fast::hash(table) != header.table_checksum {
            return Err(broken("the checksum of its table of pages is wrong"));
        }
        let (rows, _) = table.as_chunks::<{ ROW_BYTES as usize }>();
        let row = |row: &[u8; ROW_BYTES as usize]| {
            (le_uint::<8>(row, 0).unwrap_or(0), le_uint::<4>(row, 8).unwrap_or(0) as u32)
        };
        let pages: Vec<(u64, u32)> = rows.iter().map(row).collect();
        if !pages.is_sorted_by(|a, b| a.0 < b.0) {
            return Err(broken("the pages of its index are not in order"));
        }
        Ok(Self { header, pages, file_bytes })
    }

    /// Returns the memory that the table takes, in bytes.
    pub fn bytes(&self) -> usize {
        self.pages.len() * size_of::<(u64, u32)>()
    }

    /// Returns the span of the page that has a key if any has it, and the page's number.
    pub fn page_of(&self, key: u64) -> Option<(Span, usize)> {
        let number = self.pages.partition_point(|(first, _)| *first <= key).checked_sub(1)?;
        let PackedHeader { page_entries, entries, index, .. } = self.header;
        let before = number as u64 * page_entries;
        let count = page_entries.min(entries - before);
        Some((Span { offset: index.offset + before * ENTRY_BYTES, size: count * ENTRY_BYTES }, number))
    }

    /// Parses a page of the index by its number.
    pub fn page(&self, uri: &str, number: usize, bytes: &[u8]) -> Result<IndexPage, IoError> {
        let broken = |what: &str| IoError::invalid(uri, format!("packed set: page {number} of its index {what}"));
        let Some((first, checksum)) = self.pages.get(number).copied() else { return Err(broken("is missing")) };
        if crc32fast::hash(bytes) != checksum {
            return Err(broken("has a wrong checksum"));
        }
        let page = IndexPage::read(bytes);
        match page.first_key() {
            Some(key) if key == first && page.is_sorted() => Ok(page),
            _ => Err(broken("is not in order")),
        }
    }

    /// Fails unless a file lies inside of the set.
    pub fn check_span(&self, uri: &str, entry: &PackedEntry, limits: &Limits) -> Result<(), IoError> {
        limits.check_file_bytes(uri, entry.span.size)?;
        if entry.span.end().is_none_or(|end| end > self.file_bytes) {
            return Err(IoError::invalid(uri, "lies beyond the end of the packed set"));
        }
        Ok(())
    }
}

/// Fails unless the bytes of a file have the checksum of its entry.
pub(in crate::fetch::archive) fn check_content(uri: &str, entry: &PackedEntry, bytes: &[u8]) -> Result<(), IoError> {
    if bytes.len() as u64 != entry.span.size {
        return Err(IoError::invalid(uri, "the packed set ends early"));
    }
    let checksum = crc32fast::hash(bytes);
    if checksum != entry.checksum {
        let reason =
            format!("its checksum is {checksum:08x}, and {:08x} in the index of the packed set", entry.checksum);
        return Err(IoError::invalid(uri, reason));
    }
    Ok(())
}

/// Parses any bytes as a packed set and looks up its files. Entry point of the fuzz tests.
#[cfg(feature = "testing")]
pub fn fuzz_packed(bytes: &[u8], limits: &Limits) {
    let read = || {
        let header = PackedHeader::read("fuzz", bytes, bytes.len() as u64, limits)?;
        let table = header.table.slice_of(bytes, 0).unwrap_or_default();
        let directory = PackedDirectory::read("fuzz", header, table, bytes.len() as u64)?;
        for key in [0, 1, u64::MAX].into_iter().chain(directory.pages.iter().map(|(first, _)| *first)).take(100) {
            let Some((span, number)) = directory.page_of(key) else { continue };
            let page = directory.page("fuzz", number, span.slice_of(bytes, 0).unwrap_or_default())?;
            if let Some(entry) = page.find(key) {
                directory.check_span("fuzz", &entry, limits)?;
                check_content("fuzz", &entry, entry.span.slice_of(bytes, 0).unwrap_or_default())?;
            }
        }
        Ok::<(), IoError>(())
    };
    if let Err(error) = read() {
        assert!(!error.reason().is_empty());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(key: u64) -> Vec<u8> {
        let mut entry = key.to_le_bytes().to_vec();
        entry.extend(0u64.to_le_bytes());
        entry.resize(ENTRY_BYTES as usize, 0);
        entry
    }

    /// Returns a set of files without bytes, with two entries on a page.
    fn set(keys: &[u64]) -> Vec<u8> {
        let pages: Vec<Vec<u8>> =
            keys.chunks(2).map(|keys| keys.iter().flat_map(|key| entry(*key)).collect()).collect();
        let mut table = Vec::new();
        for (page, keys) in pages.iter().zip(keys.chunks(2)) {
            table.extend(keys[0].to_le_bytes());
            table.extend(crc32fast::hash(page).to_le_bytes());
            table.extend([0; 4]);
        }
        let mut out = MAGIC.to_vec();
        [1u32, 2].iter().for_each(|field| out.extend(field.to_le_bytes()));
        let index = HEADER_BYTES + table.len() as u64;
        [keys.len() as u64, HEADER_BYTES, index].iter().for_each(|field| out.extend(field.to_le_bytes()));
        out.extend(crc32fast::hash(&table).to_le_bytes());
        out.resize(HEADER_BYTES as usize - 4, 0);
        out.extend(crc32fast::hash(&out).to_le_bytes());
        [out, table, pages.concat()].concat()
    }

    fn open(bytes: &[u8]) -> Result<PackedDirectory, IoError> {
        let header = PackedHeader::read("a.terrane", bytes, bytes.len() as u64, &Limits::default())?;
        let table = header.table.slice_of(bytes, 0).unwrap_or_default();
        PackedDirectory::read("a.terrane", header, table, bytes.len() as u64)
    }

    #[test]
    fn files_are_found_by_their_keys() {
        let keys = [0, 3, 9, 10, 4000];
        let bytes = set(&keys);
        let directory = open(&bytes).unwrap();
        for key in 0..4100u64 {
            let found = directory.page_of(key).and_then(|(span, number)| {
                directory.page("a.terrane", number, span.slice_of(&bytes, 0).unwrap()).unwrap().find(key)
            });
            assert_eq!(found.is_some(), keys.contains(&key), "{key}");
        }
        assert!(open(&set(&[])).unwrap().page_of(5).is_none());
    }

    #[test]
    fn damage_is_an_error_that_names_the_file() {
        let bytes = set(&[0, 3, 9, 10, 4000]);
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x20;
            let read = || {
                let directory = open(&damaged)?;
                for key in [0, 9, 4000] {
                    let Some((span, number)) = directory.page_of(key) else { continue };
                    directory.page("a.terrane", number, span.slice_of(&damaged, 0).unwrap_or_default())?;
                }
                Ok::<(), IoError>(())
            };
            // Bytes of the table that are reserved are in its checksum.
            assert!(read().unwrap_err().to_string().contains("a.terrane"), "{at}");
        }
        for size in 0..HEADER_BYTES as usize {
            assert!(open(&bytes[..size]).is_err(), "{size}");
        }
    }

    #[test]
    fn sizes_are_bounded_before_anything_is_allocated() {
        let with = |fields: [u64; 3], page_entries: u32| {
            let mut out = MAGIC.to_vec();
            [1u32, page_entries].iter().for_each(|field| out.extend(field.to_le_bytes()));
            fields.iter().for_each(|field| out.extend(field.to_le_bytes()));
            out.resize(HEADER_BYTES as usize - 4, 0);
            out.extend(crc32fast::hash(&out).to_le_bytes());
            PackedHeader::read("t", &out, 1 << 60, &Limits::default()).map(|_| ())
        };
        assert!(with([0, 64, 64], 512).is_ok());
        for (fields, page_entries) in [
            ([u64::MAX, 64, 64], 1),
            ([u64::MAX / ENTRY_BYTES, 64, 1 << 61], 512),
            ([1, 0, 64], 512),
            ([1, 64, u64::MAX], 512),
            ([1, 64, 64], 0),
            ([1, 64, 64], u32::MAX),
            // A table of more bytes than a file may have.
            ([1 << 40, 64, 64], 1),
        ] {
            assert!(with(fields, page_entries).is_err(), "{fields:?} {page_entries}");
        }
    }
}
