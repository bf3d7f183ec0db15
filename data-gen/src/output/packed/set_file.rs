//! Puts the file of a packed set together from the files of its blocks and the tilesets in its folder. Memory is that of the
//! index of one block.

use std::fs::File;
use std::io::{BufWriter, Read as _, Seek as _, SeekFrom, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

use super::block_file::{ReadBlock, blocks_of};
use super::entry::{ENTRY_BYTES, Entry, key_of_name, level_of};
use crate::GenError;
use crate::output::set_files::each_folder;

/// The first bytes of a packed set.
pub(in crate::output) const MAGIC: &[u8; 8] = b"TERRPACK";
const VERSION: u32 = 1;
const HEADER_BYTES: u64 = 64;
/// The entries of a page of the index, which a reader loads as a whole: 20 kB.
const PAGE_ENTRIES: usize = 512;
/// The bytes of a page's row in the table of pages.
const ROW_BYTES: u64 = 16;

/// Writes the set in a folder as one file, and returns its size in bytes.
pub(in crate::output) fn write_packed_set(folder: &Path, archive: &Path) -> Result<u64, GenError> {
    let blocks = blocks_of(folder)?;
    let others = others_of(folder)?;
    let mut count = others.len() as u64;
    for (_, path) in &blocks {
        count += ReadBlock::open(path.clone())?.entries.len() as u64;
    }
    let failed = GenError::file(archive);
    let mut out = File::create(archive).map_err(GenError::file(archive))?;
    let mut index = Index::new(archive, count).map_err(failed)?;
    let mut offset = index.end();
    out.seek(SeekFrom::Start(offset)).map_err(GenError::file(archive))?;
    let mut others = add_others(&mut out, &mut offset, others).map_err(GenError::file(archive))?.into_iter().peekable();
    let levels = blocks.iter().map(|(root, _)| root.level).collect::<std::collections::BTreeSet<_>>();
    for level in 0..=25 {
        // The blocks that have the level: those with the finest roots that are not finer.
        let Some(root_level) = levels.range(..=level).next_back() else { continue };
        for (_, path) in blocks.iter().filter(|(root, _)| root.level == *root_level) {
            let block = ReadBlock::open(path.clone())?;
            let own: Vec<Entry> = block.entries.iter().copied().filter(|entry| level_of(entry.key) == level).collect();
            let Some(first) = own.first().map(|entry| entry.offset) else { continue };
            let size = own.iter().map(|entry| u64::from(entry.size)).sum::<u64>();
            copy(&block, first, size, &mut out).map_err(GenError::file(archive))?;
            for entry in own {
                while let Some(other) = others.next_if(|other| other.key < entry.key) {
                    index.add(other).map_err(GenError::file(archive))?;
                }
                let offset = offset + (entry.offset - first);
                index.add(Entry { offset, ..entry }).map_err(GenError::file(archive))?;
            }
            offset += size;
        }
    }
    others.try_for_each(|other| index.add(other)).map_err(GenError::file(archive))?;
    index.finish().map_err(GenError::file(archive))?;
    out.sync_all().map_err(GenError::file(archive))?;
    Ok(offset)
}

/// Copies bytes of a block's file to the end of the set's.
fn copy(block: &ReadBlock, first: u64, size: u64, out: &mut File) -> std::io::Result<()> {
    (&block.file).seek(SeekFrom::Start(first))?;
    match std::io::copy(&mut (&block.file).take(size), out)? {
        copied if copied == size => Ok(()),
        _ => Err(std::io::Error::other(format!("{} ends early", block.path.display()))),
    }
}

/// Returns the files of a set that no block has, by their keys: its tilesets and subtrees.
fn others_of(folder: &Path) -> Result<Vec<(u64, PathBuf)>, GenError> {
    let mut found = Vec::new();
    each_folder(folder, &mut |files: &[PathBuf]| {
        for path in files {
            let parts = path.strip_prefix(folder).unwrap_or(path).iter().map(|part| part.to_string_lossy());
            let key = key_of_name(&parts.collect::<Vec<_>>().join("/"));
            found.push((key.ok_or_else(|| GenError::invalid(path, "has no place in a packed set"))?, path.clone()));
        }
        Ok(())
    })?;
    found.sort();
    Ok(found)
}

/// Writes files without tiles, compressed, and returns their entries.
fn add_others(out: &mut File, offset: &mut u64, others: Vec<(u64, PathBuf)>) -> std::io::Result<Vec<Entry>> {
    let mut out = BufWriter::with_capacity(1 << 18, out);
    let mut entries = Vec::with_capacity(others.len());
    for (key, path) in others {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        std::io::copy(&mut File::open(path)?, &mut encoder)?;
        let bytes = encoder.finish()?;
        out.write_all(&bytes)?;
        let (size, checksum) = (bytes.len() as u32, crc32fast::hash(&bytes));
        entries.push(Entry { key, offset: *offset, size, checksum, error_m: 0.0, range_m: [0.0; 2] });
        *offset += bytes.len() as u64;
    }
    out.flush()?;
    Ok(entries)
}

/// The index of a set, written page by page in front of the files.
struct Index {
    out: BufWriter<File>,
    count: u64,
    page: Vec<u8>,
    table: Vec<u8>,
}

impl Index {
    /// Creates the index of a number of files. The file of the set exists.
    fn new(archive: &Path, count: u64) -> std::io::Result<Self> {
        let mut file = File::options().write(true).open(archive)?;
        let index = HEADER_BYTES + ROW_BYTES * count.div_ceil(PAGE_ENTRIES as u64);
        file.seek(SeekFrom::Start(index))?;
        Ok(Self { out: BufWriter::new(file), count, page: Vec::new(), table: Vec::new() })
    }

    /// Returns the offset behind the index.
    fn end(&self) -> u64 {
        HEADER_BYTES + ROW_BYTES * self.count.div_ceil(PAGE_ENTRIES as u64) + ENTRY_BYTES as u64 * self.count
    }

    fn add(&mut self, entry: Entry) -> std::io::Result<()> {
        self.page.extend(entry.to_bytes());
        if self.page.len() == PAGE_ENTRIES * ENTRY_BYTES { self.end_page() } else { Ok(()) }
    }

    fn end_page(&mut self) -> std::io::Result<()> {
        self.table.extend(self.page.get(..8).unwrap_or_default());
        self.table.extend(crc32fast::hash(&self.page).to_le_bytes());
        self.table.extend([0; 4]);
        self.out.write_all(&self.page)?;
        self.page.clear();
        Ok(())
    }

    /// Writes the table of pages, and at last the header.
    fn finish(mut self) -> std::io::Result<()> {
        if !self.page.is_empty() {
            self.end_page()?;
        }
        let mut header = MAGIC.to_vec();
        [VERSION, PAGE_ENTRIES as u32].iter().for_each(|field| header.extend(field.to_le_bytes()));
        let index = HEADER_BYTES + self.table.len() as u64;
        [self.count, HEADER_BYTES, index].iter().for_each(|field| header.extend(field.to_le_bytes()));
        header.extend(crc32fast::hash(&self.table).to_le_bytes());
        header.resize(HEADER_BYTES as usize - 4, 0);
        header.extend(crc32fast::hash(&header).to_le_bytes());
        self.out.seek(SeekFrom::Start(0))?;
        self.out.write_all(&header)?;
        self.out.write_all(&self.table)?;
        self.out.flush()
    }
}
